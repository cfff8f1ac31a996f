"""The real Meep against closed forms and RCWA, each within the sum of the errors that both state.

The coarse members keep these within minutes on one core; the stated errors are correspondingly large, so each
test also bounds them: a solver that states an error of one would agree with everything.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, CellResponse, rcwa
from metafab.cell import solve as cell_solve
from metafab.cell.meep import MeepSettings, Pool, solve
from metafab.cell.meep.grid import family, plan
from metafab.cell.pillar import Slice
from tests.paper_cell import EMPTY

pytestmark = pytest.mark.meep

MEEP = CellNumerics(target_error=1e-4, solver="meep")
#: A period of ten pixels of 25 nm, for cells that are uniform along it.
NARROW = replace(EMPTY, period_nm=(250.0, 250.0))


def _difference(a: CellResponse, b: CellResponse) -> float:
    return float(max(np.max(np.abs(a.t - b.t)), np.max(np.abs(a.r - b.r))))


def test_an_empty_cell_is_fresnels_interface(pool: Pool) -> None:
    """t = 2 n_in / (n_in + n_out) at the substrate, then 600 nm of air: 3/4 of a wave."""
    found = solve(replace(NARROW, n_substrate=(1.7601 + 0j, 1.7522 + 0j)), MEEP, MeepSettings((1, 2)), pool)
    for axis, n in enumerate((1.7601, 1.7522)):
        assert found.t[axis, axis] == pytest.approx(-1j * 2.0 * n / (n + 1.0), abs=found.error)
        assert found.r[axis, axis] == pytest.approx((n - 1.0) / (n + 1.0), abs=found.error)
    assert found.error < 3e-3
    assert found.t[0, 1] == found.t[1, 0] == 0.0


def test_a_film_is_airys_formula_from_both_sides(pool: Pool) -> None:
    """A film of n = 2 (no pillar resonances): t and r by Airy's sum, in our planes; reciprocity of t."""
    film = replace(NARROW, width_nm=250.0, length_nm=250.0, n_pillar=2.0 + 0.01j)
    n = film.n_pillar
    phase = np.exp(2j * np.pi * n * 600.0 / 800.0)
    for side in ("substrate", "ambient"):
        found = solve(replace(film, side=side), MEEP, MeepSettings((1, 2)), pool)
        n_in, n_out = (1.7601, 1.0) if side == "substrate" else (1.0, 1.7601)
        r_first, r_second = (n_in - n) / (n_in + n), (n - n_out) / (n + n_out)
        echo = 1.0 + r_first * r_second * phase**2
        t = (2 * n_in / (n_in + n)) * (2 * n / (n + n_out)) * phase / echo
        assert found.t[0, 0] == pytest.approx(t, abs=found.error)
        assert found.r[0, 0] == pytest.approx((r_first + r_second * phase**2) / echo, abs=found.error)
        assert found.error < 2e-2


def test_moving_the_monitors_changes_nothing(pool: Pool) -> None:
    """Up to what the absorbers send back, some 1e-4 of a wave."""
    cell = replace(EMPTY, width_nm=150.0, length_nm=200.0)
    found = []
    for shift in (0, 3, 7):
        run = plan(cell, family(cell), "x", 1, decay=1e-6, longest_time=800.0, shift_nodes=shift)
        reply = pool.run(run.job)
        found.append(run.amplitudes(reply["limit"][:, 0, 0], reply["incident"]))
    assert np.max(np.abs(np.array(found) - found[0])) < 5e-4


def test_mirrors_save_time_and_change_nothing(pool: Pool) -> None:
    cell = replace(EMPTY, width_nm=150.0, length_nm=200.0)
    run = plan(cell, family(cell), "y", 1, decay=1e-5, longest_time=200.0)
    quarter, whole = pool.run(run.job), pool.run(replace(run.job, mirrors=()))
    np.testing.assert_allclose(quarter["limit"], whole["limit"], atol=1e-9 * np.abs(whole["limit"]).max())


@pytest.mark.slow
def test_pillars_agree_with_rcwa(pool: Pool) -> None:
    """Three pillars: a rectangle, a square from the air side, and one on a guided-mode resonance (|t_xx|^2 < 0.003).

    A square needs one run a grid; the finest grid costs four times all others, so the rectangle goes without it.
    """
    square, on_resonance = (replace(EMPTY, width_nm=nm, length_nm=nm) for nm in (140.0, 210.0))
    cells = [
        (replace(EMPTY, width_nm=133.0, length_nm=199.0), (1, 2), 0.15),
        (replace(square, side="ambient"), (1, 2, 3), 0.05),
        (on_resonance, (1, 2, 3), 0.05),
    ]
    for cell, members, largest in cells:
        found = solve(cell, MEEP, MeepSettings(members), pool)
        reference = rcwa.solve(cell, CellNumerics(target_error=1e-3))
        assert _difference(found, reference) <= found.error + reference.error
        assert found.error < largest
        assert found.details.error_decay < 1e-3
    assert abs(reference.t[0, 0]) ** 2 < 3e-3


@pytest.mark.slow
def test_curved_sloped_and_layered_cells_agree_with_the_other_solvers(pool: Pool) -> None:
    """Low pillars, so that coarse grids do: a circle by spectral elements, a sloped cell with film and cap by RCWA."""
    low = replace(EMPTY, height_nm=200.0, n_pillar=2.4 + 0j)
    circle = replace(low, shape="ellipse", width_nm=220.0, length_nm=180.0)
    layers = {"under": (Slice(60.0, 1.9 + 0j, 1.9 + 0j),), "over": (Slice(50.0, 1.5 + 0j, 1.0 + 0j),)}
    sloped = replace(low, width_nm=200.0, length_nm=200.0, sidewall_angle_deg=80.0, side="ambient", **layers)
    for cell in (circle, sloped):
        # RCWA of sloped walls takes 30 times as long to 2e-3 as to 3e-3, a sixth of the error of these grids.
        reference = cell_solve(cell, CellNumerics(target_error=3e-3))
        found = solve(cell, MEEP, MeepSettings((1, 2)), pool)
        assert _difference(found, reference) <= found.error + reference.error
        assert found.error < 0.02
        # A square pillar of that size without slope or layers is another cell.
        other = cell_solve(replace(low, width_nm=200.0, length_nm=200.0, side=cell.side))
        assert _difference(found, other) > 3.0 * found.error
