"""Energy in the resist at every pillar of a lens, tile by tile."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.parallel.executor import in_order, kept_threads, spread
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.beside import Beside, BesideEnergy
from metafab.exposure.energy.far import LONG_PERIODS, LongRange, MiddleRange, block_masses
from metafab.exposure.energy.near import add_near, near_tables
from metafab.exposure.energy.shapes import Shapes
from metafab.layout import PillarMap
from metafab.layout.outlines import RECTANGLE, Outline

Scalar = TypeVar("Scalar", bound=np.generic)

#: Sites a side of a tile.
TILE_SITES = 512
#: Shortest range that reaches beyond the nearest neighbours, in distances of these.
_MIDDLE_PERIODS = 0.3
#: (rows, columns) of sites whose energy is summed in closed form: all nearer than two lattice spacings. Columns
#: of a hexagonal lattice are half of that distance apart.
_NEAR, _NEAR_HEXAGONAL = (1, 1), (2, 3)
#: Largest energy of a large pad that each Gaussian of a direct sum leaves out beyond its reach.
_LEFT_OUT = 1e-9


@dataclass(frozen=True)
class TileEnergy:
    """Energy on one tile, in units of that of a large pad at dose 1."""

    rows: slice  #: Lattice rows of the tile.
    columns: slice  #: Lattice columns of the tile.
    size_index: NDArray[np.uint16]  #: Shape (n_y, n_x).
    dose: Float32Array  #: Shape (n_y, n_x).
    centre: Float32Array  #: Shape (n_y, n_x), at the centre of each pillar.
    others: Float32Array  #: Shape (2, n_y, n_x), energy of all other pillars, mean of both x edges and of both y edges.


class ResistEnergy:
    """Energy in the resist at every pillar of a pattern, for any doses; the outline is no cross and no ring.

    Attributes:
        beside: lenses and shapes that are exposed with the pattern; None for none.
    """

    beside: Beside | None = None

    def __init__(self, pillars: PillarMap, psf: BeamPsf, outline: Outline = RECTANGLE) -> None:
        lattice = self._lattice = pillars.lattice
        self.psf, self._pillars = psf, pillars
        self.shapes = Shapes.of(pillars, outline)
        self.size_nm = self.shapes.size_nm
        self.size_index = pillars.to_array()
        self.period_nm = lattice.period_nm
        smallest = lattice.spacing_nm
        reach = _NEAR_HEXAGONAL if lattice.hexagonal else _NEAR
        self._near = near_tables(psf.between(0.0, LONG_PERIODS * smallest), self.shapes, lattice, reach)
        middle = psf.between(_MIDDLE_PERIODS * smallest, LONG_PERIODS * smallest)
        self._middle = MiddleRange.of(middle, self.period_nm, TILE_SITES, reach)
        self._long_psf = psf.between(LONG_PERIODS * smallest, math.inf)
        self._area = self.shapes.area_nm2.astype(np.float32)
        self._spread = (self.shapes.area_nm2 * self.shapes.sides_nm.T**2 / 24.0).astype(np.float32)
        self._edge = np.ascontiguousarray(self.size_nm.T**2 / 8.0, dtype=np.float32)
        n_y, n_x = lattice.shape
        blocks = [
            (slice(row, min(row + TILE_SITES, n_y)), slice(column, min(column + TILE_SITES, n_x)))
            for row, column in lattice.tile_corners(TILE_SITES)
        ]
        #: Rows and columns of the tiles that hold pillars.
        self.tiles = tuple(block for block in blocks if self.size_index[block].any())

    def among(self, beside: Beside | None) -> ResistEnergy:
        """The same pattern with everything that is exposed with it."""
        found = copy(self)
        found.beside = beside
        return found

    def map_tiles(
        self,
        dose: Float32Array,
        executor: Executor,
        work: Callable[[TileEnergy], FloatArray],
        tiles: Sequence[tuple[slice, slice]] | None = None,
    ) -> Iterator[tuple[tuple[slice, slice], FloatArray]]:
        """Compute the energy of each tile and apply ``work`` to it, in threads; yield rows, columns and its array.

        Doses, shape (n_y, n_x) of the lattice, are relative to the base dose. ``tiles`` are some of the tiles; all by
        default.
        """
        pattern = (self.psf, self._lattice, self.size_nm, dose)
        further = None if self.beside is None else BesideEnergy(self.beside, *pattern)
        long_range = self._long_range(dose, executor, further)

        def both(block: tuple[slice, slice]) -> tuple[tuple[slice, slice], FloatArray]:
            return block, work(self._tile(dose, long_range, further, block))

        yield from in_order(executor, both, self.tiles if tiles is None else tiles)

    def direct(self, dose: Float32Array, row: int, column: int) -> FloatArray:
        """Compute the energy at one pillar as a direct sum over all in reach, the reference of :meth:`map_tiles`.

        Doses have the shape (n_y, n_x) of the lattice and are relative to the base dose. The energy, shape (3,), is
        that at the centre, the mean of the x edges and that of the y edges; the pillar itself included.
        """
        w, length = self.size_nm[self.size_index[row, column]]
        points = np.array([[0.0, 0.0], [0.5 * w, 0.0], [-0.5 * w, 0.0], [0.0, 0.5 * length], [0.0, -0.5 * length]])
        points += 1e3 * np.array([self._lattice.x_um()[column], self._lattice.y_um()[row]])
        energy = self._direct(dose, points)
        if self.beside is not None:
            reach_nm = float(self._reach_nm.max())
            further = replace(self.beside, lenses=())
            gaussians = (self.psf.weight, self.psf.range_nm, self._reach_nm)
            box_nm = np.concatenate([points.min(axis=0) - reach_nm, points.max(axis=0) + reach_nm])
            for rectangles, doses in further.parts(dose, box_nm):
                energy += _sum_rectangles(rectangles, doses, *gaussians, points)
            for lens in self.beside.lenses:
                same = lens.pillars is self._pillars
                other = self if same else ResistEnergy(lens.pillars, self.psf, self.beside.outline)
                of_sites, factor = lens.doses_and_factor(dose, self.beside.lens_dose)
                energy += factor * other._direct(of_sites, points - np.array(lens.at_nm))
        return np.array([energy[0], energy[1:3].mean(), energy[3:].mean()])

    def _direct(self, dose: Float32Array, points_nm: FloatArray) -> FloatArray:
        """Energy of the pillars at points near one another, shape (n, 2), from the axis of the lens: shape (n,)."""
        reach_nm = float(self._reach_nm.max()) + float(self.size_nm.max())
        part, first_nm = [], []
        for axis, at_um in enumerate((self._lattice.x_um(), self._lattice.y_um())):
            low, high = 1e-3 * (points_nm[:, axis].min() - reach_nm), 1e-3 * (points_nm[:, axis].max() + reach_nm)
            part.append(slice(*np.searchsorted(at_um, [low, high]).tolist()))
            first_nm.append(1e3 * at_um[min(part[-1].start, at_um.size - 1)])
        block = (part[1], part[0])
        pattern = (self.size_index[block], dose[block], float(self.size_nm.max()), *self.period_nm)
        rows = np.zeros((pattern[0].shape[0], len(points_nm)))
        with kept_threads():
            spread(_sum_rows, len(rows), *pattern, *self._rectangles, points_nm - np.array(first_nm), rows)
        return np.asarray(rows.sum(axis=0))

    @cached_property
    def _reach_nm(self) -> FloatArray:
        """Distance beyond which a direct sum leaves out each Gaussian, shape (n,): a pad beyond it has 1e-9."""
        return np.asarray(self.psf.range_nm * np.sqrt(np.log(np.maximum(np.abs(self.psf.weight) / _LEFT_OUT, 1.0))))

    @cached_property
    def _rectangles(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Ranges of Gaussians and their reaches, shape (n,), and the rectangles of all sizes: shape (n, n_sizes, 4).

        A rectangle has its weight, its half width and its lower and upper end. Round outlines have steps of half the
        size of those in the tables, so that the difference from :meth:`direct` shows the error of both.
        """
        ranges, reaches, table = [], [], []
        for weight, beta, reach in zip(self.psf.weight, self.psf.range_nm, self._reach_nm, strict=True):
            for part in self.shapes.parts(beta, finer=2):
                ranges.append(beta)
                reaches.append(reach)
                table.append(np.stack([weight * part.share, part.half_width_nm, part.low_nm, part.high_nm], axis=1))
        return np.array(ranges), np.array(reaches), np.array(table)

    def _long_range(self, dose: Float32Array, executor: Executor, further: BesideEnergy | None) -> LongRange | None:
        if self._long_psf.range_nm.size == 0:
            return None
        rows = range(0, self.size_index.shape[0], TILE_SITES)

        def band(row: int) -> FloatArray:
            part = slice(row, row + TILE_SITES)
            return block_masses(np.asarray(self._area[self.size_index[part]] * dose[part], dtype=np.float64))

        masses = np.concatenate(list(in_order(executor, band, rows)))
        return LongRange.of(self._long_psf, masses, self.period_nm) if further is None else further.long_range(masses)

    def _tile(
        self,
        dose: Float32Array,
        long_range: LongRange | None,
        further: BesideEnergy | None,
        block: tuple[slice, slice],
    ) -> TileEnergy:
        rows, columns = block
        near = self._near
        margin = self._middle.margin if self._middle is not None else max(near.reach)
        index = _with_margin(self.size_index, rows, columns, margin)
        doses = _with_margin(dose, rows, columns, margin)
        if self._middle is None:
            n_y, n_x = rows.stop - rows.start, columns.stop - columns.start
            energy = np.zeros((3, n_y, n_x), dtype=np.float32)
        else:
            spread_x, spread_y = self._spread[0][index] * doses, self._spread[1][index] * doses
            edge = self._edge[:, self.size_index[block]]
            energy = self._middle.energy(self._area[index] * doses, spread_x, spread_y, edge)
        if long_range is not None:
            energy += long_range.at(rows, columns)
        if further is not None:
            further.add(rows, columns, self.size_index[block], energy)
        inner = tuple(slice(margin - r, n - margin + r) for r, n in zip(near.reach, index.shape, strict=True))
        tables = (near.centre, near.edge_x, near.edge_y, near.width_of, near.length_of)
        add_near(index[inner], doses[inner], *tables, near.reach, energy)
        return TileEnergy(rows, columns, self.size_index[block], dose[block], energy[0], energy[1:])


