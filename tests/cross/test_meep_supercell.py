"""Rows of pillars by the real Meep: identical ones are a unit cell, shifts are phases, unlike neighbours couple."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.cell.meep import Pool, solve_row
from metafab.cell.response import PillarCell
from metafab.core.errors import InputError

#: Lossless, so that power has nowhere else to go.
CELL = PillarCell(
    period_nm=(350.0, 350.0),
    width_nm=0.0,
    length_nm=0.0,
    height_nm=600.0,
    n_pillar=3.0 + 0j,
    n_substrate=(1.46 + 0j, 1.46 + 0j),
    n_ambient=1.0 + 0j,
    wavelength_nm=800.0,
)
#: Coarse: the tests compare grids with themselves.
PIXELS = 12


@pytest.mark.meep
def test_identical_pillars_are_their_own_local_period(pool: Pool) -> None:
    found = solve_row(CELL, [(140.0, 180.0)] * 3, "x", pixels_per_period=PIXELS, decay=1e-4, pool=pool)
    np.testing.assert_array_equal(found.order, [-1.0, 0.0, 1.0])
    # Both tails end at 1e-4 of the incident wave.
    assert found.coupling_error < 5e-4
    assert np.all(found.efficiency[[0, 2]] < 1e-6)


@pytest.mark.meep
@pytest.mark.parametrize("polarisation", ["x", "y"])
def test_a_ramp_deflects_to_its_side_and_moves_with_its_phase(pool: Pool, polarisation: str) -> None:
    ramp = [(100.0, 100.0), (150.0, 150.0), (190.0, 190.0)]
    assert polarisation in {"x", "y"}
    common = {"pixels_per_period": PIXELS, "decay": 1e-4, "pool": pool}
    found = solve_row(CELL, ramp, polarisation, **common)  # type: ignore[arg-type]
    # Wider pillars to the right delay the wave there more: its phase rises along +x, into order +1.
    assert np.argmax(found.efficiency) == 2
    assert np.argmax(np.abs(found.local_period)) == 2
    assert found.efficiency.sum() < 1.0
    # Unlike neighbours couple: what the local-period approximation misses is far above the tail.
    assert found.coupling_error > 10.0 * found.tail
    moved = solve_row(CELL, ramp[-1:] + ramp[:-1], polarisation, **common)  # type: ignore[arg-type]
    turned = found.amplitude * np.exp(-2j * np.pi * found.order / 3.0)
    # The same pillars a cell further right, on the same grid: only tails and absorbers can tell.
    np.testing.assert_allclose(moved.amplitude, turned, atol=2e-3)


def test_grids_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="pixels_per_period"):
        solve_row(CELL, [(100.0, 100.0)], "x", pixels_per_period=13)
    with pytest.raises(InputError, match="size_nm"):
        solve_row(CELL, [], "x")
