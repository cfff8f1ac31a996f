"""Display of results in a console and a notebook, and results as labelled arrays of xarray, an optional package."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from metafab.core.errors import MissingToolError

if TYPE_CHECKING:
    import xarray

#: Module whose function ``picture(result)`` returns an HTML picture of a result, or "". It is named here and imported
#: when a notebook asks for a picture, because packages of results do not import the one that draws.
PICTURES = "metafab.report.cards"
#: Dimensions, values and unit of one variable; "" for a pure number.
Variable = tuple[tuple[str, ...], ArrayLike, str]


class Displayed:
    """Mixin of results with a short ``repr`` and an HTML representation for Jupyter.

    A frozen dataclass that inherits from it is declared with ``repr=False`` and defines :meth:`key_figures`.
    """

    def key_figures(self) -> dict[str, str]:
        """Names and formatted values of the result's key figures, most important first."""
        raise NotImplementedError

    def __repr__(self) -> str:
        figures = ", ".join(f"{name}: {value}" for name, value in self.key_figures().items())
        return f"{type(self).__name__}({figures})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in self.key_figures().items()
        )
        picture: str = import_module(PICTURES).picture(self)
        title = f"<b>{type(self).__name__}</b>"
        figures = f"<div>{title}<table>{rows}</table></div>"
        return f'<div style="display:flex;gap:1.5em;align-items:center">{picture}{figures}</div>'


def dataset(
    variables: Mapping[str, Variable], coordinates: Mapping[str, ArrayLike], **attributes: Any
) -> xarray.Dataset:
    """Make an xarray dataset of variables by name: dimensions, values of any shape, unit.

    Coordinates are dimension -> values of shape (n,); their unit is the suffix of the name. MissingToolError without
    xarray.
    """
    try:
        import xarray
    except ImportError as error:
        raise MissingToolError("`to_xarray` needs xarray: pip install 'metafab[notebook]'") from error
    data = {name: (dims, values, {"units": unit}) for name, (dims, values, unit) in variables.items()}
    return xarray.Dataset(data, {name: ((name,), values) for name, values in coordinates.items()}, attributes)
