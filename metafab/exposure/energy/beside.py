"""Energy at the pillars of a lens from everything else on the wafer: other lenses, frame, text, test structures.

Every shape is a sum of rectangles. Ranges below two lattice spacings are summed in closed form, over the rectangles
nearer than four ranges. Wider ones see the rectangles as masses on a grid: a node gets the integral of its cubic
cardinal function, which keeps moments up to the third, and errs by 0.3 (step / range)^4 of the peak: 1e-3 on nodes half
a lattice spacing apart, and 1e-3 on the blocks of :mod:`metafab.exposure.energy.far`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.far import BLOCK_SITES, LONG_PERIODS, REACH, LongRange
from metafab.exposure.energy.shapes import Shapes
from metafab.layout import Lattice, PillarMap
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.mask.writing import strips

#: Range up to which rectangles are summed in closed form (lattice spacings), and their reach (ranges).
_CLOSED_PERIODS, _CLOSED_REACH = 2.0, 4.0
#: Nodes of the grid per lattice spacing; rows of another lens that are read at once.
_NODES, _BAND = 2.0, 512
#: Height of the strips of another lens' round pillars (nm).
_STRIP_NM = 10.0


@dataclass(frozen=True, eq=False)
class OtherLens:
    """Another lens of the wafer, on an equal lattice."""

    pillars: PillarMap  #: Its drawn pillars.
    at_nm: tuple[float, float]  #: (x, y) of its axis from the axis of the lens in question.
    dose: float = 1.0  #: Its dose relative to the base dose, a factor on that of each pillar.
    number: int = 0  #: Its number on the wafer.
    #: Shape (n_y, n_x) of the lattice, doses of its pillars; None for those of the lens in question at the same sites.
    doses: Float32Array | None = None

    def doses_and_factor(self, dose: Float32Array, lens_dose: float) -> tuple[Float32Array, float]:
        """Doses of its pillars, shape (n_y, n_x), and a factor on all; ``dose`` is that of the lens in question."""
        return (dose, self.dose / lens_dose) if self.doses is None else (self.doses, self.dose)


@dataclass(frozen=True, eq=False)
class Beside:
    """Everything that is exposed with a lens."""

    lenses: tuple[OtherLens, ...] = ()  #: Other lenses.
    #: Shape (n, 4), left, bottom, right and top of further rectangles, from the axis of the lens.
    rectangles_nm: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    outline: Outline = RECTANGLE  #: Outline of the pillars of all lenses.
    lens_dose: float = 1.0  #: Dose of the lens in question, already a factor in the doses of its pillars.
    rectangle_dose: float = 1.0  #: Dose of the rectangles relative to the base dose.

    def per_dose(self, lens_dose: float) -> Beside:
        """Return these shapes with doses relative to that of the lens in question."""
        return replace(self, lens_dose=lens_dose, rectangle_dose=1.0 / lens_dose)

    def with_doses(self, doses: Mapping[int, Float32Array], lens_dose: float) -> Beside:
        """Return these shapes with new doses, shape (n_y, n_x), of other lenses by number, and a new ``lens_dose``."""
        lenses = tuple(replace(lens, doses=doses.get(lens.number, lens.doses)) for lens in self.lenses)
        return replace(self, lenses=lenses, lens_dose=lens_dose)

    def with_pillars(self, pillars: PillarMap) -> Beside:
        """All other lenses with these pillars."""
        return replace(self, lenses=tuple(replace(lens, pillars=pillars) for lens in self.lenses))

    def parts(
        self, dose: Float32Array, box_nm: FloatArray, *, exact: bool = False
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Rectangles, shape (n, 4), with their doses, shape (n,), that reach into a box (left, bottom, right, top).

        ``dose``, shape (n_y, n_x) of the lattice, is that of the pillars of the lens. Round pillars are strips where
        ``exact``, otherwise rectangles of equal second moments.
        """
        inside = (self.rectangles_nm[:, :2] < box_nm[2:]).all(axis=1)
        inside &= (self.rectangles_nm[:, 2:] > box_nm[:2]).all(axis=1)
        yield self.rectangles_nm[inside], np.full(np.count_nonzero(inside), self.rectangle_dose)
        for lens in self.lenses:
            drawn, share, first = self._drawn(lens.pillars, exact)
            of_site, factor = lens.doses_and_factor(dose, self.lens_dose)
            lattice, index = lens.pillars.lattice, lens.pillars.to_array()
            x_nm, y_nm = 1e3 * lattice.x_um() + lens.at_nm[0], 1e3 * lattice.y_um() + lens.at_nm[1]
            reach = np.abs(drawn).max(initial=0.0)
            columns = np.flatnonzero((x_nm > box_nm[0] - reach) & (x_nm < box_nm[2] + reach))
            rows = np.flatnonzero((y_nm > box_nm[1] - reach) & (y_nm < box_nm[3] + reach))
            for start in range(0, rows.size if columns.size else 0, _BAND):
                row, column = np.nonzero(index[rows[start : start + _BAND, None], columns])
                row, column = rows[start + row], columns[column]
                size = index[row, column]
                count = first[size + 1] - first[size]
                pillar = np.repeat(np.arange(size.size), count)
                part = np.arange(pillar.size) - np.repeat(np.cumsum(count) - count - first[size], count)
                centre = np.stack([x_nm[column], y_nm[row]], axis=1)[pillar]
                doses = factor * of_site[row, column] * share[size]
                yield drawn[part] + np.tile(centre, 2), doses[pillar]

    def _drawn(self, pillars: PillarMap, exact: bool) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
        """Rectangles of all sizes about the site, share of the dose of each size, first rectangle of each size."""
        shapes = Shapes.of(pillars, self.outline)
        if exact and shapes.quadrants_nm:
            polygons = self.outline.polygons(pillars.size_dbu.astype(np.int64))
            unit_nm = pillars.lattice.database_unit_nm
            drawn = [strips(np.multiply(polygon, unit_nm, dtype=np.float64), _STRIP_NM) for polygon in polygons]
            return np.concatenate(drawn), np.ones(len(drawn)), np.cumsum([0, *map(len, drawn)])
        half = 0.5 * shapes.sides_nm
        share = shapes.area_nm2 / np.maximum(shapes.sides_nm.prod(axis=1), 1e-9)
        return np.concatenate([-half, half], axis=1), share, np.arange(len(half) + 1)


