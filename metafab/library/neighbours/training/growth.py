"""Growth of the chains: fits from random parameters in stages of more modes and more rows, on all workers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from metafab.core.conventions import POLARISATIONS
from metafab.core.parallel.executor import SerialExecutor, in_order, one_blas_thread
from metafab.core.parallel.progress import Progress
from metafab.library.neighbours.line import LineModel, LineShape, grown, initial_model
from metafab.library.neighbours.model import TrainedLine
from metafab.library.neighbours.rows import ROW_KINDS, RowSampler, is_steady, kind_of
from metafab.library.neighbours.solve import line_gains
from metafab.library.neighbours.training.fit import FitLimits, RowSet, fit, loss
from metafab.library.neighbours.training.held_out import is_held_out, measured
from metafab.library.neighbours.training.row_sets import Answers, local_amplitudes, weighted_sets
from metafab.library.sweep.checkpoint import Checkpoint
from metafab.library.sweep.kept import Numbers, kept_results

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


@dataclass(frozen=True)
class Plan:
    """Rows of one chain: which of them it is fitted to, and which are held out."""

    sampler: RowSampler
    answers: Answers  #: Solved amplitudes by number of the row.
    stages: list[list[RowSet]]  #: Rows that each stage of a start is fitted to; those of the last are all of the fit.
    held: list[int]  #: Numbers of the rows that are held out.
    more_modes: int  #: Modes of each parity beyond :data:`SHAPES`.

    @classmethod
    def of(cls, sampler: RowSampler, answers: Answers, more_modes: int) -> Plan:
        """Hold out one row in six of the solved ones, and spread the others over the stages."""
        held = [number for number in sorted(answers) if is_held_out(number)]
        to_fit = [number for number in sorted(answers) if not is_held_out(number)]
        turn = [number // (2 * len(ROW_KINDS)) for number in to_fit]
        parts = [[n for n, k in zip(to_fit, turn, strict=True) if k % each == 0] for each in _ONE_ROW_IN]
        stages = [weighted_sets(sampler, answers, part) for part in parts]
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
                t = local_amplitudes(self.sampler, size_nm)[1]
                gain[part] = line_gains(model, model.polynomials(size_nm))[0] / np.linalg.norm(t, axis=1)
        return [numbers[k] for k in np.argsort(-gain)[: count // _UNSURE]]

    def with_rows(self, answers: Answers) -> Plan:
        """The plan with further rows in the last stage; none of them is held out."""
        return replace(self, stages=[*self.stages, [*self.stages[-1], *weighted_sets(self.sampler, answers)]])

    def refit(self, model: LineModel) -> TrainedLine:
        """Fit a chain to all rows, and measure it on held-out rows."""
        model = fit(model, self.stages[-1], self.limits(_STAGE_STEPS))
        return TrainedLine(model, measured(self.sampler, self.answers, self.held, self.stages[-1], model))


def fitted_chains(plans: Sequence[Plan], calls: Executor, fits: Checkpoint, progress: Progress) -> list[LineModel]:
    """Fit the chains, but those that ``fits`` holds; the executor runs the starts of all chains, then their ends."""

    def started(task: tuple[Plan, int], vector: Numbers) -> LineModel:
        return task[0].like(task[0].start_shape).with_vector(np.array(vector))

    def finished(task: tuple[Plan, list[LineModel]], vector: Numbers) -> LineModel:
        plan = task[0]
        return plan.like(plan.shape.with_more(plan.more_modes)).with_vector(np.array(vector))

    tasks = [(plan, seed) for plan in plans for seed in range(STARTS)]
    step = "first fits of the chains"
    starts = kept_results(calls, start_of, tasks, fits, 0, _parameters, started, step, progress)
    ends = [(plan, starts[k * STARTS : (k + 1) * STARTS]) for k, plan in enumerate(plans)]
    step = "last fits of the chains"
    return kept_results(calls, finish_of, ends, fits, len(tasks), _parameters, finished, step, progress)


def _parameters(model: LineModel) -> Numbers:
    return tuple(model.vector.tolist())


def refitted_lines(tasks: Sequence[tuple[Plan, LineModel]], calls: Executor, progress: Progress) -> list[TrainedLine]:
    """Fit chains to all rows and measure them."""
    lines: list[TrainedLine] = []
    progress("fit to all rows", 0, len(tasks))
    for line in in_order(calls, _refit, tasks, ahead=1 if isinstance(calls, SerialExecutor) else len(tasks)):
        lines.append(line)
        progress("fit to all rows", len(lines), len(tasks))
    return lines


# One thread, so that the parameters do not depend on the number of cores.
def start_of(task: tuple[Plan, int]) -> LineModel:
    """Fit a start of a plan by its seed."""
    with one_blas_thread():
        return task[0].start(task[1])


def finish_of(task: tuple[Plan, list[LineModel]]) -> LineModel:
    """Fit the best of a plan's starts to its end."""
    with one_blas_thread():
        return task[0].finish(task[1])


def _refit(task: tuple[Plan, LineModel]) -> TrainedLine:
    with one_blas_thread():
        return task[0].refit(task[1])
