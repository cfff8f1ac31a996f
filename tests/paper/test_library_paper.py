"""The paper's library, really built: both phases over the whole circle, well transmitted, as well known as was asked.

Shen et al. 2023, Fig. 2c: silicon on sapphire, height 600 nm, period 350 nm, width and length 100 to 250 nm, 800 nm.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab import library
from metafab.core.conventions import wrap_phase
from metafab.core.executor import open_executor
from metafab.library import Library, build_size_table
from metafab.spec import UnitCell

pytestmark = pytest.mark.slow


@pytest.fixture(scope="session")
def paper_library(unit_cell: UnitCell) -> Library:
    """One build for all tests here: about 13 s of processor time."""
    with open_executor() as executor:
        return library.build(unit_cell, executor=executor)


def test_the_geometry_is_the_papers(unit_cell: UnitCell) -> None:
    assert unit_cell.cell.period_nm == (350.0, 350.0)
    assert unit_cell.cell.height_nm == 600.0
    assert unit_cell.sweep.width_nm == unit_cell.sweep.length_nm == (100.0, 250.0)
    assert unit_cell.illumination.wavelength_nm == 800.0


def test_both_phases_cover_the_circle(paper_library: Library) -> None:
    """Every phase of either polarisation is had to within 0.1 rad by sizes that pass half the power of both."""
    assert library.coverage_rad(paper_library) == pytest.approx(2.0 * math.pi)
    assert paper_library.details["coverage_rad"] == pytest.approx(2.0 * math.pi)


def test_pairs_of_phases_are_covered_but_for_a_wedge(paper_library: Library) -> None:
    """Arbitrary pairs within 0.1 rad for 95 % of the torus; the farthest pair lies 0.33 rad off (measured)."""
    figures = library.quality(paper_library)
    assert figures["torus_coverage"] > 0.95
    assert figures["worst_hole_rad"] < 0.35


def test_transmission_is_high_where_phases_are_chosen(paper_library: Library) -> None:
    """Sizes of the best overlap pass 89 % of both polarisations' power on average (measured 0.893)."""
    figures = library.quality(paper_library)
    assert figures["mean_transmittance"] > 0.88
    assert figures["mean_overlap"] > 0.93


def test_high_transmission_does_not_hold_for_every_size(paper_library: Library) -> None:
    """Guided-mode resonances cross the plane of sizes: somewhere |t| nearly vanishes."""
    assert np.abs(paper_library.t_xx).min() < 0.1


def test_mapped_phases_are_near_their_targets(paper_library: Library) -> None:
    """Random targets: the rms phase error of the chosen sizes is 0.10 rad (measured), the wedge included."""
    table = build_size_table(paper_library, database_unit_nm=0.5)
    targets = np.random.default_rng(2).uniform(-math.pi, math.pi, (2, 20_000))
    error_rad = wrap_phase(table.phase_error_rad(table.sizes_for(*targets), *targets))
    assert np.sqrt(np.mean(error_rad**2)) < 0.12


def test_every_size_is_known_to_the_asked_error(paper_library: Library) -> None:
    assert paper_library.error.max() <= paper_library.unit_cell.sweep.target_error
    assert paper_library.details["sizes_beyond_target"] == 0
    assert float(paper_library.details["points_solved"]) < 0.2 * 76 * 77 / 2


def test_a_finer_solver_agrees_at_held_out_sizes_between_the_grid(paper_library: Library) -> None:
    """Random sizes off the grid, solved to a tenth of the target: each within what the library states there."""
    judged = library.check(paper_library, samples=60, seed=21)
    assert judged.beyond_stated == 0
    assert judged.max_abs_error <= paper_library.unit_cell.sweep.target_error


def test_the_response_is_passive(paper_library: Library) -> None:
    """No size sends out more than it gets: |r|^2 + |t|^2 n_out / n_in <= 1, within the error of both amplitudes."""
    t, r = np.abs(paper_library.t_xx[0]), np.abs(paper_library.r_xx[0])
    ratio = 1.0 / 1.7601
    slack = 2.0 * paper_library.error[0] * (r + ratio * t) + 2.0 * paper_library.error[0] ** 2
    assert np.all(r**2 + ratio * t**2 <= 1.0 + slack)
