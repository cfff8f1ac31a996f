"""The layer by doubling its thickness against the layer by its modes: two ways through the same matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell.rcwa import jones, zero_order
from metafab.cell.response import PillarCell

SILICON = PillarCell((350.0, 350.0), 150.0, 210.0, 600.0, 3.6941 + 0.0065j, (1.7601, 1.7601), 1.0, 800.0)
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
    # A quarter of a wavelength of the film: cot(W d) = 0, a zero of F at the last doubling but for rounding.
    "quarter-wave film": replace(SILICON, width_nm=350.0, length_nm=350.0, n_pillar=2.0, height_nm=100.0),
    # Half a wavelength: F and G are infinite, and the modes must take over.
    "half-wave film": replace(SILICON, width_nm=350.0, length_nm=350.0, n_pillar=2.0, height_nm=200.0),
    "1 nm slits": replace(SILICON, width_nm=349.0, length_nm=349.0),
}
#: Amplitudes may differ by a hundred times the accepted inconsistency of 1e-10; these stay below.
AGREEMENT = 2e-9


@pytest.mark.parametrize("orders", [3, 5, 6])
@pytest.mark.parametrize("cell", CELLS.values(), ids=CELLS.keys())
def test_doubling_equals_the_modes(cell: PillarCell, orders: int, monkeypatch: pytest.MonkeyPatch) -> None:
    either = zero_order(cell, orders)
    monkeypatch.setattr(jones, "MOST_UNKNOWNS", 0)
    by_modes = zero_order(cell, orders)
    assert by_modes.inconsistency == 0.0
    np.testing.assert_allclose(either.t, by_modes.t, rtol=0.0, atol=AGREEMENT)
    np.testing.assert_allclose(either.r, by_modes.r, rtol=0.0, atol=AGREEMENT)


def test_doubling_is_what_usually_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_modes(*_: object) -> None:
        raise AssertionError("modes were used")

    monkeypatch.setattr(jones, "layer_modes", no_modes)
    solved = zero_order(SILICON, 6)
    assert 0.0 < solved.inconsistency < 1e-10


def test_modes_take_over_where_rounding_would_show(monkeypatch: pytest.MonkeyPatch) -> None:
    # Slits of 1 nm need so many doublings at 7 orders that rounding grows to 1e-3: refused, not returned.
    slits = CELLS["1 nm slits"]
    either = zero_order(slits, 7)
    monkeypatch.setattr(jones, "MOST_UNKNOWNS", 0)
    np.testing.assert_array_equal(either.t, zero_order(slits, 7).t)
    assert either.inconsistency == 0.0
