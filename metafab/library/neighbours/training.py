"""Training of the model of neighbours: solve rows of unlike pillars, fit the chains, measure them on held-out rows."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from metafab.cell import is_square, pillar_cell
from metafab.cell.supercell import Supercell, exchanged_site
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
from metafab.core.figures import LineStatistics
from metafab.core.parallel.executor import SerialExecutor, in_order, one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import fingerprint
from metafab.core.storage.provenance import sources_sha256
from metafab.library.library import Library, inputs_of
from metafab.library.neighbours.blocks.training import couple, inputs_of_blocks
from metafab.library.neighbours.doubt import RowDoubts, error_law
from metafab.library.neighbours.fit import FitLimits, RowSet, fit, loss
from metafab.library.neighbours.line import LineModel, LineShape, grown, initial_model
from metafab.library.neighbours.model import Neighbours, TrainedLine
from metafab.library.neighbours.rows import RESOLUTION, ROW_KINDS, RowSampler, is_steady, kind_of, solve_sampled
from metafab.library.neighbours.solve import line_corrections, line_gains
from metafab.library.sweep.checkpoint import Checkpoint
from metafab.library.sweep.kept import Numbers, kept_results
from metafab.spec import UnitCell

#: Modes and polynomials of the chains, for light polarised along the row and across it. Guided bands that are folded at
#: normal incidence are pairs of an even and an odd mode. Measured on silicon at 800 nm, rms on five periods of a lens
#: with light along: 4 + 2 modes 0.024, 4 + 3 modes 0.019 (0.025 and 0.040 without mirrored rows in the training). Rms
#: on held-out rows with steady phases, light across, without mirrored rows: 4 + 2 modes 0.068, 3 + 3 modes 0.066, 4 + 4
#: modes 0.036, 6 + 3 modes 0.077.
SHAPES = (LineShape(even=4, odd=3, degree=4), LineShape(even=4, odd=4, degree=4))
#: Degree of the starts; it rises to that of :data:`SHAPES` in the last fits. Degree 4 from the first step was worse.
#: Raised in fitted chains of 5 + 4 and 5 + 5 modes it lowered the error on held-out rows of random sizes from 0.060 to
#: 0.053 and from 0.061 to 0.054 (medians), and with steady phases from 0.010 to 0.009 and from 0.015 to 0.013 (rms).
_START_DEGREE = 3
#: Weight of reflected light in the fit, for light along the row and across it. Along, it lowered the error from 0.106
#: to 0.082 on rows of random sizes and from 0.019 to 0.016 on periods of the lens. Across, with it the error on these
#: periods was 0.09 from random parameters, and 0.028 from a fitted chain: no better than without reflected light.
_REFLECTED = (0.5, 0.0)
#: Weight of the rows with steady phases in the fit. Lenses consist of such rows, and their residuals are three to eight
#: times smaller than those of random sizes.
_STEADY_WEIGHT = 16.0
#: Weight of the squared residual of the strongest order of a row with steady phases, the wanted order of a lens.
#: Measured on 28 rows of a lens, light along: amplitude of the wanted order off by 0.0041 with 1, 0.0033 with 8 and
#: 0.0026 with 30 (rms), while rows of random sizes are off by 0.12, 0.13 and 0.15.
_STRONGEST_WEIGHT = 8.0
#: Sites of a row of weight 1. Longer rows hold more orders and count in proportion.
_SITES = 7.0
#: One row in this number is held out of the fit.
_HELD_OUT = 6
#: Part of the light cone beyond which an order is grazing, and the weight of its squared residual in the fit.
_GRAZING, _GRAZING_WEIGHT = 0.95, 0.3
#: Fits from different random parameters. The one with the smallest loss is fitted to its end, and again with each of
#: the modes beyond :data:`SHAPES`.
STARTS = 4
#: Rows of each stage of a fit: one in this number. The first stage has two modes of each parity fewer than the last,
#: the second has one.
_ONE_ROW_IN = (4, 2, 1)
#: Steps of a stage, and of the fit to its end.
_STAGE_STEPS, _LAST_STEPS = 25, 120
#: Relative decrease of the loss over five steps below which a fit ends that is followed by more modes.
_COARSE_GAIN = 2e-2
#: One further row is chosen for so many rows, and candidates are the numbers of this many times as many rows. Light
#: along, 48 rows with the largest gain (of 1750) were off by 0.151 before they were fitted, held-out ones by 0.066.
_UNSURE, _CANDIDATES = 12, 4
#: Most pillars that are drawn for a chosen row: rows of 18 cost four times as much as the others.
_MOST_DRAWN = 7
#: Candidates whose matrices are inverted at once.
_AT_ONCE = 32
#: Number of rows that are solved again to measure the error of the rows, and the increase of their resolution.
_CHECKED_ROWS, _FINER = 3, 1.0


def inputs_of_training(unit_cell: UnitCell) -> str:
    """Fingerprint of a training's inputs: the library's, the table ``[neighbours]`` and the code."""
    code = sources_sha256(("metafab.library.neighbours.training",), ())
    return fingerprint(inputs_of(unit_cell), unit_cell.neighbours, code)


def inputs_of_rows(library: Library) -> str:
    """Fingerprint of the rows of a training: pillars, sizes to draw from, resolution, and the code that solves them.

    It depends neither on the number of rows nor on the fit: more rows, or another fit, continue from the solved rows.
    """
    samplers = _samplers(library)
    drawn = [hashlib.sha256(each.size_nm.tobytes() + each.t.tobytes()).hexdigest() for each in samplers]
    code = sources_sha256(("metafab.library.neighbours.rows",), ())
    return fingerprint([each.cell for each in samplers], drawn, ROW_KINDS, RESOLUTION, code)


def inputs_of_fits(library: Library) -> str:
    """Fingerprint of the fits of a training: which rows are fitted, and how; the number of blocks does not count."""
    asked = library.unit_cell.neighbours
    without_blocks = replace(library.unit_cell, neighbours=None if asked is None else replace(asked, blocks=0))
    return fingerprint("fits", inputs_of_training(without_blocks), inputs_of_rows(library))


def train(
    library: Library,
    *,
    executor: Executor | None = None,
    checkpoint: Path | None = None,
    progress: Progress = silent,
) -> Neighbours:
    """Train the model of neighbours of a library.

    Args:
        library: library whose unit cell has the table ``[neighbours]``.
        executor: solves the rows and runs the fits; None for this process.
        checkpoint: file that keeps the solved rows; a call with equal :func:`inputs_of_rows` continues from it. Solved
            blocks (``.blocks``) and fitted chains (``.HASH.fits``) stand beside it;
            :func:`metafab.library.built.build_file` removes the latter once the library is saved.
        progress: called with the number of solved rows, and with the number of fits.

    Raises:
        InputError: ``checkpoint`` belongs to another training.
    """
    if library.unit_cell.neighbours is None:
        raise ValueError("the unit cell has no table `neighbours`")
    samplers, asked = _samplers(library), library.unit_cell.neighbours
    calls = executor or SerialExecutor()
    of_fits = inputs_of_fits(library)
    fits = Checkpoint(checkpoint and checkpoint.with_suffix(f".{of_fits[:8]}.fits"), of_fits)
    # One thread of linear algebra for all fits: the limit holds for the process, and the first thread of ours that ends
    # a fit would lift it for the others.
    with Checkpoint(checkpoint, inputs_of_rows(library)) as record, fits, one_blas_thread():
        solved = solve_sampled(samplers, [range(asked.rows)] * len(samplers), record, calls, progress)
        plans = [_Plan.of(*both, asked.more_modes) for both in zip(samplers, solved, strict=True)]
        models = _fitted(plans, calls, fits, progress)
        unsure = [plan.unsure(model) for plan, model in zip(plans, models, strict=True)]
        more = solve_sampled(samplers, unsure, record, calls, progress)
        plans = [plan.with_rows(answers) for plan, answers in zip(plans, more, strict=True)]
        lines = _refitted(list(zip(plans, models, strict=True)), calls, progress)
    along = [line for line, sampler in zip(lines, samplers, strict=True) if sampler.polarisation == "x"]
    across = [line for line, sampler in zip(lines, samplers, strict=True) if sampler.polarisation == "y"]
    inputs = inputs_of_training(library.unit_cell)
    neighbours = Neighbours((along[0], along[-1]), (across[0], across[-1]), inputs)
    if asked.blocks:
        of_blocks = checkpoint.with_suffix(".blocks") if checkpoint else None
        with Checkpoint(of_blocks, inputs_of_blocks(library)) as record, one_blas_thread():
            neighbours = couple(library, neighbours, asked.blocks, record, calls, progress)
    return neighbours


def _samplers(library: Library) -> list[RowSampler]:
    """Rows of each direction and polarisation; rows along y are exchanged into rows along x."""
    width, length = np.meshgrid(library.width_nm, library.length_nm)
    size_nm, t = np.stack([width, length], axis=-1).reshape(-1, 2), library.t.reshape(-1, 2)
    r = np.stack([library.r_xx, library.r_yy], axis=-1).reshape(-1, 2)
    cell = pillar_cell(library.unit_cell, 0.0, 0.0)
    samplers = [RowSampler(cell, light, size_nm, r, t, number) for number, light in enumerate(POLARISATIONS)]
    if not _shares_directions(library.unit_cell):
        cell, size_nm, r, t = exchanged_site(cell), size_nm[:, ::-1], r[:, ::-1], t[:, ::-1]
        samplers += [RowSampler(cell, light, size_nm, r, t, 2 + number) for number, light in enumerate(POLARISATIONS)]
    return samplers


def _shares_directions(unit_cell: UnitCell) -> bool:
    return is_square(unit_cell) and unit_cell.sweep.width_nm == unit_cell.sweep.length_nm


@dataclass(frozen=True)
class _Plan:
    """Rows of one chain: which of them it is fitted to, and which are held out."""

    sampler: RowSampler
    answers: dict[int, tuple[complex, ...]]  #: Solved amplitudes by number of the row.
    stages: list[list[RowSet]]  #: Rows that each stage of a start is fitted to; those of the last are all of the fit.
    held: list[int]  #: Numbers of the rows that are held out.
    more_modes: int  #: Modes of each parity beyond :data:`SHAPES`.

    @classmethod
    def of(cls, sampler: RowSampler, answers: dict[int, tuple[complex, ...]], more_modes: int) -> _Plan:
        held = [number for number in sorted(answers) if _is_held_out(number)]
        to_fit = [number for number in sorted(answers) if not _is_held_out(number)]
        turn = [number // (2 * len(ROW_KINDS)) for number in to_fit]
        parts = [[n for n, k in zip(to_fit, turn, strict=True) if k % each == 0] for each in _ONE_ROW_IN]
        stages = [_weighted_sets(sampler, answers, part) for part in parts]
        return cls(sampler, answers, stages, held, more_modes)

    def limits(self, steps: int) -> FitLimits:
        """Limits of a fit."""
        return FitLimits(steps, reflected=_REFLECTED[POLARISATIONS.index(self.sampler.polarisation)])

    @property
    def shape(self) -> LineShape:
        """Modes and terms of the chain without more modes."""
        return SHAPES[POLARISATIONS.index(self.sampler.polarisation)]

    @property
    def start_shape(self) -> LineShape:
        """Modes and terms of a start's last stage."""
        return replace(self.shape, degree=min(self.shape.degree, _START_DEGREE))

    def like(self, shape: LineShape, seed: int = 0) -> LineModel:
        """A chain of some shape with random parameters."""
        along, across = ((float(axis.min()), float(axis.max())) for axis in self.sampler.size_nm.T)
        return initial_model(shape, along, across, seed)

    def start(self, seed: int) -> LineModel:
        """Fit from random parameters, in stages of more modes and more rows."""
        last, fewest = self.start_shape, 1 - len(self.stages)
        model = self.like(last.with_more(fewest), seed)
        for stage, sets in enumerate(self.stages):
            model = grown(model, last.with_more(fewest + stage), seed + STARTS * stage)
            model = fit(model, sets, self.limits(_STAGE_STEPS))
        return model

    def finish(self, starts: Sequence[LineModel]) -> LineModel:
        """Fit the start with the smallest loss to its end, then with more modes."""
        rows, limits = self.stages[-1], self.limits(_LAST_STEPS)
        model = min(starts, key=lambda start: loss(start, rows, limits))
        for more in range(self.more_modes + 1):
            until = limits if more == self.more_modes else replace(limits, gain=_COARSE_GAIN)
            model = fit(grown(model, self.shape.with_more(more), more), rows, until)
        return model

    def unsure(self, model: LineModel) -> list[int]:
        """Numbers of further rows of random sizes: of many, those whose light errors of the chain change most."""
        count = len(self.answers)
        drawn = range(count, (1 + _CANDIDATES) * count)
        numbers = [each for each in drawn if not is_steady(each) and kind_of(each).drawn <= _MOST_DRAWN]
        gain = np.empty(len(numbers))
        length = np.array([kind_of(number).sites for number in numbers])
        for sites in np.unique(length):
            for part in np.array_split(at := np.flatnonzero(length == sites), math.ceil(at.size / _AT_ONCE)):
                size_nm = np.stack([self.sampler.pillars(numbers[k]) for k in part])
                t = _local(self.sampler, size_nm)[1]
                gain[part] = line_gains(model, model.polynomials(size_nm))[0] / np.linalg.norm(t, axis=1)
        return [numbers[k] for k in np.argsort(-gain)[: count // _UNSURE]]

    def with_rows(self, answers: dict[int, tuple[complex, ...]]) -> _Plan:
        """The plan with further rows in the last stage; none of them is held out."""
        return replace(self, stages=[*self.stages, [*self.stages[-1], *_weighted_sets(self.sampler, answers)]])

    def refit(self, model: LineModel) -> TrainedLine:
        """Fit a chain to all rows, and measure it on held-out rows."""
        model = fit(model, self.stages[-1], self.limits(_STAGE_STEPS))
        return TrainedLine(model, _measured(self, model))


def _fitted(plans: Sequence[_Plan], calls: Executor, fits: Checkpoint, progress: Progress) -> list[LineModel]:
    """Fit the chains, but those that ``fits`` holds; the executor runs the starts of all chains, then their ends."""

    def started(task: tuple[_Plan, int], vector: Numbers) -> LineModel:
        return task[0].like(task[0].start_shape).with_vector(np.array(vector))

    def finished(task: tuple[_Plan, list[LineModel]], vector: Numbers) -> LineModel:
        plan = task[0]
        return plan.like(plan.shape.with_more(plan.more_modes)).with_vector(np.array(vector))

    tasks = [(plan, seed) for plan in plans for seed in range(STARTS)]
    step = "first fits of the chains"
    starts = kept_results(calls, _start, tasks, fits, 0, _parameters, started, step, progress)
    ends = [(plan, starts[k * STARTS : (k + 1) * STARTS]) for k, plan in enumerate(plans)]
    step = "last fits of the chains"
    return kept_results(calls, _finish, ends, fits, len(tasks), _parameters, finished, step, progress)


def _parameters(model: LineModel) -> Numbers:
    return tuple(model.vector.tolist())


def _refitted(tasks: Sequence[tuple[_Plan, LineModel]], calls: Executor, progress: Progress) -> list[TrainedLine]:
    """Fit chains to all rows and measure them."""
    lines: list[TrainedLine] = []
    progress("fit to all rows", 0, len(tasks))
    for line in in_order(calls, _refit, tasks, ahead=1 if isinstance(calls, SerialExecutor) else len(tasks)):
        lines.append(line)
        progress("fit to all rows", len(lines), len(tasks))
    return lines


# One thread, so that the parameters do not depend on the number of cores.
def _start(task: tuple[_Plan, int]) -> LineModel:
    with one_blas_thread():
        return task[0].start(task[1])


def _finish(task: tuple[_Plan, list[LineModel]]) -> LineModel:
    with one_blas_thread():
        return task[0].finish(task[1])


def _refit(task: tuple[_Plan, LineModel]) -> TrainedLine:
    with one_blas_thread():
        return task[0].refit(task[1])


def _is_held_out(number: int) -> bool:
    """One row in ``_HELD_OUT`` of each kind, of random sizes and of steady phases."""
    turn, place = divmod(number, 2 * len(ROW_KINDS))
    return (place + turn) % _HELD_OUT == _HELD_OUT - 1


def _row_sets(sampler: RowSampler, answers: dict[int, tuple[complex, ...]], numbers: Sequence[int]) -> list[RowSet]:
    """Rows by their length."""
    sets = []
    for sites in sorted({kind.sites for kind in ROW_KINDS}):
        of_length = [number for number in numbers if kind_of(number).sites == sites]
        if of_length:
            size_nm = np.stack([sampler.pillars(number) for number in of_length])
            order, weight = _orders(Supercell(sampler.cell, size_nm[:1]), sampler.polarisation)
            amplitude = np.array([answers[number] for number in of_length]).reshape(len(size_nm), 2, -1)
            sets.append(RowSet(size_nm, _local(sampler, size_nm), amplitude.swapaxes(0, 1), order, weight))
    return sets


def _local(sampler: RowSampler, size_nm: FloatArray) -> ComplexArray:
    """The library's r and t of pillars, shape (rows, sites, 2) to (2, rows, sites)."""
    place = {tuple(size): k for k, size in enumerate(sampler.size_nm)}
    at = np.reshape([place[tuple(size)] for size in size_nm.reshape(-1, 2)], size_nm.shape[:-1])
    return np.stack([sampler.r, sampler.t])[..., POLARISATIONS.index(sampler.polarisation)][:, at]


def _weighted_sets(
    sampler: RowSampler, answers: dict[int, tuple[complex, ...]], numbers: Sequence[int] | None = None
) -> list[RowSet]:
    """Rows by their length, with weights for a fit; those with steady phases also by their strongest order."""
    weighted, numbers = [], sorted(answers) if numbers is None else numbers
    for rows in _row_sets(sampler, answers, [number for number in numbers if not is_steady(number)]):
        weighted.append(replace(rows, weight=rows.weight * rows.size_nm.shape[1] / _SITES))
    for rows in _row_sets(sampler, answers, [number for number in numbers if is_steady(number)]):
        strongest = np.argmax(np.abs(rows.amplitude[1]), axis=1)
        for order in np.unique(strongest):
            weight = _STEADY_WEIGHT * rows.weight * rows.size_nm.shape[1] / _SITES
            weight[order] *= _STRONGEST_WEIGHT
            weighted.append(replace(rows.part(strongest == order), weight=weight))
    return weighted


def _orders(supercell: Supercell, light: Polarisation) -> tuple[FloatArray, FloatArray]:
    """Numbers of a row's orders, and the weights of their squared residuals, shape (orders,) each."""
    order, cell = supercell.propagating_orders(light), supercell.cell
    sine = np.hypot(*supercell.wavevectors_per_um(order).T) / (1e3 * cell.k0_per_nm)
    sine = sine / cell.n_out[POLARISATIONS.index(light)].real
    return order[:, 0].astype(np.float64), np.where(sine > _GRAZING, _GRAZING_WEIGHT, 1.0)


def _measured(plan: _Plan, model: LineModel) -> LineStatistics:
    sampler, answers, held, fitted = plan.sampler, plan.answers, plan.held, plan.stages[-1]
    alike = _row_sets(sampler, answers, [number for number in held if is_steady(number)])
    unlike = _row_sets(sampler, answers, [number for number in held if not is_steady(number)])
    errors_alike, errors_unlike = ([rows.errors(model) for rows in sets] for sets in (alike, unlike))
    errors = np.concatenate([*errors_alike, *errors_unlike])
    checked = []
    for number in held[:_CHECKED_ROWS]:
        fine, coarse = (
            np.reshape(scattered, (2, -1))[1]
            for scattered in (sampler.solve(number, RESOLUTION + _FINER), answers[number])
        )
        checked.append(np.linalg.norm(fine - coarse) / np.linalg.norm(fine))
    solver_error = _rms([np.array(checked)])
    return replace(
        error_law(_doubts((*alike, *unlike), model), errors, floor=solver_error),
        rows=sum(len(rows.size_nm) for rows in fitted),
        held_out=len(held),
        local_period_error=_rms([rows.errors(None) for rows in (*alike, *unlike)]),
        error=_rms([errors]),
        error_unlike=_rms(errors_unlike),
        error_alike=_rms(errors_alike),
        local_period_error_alike=_rms([rows.errors(None) for rows in alike]),
        error_p90=float(np.quantile(np.concatenate(errors_alike), 0.9)),
        error_fitted=_rms([rows.errors(model) for rows in fitted]),
        solver_error=solver_error,
    )


def _doubts(sets: Sequence[RowSet], model: LineModel) -> RowDoubts:
    """Predictors of the errors of all rows of the sets, in turn."""
    found = []
    for rows in sets:
        corrections = line_corrections(model, model.polynomials(rows.size_nm))
        found.append(vars(RowDoubts.of(model, rows.size_nm, rows.local[1], corrections)))
    return RowDoubts(**{name: np.concatenate([each[name] for each in found]) for name in found[0]})


def _rms(errors: Sequence[FloatArray]) -> float:
    every = np.concatenate(list(errors))
    return math.sqrt(float(np.mean(every**2)))