def _with_margin(values: NDArray[Scalar], rows: slice, columns: slice, margin: int) -> NDArray[Scalar]:
    """A block with a margin of sites, zero outside of the lattice."""
    n_y, n_x = values.shape
    top, bottom = max(0, rows.start - margin), min(n_y, rows.stop + margin)
    left, right = max(0, columns.start - margin), min(n_x, columns.stop + margin)
    shape = (rows.stop - rows.start + 2 * margin, columns.stop - columns.start + 2 * margin)
    result = np.zeros(shape, dtype=values.dtype)
    y, x = top - rows.start + margin, left - columns.start + margin
    result[y : y + bottom - top, x : x + right - left] = values[top:bottom, left:right]
    return result


@compiled
def _sum_rows(
    first: int,
    stop: int,
    size_index: NDArray[np.uint16],
    dose: Float32Array,
    largest_nm: float,
    period_x_nm: float,
    period_y_nm: float,
    range_nm: FloatArray,
    reach_nm: FloatArray,
    rectangles: FloatArray,
    points_nm: FloatArray,
    energy: FloatArray,
) -> None:
    """Add each row's energy at ``points_nm`` (n, 2), from the centre of the first site, to ``energy`` (n_rows, n).

    Rectangles are those of :attr:`ResistEnergy._rectangles`. A Gaussian is left out beyond its reach.
    """
    for row in range(first, stop):
        for column in range(size_index.shape[1]):
            size = size_index[row, column]
            if size == 0:
                continue
            for k in range(len(points_nm)):
                x = points_nm[k, 0] - column * period_x_nm
                y = points_nm[k, 1] - row * period_y_nm
                # From the nearest point that the largest shape may have.
                distance = math.hypot(x, y) - math.sqrt(0.5) * largest_nm
                total = 0.0
                for n in range(range_nm.size):
                    if distance > reach_nm[n]:
                        continue
                    beta = range_nm[n]
                    weight, half, low, high = rectangles[n, size]
                    along_x = math.erf((x + half) / beta) - math.erf((x - half) / beta)
                    along_y = math.erf((y - low) / beta) - math.erf((y - high) / beta)
                    total += 0.25 * weight * along_x * along_y
                energy[row, k] += dose[row, column] * total


@compiled
def _sum_rectangles(
    rectangles: FloatArray,
    doses: FloatArray,
    weight: FloatArray,
    range_nm: FloatArray,
    reach_nm: FloatArray,
    points_nm: FloatArray,
) -> FloatArray:
    """Energy of rectangles (left, bottom, right, top) at ``points_nm`` (n, 2): shape (n,)."""
    energy = np.zeros(len(points_nm))
    for number in range(len(rectangles)):
        left, bottom, right, top = rectangles[number]
        for k in range(len(points_nm)):
            x, y = points_nm[k]
            away = max(left - x, x - right, bottom - y, y - top)
            for n in range(range_nm.size):
                if away > reach_nm[n]:
                    continue
                beta = range_nm[n]
                along_x = math.erf((x - left) / beta) - math.erf((x - right) / beta)
                along_y = math.erf((y - bottom) / beta) - math.erf((y - top) / beta)
                energy[k] += 0.25 * doses[number] * weight[n] * along_x * along_y
    return energy
