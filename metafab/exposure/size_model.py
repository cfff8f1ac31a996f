"""Model of measured sizes: widths and lengths of pillars that a process gives, as functions of its parameters.

A pillar of a lens with dose D prints where its energy reaches the clearing energy. Both edges of a side stand s outside
the drawn ones, where

    D base_over_clearing_dose [S(s) + O] = 1,    size = drawn + 2 s + bias + microloading (density - mean density),

with its own energy S(s) (:mod:`metafab.exposure.printing`) and that of all others O, both per unit dose. The
point-spread function is f / (1 + eta) + eta b / (1 + eta), with its forward and backscattered parts f and b and the
backscatter ratio eta, so that O follows from two energies of each measured pillar. The forward one depends smoothly on
the blur and is interpolated between Chebyshev nodes. A beam out of focus has a wider blur
(:func:`metafab.exposure.electrons.process.blur_out_of_focus_nm`). The density is that of the drawn pillars, times the
printed over the drawn area of the measured ones at the same dose and focus (:mod:`metafab.exposure.etch`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.electrons.process import blur_out_of_focus_nm
from metafab.exposure.energy.beside import Beside
from metafab.exposure.energy.resist import ResistEnergy, TileEnergy
from metafab.exposure.etch import local_density
from metafab.exposure.prediction import inside
from metafab.layout import PillarMap
from metafab.spec.mask import Etch

#: Parameters of the process in the order of the fit.
Parameter = Literal["threshold", "eta", "blur", "bias", "microloading", "convergence", "focus"]
PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)
#: Bounds of base over clearing dose, backscatter ratio, blur (nm), bias (nm), microloading (nm), convergence (mrad) and
#: best focus (um).
LOW = np.array([0.05, 1e-3, 0.5, -200.0, -500.0, 0.1, -50.0])
HIGH = np.array([100.0, 20.0, 60.0, 200.0, 500.0, 100.0, 50.0])
#: Largest blur of a beam out of focus, nm.
_WIDEST_NM = 100.0
#: Nodes of the blur for the energy of the other pillars; the error of the interpolation is below 1e-5.
_BLUR_NODES = 7
#: Last step towards an edge (nm), small for difference quotients, and most steps: as many as halvings of 200 nm need.
_LAST_STEP_NM, _MOST_STEPS = 1e-9, 38
#: Reach of an edge outwards (nm).
_REACH_NM = 100.0


@dataclass(frozen=True, eq=False)
class MeasuredLens:
    """Measured pillars of one lens at one or several doses, and one focus."""

    pillars: PillarMap  #: The drawn pillars.
    place: NDArray[np.int64]  #: Shape (n, 2), row and column of each measurement.
    dose: FloatArray  #: Shape (n,), dose of the whole lens relative to the base dose.
    size_nm: FloatArray  #: Shape (n, 2), measured width and length.
    focus_um: float = 0.0  #: Focus of the beam.
    beside: Beside | None = None  #: What is exposed with the lens, for energies per unit dose of it.


class SizeModel:
    """Sizes of measured pillars for any process, whose values have the order of :data:`PARAMETERS`.

    ``forward`` (without blur) and ``back`` are the parts of the point-spread function, weights of sum 1 each. ``start``
    are values of the process, ``chosen`` those that are fitted; ``etch`` is the range of the microloading.
    """

    def __init__(
        self,
        lenses: Sequence[MeasuredLens],
        forward: BeamPsf,
        back: BeamPsf,
        start: FloatArray,
        chosen: NDArray[np.bool_],
        etch: Etch,
        work: Work,
    ) -> None:
        self._forward, self._back = forward, back
        self._drawn = np.concatenate([lens.pillars.size_nm()[_index(lens)] for lens in lenses])
        self._dose = np.concatenate([lens.dose for lens in lenses])
        self._focus_um = np.concatenate([np.full(len(lens.dose), lens.focus_um) for lens in lenses])
        self.measured_nm = np.concatenate([lens.size_nm for lens in lenses])
        exposed = np.stack([self._dose, self._focus_um], axis=1)
        self._exposed = np.unique(exposed, axis=0, return_inverse=True)[1].ravel()
        is_loaded = bool(chosen[4] or start[4])
        self._density = np.concatenate([_excess_density(lens, etch) for lens in lenses]) if is_loaded else None
        self._nodes = np.unique(self._blurs_nm(start))
        self._widest_nm = float(self._nodes.max())
        if chosen[[2, 5, 6]].any() or self._nodes.size > _BLUR_NODES:
            turn = np.cos(np.pi * (np.arange(_BLUR_NODES) + 0.5) / _BLUR_NODES)
            is_out_of_focus = chosen[[5, 6]].any() or np.any(self._focus_um != start[6])
            self._widest_nm = _WIDEST_NM if is_out_of_focus else float(HIGH[2])
            self._nodes = 0.5 * (self._widest_nm + LOW[2]) + 0.5 * (self._widest_nm - LOW[2]) * turn
        place = np.concatenate([lens.place for lens in lenses])
        patterns, of_lens = _distinct(lenses)
        pattern = np.repeat(of_lens, [len(lens.dose) for lens in lenses])
        with work.threads() as executor:

            def others(part: BeamPsf) -> FloatArray:
                """Energy of all other pillars at the edges, per unit dose: shape (n, 2)."""
                values = np.zeros((len(pattern), 2))
                for number, lens in enumerate(patterns):
                    rows = np.flatnonzero(pattern == number)
                    resist = ResistEnergy(lens.pillars, part).among(lens.beside)
                    dose = np.ones(resist.size_index.shape, dtype=np.float32)
                    touched = [block for block in resist.tiles if len(inside(place[rows], *block))]

                    def keep(tile: TileEnergy, rows: NDArray[np.int64] = rows) -> FloatArray:
                        row, column = (place[rows] - (tile.rows.start, tile.columns.start)).T
                        n_y, n_x = tile.dose.shape
                        here = (row >= 0) & (row < n_y) & (column >= 0) & (column < n_x)
                        values[rows[here]] = tile.others[:, row[here], column[here]].T
                        return np.empty(0)

                    for _ in resist.map_tiles(dose, executor, keep, touched):
                        pass
                return values

            # The backscattered part is far wider than any blur.
            self._others_back = others(back)
            self._others_forward = np.stack([others(forward.blurred(float(blur))) for blur in self._nodes])

    def first_ratio(self, values: FloatArray) -> float:
        """Base over clearing dose at which measured edges get the clearing energy on average; ``values``: (7,)."""
        moved = 0.5 * (self.measured_nm - self._drawn)
        energy = self._own(moved, self._parts(values)) + self._others(values)
        return float(1.0 / np.mean(self._dose[:, None] * energy))

    def sizes_nm(self, values: FloatArray) -> FloatArray:
        """Sizes for a process, ``values`` of shape (7,): shape (n, 2)."""
        printed = self._drawn + 2.0 * self._moved_nm(values)
        if self._density is None:
            return np.asarray(printed + values[3])
        areas = [np.bincount(self._exposed, sizes.prod(axis=1)) for sizes in (printed, self._drawn)]
        excess = self._density * (areas[0] / areas[1])[self._exposed]
        return np.asarray(printed + values[3] + values[4] * excess[:, None])

    def _moved_nm(self, values: FloatArray) -> FloatArray:
        """Displacement of the printed edges outwards, shape (n, 2).

        Newton's method; where it leaves the interval that holds the edge, the interval is halved.
        """
        others, parts = self._others(values), self._parts(values)
        wanted = 1.0 / (values[0] * self._dose[:, None]) - others
        low, high = -0.5 * self._drawn, np.full_like(self._drawn, _REACH_NM)
        # Edges beyond the interval stand at its ends.
        at_low, at_high = self._own(low, parts) <= wanted, self._own(high, parts) > wanted
        low, high = np.where(at_high, high, low), np.where(at_low, low, high)
        moved: FloatArray = np.clip(0.0, low, high)
        for _ in range(_MOST_STEPS):
            own, drop = self._own(moved, parts), self._drop_per_nm(moved, parts)
            low, high = np.where(own > wanted, moved, low), np.where(own > wanted, high, moved)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # No slope: the interval is halved.
                newton = moved + (own - wanted) / drop
            is_within = (newton >= low - _LAST_STEP_NM) & (newton <= high + _LAST_STEP_NM)
            before, moved = moved, np.asarray(np.where(is_within, newton, 0.5 * (low + high)))
            if np.max(np.abs(moved - before)) < _LAST_STEP_NM:
                break
        return moved

    def require_within_reach(self, values: FloatArray) -> None:
        """Refuse a process, ``values`` of shape (7,), whose blur out of focus is beyond the interpolation."""
        widest = float(self._blurs_nm(values).max())
        if widest > self._widest_nm:
            expected = f"a blur of at most {self._widest_nm:g} nm at each focus"
            raise InputError.single("process fit", "convergence", expected, f"{widest:.3g} nm", "leave out that focus")

    def _blurs_nm(self, values: FloatArray) -> FloatArray:
        """Blur of each measurement, shape (n,)."""
        return blur_out_of_focus_nm(values[2], values[5], self._focus_um - values[6])

    def _others(self, values: FloatArray) -> FloatArray:
        """Energy of the other pillars at the edges, per unit dose: shape (n, 2)."""
        blur_nm = np.minimum(self._blurs_nm(values), self._widest_nm)
        return np.asarray((self._interpolated(blur_nm) + values[1] * self._others_back) / (1.0 + values[1]))

    def _parts(self, values: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Range of each Gaussian, shape (n, 1) or (1, 1), and its energy in the middle of each side, shape (n, 2)."""
        eta, blur_nm = float(values[1]), np.minimum(self._blurs_nm(values), self._widest_nm)
        ranges = [np.hypot(beta, blur_nm)[:, None] for beta in self._forward.range_nm]
        ranges += [np.full((1, 1), beta) for beta in self._back.range_nm]
        weights = np.concatenate([self._forward.weight, eta * self._back.weight]) / (1.0 + eta)
        middle = [erf(self._drawn[:, ::-1] / (2.0 * beta)) for beta in ranges]
        return [(beta, 0.5 * weight * side) for weight, beta, side in zip(weights, ranges, middle, strict=True)]

    def _own(self, moved_nm: FloatArray, parts: list[tuple[FloatArray, FloatArray]]) -> FloatArray:
        """Energy of each pillar at its edges moved outwards, per unit dose: shape (n, 2), like ``moved_nm``."""
        far = self._drawn + moved_nm
        return np.asarray(sum(middle * (erf(far / beta) - erf(moved_nm / beta)) for beta, middle in parts))

    def _drop_per_nm(self, moved_nm: FloatArray, parts: list[tuple[FloatArray, FloatArray]]) -> FloatArray:
        """Decrease of :meth:`_own` by 1 nm outwards: shape (n, 2)."""
        far, root = self._drawn + moved_nm, np.sqrt(0.25 * np.pi)
        drops = (
            middle * (np.exp(-((moved_nm / beta) ** 2)) - np.exp(-((far / beta) ** 2))) / (root * beta)
            for beta, middle in parts
        )
        return np.asarray(sum(drops))

    def _interpolated(self, blur_nm: FloatArray) -> FloatArray:
        """Forward energy of the others at a blur for each pillar, shape (n,): Lagrange's polynomial in its square."""
        nodes, square = self._nodes**2, blur_nm[:, None] ** 2
        total = np.zeros_like(self._others_back)
        for k, node in enumerate(nodes):
            rest = np.delete(nodes, k)
            total += np.prod((square - rest) / (node - rest), axis=1)[:, None] * self._others_forward[k]
        return total


