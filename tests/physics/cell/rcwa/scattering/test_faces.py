"""Faces of a lossless layer in real arithmetic against the same equations in complex arithmetic."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from metafab.cell.rcwa import zero_order
from metafab.cell.rcwa.scattering import doubling, faces
from metafab.cell.rcwa.scattering.modes import NO_MODES
from tests.paper_cell import SILICON

#: Several waves propagate behind large periods, one of them at a Rayleigh anomaly.
CHANGES: list[dict[str, Any]] = [
    {},
    {"side": "ambient"},
    {"angle_deg": 20.0},
    {"angle_deg": 20.0, "azimuth_deg": 33.0},
    {"period_nm": (800.0, 800.0)},
    {"period_nm": (800.0, 700.0), "n_ambient": 1.33},
    {"width_nm": 350.0, "length_nm": 350.0},
    {"height_nm": 50_000.0},
]


@pytest.mark.parametrize("change", CHANGES, ids=str)
def test_real_arithmetic_gives_the_same(change: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    cell = replace(SILICON, n_pillar=2.4, **change)
    monkeypatch.setattr(faces, "FEWEST_REAL", 10**9)
    expected = zero_order(cell, 5)
    monkeypatch.setattr(faces, "FEWEST_REAL", 0)
    monkeypatch.setattr(doubling, "amplitudes", Mock(side_effect=AssertionError("complex arithmetic")))
    found = zero_order(cell, 5)
    np.testing.assert_allclose(found.t, expected.t, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(found.r, expected.r, rtol=0.0, atol=1e-11)
    assert found.conditioning == NO_MODES
