"""Cells by FDTD with waves of known amplitudes in place of Meep."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell
from metafab.cell.meep import MeepSettings, Pool, solve
from metafab.cell.meep.grid import family, plan
from metafab.cell.meep.protocol import Job, Reply
from metafab.cell.meep.solver import richardson, smoothed_limit
from metafab.core.errors import InputError, SolverError
from tests.paper_cell import SILICON


class _KnownAnswers(Pool):
    """In place of workers: grid waves around a pillar whose t and r err by h^2 and whose tails are known."""

    T, R = {"x": 0.3 - 0.8j, "y": 0.6 + 0.2j}, {"x": -0.2 + 0.1j, "y": 0.1 + 0.4j}

    def __init__(self, cell: PillarCell, tail: float) -> None:
        super().__init__(1)
        self.cell, self.tail = cell, tail
        self.jobs: list[Job] = []

    def run(self, job: Job, report: object = None) -> Reply:
        self.jobs.append(job)
        grids = family(self.cell)
        member = job.n_x // (2 * grids.period[0])
        run = plan(self.cell, grids, job.polarisation, member, decay=1.0, longest_time=1.0)
        k_in, (k_out,) = run.k_in, run.k_out
        t, r = (value[job.polarisation] + 40.0 * job.pixel_um**2 for value in (self.T, self.R))
        near, far = cmath.exp(1j * k_in * run.near_um), cmath.exp(1j * k_out * run.far_um)
        return {
            "limit": np.array([near + r / near, t * far])[:, None, None],
            "incident": np.array([near, 0.0]),
            "tail": np.array(self.tail),
            "time": np.array([10.0]),
            "seconds": np.array(0.5),
        }


def test_a_cell_is_solved_in_both_polarisations_until_the_error_is_reached() -> None:
    pool = _KnownAnswers(SILICON, 1e-6)
    found = solve(SILICON, CellNumerics(target_error=1e-3, solver="meep"), pool=pool)
    np.testing.assert_allclose(found.t, np.diag(list(pool.T.values())), atol=1e-10)
    np.testing.assert_allclose(found.r, np.diag(list(pool.R.values())), atol=1e-10)
    assert found.converged
    assert len(pool.jobs) == 6, "a pure h^2 error is seen to be one on the third grid, and the fourth is saved"
    assert found.error == pytest.approx(found.details.error_decay, abs=1e-9)
    assert found.details.error_decay > 1e-6, "extrapolation makes more of the tails"


def test_a_square_pillar_is_solved_in_one_polarisation() -> None:
    square = replace(SILICON, width_nm=150.0, length_nm=150.0)
    pool = _KnownAnswers(square, 0.0)
    found = solve(square, CellNumerics(target_error=1e-3, solver="meep"), pool=pool)
    assert found.t[0, 0] == found.t[1, 1]
    assert {job.polarisation for job in pool.jobs} == {"x"}


def test_a_field_that_does_not_decay_has_no_limit() -> None:
    with pytest.raises(SolverError, match="longest_periods"):
        solve(SILICON, CellNumerics(target_error=1e-3, solver="meep"), pool=_KnownAnswers(SILICON, math.inf))


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"angle_deg": 5.0}, "angle_deg"),
        ({"n_substrate": (1.76 + 0.1j, 1.76 + 0j)}, "n_substrate"),
        ({"n_ambient": 1.0 + 1e-3j}, "n_ambient"),
        ({"n_pillar": 0.05 + 5.0j}, "n_pillar"),
        ({"height_nm": 0.0}, "height_nm"),
    ],
)
def test_what_fdtd_does_not_treat_is_refused_before_anything_starts(changes: dict[str, object], field: str) -> None:
    with pytest.raises(InputError, match=field):
        solve(replace(SILICON, **changes), CellNumerics(solver="meep"))


@pytest.mark.parametrize("members", [(2,), (2, 1), (0, 1), (2, 2)])
def test_settings_are_checked(members: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="members"):
        MeepSettings(members=members)


def test_richardson_finds_the_limit_of_its_own_model() -> None:
    h = np.array([4.0, 2.0, 4.0 / 3.0])
    value = np.array([0.4 - 0.2j, 1.0 + 0j])
    exact = [value + (0.1 + 0.05j) * x**2 - 0.002j * x**4 for x in h]
    found = richardson(h, exact)
    np.testing.assert_allclose(found.value, value, atol=1e-12)
    assert found.error > 0.0
    # Weights 0.0417, -1.0667 and 2.025 for grids in the ratio 1 : 2 : 3.
    assert found.gain == pytest.approx(1 / 24 + 16 / 15 + 81 / 40)


def test_richardson_states_an_error_that_covers_other_orders() -> None:
    """Corners of the pillar leave a rest that falls with a lower power than the model's."""
    h = np.array([4.0, 2.0, 4.0 / 3.0, 1.0])
    for power in (4.0 / 3.0, 1.5, 2.5, 3.0):
        samples = [np.array([1.0 + 0.1 * x**2 + 0.01j * x**power]) for x in h]
        for count in (2, 3, 4):
            found = richardson(h[:count], samples[:count])
            assert abs(found.value[0] - 1.0) < found.error


def test_richardson_refuses_what_it_cannot_extrapolate() -> None:
    with pytest.raises(ValueError, match="two or more"):
        richardson([1.0], [np.zeros(1, complex)])
    with pytest.raises(ValueError, match="descending"):
        richardson([1.0, 2.0], [np.zeros(1, complex)] * 2)


def test_plain_grids_have_a_limit_of_second_order_with_an_error_that_covers_their_irregularity() -> None:
    """Deviations of up to a fifth of c h^2, as of walls that cross pixels anywhere; exact without them."""
    h = 1.0 / np.array([12.0, 24.0, 36.0, 48.0])
    value, slope = np.array([0.4 - 0.2j, 1.0 + 0j]), np.array([3.0 + 1.0j, -2.0j])
    exact = smoothed_limit(h, [value + slope * x**2 for x in h])
    np.testing.assert_allclose(exact.value, value, atol=1e-12)
    assert exact.error == pytest.approx(np.abs(slope).max() * h[-1] ** 2)
    rng = np.random.default_rng(0)
    for _ in range(200):
        samples = [value + slope * x**2 * (1.0 + 0.2 * rng.uniform(-1.0, 1.0, 2)) for x in h]
        for count in (2, 3, 4):
            found = smoothed_limit(h[:count], samples[:count])
            assert np.abs(found.value - value).max() < found.error
    with pytest.raises(ValueError, match="two or more"):
        smoothed_limit([1.0], [np.zeros(1, complex)])
