"""Response of sizes on the grid, between it, and beyond the sweep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import PillarCell, curved
from metafab.core.errors import InputError
from metafab.library import Library
from metafab.library.use import any_size
from metafab.library.use.any_size import response_of_sizes
from metafab.spec import UnitCell


@pytest.fixture(scope="module")
def library(unit_cell: UnitCell) -> Library:
    """49 sizes of the paper's cell, away from its sharpest resonances."""
    from metafab.library import build

    span = (100.0, 160.0)
    sweep = replace(unit_cell.sweep, width_nm=span, length_nm=span, size_grid_nm=10.0, target_error=1e-2)
    return build(replace(unit_cell, sweep=sweep))


def test_stored_sizes_are_unchanged_and_others_are_the_surface(library: Library) -> None:
    sizes = np.array([[120.0, 150.0], [121.3, 150.0], [160.0, 100.0]])
    found = response_of_sizes(library, sizes)
    stored = library.at_sizes(*sizes[[0, 2]].T)
    np.testing.assert_array_equal(found.t_xx[[0, 2]], stored.t_xx)
    assert found.t_yy[1] == library.surface(121.3, 150.0).t_yy


def test_solved_sizes_continue_the_library(library: Library) -> None:
    """A hundredth of a nanometre beyond the sweep: within both errors, and mirror images exchange x and y."""
    sizes = np.array([[160.01, 130.0], [130.0, 160.01], [99.99, 99.99]])
    found = response_of_sizes(library, sizes)
    edge = library.at_sizes(*np.round(sizes).T)
    bound = found.error + edge.error + 2e-3
    assert np.all(np.abs(found.t_xx - edge.t_xx) < bound)
    assert np.all(np.abs(found.t_yy - edge.t_yy) < bound)
    assert found.t_xx[0] == found.t_yy[1]


def test_under_slanting_light_mirror_images_are_solved_apart(library: Library) -> None:
    slanting = replace(library, corner={"angle_x_deg": 20.0})
    sizes = np.array([[170.0, 130.0], [130.0, 170.0]])
    found = response_of_sizes(slanting, sizes)
    cells = [(slanting.pillar(width, length), 8) for width, length in sizes.tolist()]
    assert all(cell.angle_deg == 20.0 for cell, _ in cells)
    np.testing.assert_array_equal(np.stack([found.t_xx, found.t_yy], axis=1), any_size.solved_amplitudes(cells))
    assert abs(found.t_xx[0] - found.t_yy[1]) > 0.02


def test_a_mask_far_beyond_the_library_is_refused(library: Library) -> None:
    side = np.linspace(161.0, 300.0, 100)
    sizes = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    assert len(sizes) > any_size.MOST_SOLVED
    with pytest.raises(InputError, match="wider sweep"):
        response_of_sizes(library, sizes)


def test_sloped_circles_state_the_error_that_they_have() -> None:
    """Five cosines and eight slices are off by a tenth at a resonant circle; upright circles and rectangles are not."""
    circle = PillarCell(
        period_nm=(330.0, 330.0),
        width_nm=200.0,
        length_nm=200.0,
        height_nm=800.0,
        n_pillar=2.461 + 0j,
        n_substrate=(1.461 + 0j,) * 2,
        n_ambient=1.0 + 0j,
        wavelength_nm=532.0,
        shape="ellipse",
    )
    sloped = [(replace(circle, sidewall_angle_deg=87.0), 8)]
    amplitudes = any_size.solved_amplitudes(sloped)
    # 9 cosines and 16 slices, themselves not at the limit.
    finer = np.array([[-0.8537 - 0.5378j] * 2])
    off = np.abs(amplitudes - finer).max()
    assert off > 0.1
    assert off < any_size.solver_error(sloped, amplitudes) < 0.3
    for upright in (circle, replace(circle, shape="rectangle")):
        tasks = [(upright, 8)]
        found = any_size.solved_amplitudes(tasks)
        assert any_size.solver_error(tasks, found) == any_size.SOLVER_ERROR


def test_rings_beside_a_resonance_state_the_error_that_they_have() -> None:
    """Order 5 of the second ring is off by 0.1 (order 6), of its neighbours by less than 1e-3."""
    ring = PillarCell(
        period_nm=(760.0, 760.0),
        width_nm=560.0,
        length_nm=560.0,
        height_nm=730.0,
        n_pillar=3.5 + 0j,
        n_substrate=(1.45 + 0j,) * 2,
        n_ambient=1.0 + 0j,
        wavelength_nm=1310.0,
        shape="ring",
        hole_nm=40.0,
    )
    tasks = [(replace(ring, width_nm=size, length_nm=size), 8) for size in (560.0, 620.0)]
    amplitudes = any_size.solved_amplitudes(tasks)
    finer = curved.zero_order(tasks[1][0], 6)
    off = np.abs(np.diagonal(finer.t) - amplitudes[1]).max()
    assert off > 0.1
    assert any_size.solver_error(tasks, amplitudes) > 2.0 * off
    assert any_size.solver_error(tasks[:1], amplitudes[:1]) == any_size.SOLVER_ERROR
