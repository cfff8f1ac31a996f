"""Training of the model of neighbours: solve rows and blocks of unlike pillars, fit the chains, measure them."""

from __future__ import annotations

import hashlib
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

import numpy as np

from metafab.cell import is_square, pillar_cell
from metafab.cell.supercell import exchanged_site
from metafab.core.conventions import POLARISATIONS
from metafab.core.parallel.executor import SerialExecutor, one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import fingerprint
from metafab.core.storage.provenance import sources_sha256
from metafab.library.library import Library, inputs_of
from metafab.library.neighbours.blocks.training import couple, inputs_of_blocks
from metafab.library.neighbours.model import Neighbours
from metafab.library.neighbours.rows import RESOLUTION, ROW_KINDS, RowSampler, solve_sampled
from metafab.library.neighbours.training.growth import Plan, fitted_chains, refitted_lines
from metafab.library.sweep.checkpoint import Checkpoint
from metafab.spec import UnitCell


def inputs_of_training(unit_cell: UnitCell) -> str:
    """Fingerprint of a training's inputs: the library's, the table ``[neighbours]`` and the code."""
    code = sources_sha256(("metafab.library.neighbours.training",), ())
    return fingerprint(inputs_of(unit_cell), unit_cell.neighbours, code)


def inputs_of_rows(library: Library) -> str:
    """Fingerprint of the rows of a training: pillars, sizes to draw from, resolution, and the code that solves them.

    It depends neither on the number of rows nor on the fit: more rows, or another fit, continue from the solved rows.
    """
    samplers = row_samplers(library)
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
    samplers, asked = row_samplers(library), library.unit_cell.neighbours
    calls = executor or SerialExecutor()
    of_fits = inputs_of_fits(library)
    fits = Checkpoint(checkpoint and checkpoint.with_suffix(f".{of_fits[:8]}.fits"), of_fits)
    # One thread of linear algebra for all fits: the limit holds for the process, and the first thread of ours that ends
    # a fit would lift it for the others.
    with Checkpoint(checkpoint, inputs_of_rows(library)) as record, fits, one_blas_thread():
        solved = solve_sampled(samplers, [range(asked.rows)] * len(samplers), record, calls, progress)
        plans = [Plan.of(*both, asked.more_modes) for both in zip(samplers, solved, strict=True)]
        models = fitted_chains(plans, calls, fits, progress)
        unsure = [plan.unsure(model) for plan, model in zip(plans, models, strict=True)]
        more = solve_sampled(samplers, unsure, record, calls, progress)
        plans = [plan.with_rows(answers) for plan, answers in zip(plans, more, strict=True)]
        lines = refitted_lines(list(zip(plans, models, strict=True)), calls, progress)
    along = [line for line, sampler in zip(lines, samplers, strict=True) if sampler.polarisation == "x"]
    across = [line for line, sampler in zip(lines, samplers, strict=True) if sampler.polarisation == "y"]
    inputs = inputs_of_training(library.unit_cell)
    neighbours = Neighbours((along[0], along[-1]), (across[0], across[-1]), inputs)
    if asked.blocks:
        of_blocks = checkpoint.with_suffix(".blocks") if checkpoint else None
        with Checkpoint(of_blocks, inputs_of_blocks(library)) as record, one_blas_thread():
            neighbours = couple(library, neighbours, asked.blocks, record, calls, progress)
    return neighbours


def row_samplers(library: Library) -> list[RowSampler]:
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
