"""Derivatives by the pillar's sizes against finite differences of the same truncated equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell.rcwa import Formulation, derivatives, zero_order
from metafab.cell.response import PillarCell
from metafab.core.conventions import ComplexArray
from metafab.core.errors import InputError

SILICON = PillarCell((350.0, 350.0), 150.0, 210.0, 600.0, 3.6941 + 0.0065j, (1.7601, 1.7601), 1.0, 800.0)
CELLS = [
    SILICON,
    replace(SILICON, width_nm=230.0, length_nm=230.0, side="ambient"),
    replace(SILICON, n_substrate=(1.7601, 1.7522), period_nm=(350.0, 420.0)),
    replace(SILICON, n_pillar=2.4, height_nm=5_000.0),
    replace(SILICON, n_pillar=0.15 + 3.5j),
]
#: Step of the five-point difference; its truncation error is below 1e-11 of the derivative, its rounding error about
#: 1e-12 / step.
STEP_NM = 0.02


def _difference(cell: PillarCell, name: str, formulation: Formulation) -> tuple[ComplexArray, ComplexArray]:
    size = getattr(cell, name)
    at = {k: zero_order(replace(cell, **{name: size + k * STEP_NM}), 4, formulation) for k in (-2, -1, 1, 2)}
    weights = {-2: 1.0, -1: -8.0, 1: 8.0, 2: -1.0}
    t, r = (
        sum(weight * getattr(at[k], which) for k, weight in weights.items()) / (12.0 * STEP_NM) for which in ("t", "r")
    )
    return np.asarray(t), np.asarray(r)


@pytest.mark.parametrize("formulation", ["adaptive", "fourier"])
@pytest.mark.parametrize("cell", CELLS, ids=["silicon", "square", "anisotropic", "tall", "metal"])
def test_derivatives_equal_differences(cell: PillarCell, formulation: Formulation) -> None:
    found = derivatives(cell, 4, formulation)
    value = zero_order(cell, 4, formulation)
    np.testing.assert_allclose(found.t, value.t, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(found.r, value.r, rtol=0.0, atol=1e-11)
    for name, t_tangent, r_tangent in (
        ("width_nm", found.t_per_width, found.r_per_width),
        ("length_nm", found.t_per_length, found.r_per_length),
    ):
        t, r = _difference(cell, name, formulation)
        scale = max(np.abs(t).max(), np.abs(r).max())
        np.testing.assert_allclose(t_tangent, t, rtol=0.0, atol=1e-6 * scale)
        np.testing.assert_allclose(r_tangent, r, rtol=0.0, atol=1e-6 * scale)


def test_derivatives_need_walls_and_upright_light() -> None:
    with pytest.raises(InputError, match="width_nm"):
        derivatives(replace(SILICON, width_nm=350.0), 4)
    with pytest.raises(InputError, match="angle_deg"):
        derivatives(replace(SILICON, angle_deg=1.0), 4)
