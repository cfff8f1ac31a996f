"""Dose classes: each class of pillars has its own datatype; tables with the dose of each datatype."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.layout import PillarMap, PillarTile
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.mask.drawing.cells import top_name
from metafab.spec import Design, Dose

#: Files that give the dose of each datatype.
DOSE_TABLES = ("doses.csv", "doses.jdi", "doses.txt")
#: Corrected mask whose datatypes are doses.
DOSE_DATATYPES = "doses.gds"


class DoseClasses:
    """Splits tiles by dose class.

    The classes divide the range of areas, or of densities, over the whole mask evenly; they do not depend on tiles.

    Args:
        pillars: the drawn pillars; read once if classes go by size or density.
        dose: number and kind of the classes; None for a single class.
        outline: outline of the pillars, for their areas.
        of_site: shape (n_y, n_x) of the lattice, class of each site; for classes by proximity, and only for them.

    Raises:
        InputError: classes by proximity without ``of_site``, ``of_site`` with other classes, of another shape, or with
            a class that does not exist.
    """

    def __init__(
        self,
        pillars: PillarMap,
        dose: Dose | None,
        outline: Outline = RECTANGLE,
        of_site: NDArray[np.uint8] | None = None,
    ) -> None:
        self._count = 1 if dose is None else dose.classes
        self._of_size: NDArray[np.int64] | None = None
        self._of_site = of_site
        _require_classes(pillars.lattice.shape, dose, of_site)
        if dose is None or of_site is not None:
            return
        area = outline.area(pillars.size_dbu)
        if dose.by == "size":
            drawn = np.zeros(area.size, dtype=bool)
            for tile in pillars.tiles():
                drawn[tile.size_index] = True
            drawn[0] = False
            self._of_size = _classes(area, area[drawn], dose.classes)
            return
        lattice = pillars.lattice
        self._block_columns, self._block_rows = [
            max(1, round(dose.block_um * 1e3 / side)) for side in lattice.period_nm
        ]
        covered = np.zeros((-(-lattice.shape[0] // self._block_rows), -(-lattice.shape[1] // self._block_columns)))
        for tile in pillars.tiles():
            np.add.at(covered, self._blocks(tile), area[tile.size_index])
        self._of_block = _classes(covered, covered[covered > 0], dose.classes)

    def split(self, tile: PillarTile) -> Iterator[tuple[int, PillarTile]]:
        """Yield each class that occurs, and its pillars; a single class yields the tile itself."""
        if self._count == 1:
            yield 0, tile
            return
        index = tile.size_index
        classes = self._classes_of(tile)
        for number in np.flatnonzero(np.bincount(classes[index > 0])).tolist():
            yield number, PillarTile(tile.row, tile.column, np.where(classes == number, index, np.uint16(0)))

    def _classes_of(self, tile: PillarTile) -> NDArray[np.integer]:
        """Class of each site of a tile, shape (n_y, n_x)."""
        if self._of_site is not None:
            n_y, n_x = tile.size_index.shape
            return self._of_site[tile.row : tile.row + n_y, tile.column : tile.column + n_x]
        return self._of_block[self._blocks(tile)] if self._of_size is None else self._of_size[tile.size_index]

    def _blocks(self, tile: PillarTile) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Density block of each row, shape (n_y, 1), and of each column, shape (1, n_x), of a tile."""
        n_y, n_x = tile.size_index.shape
        rows, columns = tile.row + np.arange(n_y), tile.column + np.arange(n_x)
        return (rows // self._block_rows)[:, None], (columns // self._block_columns)[None]


def dose_patterns(design: Design, of_site: Sequence[NDArray[np.uint8]]) -> tuple[int, ...]:
    """Number the distinct arrays of dose classes, shape (n_y, n_x) each; empty for a single one.

    They are given for each lens, or once for all.

    InputError for another number of arrays.
    """
    lenses = max(1, len(design.mask.copies))
    if len(of_site) not in {0, 1, lenses}:
        expected = f"dose classes of each of {lenses} lenses, or of one for all"
        raise InputError.single("mask", "dose_class", expected, f"{len(of_site)} arrays")
    first = {id(array): number for number, array in reversed(list(enumerate(of_site)))}
    return tuple(first[id(array)] for array in of_site) if len(first) > 1 else ()


def datatype_doses(design: Design, class_dose: FloatArray | None = None) -> dict[int, float]:
    """Dose of each exposed datatype relative to the base dose; ``class_dose``, shape (classes,), of each class."""
    mask = design.mask
    if mask.tone != "negative":  # The field is exposed, at one dose, on datatype 0 of its layer.
        return {0: mask.doses[0]}
    of_class = np.ones(mask.dose_classes) if class_dose is None else class_dose
    return dict(enumerate(np.outer(mask.doses, of_class).ravel().tolist(), start=mask.datatype))


def dose_tables(design: Design, class_dose: FloatArray | None = None) -> dict[str, list[str]]:
    """Dose of each exposed datatype relative to the base dose.

    As a table, as the shot modulation of JEOL writers, and as rows of layer, datatype and dose for pattern converters.

    ``class_dose`` is the dose of each class, shape (classes,); None if not known: the table holds the copies' doses
    alone. With classes of several lenses the table has the numbers of the lenses that use a datatype. Returns lines of
    each of :data:`DOSE_TABLES`; empty where no dose is known.
    """
    mask = design.mask
    if class_dose is None and mask.doses == (1.0,):
        return {}
    table = list(datatype_doses(design, class_dose).items())
    rows = ["datatype,dose_over_base_dose", *(f"{datatype},{dose:.6f}" for datatype, dose in table)]
    if class_dose is not None and len(mask.copies) > 1:
        users = [" ".join(str(n) for n, copy in enumerate(mask.copies, 1) if copy.dose == dose) for dose in mask.doses]
        columns = ["copies", *(lenses for lenses in users for _ in class_dose)]
        rows = [f"{row},{lenses}" for row, lenses in zip(rows, columns, strict=True)]
    # The shot rank is the datatype, the modulation a change of dose in percent.
    ranks = [f"({datatype:4d}, {100.0 * (dose - 1.0):8.3f} )" for datatype, dose in table]
    name = f"{top_name(design.name)}: MODULAT ("
    starts = [name, *["-  , "] * (len(ranks) - 1)]
    ends = [""] * (len(ranks) - 1) + [")"]
    modulation = [start + rank + end for start, rank, end in zip(starts, ranks, ends, strict=True)]
    layer = mask.layer if mask.tone == "negative" else mask.field_layer
    assignment = [f"{layer} {datatype} {dose:.6f}" for datatype, dose in table]
    return dict(zip(DOSE_TABLES, (rows, modulation, assignment), strict=True))


def _require_classes(shape: tuple[int, int], dose: Dose | None, of_site: NDArray[np.uint8] | None) -> None:
    """Check that classes of sites are given for classes by proximity, and only for them."""
    proximity = dose is not None and dose.by == "proximity"
    if proximity and of_site is None:
        remedy = "write the mask without it, then run `metafab expose LAYOUT --design DESIGN.toml --correct -o DIR`"
        raise InputError.single("mask", "dose.by", "'size' or 'density'", "'proximity' without classes", remedy)
    if of_site is None:
        return
    if not proximity:
        raise InputError.single("mask", "dose.by", "'proximity' for given classes", repr(dose and dose.by))
    if of_site.shape != shape:
        raise InputError.single("mask", "dose_class", f"shape {shape} of the lattice", f"shape {of_site.shape}")
    if dose is not None and of_site.size and int(of_site.max()) >= dose.classes:
        raise InputError.single("mask", "dose_class", f"classes below {dose.classes}", f"{int(of_site.max())}")


def _classes(value: FloatArray, of: FloatArray, count: int) -> NDArray[np.int64]:
    """Class of each value: the range of ``of``, divided into ``count`` equal parts."""
    low, high = (float(of.min()), float(of.max())) if of.size else (0.0, 0.0)
    if high <= low:
        return np.zeros(value.shape, dtype=np.int64)
    share = (value - low) / (high - low)
    return np.clip((share * count).astype(np.int64), 0, count - 1)
