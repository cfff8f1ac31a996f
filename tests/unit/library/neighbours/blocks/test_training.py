"""Coupling of lines fitted to blocks: chains whose coupling is known are found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import pillar_cell
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS
from metafab.core.figures import LineStatistics
from metafab.library.library import Library
from metafab.library.neighbours.blocks.cross import free_elements
from metafab.library.neighbours.blocks.lattice import SolvedLines
from metafab.library.neighbours.blocks.training import BLOCK_KINDS, BlockSampler, couple
from metafab.library.neighbours.evaluation import block_corrections, solve_supercell
from metafab.library.neighbours.line import LineShape, initial_model
from metafab.library.neighbours.model import Neighbours, TrainedLine
from metafab.library.sweep.checkpoint import Checkpoint

SPAN = (100.0, 250.0)


def chains() -> Neighbours:
    """Uncoupled chains of a square cell, whose modes radiate ten times as much as random ones."""
    models = [initial_model(LineShape(2, 1, 1), SPAN, SPAN, seed) for seed in (1, 2)]
    along, across = (
        TrainedLine(replace(model, own=10.0 * model.own, side=10.0 * model.side), LineStatistics()) for model in models
    )
    return Neighbours((along, along), (across, across), "inputs")


def test_a_known_coupling_is_found(smooth_library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    start, rng = chains(), np.random.default_rng(3)
    sizes = [line.model.shape.pairs[0].size for line in start.lines]
    known = start.with_couplings([0.1 * (rng.normal(size=n) + 1j * rng.normal(size=n)) for n in sizes])
    free = free_elements(known)
    known = replace(known, cross=0.1 * (rng.normal(size=free) + 1j * rng.normal(size=free)))
    with_known = replace(smooth_library, neighbours=known)

    def solved(sampler: BlockSampler, number: int, resolution: float) -> tuple[complex, ...]:
        return tuple(solve_supercell(with_known, sampler.supercell(number)).t.ravel())

    monkeypatch.setattr(BlockSampler, "solve", solved)
    # Lines of larger blocks are coupled; here those of small ones are.
    monkeypatch.setattr("metafab.library.neighbours.evaluation.has_joint_effect", lambda _: False)
    # These chains radiate less than trained ones, whose couplings the prior suits.
    monkeypatch.setattr("metafab.library.neighbours.blocks.training._CROSS_RIDGE", 1e-8)
    with Checkpoint(None, "blocks") as record:
        fitted = couple(smooth_library, start, 12, record)
    assert fitted.shares_directions
    size_nm = np.random.default_rng(4).uniform(*SPAN, (4, 5, 2))
    for axis in (0, 1):
        truth, before, after = (block_corrections(each, size_nm, axis) for each in (known, start, fitted))
        assert np.linalg.norm(after - truth) < 0.2 * np.linalg.norm(before - truth)
    block = Supercell(pillar_cell(smooth_library.unit_cell, 0.0, 0.0), size_nm)
    truth, before, after = (
        solve_supercell(replace(smooth_library, neighbours=each), block).t for each in (known, start, fitted)
    )
    assert not before[:, 0, 1].any()
    assert np.abs(truth[:, 0, 1]).max() > 1e-3
    for out, into in ((0, 1), (1, 0)):
        assert np.linalg.norm((after - truth)[:, out, into]) < 0.3 * np.linalg.norm(truth[:, out, into])
    line = fitted.line(0, POLARISATIONS[0])
    assert line.coupling is not None
    rows = line.model.polynomials(size_nm)
    np.testing.assert_array_equal(
        block_corrections(fitted, size_nm, 0)[0], SolvedLines.of(line.model, line.coupling, rows).corrections
    )


def test_blocks_depend_on_their_number_alone_and_most_have_a_half_turn(smooth_library: Library) -> None:
    sampler = BlockSampler.of(smooth_library)
    for number, (shape, turned) in enumerate(BLOCK_KINDS):
        size_nm = sampler.supercell(number).size_nm
        assert size_nm.shape == (*shape, 2)
        assert np.array_equal(size_nm, size_nm[::-1, ::-1]) == turned
        assert np.array_equal(size_nm, BlockSampler.of(smooth_library).supercell(number).size_nm)
