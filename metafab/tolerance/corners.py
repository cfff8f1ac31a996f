"""Amplitudes of the pillars of a mask at a corner of the fabrication, from a few solved cells.

If the library was built over the axis of the corner (``[sweep.axes]``), it is looked up. A bias of the critical
dimension moves sizes: the surface of the library holds them within its sweep, and only sizes beyond it are solved.
Height, sidewall, round corners and index are solved for a sample of the mask's sizes, with and without the change, and
fitted by a shift of the sizes and a smooth factor (:mod:`metafab.tolerance.corner_fit`). Leave-one-out prediction with
two standard errors gives the error. For sizes within the sweep of Shen's cell it is 0.001 (index, change 0.08) to
0.017 of the field (walls of 88 degrees, change 0.18); up to 8 nm beyond the sweep, 0.009 to 0.06.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, fields, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from metafab.cell import PillarCell
from metafab.cell.curved import is_treated
from metafab.core.arguments import require_types
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.library.axes import Corner, CornerBox, corner_cell
from metafab.library.library import Library
from metafab.library.use.any_size import (
    SOLVER_ERROR,
    must_be_solved,
    response_of_sizes,
    solved_amplitudes,
    solver_error,
    swaps_polarisations,
)
from metafab.optics.sources.source import WrittenField, made_field
from metafab.spec.cell import Axes
from metafab.spec.keys.reference import near
from metafab.tolerance.corner_fit import fitted_amplitudes

#: Sizes solved at a corner; twice as many for cells whose x and y axes differ.
_SAMPLES = 56
#: Slices of a sloped sidewall.
_SLICES = 8
#: Sizes solved once more with half the slices, for the error of the slices.
SLICE_CHECKS = 4
#: Rows of sites that are compared at a time.
_BAND_ROWS = 256
#: Largest factor by which a corner may raise an amplitude as a ratio: it raises the solver's error as much.
_LARGEST_RATIO = 2.0


@dataclass(frozen=True)
class CornerField:
    """Field behind a mask at a corner."""

    name: str  #: Axis and deviation.
    field: WrittenField  #: The mask with the amplitudes at the corner.
    error: float  #: Rms error of the amplitudes over their rms, weighted by the number of pillars.
    change: float  #: Rms change of the amplitudes over their rms, apart from a common factor of each polarisation.
    solved: int  #: Number of solved cells.

    @property
    def relative_error(self) -> float:
        """Error of the change over the change."""
        return self.error / self.change if self.change > 0.0 else 0.0

    def against(self, written: WrittenField) -> CornerField:
        """Return the corner with its change from the pillars of ``written``, site by site: of other sizes, too."""
        old_power, new_power, product = np.zeros((3, 2), dtype=np.complex128)
        both = zip(written.pillars.bands(_BAND_ROWS), self.field.pillars.bands(_BAND_ROWS), strict=True)
        for (_, old_index), (_, new_index) in both:
            old, new = written.table[old_index[:_BAND_ROWS]], self.field.table[new_index[:_BAND_ROWS]]
            old_power += np.sum(np.abs(old) ** 2, axis=(0, 1))
            new_power += np.sum(np.abs(new) ** 2, axis=(0, 1))
            product += np.sum(new * old.conj(), axis=(0, 1))
        left = new_power.real - np.abs(product) ** 2 / old_power.real
        return replace(self, change=float(np.sqrt(max(0.0, left.sum()) / old_power.real.sum())))


def corner_fields(
    written: WrittenField,
    library: Library,
    deviations: Mapping[str, float],
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> list[CornerField]:
    """Return the mask at plus and minus a positive deviation of each axis: two corners an axis, one axis at a time.

    Axes are those of :class:`metafab.spec.cell.Axes`; other arguments and errors are those of :func:`fields_at`.
    """
    corners = [
        (f"{axis} {sign * deviation:+g}", {axis: library.unit_cell.nominal(axis) + sign * deviation})
        for axis, deviation in deviations.items()
        for sign in (-1.0, 1.0)
    ]
    return fields_at(written, library, corners, executor=executor, progress=progress)


def fields_at(
    written: WrittenField,
    library: Library,
    corners: Sequence[tuple[str, Corner]],
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> list[CornerField]:
    """Return the mask, upright pillars of any size, at some corners: values by name and axis of a library.

    The axes are those of :class:`metafab.spec.cell.Axes`; InputError for other names. The result does not depend on the
    executor (None for this process).
    """
    require_types("tolerance", written=(written, WrittenField), library=(library, Library))
    _require_axes({axis for _, corner in corners for axis in corner})
    sizes = MaskSizes.of(written, library)
    plans = [_plan(sizes, library, corner) for _, corner in corners]
    tasks = [sizes.tasks(library, plan, corner) for plan, (_, corner) in zip(plans, corners, strict=True)]
    # One solver solves all cells of a call. Sloped circles have RCWA alone, by which changes of upright ones of silicon
    # were off by up to 1.3 at these orders: corners whose cells have spectral elements are a call of their own.
    by_elements = [all(is_treated(cell) for cell, _ in each) for each in tasks]
    calls = []
    for has_elements in (True, False):
        chosen = [k for k in range(len(corners)) if by_elements[k] == has_elements]
        is_sampled = any(plans[k].sampled for k in chosen)
        sample = sizes.tasks(library, _Plan(sizes.sample), {}) if is_sampled else []
        calls.append((chosen, [sample, *(tasks[k] for k in chosen)]))
    found: dict[int, CornerField] = {}
    done, total = 0, sum(len(part) for _, parts in calls for part in parts)
    for chosen, parts in calls:
        amplitudes = solved_amplitudes([*chain(*parts)], executor, _following(progress, done, total))
        done += len(amplitudes)
        before, *after = np.split(amplitudes, np.cumsum([len(part) for part in parts])[:-1])
        for k, solved in zip(chosen, after, strict=True):
            found[k] = sizes.corner_field(written, library, *corners[k], plans[k], before, solved)
    return [found[k] for k in range(len(corners))]


def _following(progress: Progress, before: int, whole: int) -> Progress:
    """Progress of a part that follows ``before`` of ``whole`` units."""

    def advance(step: str, done: float, total: float) -> None:
        """Report the units of the whole."""
        progress(step, before + done, whole)

    return advance


def slice_error(before: ComplexArray, fine: ComplexArray, coarse: ComplexArray) -> float:
    """Return the relative error of sloped sidewalls in slices: the change from half as many slices.

    The error does not yet fall by the factor of four of second order: from four to eight slices it falls by 2.4, judged
    against 64. All amplitudes have the shape (n, 2): without the slope, with all and with half of the slices.
    """
    return float(np.linalg.norm(fine - coarse) / np.linalg.norm(before))


_NONE = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class _Plan:
    """Sizes of a mask to solve at a corner."""

    solved: NDArray[np.int64] = field(default_factory=lambda: _NONE)  #: Indices of the sizes to solve.
    #: Indices of the sizes to solve once more with half the slices.
    checked: NDArray[np.int64] = field(default_factory=lambda: _NONE)
    sampled: bool = False  #: Whether the sizes are a sample to which the change is fitted.

    @property
    def count(self) -> int:
        """Number of cells."""
        return int(self.solved.size + self.checked.size)


@dataclass(frozen=True)
class MaskSizes:
    """Pillar sizes of a mask."""

    index: NDArray[np.int64]  #: Shape (n,), rows of the mask's table.
    size_nm: FloatArray  #: Shape (n, 2), width and length.
    count: FloatArray  #: Shape (n,), number of pillars of each size.
    t: ComplexArray  #: Shape (n, 2), amplitudes of the library for x and y polarisation.
    sample: NDArray[np.int64]  #: Shape (n_sample,), indices of sizes drawn with their counts as weights.
    #: Shape (n,), index of the size with width and length exchanged; n where the mask has none.
    mirror: NDArray[np.int64]

    @classmethod
    def of(cls, written: WrittenField, library: Library) -> MaskSizes:
        """Count the sizes of a mask and draw the sample."""
        pillars = written.pillars
        counts = np.zeros(pillars.size_dbu.shape[0])
        for tile in pillars.tiles():
            counts += np.bincount(tile.size_index.ravel(), minlength=counts.size)
        index = np.flatnonzero(counts[1:]) + 1
        size_nm, count = pillars.size_nm()[index], counts[index]
        stored = response_of_sizes(library, size_nm)
        samples = min(_SAMPLES if swaps_polarisations(library) else 2 * _SAMPLES, index.size)
        # Without slopes over the sizes no change can be fitted: every size is solved.
        samples = samples if library.is_continuous else index.size
        chosen = np.random.default_rng(0).choice(index.size, samples, replace=False, p=count / count.sum())
        place = {tuple(size): k for k, size in enumerate(size_nm.tolist())}
        mirror = np.array([place.get((length, width), index.size) for width, length in size_nm.tolist()])
        return cls(index, size_nm, count, np.stack([stored.t_xx, stored.t_yy], axis=1), np.sort(chosen), mirror)

    def tasks(self, library: Library, plan: _Plan, corner: Corner) -> list[tuple[PillarCell, int]]:
        """Cells of a plan at a corner, each with its number of slices."""
        return [
            (_cell(library, width_nm, length_nm, corner), slices)
            for slices, places in ((_SLICES, plan.solved), (_SLICES // 2, plan.checked))
            for width_nm, length_nm in self.size_nm[places].tolist()
        ]

    def corner_field(
        self,
        written: WrittenField,
        library: Library,
        name: str,
        corner: Corner,
        plan: _Plan,
        before: ComplexArray,
        after: ComplexArray,
    ) -> CornerField:
        """Return the mask at a corner, axis -> value, from the sizes that were solved by its plan.

        Amplitudes of the sample without the change have the shape (n_sample, 2), those of the solved sizes at the
        corner (plan.count, 2).
        """
        if _in_library(library, corner):
            there = library.at(**corner)
            table = made_field(written.pillars, there).table
            error = self._rms(response_of_sizes(there, self.size_nm).error)
        else:
            if plan.sampled:
                n = self.sample.size
                t, error = self._fitted(library, before, after[:n])
                if n == self.index.size:
                    error = max(error, self._solved_error(library, corner, after[:n]))
                if plan.checked.size:
                    judged = slice(plan.checked.size)
                    error = float(np.hypot(error, slice_error(before[judged], after[judged], after[n:])))
            else:
                t, error = self._biased(library, corner["cd_bias_nm"], plan.solved, after)
            table = written.table.copy()
            with np.errstate(divide="ignore", invalid="ignore"):
                table[self.index] *= np.where(self.t == 0.0, 0.0, t / self.t)
        return CornerField(name, WrittenField(written.pillars, table), error, self._change(written, table), plan.count)

    def _rms(self, error: FloatArray) -> float:
        return float(np.sqrt(np.average(error**2, weights=self.count)))

    def _change(self, written: WrittenField, table: ComplexArray) -> float:
        """Rms change of the amplitudes over their rms, apart from a common factor of each polarisation."""
        weight = self.count[:, None]
        old, new = written.table[self.index], table[self.index]
        power = np.sum(weight * np.abs(old) ** 2, axis=0)
        common = np.sum(weight * new * old.conj(), axis=0) / power
        return float(np.sqrt(np.sum(weight * np.abs(new - common * old) ** 2) / power.sum()))

    def _biased(
        self, library: Library, bias_nm: float, solved: NDArray[np.int64], after: ComplexArray
    ) -> tuple[ComplexArray, float]:
        """Amplitudes of biased sizes: solved beyond the sweep, from the surface of the library inside."""
        mirrored = np.zeros(solved.size, dtype=bool)
        if swaps_polarisations(library):
            mirrored = self.mirror[solved] < self.index.size
        images = self.mirror[solved[mirrored]]
        inside = np.setdiff1d(np.arange(self.index.size), np.concatenate([solved, images]))
        bias = {"cd_bias_nm": bias_nm}
        tasks = self.tasks(library, _Plan(solved), bias)
        t, error = np.empty_like(self.t), np.full(self.index.size, solver_error(tasks, after))
        if inside.size:
            found = library.surface if library.is_continuous else library.at_sizes
            response = found(*(self.size_nm[inside] + bias_nm).T)
            t[inside] = np.stack([response.t_xx, response.t_yy], axis=1)
            error[inside] = response.error
        t[images] = after[mirrored, ::-1]
        t[solved] = after
        return t, self._rms(error)

    def _solved_error(self, library: Library, corner: Corner, after: ComplexArray) -> float:
        """Error of the ratio of two solutions of a size, with and without a change.

        Ratios by spectral elements were off by at most 8e-5 in 24 circles and rings of two materials. Crosses and
        sloped walls by RCWA state the error of the solution at the corner itself: beside resonances of crosses, ratios
        were off by up to 0.26.
        """
        tasks = self.tasks(library, _Plan(self.sample), corner)
        if all(not cell.is_shaped or is_treated(cell) for cell, _ in tasks):
            return SOLVER_ERROR
        return solver_error(tasks, after)

    def _fitted(self, library: Library, before: ComplexArray, after: ComplexArray) -> tuple[ComplexArray, float]:
        """Amplitudes fitted to the change of the sample, and their relative leave-one-out error."""
        changed, missed = changed_amplitudes(self.t[self.sample], before, after)
        if self.sample.size == self.index.size:
            weight = self.count[:, None]
            square = np.sum(weight * missed**2) / np.sum(weight * np.abs(self.t) ** 2)
            return changed, float(np.hypot(SOLVER_ERROR, np.sqrt(square)))
        groups = [(0, 1)] if swaps_polarisations(library) else [(0,), (1,)]
        return fitted_amplitudes(library, self.size_nm, self.sample, changed, groups)


def _require_axes(names: Collection[str]) -> None:
    """Refuse names of no axis, which would leave the cells as they are."""
    axes = [item.name for item in fields(Axes)]
    faults = [
        Fault(name, f"an axis: {', '.join(axes)}", "none of them", near(name, axes))
        for name in sorted({*names} - {*axes})
    ]
    if faults:
        raise InputError("tolerance", faults)


def changed_amplitudes(t: ComplexArray, before: ComplexArray, after: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """Return a library's amplitudes ``t`` at a corner, and the error that a difference of solutions adds: all (n, 2).

    The ratio of the solutions ``after`` and ``before`` the change cancels the solver's common error and a constant
    factor of an imported library. Beside a resonance the amplitude before the change may be close to 0, where a ratio
    would raise the solver's error without limit: there the difference of the solutions is added, times that factor.
    """
    factor = np.sum(before.conj() * t, axis=0) / np.sum(np.abs(before) ** 2, axis=0)
    weak = np.abs(after) > _LARGEST_RATIO * np.abs(before)
    ratio = np.divide(after, before, out=np.zeros_like(after), where=~weak)
    changed = np.where(weak, t + factor * (after - before), t * ratio)
    return changed, np.where(weak, np.abs(t - factor * before), 0.0)


def _cell(library: Library, width_nm: float, length_nm: float, corner: Corner) -> PillarCell:
    """Cell of a pillar at a corner; axes that it does not name, such as the angle, have the library's values."""
    return corner_cell(library.unit_cell, width_nm, length_nm, {**library.corner, **corner})


def _plan(sizes: MaskSizes, library: Library, corner: Corner) -> _Plan:
    """Sizes of the mask that must be solved at a corner."""
    if _in_library(library, corner):
        return _Plan()
    bias_nm = corner.get("cd_bias_nm")
    if bias_nm is None:
        sloped = "sidewall_angle_deg" in corner
        return _Plan(sizes.sample, sizes.sample[:SLICE_CHECKS] if sloped else _NONE, sampled=True)
    # The hole of a ring shrinks by the bias as well: no size of the library is that ring.
    is_ring = library.unit_cell.cell.shape == "ring"
    outside = np.flatnonzero(is_ring | must_be_solved(library, sizes.size_nm + bias_nm))
    # Of a size and its mirror image, one is solved.
    return _Plan(outside[sizes.mirror[outside] >= outside] if swaps_polarisations(library) else outside)


def _in_library(library: Library, corner: Corner) -> bool:
    """Whether the corner lies within the axes of the library."""
    box = CornerBox.of(library.unit_cell)
    if box is None or library.corners is None:
        return False
    return all(name in box.spans and box.spans[name][0] <= at <= box.spans[name][1] for name, at in corner.items())
