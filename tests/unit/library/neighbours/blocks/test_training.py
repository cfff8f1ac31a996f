"""Coupling of lines fitted to blocks: chains whose coupling is known are found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.core.conventions import POLARISATIONS
from metafab.core.figures import LineStatistics
from metafab.library.library import Library
from metafab.library.neighbours.blocks.lattice import lattice_corrections
from metafab.library.neighbours.blocks.training import BLOCK_KINDS, BlockSampler, couple
from metafab.library.neighbours.evaluation import block_corrections
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

    def solved(sampler: BlockSampler, number: int, resolution: float) -> tuple[complex, ...]:
        block = sampler.supercell(number)
        orders = block.propagating_orders("x")
        t = np.zeros((len(orders), 2, 2), dtype=np.complex128)
        found = smooth_library.surface(block.size_nm[..., 0], block.size_nm[..., 1])
        for axis, local in enumerate((found.t_xx, found.t_yy)):
            field = local + block_corrections(known, block.size_nm, axis).sum(axis=0)
            t[:, axis, axis] = block.local_period(orders, field)
        return tuple(t.ravel())

    monkeypatch.setattr(BlockSampler, "solve", solved)
    with Checkpoint(None, "blocks") as record:
        fitted = couple(smooth_library, start, 12, record)
    assert fitted.shares_directions
    size_nm = np.random.default_rng(4).uniform(*SPAN, (4, 5, 2))
    for axis in (0, 1):
        truth, before, after = (block_corrections(each, size_nm, axis) for each in (known, start, fitted))
        assert np.linalg.norm(after - truth) < 0.2 * np.linalg.norm(before - truth)
    line = fitted.line(0, POLARISATIONS[0])
    assert line.coupling is not None
    rows = line.model.polynomials(size_nm)
    np.testing.assert_array_equal(
        block_corrections(fitted, size_nm, 0)[0], lattice_corrections(line.model, line.coupling, rows)
    )


def test_blocks_depend_on_their_number_alone_and_most_have_a_half_turn(smooth_library: Library) -> None:
    sampler = BlockSampler.of(smooth_library)
    for number, (shape, turned) in enumerate(BLOCK_KINDS):
        size_nm = sampler.supercell(number).size_nm
        assert size_nm.shape == (*shape, 2)
        assert np.array_equal(size_nm, size_nm[::-1, ::-1]) == turned
        assert np.array_equal(size_nm, BlockSampler.of(smooth_library).supercell(number).size_nm)
