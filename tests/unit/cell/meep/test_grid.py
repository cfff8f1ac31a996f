"""Grids, de-embedding, tails and limits of the FDTD driver, without Meep."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.cell import CellNumerics, PillarCell
from metafab.cell.meep import MeepSettings, Pool, solve
from metafab.cell.meep.extrapolation import richardson
from metafab.cell.meep.grid import family, grid_wavenumber, plan
from metafab.cell.meep.protocol import Job, Reply
from metafab.cell.meep.stretched_axes import Axis, lateral_axis, stretched_blocks
from metafab.cell.meep_worker import tail_limit
from metafab.core.errors import InputError, SolverError


def _cell(**changes: object) -> PillarCell:
    values: dict[str, object] = {
        "period_nm": (350.0, 350.0),
        "width_nm": 150.0,
        "length_nm": 210.0,
        "height_nm": 600.0,
        "n_pillar": 3.6941 + 0.0065j,
        "n_substrate": (1.7601 + 0j, 1.7601 + 0j),
        "n_ambient": 1.0 + 0j,
        "wavelength_nm": 800.0,
    }
    return PillarCell(**(values | changes))  # type: ignore[arg-type]


@given(
    width=st.floats(20.0, 350.0),
    length=st.floats(20.0, 410.0),
    height=st.floats(50.0, 3000.0),
    member=st.integers(1, 4),
)
def test_walls_lie_on_nodes_and_every_length_is_kept(width: float, length: float, height: float, member: int) -> None:
    cell = _cell(period_nm=(350.0, 410.0), width_nm=width, length_nm=length, height_nm=height)
    run = plan(cell, "x", family(cell), member, decay=1e-3, longest_time=1.0)
    job = run.job
    assert job.n_x % 2 == job.n_y % 2 == job.n_z % 2 == 0
    grids = family(cell)
    for size, period, count, inside in zip(
        (width, length), cell.period_nm, (job.n_x, job.n_y), grids.inside, strict=True
    ):
        axis = lateral_axis(count, 2 * member * inside, size, period, job.pixel_um * 1e3)
        assert all(edge == round(edge) for edge in axis.edges)
        physical = np.diff(axis.edges) * np.array(axis.stretch) * job.pixel_um * 1e3
        assert physical.sum() == pytest.approx(period)
        if 0 < inside < count // (2 * member):
            assert physical[1] == pytest.approx(size)
        assert axis.node_stretch().sum() * job.pixel_um * 1e3 == pytest.approx(period)


def test_the_papers_pillars_need_little_stretching() -> None:
    for width in range(100, 251, 10):
        for length in range(100, 251, 10):
            cell = _cell(width_nm=float(width), length_nm=float(length))
            grids = family(cell)
            for inside, size in zip(grids.inside, (width, length), strict=True):
                stretch = size / 350.0 * grids.period[0] / inside
                assert 0.72 < stretch < 1.4, (width, length, grids)


def test_members_of_a_family_differ_by_a_factor_only() -> None:
    cell = _cell()
    runs = [plan(cell, "y", family(cell), member, decay=1e-3, longest_time=1.0).job for member in (1, 2, 3)]
    for fine, factor in zip(runs[1:], (2, 3), strict=True):
        assert fine.n_x == factor * runs[0].n_x
        assert fine.pixel_um == pytest.approx(runs[0].pixel_um / factor)
        for ours, theirs in zip(fine.blocks, runs[0].blocks, strict=True):
            np.testing.assert_allclose(ours.epsilon, theirs.epsilon, rtol=1e-12)
            np.testing.assert_allclose(ours.mu, theirs.mu, rtol=1e-12)


def test_averages_on_a_wall_keep_a_plane_wave_whole() -> None:
    """Along z alone the stretched cell must be one medium: n^2 = eps~_xx mu~_yy / s_z^2 wherever E_x is sampled."""
    x = Axis((-6.0, -2.0, 2.0, 6.0), (1.1, 0.8, 1.1), (0, 1, 0))
    y = Axis((-6.0, -4.0, 4.0, 6.0), (1.4, 0.8, 1.4), (0, 1, 0))
    z = Axis((0.0, 4.0), (1.0,), (0,))
    uniform = {(i, j, 0): (3.0 + 0j,) * 3 for i in (0, 1) for j in (0, 1)}
    boxes = stretched_blocks((x, y, z), uniform, 1.0)
    assert len(boxes) == 25
    on_x_wall = [box for box in boxes if box.high[0] - box.low[0] == 0.5]
    assert len(on_x_wall) == 10
    for box in boxes:
        # E_x and H_y share their x (half a pixel off every wall), E_y and H_x their y.
        if box not in on_x_wall:
            assert box.epsilon[0] * box.mu[1] == pytest.approx(3.0)
    weight = y.node_stretch()
    assert weight[0] == pytest.approx(1.4)
    assert weight[2] == pytest.approx((1.4 + 0.8) / 2.0)
    assert weight.mean() == pytest.approx(1.0)


def test_grid_waves_become_plane_waves() -> None:
    exact = 2.0 * math.pi * 1.7601 / 0.8
    errors = [abs(grid_wavenumber(1.7601, 0.8, pixel, 0.5) - exact) for pixel in (0.02, 0.01)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02), "second order"


def test_deembedding_undoes_the_way_to_the_monitors() -> None:
    """Synthetic grid waves around a pillar of known t and r, for monitors anywhere."""
    t, r = 0.3 - 0.8j, -0.2 + 0.1j
    for shift in (0, 5):
        run = plan(_cell(), "x", family(_cell()), 2, decay=1e-3, longest_time=1.0, shift_nodes=shift)
        job = run.job
        k_in = grid_wavenumber(1.7601, job.wavelength_um, job.pixel_um, job.courant)
        k_out = grid_wavenumber(1.0, job.wavelength_um, job.pixel_um, job.courant)
        source = 0.7 * cmath.exp(0.3j)
        near, far = cmath.exp(1j * k_in * run.near_um), cmath.exp(1j * k_out * run.far_um)
        incident = np.array([source * near, 0.0])
        limit = np.array([source * (near + r / near), source * t * far])
        assert run.amplitudes(limit, incident) == pytest.approx((t, r), abs=1e-12)


def test_a_tail_of_few_modes_has_its_limit_at_once() -> None:
    rng = np.random.default_rng(1)
    limit = rng.normal(size=3) + 1j * rng.normal(size=3)
    decay = np.array([0.97 * cmath.exp(0.3j), 0.9 * cmath.exp(-1.1j), 0.6 * cmath.exp(2j)])
    strength = rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))
    samples = limit + np.array([(strength * decay**j).sum(axis=1) for j in range(18)])
    assert np.abs(samples[-1] - limit).max() > 0.5, "waiting alone has not got there"
    # Three of the six modes are left over: they may only pick up round-off.
    np.testing.assert_allclose(tail_limit(samples, 6), limit, atol=1e-4)
    np.testing.assert_allclose(tail_limit(samples, 3), limit, atol=1e-6)


def test_a_tail_that_has_ended_is_its_own_limit() -> None:
    samples = np.full((18, 2), 1.0 + 2.0j)
    np.testing.assert_array_equal(tail_limit(samples), samples[-1])


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
        run = plan(self.cell, job.polarisation, grids, member, decay=1.0, longest_time=1.0)
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
    pool = _KnownAnswers(_cell(), 1e-6)
    found = solve(_cell(), CellNumerics(1e-3, "meep"), pool=pool)
    np.testing.assert_allclose(found.t, np.diag(list(pool.T.values())), atol=1e-10)
    np.testing.assert_allclose(found.r, np.diag(list(pool.R.values())), atol=1e-10)
    assert found.converged
    assert len(pool.jobs) == 6, "a pure h^2 error is seen to be one on the third grid, and the fourth is saved"
    assert found.error == pytest.approx(found.details.error_decay, abs=1e-9)
    assert found.details.error_decay > 1e-6, "extrapolation makes more of the tails"


def test_a_square_pillar_is_solved_in_one_polarisation() -> None:
    square = _cell(width_nm=150.0, length_nm=150.0)
    pool = _KnownAnswers(square, 0.0)
    found = solve(square, CellNumerics(1e-3, "meep"), pool=pool)
    assert found.t[0, 0] == found.t[1, 1]
    assert {job.polarisation for job in pool.jobs} == {"x"}


def test_a_field_that_does_not_decay_has_no_limit() -> None:
    with pytest.raises(SolverError, match="longest_periods"):
        solve(_cell(), CellNumerics(1e-3, "meep"), pool=_KnownAnswers(_cell(), math.inf))


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
        solve(_cell(**changes), CellNumerics(solver="meep"))


@pytest.mark.parametrize("members", [(2,), (2, 1), (0, 1), (2, 2)])
def test_settings_are_checked(members: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="members"):
        MeepSettings(members=members)
