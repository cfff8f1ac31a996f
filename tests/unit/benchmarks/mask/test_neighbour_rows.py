"""The search over closed rows: all sizes at one site, by its block of the inverse, against solves by the model."""

from __future__ import annotations

import numpy as np

from benchmarks.mask.neighbour_rows import _Light, _Row
from metafab.library.neighbours.line import LineShape, initial_model
from metafab.library.neighbours.solve import line_corrections

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
