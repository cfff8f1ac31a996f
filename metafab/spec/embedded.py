"""Unit cell stored in a built library file."""

from __future__ import annotations

import tomllib
from pathlib import Path

from metafab.core.storage import hdf5
from metafab.spec.cell import UnitCell
from metafab.spec.toml import validate

LIBRARY_KIND = "metafab library"
LIBRARY_FORMAT = 1


def unit_cell_of_library(path: Path) -> UnitCell:
    """The unit-cell spec stored in ``path`` (attribute ``unit_cell_toml``).

    Raises:
        InputError: the file is missing, truncated, foreign or of a newer format.
    """
    remedy = "build it with `metafab library build UNITCELL.toml`"
    with hdf5.open_kind(path, kind=LIBRARY_KIND, format_version=LIBRARY_FORMAT, remedy=remedy) as file:
        table = tomllib.loads(str(file.attrs["unit_cell_toml"]))
    return validate(UnitCell, table, str(path))
