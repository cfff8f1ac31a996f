"""Corrected doses of the lenses of a wafer, and their rounding to classes.

One lens is solved with all others at its doses. From there every lens is solved with the others at their own doses, in
turn (Gauss-Seidel), until no lens changes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress
from metafab.exposure.energy.resist import TileEnergy
from metafab.exposure.prediction import Printing
from metafab.exposure.sums import newton_doses

#: Largest number of rounds of Newton's method, and the rms residual (nm) below which a round is the last. A round
#: reduces the residual about tenfold.
_MOST_ROUNDS, _CONVERGED_NM = 12, 0.1
#: Least number of rounds over several lenses: the rms over a lens hides a rim that faces another one.
_ROUNDS_IN_TURN = 2
#: Largest number of dose classes.
MOST_CLASSES = 256
#: Bounds of a corrected dose relative to the base dose.
_DOSE_BOUNDS = (0.2, 5.0)


@dataclass(frozen=True, eq=False)
class LensDoses:
    """A lens and the doses of its pillars; other lenses have the same doses until :meth:`at` states theirs."""

    process: Printing  #: Printing of its drawn pattern among all other shapes.
    number: int  #: Number of the lens on the wafer, by which others refer to it.
    dose: Float32Array  #: Shape (n_y, n_x), relative to the base dose, without that of the lens.

    @property
    def surroundings(self) -> int | None:
        """Key that lenses of equal doses share: None with nothing beside the lens, else its number."""
        return None if self.process.resist.beside is None else self.number

    def at(self, lens_dose: float, lenses: Sequence[LensDoses]) -> LensDoses:
        """The lens with ``lens_dose`` multiplied into its doses, and the doses of ``lenses`` in those beside it."""
        dose, beside = self.dose if lens_dose == 1.0 else self.dose * np.float32(lens_dose), self.process.resist.beside
        if beside is not None:
            beside = beside.with_doses({lens.number: lens.dose for lens in lenses}, lens_dose)
        return replace(self, process=self.process.among(beside), dose=dose)


def corrected(lenses: Sequence[LensDoses], progress: Progress) -> tuple[list[LensDoses], int]:
    """Find the doses at which the mean size error of each pillar's width and length vanishes, by Newton's method.

    The derivative assumes that the doses of neighbours change by the same factor. Returns the lenses with their doses
    and the number of rounds; lenses with nothing in reach share one array.
    """
    first = lenses[0]
    for rounds in range(1, _MOST_ROUNDS + 1):
        first, residual_nm = _newton(first)
        progress("correction", rounds, _MOST_ROUNDS)
        if residual_nm < _CONVERGED_NM:
            break
    solved = {lens.surroundings: replace(lens, dose=first.dose) for lens in lenses}
    in_turn = 0
    while len(solved) > 1 and in_turn < _MOST_ROUNDS and (in_turn < _ROUNDS_IN_TURN or residual_nm >= _CONVERGED_NM):
        residual_nm, in_turn = 0.0, in_turn + 1
        for kind, lens in solved.items():
            new, left_nm = _newton(lens.at(1.0, [replace(one, dose=solved[one.surroundings].dose) for one in lenses]))
            solved[kind], residual_nm = replace(lens, dose=new.dose), max(residual_nm, left_nm)
        progress("correction of all lenses", in_turn, _MOST_ROUNDS)
    return [replace(lens, dose=solved[lens.surroundings].dose) for lens in lenses], rounds + in_turn


def _newton(lens: LensDoses) -> tuple[LensDoses, float]:
    """One round: the lens with new doses, and the rms residual (nm) of the former ones."""
    process, tables, new = lens.process, lens.process.tables, np.ones_like(lens.dose)

    def update(tile: TileEnergy) -> FloatArray:
        place = new[tile.rows, tile.columns]
        edges = (tile.others, tables.at_edge, tables.slope_per_nm)
        return np.array(
            newton_doses(tile.size_index, tile.dose, *edges, process.base_over_clearing_dose, _DOSE_BOUNDS, place)
        )

    parts = [found for _, found in process.resist.map_tiles(lens.dose, process.executor, update)]
    square, count = np.sum(parts, axis=0)
    return replace(lens, dose=new), math.sqrt(square / max(count, 1.0))


def quantised(lenses: Sequence[LensDoses], classes: int) -> tuple[tuple[NDArray[np.uint8], ...], FloatArray]:
    """Divide the doses of all lenses into classes by equal steps of their logarithm.

    The dose of a class is the mean of its members. Returns the class of each site of each lens, shape (n_y, n_x), one
    array for lenses that share their doses; and the dose of each class, shape (classes,).
    """
    if not 2 <= classes <= MOST_CLASSES:
        raise InputError.single("exposure", "classes", f"2 to {MOST_CLASSES}", str(classes))
    distinct = {id(lens.dose): lens for lens in lenses}
    low, high = np.log(_ends(list(distinct.values()))).tolist()
    step = max(high - low, 1e-6) / classes
    total, count, class_of = np.zeros(classes), np.zeros(classes), {}
    for key, lens in distinct.items():
        class_of[key] = dose_class = np.zeros(lens.dose.shape, dtype=np.uint8)
        for block, stand, dose in _pillars(lens):
            number = np.clip(((np.log(dose) - low) / step).astype(np.int64), 0, classes - 1)
            dose_class[block][stand] = number
            total += np.bincount(number, dose, classes)
            count += np.bincount(number, minlength=classes)
    middle = np.exp(low + step * (np.arange(classes) + 0.5))
    return tuple(class_of[id(lens.dose)] for lens in lenses), np.where(
        count > 0, total / np.maximum(count, 1.0), middle
    )


def dose_span(lenses: Sequence[LensDoses]) -> float:
    """Largest over smallest dose of all pillars."""
    low, high = _ends(lenses)
    return high / low


def _ends(lenses: Sequence[LensDoses]) -> tuple[float, float]:
    """Smallest and largest dose of all pillars."""
    ends = np.array([(dose.min(), dose.max()) for lens in lenses for _, _, dose in _pillars(lens)])
    return float(ends[:, 0].min()), float(ends[:, 1].max())


def _pillars(lens: LensDoses) -> Iterator[tuple[tuple[slice, slice], NDArray[np.bool_], Float32Array]]:
    """For each tile of a lens: rows and columns, whether a pillar stands at each site, and the doses of those."""
    for block in lens.process.resist.tiles:
        stand = lens.process.resist.size_index[block] > 0
        yield block, stand, lens.dose[block][stand]
