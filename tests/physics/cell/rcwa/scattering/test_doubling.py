"""The layer by doubling its thickness against the layer by its modes: two ways through the same matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import PillarCell
from metafab.cell.rcwa import zero_order
from metafab.cell.rcwa.scattering import doubling
from metafab.cell.rcwa.scattering.modes import NO_MODES
from metafab.cell.rcwa.scattering.reverse import pull_back_doubled
from tests.paper_cell import SILICON

CELLS = {
    "lossy": SILICON,
    "lossless": replace(SILICON, n_pillar=3.6941),
    "resonant": replace(SILICON, width_nm=220.8, length_nm=244.6),
    "from the ambient": replace(SILICON, side="ambient"),
    "oblique": replace(SILICON, angle_deg=20.0),
    "out of plane": replace(SILICON, angle_deg=20.0, azimuth_deg=33.0),
    "Rayleigh anomaly": replace(SILICON, period_nm=(800.0, 800.0)),
    "metal": replace(SILICON, n_pillar=0.15 + 3.5j),
    "absorbing substrate": replace(SILICON, n_substrate=(1.7601 + 0.3j, 1.7601 + 0.3j), side="ambient"),
    "thin": replace(SILICON, height_nm=0.5),
    "tall": replace(SILICON, height_nm=50_000.0),
    "no height": replace(SILICON, height_nm=0.0),
    "film": replace(SILICON, width_nm=350.0, length_nm=350.0),
    # The film's half slab has cot(W d / 2) = 1, 0 or infinity: a regular point, a zero and a pole of F_half.
    "quarter-wave film": replace(SILICON, width_nm=350.0, length_nm=350.0, n_pillar=2.0, height_nm=100.0),
    "half-wave film": replace(SILICON, width_nm=350.0, length_nm=350.0, n_pillar=2.0, height_nm=200.0),
    "full-wave film": replace(SILICON, width_nm=350.0, length_nm=350.0, n_pillar=2.0, height_nm=400.0),
    "2 nm": replace(SILICON, width_nm=2.0, length_nm=2.0),
    "1 nm slits": replace(SILICON, width_nm=349.0, length_nm=349.0),
    "hole": replace(SILICON, n_pillar=1.0, n_ambient=3.6941),
}
#: Amplitudes may differ by a hundred times the accepted inconsistency of 1e-10; these stay below.
AGREEMENT = 2e-9


@pytest.mark.parametrize("orders", [3, 5, 6])
@pytest.mark.parametrize("cell", CELLS.values(), ids=CELLS.keys())
def test_doubling_equals_the_modes(cell: PillarCell, orders: int) -> None:
    either, modes = zero_order(cell, orders), zero_order(cell, orders, by_modes=True)
    assert modes.inconsistency == 0.0
    np.testing.assert_allclose(either.t, modes.t, rtol=0.0, atol=AGREEMENT)
    np.testing.assert_allclose(either.r, modes.r, rtol=0.0, atol=AGREEMENT)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lossy", "lossless", "resonant", "tall", "2 nm", "1 nm slits"])
def test_doubling_equals_the_modes_with_many_unknowns(name: str) -> None:
    # 221 unknowns, and wave numbers that differ by up to 1e4.
    either, modes = zero_order(CELLS[name], 10), zero_order(CELLS[name], 10, by_modes=True)
    np.testing.assert_allclose(either.t, modes.t, rtol=0.0, atol=AGREEMENT)
    np.testing.assert_allclose(either.r, modes.r, rtol=0.0, atol=AGREEMENT)


@pytest.mark.parametrize("name", ["lossy", "tall", "2 nm", "1 nm slits", "half-wave film", "metal"])
def test_doubling_is_what_usually_runs(name: str) -> None:
    solved = zero_order(CELLS[name], 6)
    assert solved.conditioning == NO_MODES
    assert 0.0 < solved.inconsistency < 1e-10


def test_modes_take_over_where_rounding_would_show(monkeypatch: pytest.MonkeyPatch) -> None:
    modes = zero_order(SILICON, 5, by_modes=True)
    monkeypatch.setattr(doubling, "CONSISTENT", 1e-18)
    refused = zero_order(SILICON, 5)
    np.testing.assert_array_equal(refused.t, modes.t)
    assert refused.inconsistency == 0.0


@pytest.mark.parametrize("n_pillar", [1e3, 1e-3 + 1e3j])
def test_rounding_does_not_show_at_a_million_to_one(n_pillar: complex) -> None:
    # Permittivities of +-1e6: doubling breaks reciprocity by up to 2e-5, and the modes take over.
    cell = replace(SILICON, n_pillar=n_pillar)
    for orders in (3, 5):
        either, modes = zero_order(cell, orders), zero_order(cell, orders, by_modes=True)
        np.testing.assert_allclose(either.t, modes.t, rtol=0.0, atol=AGREEMENT)
        assert either.inconsistency < 1e-10


@pytest.mark.parametrize(("thickness", "omitted", "rank"), [(0.8, 0, 8), (4.7, 1, 2), (4.7, 1, 8), (40.0, 1, 1)])
def test_the_reverse_of_doubling_obeys_the_dot_product_identity(thickness: float, omitted: int, rank: int) -> None:
    """Two and several halvings, weights of low and of full rank; differences over 2e-6 leave 1e-9."""
    rng = np.random.default_rng(0)
    draws = [rng.normal(size=(8, 8)) + 1j * rng.normal(size=(8, 8)) for _ in range(7)]
    noise_p, noise_q, d_p, d_q = (draw + draw.T for draw in draws[:4])
    p, q = np.eye(8) + 0.1 * noise_p, 2.0 * np.eye(8) + 0.5 * noise_q
    left, right = np.stack(draws[4:6])[:, :, :rank], draws[6][:, :rank]
    whole = doubling.doubled(p, q, thickness, np.inf, omitted=omitted, keep=True)
    ends = [doubling.doubled(p + h * d_p, q + h * d_q, thickness, np.inf, omitted=omitted) for h in (1e-6, -1e-6)]
    assert whole is not None and ends[0] is not None and ends[1] is not None
    by_a = pull_back_doubled(whole, left, right)
    forward = np.sum(left @ right.T * (ends[0].f - ends[1].f), axis=(1, 2)) / 2e-6
    np.testing.assert_allclose(np.sum(by_a * (d_p @ q + p @ d_q), axis=(1, 2)), forward, rtol=1e-7)
