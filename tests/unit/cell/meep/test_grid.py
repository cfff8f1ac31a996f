"""Grids of a cell, and de-embedding of synthetic grid waves."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.cell.meep.grid import family, grid_wavenumber, plan
from metafab.cell.meep.stretched_axes import lateral_axis
from tests.paper_cell import SILICON


@given(
    width=st.floats(20.0, 350.0),
    length=st.floats(20.0, 410.0),
    height=st.floats(50.0, 3000.0),
    member=st.integers(1, 4),
)
def test_walls_lie_on_nodes_and_every_length_is_kept(width: float, length: float, height: float, member: int) -> None:
    cell = replace(SILICON, period_nm=(350.0, 410.0), width_nm=width, length_nm=length, height_nm=height)
    run = plan(cell, family(cell), "x", member, decay=1e-3, longest_time=1.0)
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
            cell = replace(SILICON, width_nm=float(width), length_nm=float(length))
            grids = family(cell)
            for inside, size in zip(grids.inside, (width, length), strict=True):
                stretch = size / 350.0 * grids.period[0] / inside
                assert 0.72 < stretch < 1.4, (width, length, grids)


def test_members_of_a_family_differ_by_a_factor_only() -> None:
    cell = SILICON
    runs = [plan(cell, family(cell), "y", member, decay=1e-3, longest_time=1.0).job for member in (1, 2, 3)]
    for fine, factor in zip(runs[1:], (2, 3), strict=True):
        assert fine.n_x == factor * runs[0].n_x
        assert fine.pixel_um == pytest.approx(runs[0].pixel_um / factor)
        for ours, theirs in zip(fine.blocks, runs[0].blocks, strict=True):
            np.testing.assert_allclose(ours.epsilon, theirs.epsilon, rtol=1e-12)
            np.testing.assert_allclose(ours.mu, theirs.mu, rtol=1e-12)


def test_grid_waves_become_plane_waves() -> None:
    exact = 2.0 * math.pi * 1.7601 / 0.8
    errors = [abs(grid_wavenumber(1.7601, 0.8, pixel, 0.5) - exact) for pixel in (0.02, 0.01)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02), "second order"


def test_deembedding_undoes_the_way_to_the_monitors() -> None:
    """Synthetic grid waves around a pillar of known t and r, for monitors anywhere."""
    t, r = 0.3 - 0.8j, -0.2 + 0.1j
    for shift in (0, 5):
        run = plan(SILICON, family(SILICON), "x", 2, decay=1e-3, longest_time=1.0, shift_nodes=shift)
        job = run.job
        k_in = grid_wavenumber(1.7601, job.wavelength_um, job.pixel_um, job.courant)
        k_out = grid_wavenumber(1.0, job.wavelength_um, job.pixel_um, job.courant)
        source = 0.7 * cmath.exp(0.3j)
        near, far = cmath.exp(1j * k_in * run.near_um), cmath.exp(1j * k_out * run.far_um)
        incident = np.array([source * near, 0.0])
        limit = np.array([source * (near + r / near), source * t * far])
        assert run.amplitudes(limit, incident) == pytest.approx((t, r), abs=1e-12)
