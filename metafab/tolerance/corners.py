"""What a changed cell does to the pillars of a mask: their amplitudes at a corner, from few solved cells.

Where the library was built over an axis (``[sweep.axes]``), it is asked. A bias of the critical dimension moves sizes,
so the library's own surface knows it within its sweep, and only sizes beyond are solved. Height, walls and index
change a pillar's response as a smooth change of its amplitude and a smooth shift of its sizes do, resonances included:

    t_corner = t + p t + q dt/d(width) + r dt/d(length),

with polynomials p, q, r of the sizes, fitted to a few sizes of the mask that are solved with and without the change.
Each size predicted without itself gives the error: below 1e-2 of the field for the paper's cell, of 0.1 to 0.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field

import numpy as np
from threadpoolctl import threadpool_limits

from metafab.cell import PillarCell, is_square
from metafab.cell.rcwa import zero_order
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.executor import SerialExecutor, in_order
from metafab.core.parallel.progress import Progress, silent
from metafab.library.axes import CornerBox, corner_cell
from metafab.library.library import Library
from metafab.optics.sources.source import WrittenField, written_field

#: Sizes that are solved at a corner; twice as many where x and y cannot be exchanged.
_SAMPLES = 28
#: Truncation, at which changes of t are exact to some 1e-3; steps of a sloped wall, and sizes on which they are judged.
_ORDERS, _STEPS, _JUDGED = 5, 8, 4
_DEGREE = 2
#: Derivatives of the library's surface are taken over two of it, nm.
_SHIFT_NM = 0.5


@dataclass(frozen=True)
class CornerField:
    """A mask's pillars at a corner.

    Attributes:
        name: axis and deviation.
        field: the mask with the amplitudes of the corner.
        error: rms error of the amplitudes over rms amplitude, pillars counted.
        change: the same of what the corner changes, each polarisation's common factor taken out.
        solved: cells that were solved for it.
    """

    name: str
    field: WrittenField
    error: float
    change: float
    solved: int

    @property
    def relative_error(self) -> float:
        """Error of the change over the change."""
        return self.error / self.change if self.change > 0.0 else 0.0


def corner_fields(
    written: WrittenField,
    library: Library,
    deviations: Mapping[str, float],
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> list[CornerField]:
    """The mask at plus and minus a deviation of each axis, one at a time.

    Args:
        written: the mask with the library's amplitudes.
        library: what the mask was made with.
        deviations: axis (of :class:`metafab.spec.cell.Axes`) -> deviation from the unit cell's own value, above 0.
        executor: where cells are solved; this process when None. The result is the same.
        progress: called as cells are solved.

    Returns:
        Two corners an axis, in the order of ``deviations``.
    """
    sizes, unit_cell = _Sizes.of(written, library), library.unit_cell
    corners = [
        (f"{axis} {sign * deviation:+g}", {axis: unit_cell.nominal(axis) + sign * deviation})
        for axis, deviation in deviations.items()
        for sign in (-1.0, 1.0)
    ]
    wanted = [_cells_wanted(sizes, library, corner) for _, corner in corners]
    nominal = _Wanted(sizes.sample) if any(each.sampled for each in wanted) else _Wanted()
    tasks = [
        (corner_cell(unit_cell, float(sizes.size_nm[k, 0]), float(sizes.size_nm[k, 1]), corner), steps)
        for each, corner in zip([nominal, *wanted], [{}, *(corner for _, corner in corners)], strict=True)
        for steps, which in ((_STEPS, each.which), (_STEPS // 2, each.judged))
        for k in which
    ]
    solved = np.empty((len(tasks), 2), dtype=np.complex128)
    # One thread of linear algebra here as in workers, so that results are the same to the last bit.
    with threadpool_limits(1, "blas"):
        for done, t in enumerate(in_order(executor or SerialExecutor(), _amplitudes, tasks)):
            solved[done] = t
            progress("corners", done + 1, len(tasks))
    before, *after = np.split(solved, np.cumsum([each.count for each in (nominal, *wanted)])[:-1])
    return [
        sizes.corner_field(written, library, name, corner, each, before, there)
        for (name, corner), each, there in zip(corners, wanted, after, strict=True)
    ]


_NONE = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class _Wanted:
    """Which of a mask's sizes are solved at a corner: ``which``, and ``judged`` once more with half the steps."""

    which: np.ndarray = field(default_factory=lambda: _NONE)
    judged: np.ndarray = field(default_factory=lambda: _NONE)
    sampled: bool = False

    @property
    def count(self) -> int:
        """Cells."""
        return int(self.which.size + self.judged.size)


