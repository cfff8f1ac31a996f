"""Condition numbers: what they are, that they bound what rounding does, and that an answer too ill is not passed on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import hilbert

from metafab.cell import CellNumerics, PillarCell, Slice, solve
from metafab.cell.rcwa import zero_order
from metafab.cell.rcwa.jones import distance
from metafab.cell.rcwa.scattering import stack
from metafab.cell.rcwa.scattering.modes import NO_MODES, LayerModes, condition, conditioning, layer_modes
from tests.paper_cell import SILICON


@pytest.mark.parametrize("n", [3, 5, 7])
def test_condition_of_known_matrices(n: int) -> None:
    assert condition(np.eye(n)) == pytest.approx(1.0)
    assert condition(np.diag(np.arange(1.0, n + 1.0)) * (1.0 + 1.0j)) == pytest.approx(n)
    # LAPACK's estimate is exact on matrices this small, and never too large.
    assert condition(hilbert(n)) == pytest.approx(np.linalg.cond(hilbert(n), 1), rel=1e-6)
    assert condition(np.ones((n, n))) > 1e15
    assert condition(np.full((n, n), np.nan)) == np.inf


def test_modes_near_an_exceptional_point_are_ill_conditioned() -> None:
    # [[1, 1], [d, 1]] has the eigenvectors (1, +-sqrt d), which meet as d vanishes: cond ~ 1 / sqrt d.
    for d in (1e-2, 1e-6, 1e-10):
        modes = layer_modes(np.array([[1.0, 1.0], [d, 1.0]]), np.eye(2))
        assert conditioning(modes).condition == pytest.approx(1.0 / np.sqrt(d), rel=0.5)


@pytest.mark.parametrize(
    "cell",
    [
        SILICON,
        replace(SILICON, n_pillar=0.15 + 3.5j),
        replace(SILICON, n_pillar=1e3),
        replace(SILICON, width_nm=2.0, length_nm=2.0),
        replace(SILICON, angle_deg=20.0, azimuth_deg=33.0),
    ],
    ids=["silicon", "metal", "index 1000", "2 nm", "tilted"],
)
def test_both_ways_through_the_layer_agree_within_the_bound(cell: PillarCell) -> None:
    orders = 3 if cell.angle_deg else 5
    either, by_modes = zero_order(cell, orders), zero_order(cell, orders, by_modes=True)
    assert by_modes.conditioning.condition >= 1.0
    assert distance(either, by_modes) <= by_modes.conditioning.rounding < 1e-6


def test_conditioning_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    coated = replace(SILICON, over=(Slice(40.0, 1.41, 1.0),))
    assert solve(coated, CellNumerics(target_error=1e-1)).details.condition == 0.0
    monkeypatch.setattr(stack, "by_slabs", lambda *_: None)
    assert solve(coated, CellNumerics(target_error=1e-1)).details.condition > 1.0
    assert zero_order(SILICON, 4).conditioning == NO_MODES
    assert solve(SILICON, CellNumerics(target_error=1e-2)).details.condition == 0.0


def test_an_answer_from_modes_too_ill_is_not_called_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    # A planted fault: each layer's first mode is all but the second, as at an exceptional point.
    coated = replace(SILICON, over=(Slice(40.0, 1.41, 1.0),))

    def nearly_defective(p: np.ndarray, q: np.ndarray) -> LayerModes:
        modes = layer_modes(p, q)
        e, h = modes.e.copy(), modes.h.copy()
        e[:, 0], h[:, 0] = e[:, 1] + 1e-13 * e[:, 0], h[:, 1] + 1e-13 * h[:, 0]
        return LayerModes(modes.beta, e, h)

    monkeypatch.setattr(stack, "by_slabs", lambda *_: None)
    assert solve(coated, CellNumerics(target_error=1e-1)).converged
    monkeypatch.setattr(stack, "layer_modes", nearly_defective)
    spoilt = solve(coated, CellNumerics(target_error=1e-1, max_orders=6))
    assert spoilt.details.condition > 1e12
    assert not spoilt.converged
    assert spoilt.error > 1e-1
