"""Results as labelled arrays of xarray, an optional package."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from metafab.core.errors import MissingToolError

if TYPE_CHECKING:
    import xarray

#: Dimensions, values and unit of one variable; "" for a pure number.
Variable = tuple[tuple[str, ...], ArrayLike, str]


def dataset(
    variables: Mapping[str, Variable], coordinates: Mapping[str, ArrayLike], **attributes: Any
) -> xarray.Dataset:
    """Make an xarray dataset of variables by name: dimensions, values of any shape, unit. MissingToolError without it.

    Coordinates are dimension -> values of shape (n,); their unit is the suffix of the name.
    """
    try:
        import xarray
    except ImportError as error:
        raise MissingToolError("`to_xarray` needs xarray: pip install 'metafab[notebook]'") from error
    data = {name: (dims, values, {"units": unit}) for name, (dims, values, unit) in variables.items()}
    return xarray.Dataset(data, {name: ((name,), values) for name, values in coordinates.items()}, attributes)
