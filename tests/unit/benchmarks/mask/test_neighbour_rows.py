"""The search over closed rows: all sizes at one site against solves by the model; wanted orders by full wave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.mask.neighbour_rows import _Light, _Row, full_wave
from metafab.cell import solve
from metafab.library.neighbours.line import LineShape, initial_model
from metafab.library.neighbours.solve import line_corrections
from tests.paper_cell import EMPTY

SPAN = (100.0, 250.0)


def test_sizes_at_one_site_are_those_of_a_solve_of_the_row() -> None:
    rng = np.random.default_rng(2)
    size_nm, t = rng.uniform(*SPAN, (30, 2)), np.exp(1j * rng.uniform(-3.0, 3.0, (30, 2)))
    models = [initial_model(LineShape(3, 2, 2), SPAN, SPAN, seed) for seed in (1, 2)]
    lights = _Light.of(models[0], size_nm, t[:, 0]), _Light.of(models[1], size_nm, t[:, 1])
    weight, row = np.exp(-1j * rng.uniform(-3.0, 3.0, (2, 6))), rng.integers(30, size=6)
    for light, w, model, own in zip(lights, weight, models, t.T, strict=True):
        found = light.replaced(w, row, light.solve(w, row), 5, np.arange(30))
        for size in (0, 7, 29):
            moved = np.append(row[:5], size)
            fields = own[moved] + line_corrections(model, model.polynomials(size_nm[moved][None]))[0]
            assert abs(found[size] - w @ fields) < 1e-9
    searched = _Row(lights, weight, 0.03, 1.0)
    at_first = searched.score([each.sum for each in searched.solve(row)])
    ended, score = searched.ascended(row, 20)
    assert score >= at_first
    assert abs(score - searched.score([each.sum for each in searched.solve(ended)])) < 1e-12


def test_full_wave_orders_of_equal_pillars_are_those_of_the_cell_over_the_target() -> None:
    cell = replace(EMPTY, n_pillar=2.0)
    size_nm = np.tile([[150.0, 180.0]], (3, 1))
    alone = np.diag(solve(replace(cell, width_nm=150.0, length_nm=180.0)).t)
    level = np.array([[0.7], [-1.1]]) * np.ones(3)
    # Elements of resolution 3 leave some 0.003 of the field of a lattice of such pillars.
    np.testing.assert_allclose(full_wave(cell, size_nm, level, 3.0), alone * np.exp(-1j * level[:, 0]), atol=0.01)
    turn = level + 2.0 * np.pi / 3.0 * np.arange(3)
    assert np.abs(full_wave(cell, size_nm, turn, 3.0)).max() < 1e-9


def test_full_wave_order_is_the_one_that_the_target_phases_send_light_to() -> None:
    """Pillars whose phase rises along x, and the same row mirrored with falling target phases."""
    cell = replace(EMPTY, n_pillar=2.0)
    size_nm = np.array([[100.0, 100.0], [170.0, 170.0], [230.0, 230.0]])
    turn = np.tile(2.0 * np.pi / 3.0 * (np.arange(3) - 1.0), (2, 1))
    rising, wrong = full_wave(cell, size_nm, turn, 3.0), full_wave(cell, size_nm, -turn, 3.0)
    np.testing.assert_allclose(rising, full_wave(cell, size_nm[::-1], -turn, 3.0), atol=1e-9)
    assert np.all(np.abs(rising) > 1.1 * np.abs(wrong))