def _distinct(lenses: Sequence[MeasuredLens]) -> tuple[list[MeasuredLens], list[int]]:
    """Lenses of distinct patterns, and the number of that of each lens; copies alone on the wafer share theirs."""
    distinct: list[MeasuredLens] = []
    number = []
    for lens in lenses:
        found = (k for k, other in enumerate(distinct) if lens.beside is other.beside and _are_equal(lens, other))
        number.append(next(found, len(distinct)))
        if number[-1] == len(distinct):
            distinct.append(lens)
    return distinct, number


def _are_equal(lens: MeasuredLens, other: MeasuredLens) -> bool:
    """Whether two lenses have the same pillars."""
    one, two = lens.pillars, other.pillars
    same_sizes = np.array_equal(one.size_dbu, two.size_dbu)
    return one is two or (same_sizes and np.array_equal(one.to_array(), two.to_array()))


def _excess_density(lens: MeasuredLens, etch: Etch) -> FloatArray:
    """Local density of the drawn pillars at each measurement, less its mean over all pillars: shape (n,)."""
    index, area_nm2 = lens.pillars.to_array(), lens.pillars.size_nm().prod(axis=1)
    density, mean = local_density(lens.pillars, lambda rows: area_nm2[index[rows]], etch)
    at = [density.at(slice(row, row + 1), slice(column, column + 1)).item() for row, column in lens.place.tolist()]
    return np.array(at) - mean


def _index(lens: MeasuredLens) -> NDArray[np.int64]:
    """Size index of each measured pillar."""
    row, column = lens.place.T
    return np.asarray(lens.pillars.to_array()[row, column], dtype=np.int64)
