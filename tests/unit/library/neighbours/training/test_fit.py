"""Fit of a chain: rows made by a known chain are found again."""

from __future__ import annotations

import numpy as np

from metafab.library.neighbours.line import LineShape, initial_model
from metafab.library.neighbours.solve import scattered_corrections
from metafab.library.neighbours.training.fit import FitLimits, RowSet, fit

SPAN = (100.0, 250.0)


def _rows(seed: int, rows: int, sites: int) -> RowSet:
    """Rows by a chain with strong coupling, all orders propagating."""
    rng = np.random.default_rng(seed)
    truth = initial_model(LineShape(2, 1, 1), SPAN, SPAN, 7)
    size_nm = rng.uniform(*SPAN, (rows, sites, 2))
    local = np.exp(2j * np.pi * (size_nm[..., 0] - 100.0) / 150.0) * np.array([0.5, 1.0])[:, None, None]
    order = np.arange(sites) - sites // 2
    bare = RowSet(size_nm, local, np.zeros((rows, sites), complex), order.astype(float), np.ones(sites))
    field = local + 20.0 * scattered_corrections(truth, truth.polynomials(size_nm))
    return RowSet(size_nm, local, field @ bare.to_orders.T, bare.order, bare.weight)


def test_fit_predicts_rows_it_has_not_seen() -> None:
    held_out = _rows(2, 20, 7)
    start = initial_model(LineShape(2, 1, 1), SPAN, SPAN, 1)
    model = fit(start, [_rows(1, 60, 5), _rows(3, 30, 4)], FitLimits(steps=80, ridge=1e-8))
    lone = np.sqrt(np.mean(held_out.errors(None) ** 2))
    assert lone > 0.1
    assert np.sqrt(np.mean(held_out.errors(model) ** 2)) < 0.02 * lone


def test_orders_of_a_row_are_its_fourier_series() -> None:
    rows = _rows(1, 2, 5)
    back = rows.amplitude @ np.exp(2j * np.pi * np.outer(rows.order, (np.arange(5) + 0.5) / 5 - 0.5))
    assert np.abs(back @ rows.to_orders.T - rows.amplitude).max() < 1e-13
