"""Light of a block by the model: lines and their joint effect; a false resonance of coupled lines is not believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import pillar_cell
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS
from metafab.core.errors import SolverError
from metafab.core.figures import LineStatistics
from metafab.library.library import Library
from metafab.library.neighbours.blocks.cross import free_elements
from metafab.library.neighbours.blocks.joint import joint_effect
from metafab.library.neighbours.evaluation import block_corrections, joint_share, largest_power, solve_supercell
from metafab.library.neighbours.line import LineShape, initial_model
from metafab.library.neighbours.model import Neighbours, TrainedLine

SPAN = (100.0, 250.0)


def test_a_small_block_is_its_lines_and_their_joint_effect(
    smooth_library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is stated of the lines has tests of its own.
    monkeypatch.setattr("metafab.library.neighbours.evaluation._stated_error", lambda *_: 0.0)
    rng = np.random.default_rng(4)
    models = [initial_model(LineShape(2, 1, 1), SPAN, SPAN, seed) for seed in (1, 2)]
    along, across = (TrainedLine(each, LineStatistics()) for each in models)
    bare = Neighbours((along, along), (across, across))
    couplings = [0.1 * np.ones(line.model.shape.pairs[0].size, dtype=np.complex128) for line in bare.lines]
    coupled = replace(bare.with_couplings(couplings), cross=np.ones(free_elements(bare), dtype=np.complex128))
    block = Supercell(pillar_cell(smooth_library.unit_cell, 0.0, 0.0), rng.uniform(*SPAN, (2, 3, 2)))
    known = smooth_library.surface(block.size_nm[..., 0], block.size_nm[..., 1])
    orders, joint = block.propagating_orders("x"), joint_effect(block, np.stack([known.t_xx, known.t_yy]))
    found = solve_supercell(replace(smooth_library, neighbours=coupled), block)
    share, lit = np.zeros(2), np.zeros(2)
    for axis, local in enumerate((known.t_xx, known.t_yy)):
        lines = block.local_period(orders, local + block_corrections(bare, block.size_nm, axis).sum(axis=0))
        expected = joint[:, :, axis].copy()
        expected[:, axis] += lines
        share[axis], lit[axis] = np.linalg.norm(joint[:, :, axis]), np.linalg.norm(expected)
        sent = block.relative_power(orders, expected, POLARISATIONS[axis]).sum()
        np.testing.assert_allclose(found.t[:, :, axis], expected / np.sqrt(max(1.0, sent)), atol=1e-12)
    # Half of the joint effect, more where the scaling for power comes on top.
    assert found.error >= 0.5 * np.linalg.norm(share) / np.linalg.norm(lit) * (1.0 - 1e-9)
    alone = joint_share(replace(smooth_library, neighbours=coupled), block.size_nm)
    assert alone == pytest.approx(share / lit)
    with_bare = replace(smooth_library, neighbours=bare)
    assert joint_share(with_bare, np.repeat(block.size_nm[:1], 3, axis=0)) == pytest.approx([0.0, 0.0])
    assert joint_share(with_bare, rng.uniform(*SPAN, (12, 12, 2))) is None

    def fails(*_: object) -> None:
        raise SolverError("singular")

    # The line of a budget is no reason to lose the PSFs.
    monkeypatch.setattr("metafab.library.neighbours.evaluation.joint_effect", fails)
    assert joint_share(with_bare, block.size_nm) is None


def test_coupled_lines_that_send_out_more_light_than_arrives_are_solved_uncoupled(
    smooth_library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("metafab.library.neighbours.evaluation.has_joint_effect", lambda _: False)
    rng = np.random.default_rng(3)
    models = [initial_model(LineShape(2, 1, 1), SPAN, SPAN, seed) for seed in (1, 2)]
    along, across = (TrainedLine(replace(each, own=100.0 * each.own), LineStatistics()) for each in models)
    bare = Neighbours((along, along), (across, across))
    bare = replace(bare, cross=rng.normal(size=free_elements(bare)) + 0.0j)
    block = Supercell(pillar_cell(smooth_library.unit_cell, 0.0, 0.0), rng.uniform(*SPAN, (3, 4, 2)))
    orders, width_nm, length_nm = block.propagating_orders("x"), block.size_nm[..., 0], block.size_nm[..., 1]
    local = smooth_library.surface(width_nm, length_nm).t_xx
    drawn = [rng.normal(size=2 * line.model.shape.pairs[0].size).view(np.complex128) for line in bare.lines]
    believed = refused = 0
    for strength in np.linspace(0.02, 0.5, 40):
        coupled = bare.with_couplings([strength * each for each in drawn])
        found, lines = (
            solve_supercell(replace(smooth_library, neighbours=each), block).t for each in (coupled, coupled.uncoupled)
        )
        field = local + block_corrections(coupled, block.size_nm, 0).sum(axis=0)
        sent = block.relative_power(orders, np.stack([block.local_period(orders, field), found[:, 1, 0]], axis=1), "x")
        if found[:, 1, 0].any():
            assert sent.sum() <= 1.0 + 1e-12
            # A light between x and y may ask for a scaling of both.
            scale = np.linalg.norm(found[:, 0, 0]) / np.linalg.norm(block.local_period(orders, field))
            assert scale == pytest.approx(1.0) or largest_power(block, orders, found) == pytest.approx(1.0)
            np.testing.assert_allclose(found[:, 0, 0], scale * block.local_period(orders, field), atol=1e-12)
            believed += 1
        else:
            np.testing.assert_array_equal(found[:, :, 0], lines[:, :, 0])
            refused += 1
    assert believed
    assert refused


def test_no_incident_light_leaves_a_block_with_more_power_than_it_brings(
    smooth_library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Light along x and light across it stay below 1 where light between them exceeds it: 1.03 in one of 100 blocks."""
    monkeypatch.setattr("metafab.library.neighbours.evaluation._stated_error", lambda *_: 0.0)
    models = [initial_model(LineShape(3, 2, 2), SPAN, SPAN, seed) for seed in (1, 2)]
    along, across = (TrainedLine(each, LineStatistics()) for each in models)
    library = replace(smooth_library, neighbours=Neighbours((along, along), (across, across)))
    cell, rng = pillar_cell(smooth_library.unit_cell, 0.0, 0.0), np.random.default_rng(5)
    jones, largest = rng.normal(size=(40, 2, 2)).view(np.complex128)[..., 0], []
    jones /= np.linalg.norm(jones, axis=1, keepdims=True)
    for _ in range(100):
        block = Supercell(cell, rng.uniform(*SPAN, (*rng.integers(8, 11, 2), 2)))
        found = solve_supercell(library, block)
        powers = [block.relative_power(found.order, found.t @ light, "x").sum() for light in jones]
        largest.append(largest_power(block, found.order, found.t))
        assert max(powers) <= largest[-1] * (1.0 + 1e-12) <= 1.0 + 1e-9
        assert max(powers) > 0.9 * largest[-1]
    assert max(largest) == pytest.approx(1.0)


def test_the_error_of_a_dim_pillar_is_the_library_s_over_its_own_field(smooth_library: Library) -> None:
    """Tables of t made a hundred times dimmer: the same absolute error is a hundred times as much of the field."""
    models = [initial_model(LineShape(2, 1, 1), SPAN, SPAN, seed) for seed in (1, 2)]
    along, across = (TrainedLine(each, LineStatistics()) for each in models)
    bright = replace(smooth_library, neighbours=Neighbours((along, along), (across, across)))
    dim = replace(bright, t_xx=0.01 * bright.t_xx, t_yy=0.01 * bright.t_yy)
    pillar = Supercell(pillar_cell(bright.unit_cell, 0.0, 0.0), np.array([[[150.0, 180.0]]]))
    for library in (bright, dim):
        known = library.surface(np.array(150.0), np.array(180.0))
        found = solve_supercell(library, pillar)
        norm = np.sqrt(0.5 * np.sum(np.abs([known.t_xx, known.t_yy]) ** 2))
        assert found.error == pytest.approx(float(known.error) / norm, rel=1e-6)