class BesideEnergy:
    """Energy of the shapes beside a lens, at its pillars, for one dose of these.

    Args:
        beside: the shapes.
        psf: beam.
        lattice: lattice of the lens.
        size_nm: shape (n_sizes, 2), widths and lengths of the pillars.
        dose: shape (n_y, n_x) of the lattice.
    """

    def __init__(self, beside: Beside, psf: BeamPsf, lattice: Lattice, size_nm: FloatArray, dose: Float32Array) -> None:
        spacing = lattice.spacing_nm
        self._closed = psf.between(0.0, _CLOSED_PERIODS * spacing)
        self._fine = psf.between(_CLOSED_PERIODS * spacing, LONG_PERIODS * spacing)
        self._long = psf.between(LONG_PERIODS * spacing, math.inf)
        self._lattice, self._size_nm, self._step_nm = lattice, size_nm, spacing / _NODES
        self._x_nm, self._y_nm = 1e3 * lattice.x_um(), 1e3 * lattice.y_um()
        sites = np.array([self._x_nm[0], self._y_nm[0], self._x_nm[-1], self._y_nm[-1]])

        def parts(reach_nm: float, *, exact: bool) -> tuple[FloatArray, FloatArray]:
            found = list(beside.parts(dose, sites + reach_nm * np.array([-1, -1, 1, 1]), exact=exact))
            return np.concatenate([one for one, _ in found]), np.concatenate([one for _, one in found])

        edge_nm = 0.5 * float(size_nm.max())
        self._near = parts(_CLOSED_REACH * _largest(self._closed) + edge_nm, exact=True)
        self._middle = parts(REACH * _largest(self._fine), exact=False)
        self._pad, self._blocks = (0, 0), np.zeros((0, 0))
        if self._long.range_nm.size:
            step_nm = BLOCK_SITES * np.array(lattice.period_nm)
            pad = np.ceil(REACH * _largest(self._long) / step_nm).astype(int) + 3
            first_nm = sites[:2] + step_nm * (0.5 - 0.5 / BLOCK_SITES - pad)
            count = -(-np.array(lattice.shape[::-1]) // BLOCK_SITES) + 2 * pad
            box_nm = np.concatenate([first_nm, first_nm + step_nm * (count - 1)])
            masses = _masses(beside.parts(dose, box_nm), box_nm, step_nm, (int(count[1]), int(count[0])))
            # A node has no width, a block spreads its mass over its sides: subtract a 24th of the second differences.
            rough = masses.copy()
            for axis in (0, 1):
                masses -= np.diff(np.pad(rough, [(1, 1) if k == axis else (0, 0) for k in (0, 1)]), 2, axis) / 24.0
            self._pad, self._blocks = (int(pad[1]), int(pad[0])), masses

    def long_range(self, block_mass: FloatArray) -> LongRange | None:
        """Energy of the long ranges, of the lens and of all shapes beside it.

        ``block_mass``, nm^2, shape (blocks_y, blocks_x), holds the masses of the blocks of the lens.
        """
        pads = [(pad, pad) for pad in self._pad]
        found = LongRange.of(self._long, np.pad(block_mass, pads) + self._blocks, self._lattice.period_nm)
        assert found is not None
        inner = tuple(slice(pad, pad + count) for pad, count in zip(self._pad, block_mass.shape, strict=True))
        return LongRange(found.energy[inner])

    def add(self, rows: slice, columns: slice, size_index: NDArray[np.uint16], energy: Float32Array) -> None:
        """Add the energy of all ranges but the long ones on a tile: shape (3, n_y, n_x), centre, x edges, y edges."""
        x_nm, y_nm = self._x_nm[columns], self._y_nm[rows]
        sites = np.array([x_nm[0], y_nm[0], x_nm[-1], y_nm[-1]])
        for weight, beta in zip(self._closed.weight, self._closed.range_nm, strict=True):
            reach_nm = _CLOSED_REACH * beta + 0.5 * float(self._size_nm.max())
            rectangles, doses = _touching(self._near, sites, reach_nm)
            _add_closed(rectangles, weight * doses, size_index, self._size_nm, x_nm, y_nm, beta, reach_nm, energy)
        reach_nm = REACH * _largest(self._fine)
        rectangles, doses = _touching(self._middle, sites, reach_nm)
        if not len(rectangles) or not self._fine.range_nm.size:
            return
        low = np.maximum(rectangles[:, :2].min(axis=0), sites[:2] - reach_nm) - 3.0 * self._step_nm
        high = np.minimum(rectangles[:, 2:].max(axis=0), sites[2:] + reach_nm) + 3.0 * self._step_nm
        count = np.ceil((high - low) / self._step_nm).astype(int) + 1
        box_nm, step_nm = np.concatenate([low, low + self._step_nm * (count - 1)]), np.full(2, self._step_nm)
        masses = _masses([(rectangles, doses)], box_nm, step_nm, (int(count[1]), int(count[0])))
        nodes = [low[axis] + self._step_nm * np.arange(count[axis]) for axis in (0, 1)]
        # The mean over both edges adds (size / 2)^2 / 2 times the second derivative.
        eighth = (self._size_nm.T**2 / 8.0)[:, size_index]
        for weight, beta in zip(self._fine.weight, self._fine.range_nm, strict=True):
            along_x, along_y = (_profile(at, node, beta) for at, node in zip((x_nm, y_nm), nodes, strict=True))
            plain, curved = (profile @ masses for profile in along_y)
            centre = plain @ along_x[0].T
            energy[0] += weight * centre
            energy[1] += weight * (centre + eighth[0] * (plain @ along_x[1].T))
            energy[2] += weight * (centre + eighth[1] * (curved @ along_x[0].T))


def _largest(psf: BeamPsf) -> float:
    return float(psf.range_nm.max(initial=0.0))


def _touching(parts: tuple[FloatArray, FloatArray], box_nm: FloatArray, reach_nm: float) -> tuple[FloatArray, ...]:
    """The rectangles and doses that reach into a box grown by ``reach_nm``."""
    rectangles, doses = parts
    inside = (rectangles[:, :2] < box_nm[2:] + reach_nm).all(axis=1)
    inside &= (rectangles[:, 2:] > box_nm[:2] - reach_nm).all(axis=1)
    return rectangles[inside], doses[inside]


def _profile(at_nm: FloatArray, node_nm: FloatArray, beta: float) -> tuple[FloatArray, FloatArray]:
    """Gaussian of unit integral and its second derivative at ``at_nm`` from nodes: shape (n, n_nodes) each."""
    square = ((at_nm[:, None] - node_nm) / beta) ** 2
    value = np.exp(-square) / (math.sqrt(math.pi) * beta)
    return value, value * (4.0 * square - 2.0) / beta**2


def _masses(
    parts: Iterator[tuple[FloatArray, FloatArray]] | list[tuple[FloatArray, FloatArray]],
    box_nm: FloatArray,
    step_nm: FloatArray,
    shape: tuple[int, int],
) -> FloatArray:
    """Masses (dose times area, nm^2) of rectangles on nodes, the first and the last at the ends of a box."""
    masses = np.zeros(shape)
    for rectangles, doses in parts:
        # The outermost intervals have no node on one side.
        cut = np.clip(rectangles, np.tile(box_nm[:2] + step_nm, 2), np.tile(box_nm[2:] - step_nm, 2))
        _add_masses((cut - np.tile(box_nm[:2], 2)) / np.tile(step_nm, 2), doses * step_nm.prod(), masses)
    return masses


@compiled
def _add_weights(low: float, high: float, weights: FloatArray) -> tuple[int, int]:
    """Write the integrals of the nodes' cardinal functions over an interval; return the first node and the end.

    Nodes are 0, 1, ... Two Gauss points in each piece no longer than a step are exact for cubics, not across nodes.
    """
    first, end = max(0, int(np.floor(low)) - 1), min(weights.size, int(np.floor(high)) + 3)
    weights[first:end] = 0.0
    pieces = max(1, int(np.ceil(high - low)))
    length = (high - low) / pieces
    for piece in range(pieces):
        for side in (-1.0, 1.0):
            place = low + (piece + 0.5 + side / np.sqrt(12.0)) * length
            node = min(max(int(np.floor(place)), 1), weights.size - 3)
            t = place - node
            weights[node - 1] -= 0.5 * length * t * (t - 1.0) * (t - 2.0) / 6.0
            weights[node] += 0.5 * length * (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0
            weights[node + 1] -= 0.5 * length * (t + 1.0) * t * (t - 2.0) / 2.0
            weights[node + 2] += 0.5 * length * (t + 1.0) * t * (t - 1.0) / 6.0
    return first, end


@compiled
def _add_masses(rectangles: FloatArray, doses: FloatArray, masses: FloatArray) -> None:
    """Add rectangles (left, bottom, right, top), shape (n, 4), in steps from the first node, to masses on nodes."""
    along_x, along_y = np.zeros(masses.shape[1]), np.zeros(masses.shape[0])
    for number in range(len(rectangles)):
        left, bottom, right, top = rectangles[number]
        if right <= left or top <= bottom:
            continue
        first_x, end_x = _add_weights(left, right, along_x)
        first_y, end_y = _add_weights(bottom, top, along_y)
        for row in range(first_y, end_y):
            for column in range(first_x, end_x):
                masses[row, column] += doses[number] * along_y[row] * along_x[column]


@compiled
def _add_closed(
    rectangles: FloatArray,
    doses: FloatArray,
    size_index: NDArray[np.uint16],
    size_nm: FloatArray,
    x_nm: FloatArray,
    y_nm: FloatArray,
    beta: float,
    reach_nm: float,
    energy: Float32Array,
) -> None:
    """Add a Gaussian's energy of rectangles at centre and edges of pillars on sites ``x_nm`` (n_x,), ``y_nm`` (n_y,).

    Sites farther than ``reach_nm`` along an axis are left out.
    """
    for number in range(len(rectangles)):
        left, bottom, right, top = rectangles[number]
        for row in range(np.searchsorted(y_nm, bottom - reach_nm), np.searchsorted(y_nm, top + reach_nm)):
            for column in range(np.searchsorted(x_nm, left - reach_nm), np.searchsorted(x_nm, right + reach_nm)):
                size = size_index[row, column]
                if size == 0:
                    continue
                x, y, half_x, half_y = x_nm[column], y_nm[row], 0.5 * size_nm[size, 0], 0.5 * size_nm[size, 1]
                at_x, at_y = _between(x, left, right, beta), _between(y, bottom, top, beta)
                edges_x = _between(x + half_x, left, right, beta) + _between(x - half_x, left, right, beta)
                edges_y = _between(y + half_y, bottom, top, beta) + _between(y - half_y, bottom, top, beta)
                energy[0, row, column] += 0.25 * doses[number] * at_x * at_y
                energy[1, row, column] += 0.125 * doses[number] * edges_x * at_y
                energy[2, row, column] += 0.125 * doses[number] * at_x * edges_y


@compiled
def _between(at: float, low: float, high: float, beta: float) -> float:
    """Difference of error functions from the ends of a side."""
    return math.erf((at - low) / beta) - math.erf((at - high) / beta)
