"""Supercells by the real Meep: equal pillars are a cell, shifts are phases, unlike neighbours couple as in RCWA."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import elements
from metafab.cell.meep import Pool, SupercellSettings, solve_supercell
from metafab.cell.meep.supercell import refined_orders
from metafab.cell.supercell import Supercell, relative_rms
from metafab.core.errors import InputError
from tests.paper_cell import EMPTY

#: Lossless, so that power has nowhere else to go.
CELL = replace(EMPTY, n_pillar=3.0, n_substrate=(1.46, 1.46))
#: Coarse: the tests compare grids with themselves.
COARSE = SupercellSettings(pixels_per_period=12, decay=1e-4)
RAMP = [(100.0, 100.0), (150.0, 150.0), (190.0, 190.0)]


def _row(*sizes: tuple[float, float]) -> Supercell:
    return Supercell(CELL, np.array([sizes]))


@pytest.mark.meep
def test_equal_pillars_are_their_own_local_period(pool: Pool) -> None:
    """In a block of 2 x 3 as well as alone; the block has both mirrors, and orders along x and y."""
    block = Supercell(CELL, np.full((2, 3, 2), 150.0) + np.array([-10.0, 30.0]))
    found = solve_supercell(block, "x", COARSE, pool)
    assert {(int(m), int(n)) for m, n in found.order} == {(-1, 0), (0, 0), (1, 0)}
    # Both tails end at 1e-4 of the incident wave.
    assert found.coupling_error < 5e-4
    assert np.all(found.efficiency[[0, 2]] < 1e-6)
    assert np.abs(found.amplitude[:, 1]).max() < 1e-6, "a mirror keeps y light out of x light"


@pytest.mark.meep
def test_rows_along_y_are_rows_along_x_exchanged(pool: Pool) -> None:
    row = _row((100.0, 120.0), (180.0, 130.0), (190.0, 190.0))
    along_x, along_y = (
        solve_supercell(each, light, COARSE, pool)  # type: ignore[arg-type]
        for each, light in ((row, "x"), (row.exchanged(), "y"))
    )
    np.testing.assert_array_equal(along_y.order[:, ::-1], along_x.order)
    # Meep's own sampling treats both axes alike; the tails are 1e-4.
    np.testing.assert_allclose(along_y.amplitude[:, ::-1], along_x.amplitude, atol=1e-3)


@pytest.mark.meep
@pytest.mark.parametrize("polarisation", ["x", "y"])
def test_a_ramp_deflects_to_its_side_and_moves_with_its_phase(pool: Pool, polarisation: str) -> None:
    found = solve_supercell(_row(*RAMP), polarisation, COARSE, pool)  # type: ignore[arg-type]
    # Wider pillars to the right delay the wave there more: its phase rises along +x, into order +1.
    assert np.argmax(found.efficiency) == 2
    assert np.argmax(found.local_period_efficiency) == 2
    assert found.efficiency.sum() < 1.0
    # Unlike neighbours couple: what the local-period approximation misses is far above the tail.
    assert found.coupling_error > 10.0 * found.error
    moved = solve_supercell(_row(*RAMP[-1:], *RAMP[:-1]), polarisation, COARSE, pool)  # type: ignore[arg-type]
    turned = found.co_polarised * np.exp(-2j * np.pi * found.order[:, 0] / 3.0)
    # The same pillars a cell further right, on the same grid: only tails and absorbers can tell.
    np.testing.assert_allclose(moved.co_polarised, turned, atol=2e-3)


@pytest.mark.meep
@pytest.mark.slow
def test_rcwa_finds_the_same_orders_and_the_same_coupling(pool: Pool) -> None:
    """Walls on the nodes of both grids, so that errors fall by h^2 and extrapolate: 0.06 on the finer one.

    What is left are the corners' slower power (1e-2, from lone pillars on such grids) and what RCWA states.
    """
    row = _row((100.0, 150.0), (200.0, 200.0), (100.0, 150.0))
    coarse, fine = (solve_supercell(row, "y", SupercellSettings(pixels, 1e-3), pool) for pixels in (14, 28))
    reference = elements.solve_supercell(row, "y", elements.ElementNumerics(2e-3))
    limit = fine.co_polarised + (fine.co_polarised - coarse.co_polarised) / 3.0
    assert np.abs(fine.co_polarised - reference.co_polarised).max() < 6e-2
    assert np.abs(limit - reference.co_polarised).max() < 1e-2 + reference.error
    assert fine.coupling_error == pytest.approx(reference.coupling_error, rel=0.05)
    assert reference.coupling_error > 0.1


@pytest.mark.parametrize("pixels", [13, 6])
def test_grids_that_do_not_fit_are_refused(pixels: int) -> None:
    with pytest.raises(InputError, match="pixels_per_period"):
        solve_supercell(_row(*RAMP), "x", SupercellSettings(pixels))


@pytest.mark.meep
@pytest.mark.slow
def test_spectral_elements_and_fdtd_agree_in_both_polarisations(pool: Pool) -> None:
    """Walls on nodes, so that both grids extrapolate; Meep states the step to the limit, most of which it removes."""
    row = _row((100.0, 150.0), (200.0, 200.0), (100.0, 150.0))
    found = refined_orders(row, (14, 28), pool=pool)
    reference = elements.supercell_orders(row)
    assert relative_rms(found.t - reference.t, reference.t) < found.error + reference.error