@dataclass(frozen=True)
class _Sizes:
    """The sizes that a mask uses.

    Attributes:
        index: shape (n,), rows of the mask's table.
        size_nm: shape (n, 2), width and length.
        count: shape (n,), pillars of each.
        t: shape (n, 2), the library's amplitudes.
        sample: some of them, chosen by their count, as indices.
        mirror: shape (n,), the size with width and length exchanged, n where the mask has none.
    """

    index: np.ndarray
    size_nm: FloatArray
    count: FloatArray
    t: ComplexArray
    sample: np.ndarray
    mirror: np.ndarray

    @classmethod
    def of(cls, written: WrittenField, library: Library) -> _Sizes:
        pillars = written.pillars
        counts = np.zeros(pillars.size_dbu.shape[0])
        for tile in pillars.tiles():
            counts += np.bincount(tile.size_index.ravel(), minlength=counts.size)
        index = np.flatnonzero(counts[1:]) + 1
        size_nm, count = pillars.size_nm()[index], counts[index]
        stored = library.at_sizes(*size_nm.T)
        wanted = min(_SAMPLES if is_square(library.unit_cell) else 2 * _SAMPLES, index.size)
        chosen = np.random.default_rng(0).choice(index.size, wanted, replace=False, p=count / count.sum())
        place = {tuple(size): k for k, size in enumerate(size_nm.tolist())}
        mirror = np.array([place.get((length, width), index.size) for width, length in size_nm.tolist()])
        return cls(index, size_nm, count, np.stack([stored.t_xx, stored.t_yy], axis=1), np.sort(chosen), mirror)

    def corner_field(
        self,
        written: WrittenField,
        library: Library,
        name: str,
        corner: Mapping[str, float],
        wanted: _Wanted,
        before: ComplexArray,
        after: ComplexArray,
    ) -> CornerField:
        """The mask at a corner, from the cells that were solved there."""
        if _in_library(library, corner):
            there = library.at(**corner)
            table = written_field(written.pillars, there).table
            stated = there.at_sizes(*self.size_nm.T).error
            error = float(np.sqrt(np.average(stated**2, weights=self.count)))
        else:
            if wanted.sampled:
                t, error = self._fitted(library, before, after[: self.sample.size])
                error = float(np.hypot(error, self._step_error(before, after)))
            else:
                t, error = self._moved(library, corner["cd_bias_nm"], wanted.which, after)
            table = written.table.copy()
            with np.errstate(divide="ignore", invalid="ignore"):
                table[self.index] *= np.where(self.t == 0.0, 0.0, t / self.t)
        return CornerField(
            name, WrittenField(written.pillars, table), error, self._change(written, table), wanted.count
        )

    def _change(self, written: WrittenField, table: ComplexArray) -> float:
        """Rms change of the amplitudes, apart from a common factor of each polarisation, over their rms."""
        weight = self.count[:, None]
        old, new = written.table[self.index], table[self.index]
        power = np.sum(weight * np.abs(old) ** 2, axis=0)
        common = np.sum(weight * new * old.conj(), axis=0) / power
        return float(np.sqrt(np.sum(weight * np.abs(new - common * old) ** 2) / power.sum()))

    def _moved(
        self, library: Library, bias_nm: float, solved: np.ndarray, after: ComplexArray
    ) -> tuple[ComplexArray, float]:
        """Amplitudes of sizes all moved by a bias: the library's surface, and those that were solved beyond it."""
        mirrored = (
            self.mirror[solved] < self.index.size if is_square(library.unit_cell) else np.zeros(solved.size, bool)
        )
        images = self.mirror[solved[mirrored]]
        inside = np.setdiff1d(np.arange(self.index.size), np.concatenate([solved, images]))
        t, error = np.empty_like(self.t), np.full(self.index.size, 1e-3)
        if inside.size:
            response = library.surface(*(self.size_nm[inside] + bias_nm).T)
            t[inside] = np.stack([response.t_xx, response.t_yy], axis=1)
            error[inside] = response.error
        t[images] = after[mirrored, ::-1]
        t[solved] = after
        return t, float(np.sqrt(np.average(error**2, weights=self.count)))

    def _fitted(self, library: Library, before: ComplexArray, after: ComplexArray) -> tuple[ComplexArray, float]:
        """Amplitudes by the change that was solved at the sample, and the rms error over rms amplitude."""
        if self.sample.size == self.index.size:
            return self.t * (after / before), 1e-3
        basis = self._basis(library)
        fitted, missed = np.empty_like(self.t), []
        groups = [(0, 1)] if is_square(library.unit_cell) else [(0,), (1,)]
        for group in groups:
            seen = np.concatenate([basis[p][self.sample] for p in group])
            change = np.concatenate([after[:, p] - before[:, p] for p in group])
            inverse = np.linalg.pinv(seen, rcond=1e-9)
            coefficients = inverse @ change
            own = np.einsum("ij,ji->i", seen, inverse).real
            missed.append((change - seen @ coefficients) / np.maximum(1.0 - own, 1e-3))
            for p in group:
                fitted[:, p] = self.t[:, p] + basis[p] @ coefficients
        error = np.linalg.norm(np.concatenate(missed)) / np.linalg.norm(before)
        return fitted, float(error)

    def _step_error(self, before: ComplexArray, after: ComplexArray) -> float:
        """What a sloped wall's steps leave: as much as half as many change.

        So few steps are not yet where their error falls by four: against 64 it falls by 2.4 from four to eight.
        """
        fine, coarse = after[: self.sample.size], after[self.sample.size :]
        if not coarse.size:
            return 0.0
        judged = len(coarse)
        return float(np.linalg.norm(fine[:judged] - coarse) / np.linalg.norm(before[:judged]))

    def _basis(self, library: Library) -> list[ComplexArray]:
        """Of each polarisation, shape (n, terms): polynomials of own and other side times t and its two slopes."""
        low = np.array([library.width_nm[0], library.length_nm[0]])
        high = np.array([library.width_nm[-1], library.length_nm[-1]])
        slopes = []
        for axis in (0, 1):
            ends = []
            for sign in (-1.0, 1.0):
                at = self.size_nm.copy()
                at[:, axis] = np.clip(at[:, axis] + sign * _SHIFT_NM, low[axis], high[axis])
                response = library.surface(*at.T)
                ends.append((at[:, axis], np.stack([response.t_xx, response.t_yy], axis=1)))
            (left, there), (right, here) = ends
            slopes.append((here - there) / (right - left)[:, None])
        place = (2.0 * self.size_nm - low - high) / np.maximum(high - low, 1.0)
        columns = []
        for own, other in ((0, 1), (1, 0)):
            u, v = place[:, own], place[:, other]
            powers = [u**i * v**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
            values = (self.t[:, own], slopes[own][:, own], slopes[other][:, own])
            columns.append(np.stack([value * power for value in values for power in powers], axis=1))
        return columns


def _cells_wanted(sizes: _Sizes, library: Library, corner: Mapping[str, float]) -> _Wanted:
    """Which of the mask's sizes must be solved at a corner."""
    if _in_library(library, corner):
        return _Wanted()
    bias_nm = corner.get("cd_bias_nm")
    if bias_nm is None:
        sloped = "sidewall_angle_deg" in corner
        return _Wanted(sizes.sample, sizes.sample[:_JUDGED] if sloped else _NONE, sampled=True)
    low = np.array([library.width_nm[0], library.length_nm[0]]) - 1e-6
    high = np.array([library.width_nm[-1], library.length_nm[-1]]) + 1e-6
    at = sizes.size_nm + bias_nm
    outside = np.flatnonzero(np.any((at < low) | (at > high), axis=1))
    # Of a size and its mirror image, one is solved.
    return _Wanted(outside[sizes.mirror[outside] >= outside] if is_square(library.unit_cell) else outside)


def _in_library(library: Library, corner: Mapping[str, float]) -> bool:
    """Whether the library was built over the corner's axis that far."""
    box = CornerBox.of(library.unit_cell)
    if box is None or library.corners is None:
        return False
    return all(name in box.spans and box.spans[name][0] <= at <= box.spans[name][1] for name, at in corner.items())


def _amplitudes(task: tuple[PillarCell, int]) -> ComplexArray:
    """t_xx and t_yy at a fixed truncation: its error is the same with and without a small change."""
    cell, steps = task
    return np.diagonal(zero_order(cell, _ORDERS, "adaptive", steps).t).copy()
