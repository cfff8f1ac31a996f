"""Turned pillars of a mask file: rectangles at an angle, recognised by their vertices."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.scratch import release, scratch
from metafab.layout import PillarMap, lattice_of
from metafab.layout.geometry import whole_dbu
from metafab.layout.outlines import IntArray, Outline, canonical_polygon
from metafab.layout.turned import turned_rectangles, turned_sizes
from metafab.mask.drawing.copies import biases_dbu, lens_copies
from metafab.mask.read import ReadBack, read
from metafab.mask.shapes.recover import KnownShapes
from metafab.spec import Design

#: Rows of sites that are numbered anew at a time.
_ROWS = 256


def read_turned(path: Path, design: Design, angles: int, progress: Progress = silent, copy: int = 1) -> ReadBack:
    """Read turned pillars from a GDSII or OASIS file, as :func:`metafab.mask.read` reads upright ones.

    Args:
        design: lattice, layer, unit, bias and rules; widths and lengths lie on the size grid of its library.
        angles: angles in half a turn that pillars may have.
        copy: lens of ``mask.copies``, counted from 1.

    Returns:
        The contents of the file; its pillars have angles, and rectangles of other sizes or angles count as foreign.

    Raises:
        InputError: as :func:`metafab.mask.read`.
    """
    outlines = _TurnedOutlines.of_turned(design, angles)
    back = read(path, design, progress, copy, known=KnownShapes(outlines))
    return replace(back, pillars=outlines.decoded(back.pillars))


@dataclass(frozen=True, eq=False)
class _TurnedOutlines(Outline):
    """All turned rectangles that a design may draw, by their vertices.

    Readers and :class:`metafab.mask.shapes.recover.Recovery` carry a shape as (width, length). Here this pair encodes
    the number of a kind that the file holds, which :meth:`decoded` resolves.
    """

    #: Shape (n, 3), drawn width and length in database units and angle in degrees.
    kinds: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    #: Row of ``kinds`` by the bytes of the vertices from the first one.
    kind_of: dict[bytes, int] = field(default_factory=dict)
    numbers_per_width: int = 1  #: Numbers that share one encoded width.
    _numbers: dict[int, int] = field(default_factory=dict)
    _next_number: Iterator[int] = field(default_factory=itertools.count)

    @classmethod
    def of_turned(cls, design: Design, angles: int) -> _TurnedOutlines:
        """Rectangles of all sizes and angles that keep the design's rules, drawn with its biases."""
        size_dbu, angle_deg = turned_sizes(design, angles, design.unit_cell.sweep.size_grid_nm)
        unit_nm = design.mask.database_unit_nm
        mask_bias_dbu = whole_dbu(design.mask.bias_nm, unit_nm, "mask.bias_nm", even=True)
        biases = [mask_bias_dbu + copy_bias_dbu for copy_bias_dbu in biases_dbu(lens_copies(design))]
        kinds = np.concatenate([np.column_stack([size_dbu[1:] + bias_dbu, angle_deg[1:]]) for bias_dbu in biases])
        rings = turned_rectangles(kinds[:, :2].astype(np.int64), kinds[:, 2])
        kind_of = {ring.tobytes(): kind for kind, ring in enumerate(rings - rings[:, :1])}
        per_width = lattice_of(design).cell_dbu[1] // 2
        return cls("rectangle", unit_nm, kinds=kinds, kind_of=kind_of, numbers_per_width=per_width)

    @property
    def is_rectangle(self) -> bool:
        """False: the sides do not lie along x and y."""
        return False

    def size_of(self, polygon: IntArray) -> tuple[int, int] | None:
        """Encoded kind of a polygon, shape (n, 2), anywhere on the grid; None for other shapes."""
        ring = canonical_polygon(polygon)
        kind = self.kind_of.get((ring - ring[:1]).tobytes())
        if kind is None:
            return None
        number = self._numbers.get(kind)
        if number is None:  # Threads that meet a kind at once draw a number each; the first one holds.
            number = self._numbers.setdefault(kind, next(self._next_number))
        across, along = divmod(number, self.numbers_per_width)
        return 2 * (across + 1), 2 * (along + 1)

    def decoded(self, encoded: PillarMap) -> PillarMap:
        """The map with the widths, lengths and angles of its encoded sizes, in ascending order."""
        kind_of = {number: kind for kind, number in self._numbers.items()}
        numbers = (encoded.size_dbu[1:] // 2 - 1) @ np.array([self.numbers_per_width, 1])
        rows = np.array([kind_of[number] for number in numbers.tolist()], dtype=np.intp)
        kinds = np.concatenate([np.zeros((1, 3)), self.kinds[rows]])
        order = np.lexsort(kinds.T[::-1])
        rank, index = np.argsort(order).astype(np.uint16), scratch(encoded.lattice.shape, np.uint16)
        for row, band in encoded.bands(_ROWS):
            index[row : row + len(band)] = rank[band]
            release(index)
        size_dbu = kinds[order, :2].astype(np.int32)
        return PillarMap.from_array(encoded.lattice, size_dbu, index, encoded.tile_sites, kinds[order, 2])
