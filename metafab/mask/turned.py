"""Turned pillars of a mask file: rectangles at an angle, recognised by their vertices."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from metafab.core.parallel.progress import Progress, silent
from metafab.layout import PillarMap, lattice_of
from metafab.layout.geometry import whole_dbu
from metafab.layout.outlines import IntArray, Outline, canonical_polygon
from metafab.layout.turned import turned_rectangle
from metafab.mask.drawing.copies import biases_dbu, lens_copies
from metafab.mask.read import ReadBack, read
from metafab.mask.shapes.known import KnownShapes
from metafab.spec import Design

#: Drawn width and length in database units, and angle in degrees.
_Kind = tuple[int, int, float]


def read_turned(path: Path, design: Design, angles: int, progress: Progress = silent, copy: int = 1) -> ReadBack:
    """Read turned pillars from a GDSII or OASIS file, as :func:`metafab.mask.read` reads upright ones.

    Args:
        path: the file.
        design: lattice, layer, unit and bias; drawn sides lie on the size grid of its library.
        angles: angles in half a turn that pillars may have.
        progress: called while the file is read.
        copy: lens of ``mask.copies``, counted from 1.

    Returns:
        The contents of the file; its pillars have angles, and rectangles of other sizes or angles count as foreign.

    Raises:
        InputError: as :func:`metafab.mask.read`.
    """
    outlines = _RecognisedOutlines.of_turned(design, angles)
    back = read(path, design, progress, copy, known=KnownShapes(outlines))
    return replace(back, pillars=outlines.decoded(back.pillars))


@dataclass(frozen=True, eq=False)
class _RecognisedOutlines(Outline):
    """Turned rectangles that a design may draw; each kind met in a file gets a number.

    Readers and :class:`metafab.mask.shapes.recover.Recovery` carry a shape as (width, length). Here this pair encodes
    the kind's number, which :meth:`decoded` resolves.

    Attributes:
        angle_step_deg: angles are its multiples below 90 degrees.
        smallest_dbu: smallest width and length of the library.
        grid_dbu: step of widths and lengths.
        biases_dbu: biases that the lenses of the mask are drawn with.
        per_width: numbers that share one encoded width.
    """

    angle_step_deg: float = 1.0
    smallest_dbu: tuple[int, int] = (0, 0)
    grid_dbu: int = 1
    biases_dbu: tuple[int, ...] = (0,)
    per_width: int = 1
    _numbers: dict[_Kind, int] = field(default_factory=dict)
    _next_number: Iterator[int] = field(default_factory=itertools.count)

    @classmethod
    def of_turned(cls, design: Design, angles: int) -> _RecognisedOutlines:
        """Outlines of a design's turned pillars, drawn with its biases."""
        sweep, unit_nm = design.unit_cell.sweep, design.mask.database_unit_nm
        width_dbu = whole_dbu(sweep.width_nm[0], unit_nm, "sweep.width_nm")
        length_dbu = whole_dbu(sweep.length_nm[0], unit_nm, "sweep.length_nm")
        bias_dbu = whole_dbu(design.mask.bias_nm, unit_nm, "mask.bias_nm", even=True)
        return cls(
            "rectangle",
            unit_nm,
            angle_step_deg=180.0 / angles,
            smallest_dbu=(width_dbu, length_dbu),
            grid_dbu=whole_dbu(sweep.size_grid_nm, unit_nm, "sweep.size_grid_nm"),
            biases_dbu=tuple(bias_dbu + copy_dbu for copy_dbu in biases_dbu(lens_copies(design))),
            per_width=lattice_of(design).cell_dbu[1] // 2,
        )

    @property
    def is_rectangle(self) -> bool:
        """False: sides do not lie along x and y."""
        return False

    def size_of(self, polygon: IntArray) -> tuple[int, int] | None:
        """Encoded kind of a polygon, shape (n, 2), anywhere on the grid; None for other shapes."""
        ring = canonical_polygon(polygon)
        if len(ring) != 4:
            return None
        # Counter-clockwise from the lowest corner, the first side is the width: its angle lies in [0, 90) degrees.
        sides = np.diff(ring[:3], axis=0)
        measured_deg = math.degrees(math.atan2(sides[0, 1], sides[0, 0]))
        angle_deg = round(measured_deg / self.angle_step_deg) * self.angle_step_deg
        measured_dbu = np.hypot(*sides.T)
        for bias_dbu in self.biases_dbu:
            first_dbu = np.array(self.smallest_dbu) + bias_dbu
            size_dbu = first_dbu + np.rint((measured_dbu - first_dbu) / self.grid_dbu).astype(np.int64) * self.grid_dbu
            width, length = size_dbu.tolist()
            drawn = canonical_polygon(turned_rectangle(width, length, angle_deg))
            if np.array_equal(2 * drawn, 2 * ring - ring[0] - ring[2]):
                kind = width, length, angle_deg
                number = self._numbers.get(kind)
                if number is None:  # Threads that meet a kind at once draw a number each; the first one holds.
                    number = self._numbers.setdefault(kind, next(self._next_number))
                across, along = divmod(number, self.per_width)
                return 2 * (across + 1), 2 * (along + 1)
        return None

    def decoded(self, encoded: PillarMap) -> PillarMap:
        """The map with the widths, lengths and angles that its encoded sizes stand for, in ascending order."""
        kind_of = {number: kind for kind, number in self._numbers.items()}
        numbers = (encoded.size_dbu[1:] // 2 - 1) @ np.array([self.per_width, 1])
        kinds = np.array([(0, 0, 0.0), *(kind_of[number] for number in numbers.tolist())])
        order = np.lexsort(kinds.T[::-1])
        rank = np.argsort(order).astype(np.uint16)
        return PillarMap.from_array(
            encoded.lattice,
            kinds[order, :2].astype(np.int32),
            rank[encoded.to_array()],
            encoded.tile_sites,
            kinds[order, 2],
        )
