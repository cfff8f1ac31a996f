"""Pillars of a gdstk cell; :meth:`metafab.layout.PillarMap.to_gdstk` makes such cells."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from metafab.mask.read import ReadBack, read
from metafab.spec import Design

if TYPE_CHECKING:
    import gdstk

#: A gdstk cell is in micrometres.
_UNIT_M, _NM_M = 1e-6, 1e-9


def from_gdstk(cell: gdstk.Cell, design: Design) -> ReadBack:
    """Recover the pillars of a gdstk cell, in micrometres, as :func:`metafab.mask.read` does those of a file.

    The lens is centred on the origin; cells that ``cell`` places are included. Errors as :func:`metafab.mask.read`.
    """
    import gdstk

    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{design.name}.gds"
        library = gdstk.Library(unit=_UNIT_M, precision=design.mask.database_unit_nm * _NM_M)
        library.add(cell, *cell.dependencies(True))
        library.write_gds(path)
        return read(path, design)
