"""Continuous evaluation of libraries in closed form: values and error bounds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metafab import library
from metafab.core.errors import InputError
from metafab.library import Library
from metafab.library.fit.rational import RationalModel, Shape


def test_grid_sizes_come_back(smooth_library: Library) -> None:
    """A spline passes through its nodes, to rounding."""
    width_nm, length_nm = np.meshgrid(smooth_library.width_nm, smooth_library.length_nm)
    held = library.evaluate(smooth_library, width_nm, length_nm)
    assert np.allclose(held.t_xx, smooth_library.t_xx[0], atol=1e-12)
    assert np.allclose(held.t_yy, smooth_library.t_yy[0], atol=1e-12)


def test_between_the_grid_the_closed_form_is_met_within_the_stated_error(smooth_library: Library) -> None:
    width_nm, length_nm = np.random.default_rng(2).uniform(100.0, 250.0, (2, 400))
    w, h = (width_nm - 100.0) / 150.0, (length_nm - 100.0) / 150.0
    true = 1.25 * (1.0 - 0.15 * w * h) * np.exp(2.6j * math.pi * (0.8 * w + 0.2 * h))
    held = library.evaluate(smooth_library, width_nm, length_nm)
    # The phase turns by k = 0.0436 rad/nm, the step is 2 nm: (k h)^4 / 384 = 1.5e-7, more at the edges.
    assert np.abs(held.t_xx - true).max() < 2e-6
    assert np.all(np.abs(held.t_xx - true) <= held.error)


def sharp_library(smooth_library: Library, edge: float, depth: float) -> tuple[Library, RationalModel]:
    """A pole ``depth`` beyond ``edge`` (the sweep is -1..1) across a side of 5 nm steps, known exactly otherwise."""
    span = (100.0, 250.0)
    numerator = np.array([[1.0, 0.1], [0.0, 0.0], [0.4, 0.04]], dtype=np.complex128)
    # 1 / (u - edge - i depth): the terms are 1, T_1(v), T_1(u).
    denominator = np.array([-edge - 1j * depth, 0.0, 1.0])
    swap = [0, 2, 1]
    sharp = RationalModel(
        span,
        span,
        Shape((1, 1)),
        depth * np.stack([numerator, numerator[swap]]),
        np.stack([denominator, denominator[swap]]),
    )
    side = np.linspace(100.0, 250.0, 31)
    t_xx, t_yy, r_xx, r_yy = sharp.on_grid(side, side)[:, None]
    known = np.full((31, 31), 1e-9)
    library_of = replace(
        smooth_library,
        width_nm=side,
        length_nm=side,
        t_xx=t_xx,
        t_yy=t_yy,
        r_xx=r_xx,
        r_yy=r_yy,
        error=known,
        model=sharp,
        model_error=known,
    )
    return library_of, sharp


@pytest.fixture(scope="module")
def ridged(smooth_library: Library) -> tuple[Library, RationalModel]:
    """A ridge of 1.5 nm half width at 190 nm, across steps of 5 nm."""
    return sharp_library(smooth_library, 0.2, 0.02)


def test_tiles_are_fine_only_where_the_ridge_is(ridged: tuple[Library, RationalModel]) -> None:
    """The ridge of x lies at W = 190 nm, that of y at L = 190 nm; tiles away from both keep the uniform grid."""
    tiles = ridged[0].surface.tiles
    ridge = tiles.column[int((190.0 - 100.0) / 2.5)]
    assert tiles.parts[:, ridge].min() >= 4
    assert tiles.parts[ridge, :].min() >= 4
    assert tiles.parts[0, 0] == 1
    whole = (60 * tiles.parts.max() + 3) ** 2
    assert tiles.coefficients.shape[0] < 0.6 * whole


def test_a_ridge_inside_is_met_within_the_stated_error(ridged: tuple[Library, RationalModel]) -> None:
    """20 000 sizes, a quarter of them on the ridge: the miss is stated, and within a tenth of the target."""
    library_of, model = ridged
    rng = np.random.default_rng(7)
    width_nm, length_nm = rng.uniform(100.0, 250.0, (2, 20_000))
    width_nm[:5000] = rng.uniform(187.0, 193.0, 5000)
    held, true = library_of.surface(width_nm, length_nm), model(width_nm, length_nm)
    miss = np.maximum(np.abs(held.t_xx - true[:, 0]), np.abs(held.t_yy - true[:, 1]))
    assert np.all(miss <= held.error)
    assert held.error.max() <= 0.1 * library_of.unit_cell.sweep.target_error + 1e-9


def test_tiles_meet_within_what_they_miss(ridged: tuple[Library, RationalModel]) -> None:
    """From one side of each border between tiles to the other, no value jumps by more than both sides state."""
    surface = ridged[0].surface
    borders = 100.0 + surface.step_nm[0] * surface.tiles.first_column[1:]
    width_nm, length_nm = np.meshgrid(borders, np.linspace(100.0, 250.0, 400))
    left, right = (surface(width_nm + side, length_nm) for side in (-1e-7, 1e-7))
    # The slope is at most 1.5 / (1.5 nm), 2e-7 nm apart.
    assert np.all(np.abs(left.t_xx - right.t_xx) <= left.error + right.error + 3e-7)


def test_a_sweep_of_few_sizes_is_one_tile(smooth_library: Library) -> None:
    """Five widths and nine lengths, fewer cells than a tile has: the nodes come back all the same."""
    few = replace(
        smooth_library,
        width_nm=smooth_library.width_nm[:5],
        length_nm=smooth_library.length_nm[:9],
        **{name: getattr(smooth_library, name)[:, :9, :5] for name in ("t_xx", "t_yy", "r_xx", "r_yy")},
        error=np.broadcast_to(smooth_library.error, smooth_library.t_xx.shape)[:, :9, :5],
    )
    width_nm, length_nm = np.meshgrid(few.width_nm, few.length_nm)
    held = library.evaluate(few, width_nm, length_nm)
    assert np.allclose(held.t_xx, few.t_xx[0], atol=1e-12)
    assert held.error.shape == (9, 5)


@pytest.mark.parametrize("width_nm", [99.0, 251.0, math.nan])
def test_nothing_is_extrapolated(smooth_library: Library, width_nm: float) -> None:
    with pytest.raises(InputError, match="width_nm"):
        library.evaluate(smooth_library, width_nm, 150.0)


def test_a_spline_states_what_it_misses_at_a_ridge_beside_the_edge(smooth_library: Library) -> None:
    """A pole 1.5 nm off a side of 5 nm steps: nothing beyond the edge tells how sharp it is, only the model does."""
    built, model = sharp_library(smooth_library, 1.02, 0.01)
    width_nm = np.random.default_rng(6).uniform(240.0, 250.0, 2000)
    length_nm = np.full(2000, 170.0)
    held = built.surface(width_nm, length_nm)
    assert np.all(np.abs(held.t_xx - model(width_nm, length_nm)[:, 0]) <= held.error)
