"""Continuous evaluation and quality figures of libraries in closed form."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import library
from metafab.core.errors import InputError
from metafab.library import Library
from metafab.library.fit.models import SizeModel
from metafab.library.fit.rational import RationalModel
from metafab.library.spline import fill_plain
from metafab.materials import refractive_index
from metafab.spec import load_unit_cell

SPECS = sorted((Path(__file__).parents[2] / "unitcell_lib").glob("*.toml"))


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


def sharp_library(smooth_library: Library, edge: float, depth: float) -> tuple[Library, SizeModel]:
    """A pole ``depth`` beyond ``edge`` (the sweep is -1..1) across a side of 5 nm steps, known exactly otherwise."""
    span = (100.0, 250.0)
    numerator = np.array([[1.0, 0.1], [0.0, 0.0], [0.4, 0.04]], dtype=np.complex128)
    # 1 / (u - edge - i depth): the terms are 1, T_1(v), T_1(u).
    denominator = np.array([-edge - 1j * depth, 0.0, 1.0])
    model = RationalModel(span, span, (1, 1), depth * numerator, denominator)
    sharp = SizeModel(model, model.exchanged())
    side = np.linspace(100.0, 250.0, 31)
    t_xx, t_yy, r_xx, r_yy = sharp.on_grid(side, side)[:, None]
    known = np.full((31, 31), 1e-9)
    library_of = replace(
        smooth_library, width_nm=side, length_nm=side, t_xx=t_xx, t_yy=t_yy, r_xx=r_xx, r_yy=r_yy,
        error=known, model=sharp, model_error=known,
    )  # fmt: skip
    return library_of, sharp


@pytest.fixture(scope="module")
def ridged(smooth_library: Library) -> tuple[Library, SizeModel]:
    """A ridge of 1.5 nm half width at 190 nm, across steps of 5 nm."""
    return sharp_library(smooth_library, 0.2, 0.02)


def test_tiles_are_fine_only_where_the_ridge_is(ridged: tuple[Library, SizeModel]) -> None:
    """The ridge of x lies at W = 190 nm, that of y at L = 190 nm; tiles away from both keep the uniform grid."""
    tiles = ridged[0].surface.tiles
    ridge = tiles.column[int((190.0 - 100.0) / 2.5)]
    assert tiles.parts[:, ridge].min() >= 4
    assert tiles.parts[ridge, :].min() >= 4
    assert tiles.parts[0, 0] == 1
    whole = (60 * tiles.parts.max() + 3) ** 2
    assert tiles.coefficients.shape[0] < 0.6 * whole


def test_a_ridge_inside_is_met_within_the_stated_error(ridged: tuple[Library, SizeModel]) -> None:
    """20 000 sizes, a quarter of them on the ridge: the miss is stated, and within a tenth of the target."""
    library_of, model = ridged
    rng = np.random.default_rng(7)
    width_nm, length_nm = rng.uniform(100.0, 250.0, (2, 20_000))
    width_nm[:5000] = rng.uniform(187.0, 193.0, 5000)
    held, true = library_of.surface(width_nm, length_nm), model(width_nm, length_nm)
    miss = np.maximum(np.abs(held.t_xx - true[:, 0]), np.abs(held.t_yy - true[:, 1]))
    assert np.all(miss <= held.error)
    assert held.error.max() <= 0.1 * library_of.unit_cell.sweep.target_error + 1e-9


def test_tiles_meet_within_what_they_miss(ridged: tuple[Library, SizeModel]) -> None:
    """From one side of each border between tiles to the other, no value jumps by more than both sides state."""
    surface = ridged[0].surface
    borders = 100.0 + surface.step_nm[0] * surface.tiles.first_column[1:]
    width_nm, length_nm = np.meshgrid(borders, np.linspace(100.0, 250.0, 400))
    left, right = (surface(width_nm + side, length_nm) for side in (-1e-7, 1e-7))
    # The slope is at most 1.5 / (1.5 nm), 2e-7 nm apart.
    assert np.all(np.abs(left.t_xx - right.t_xx) <= left.error + right.error + 3e-7)


def test_the_plain_and_the_compiled_evaluation_agree(ridged: tuple[Library, SizeModel]) -> None:
    surface = ridged[0].surface
    width_nm, length_nm = np.random.default_rng(3).uniform(100.0, 250.0, (2, 3000))
    width_nm[:2], length_nm[:2] = (100.0, 250.0), (250.0, 100.0)
    held = surface(width_nm, length_nm)
    t, error = np.empty((3000, 2), dtype=np.complex128), np.empty(3000)
    fill_plain(surface.tiles, *((size - 100.0) / surface.step_nm[0] for size in (width_nm, length_nm)), t, error)
    assert np.allclose(t, np.stack([held.t_xx, held.t_yy], axis=-1), atol=1e-13)
    assert np.array_equal(error, held.error)


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


def test_quality_of_the_closed_form(smooth_library: Library) -> None:
    """Both phases run over 1.3 turns, |t|^2 n_out / n_in = 1.5625 (1 - 0.15 w h)^2 / 1.7601."""
    figures = library.quality(smooth_library)
    assert figures["coverage_rad"] == pytest.approx(2.0 * math.pi)
    assert 0.6 < figures["mean_transmittance"] < 1.5625 / 1.7601
    assert figures["cd_phase_rms_rad"] == pytest.approx(5.0 * 2.6 * math.pi / 150.0, rel=1e-2)
    assert 0.0 < figures["phase_rms_error_rad"] < figures["phase_max_error_rad"]


def test_a_library_of_dark_sizes_covers_nothing(smooth_library: Library) -> None:
    dark = replace(smooth_library, t_xx=0.1 * smooth_library.t_xx)
    assert library.coverage_rad(dark) == 0.0
    assert library.quality(dark)["torus_coverage"] == 0.0


@pytest.mark.parametrize("path", SPECS, ids=[path.stem for path in SPECS])
def test_the_unit_cells_on_offer_are_complete(path: Path) -> None:
    """Every spec loads, says its source, has indices at its wavelength and no diffraction orders in the substrate."""
    cell = load_unit_cell(path)
    wavelength_nm = cell.illumination.wavelength_nm
    index = refractive_index(cell.materials.substrate, wavelength_nm)[0]
    assert cell.source
    assert refractive_index(cell.materials.pillar, wavelength_nm)[0].real > index.real
    if path.stem != "sos_800nm":
        assert max(cell.cell.period_nm) * index.real < wavelength_nm
    assert cell.sweep.width_nm[1] <= cell.cell.period_nm[0] - 80.0


def test_coverage_and_the_worst_hole_are_those_of_a_full_search(smooth_library: Library) -> None:
    """Every 8th size, some of them dark: each of the 128 x 128 pairs of phases against all sizes that pass half."""
    some = replace(
        smooth_library,
        width_nm=smooth_library.width_nm[::8],
        length_nm=smooth_library.length_nm[::8],
        t_xx=0.85 * smooth_library.t_xx[:, ::8, ::8],
        t_yy=0.85 * smooth_library.t_yy[:, ::8, ::8],
        error=np.broadcast_to(smooth_library.error, smooth_library.t_xx.shape)[:, ::8, ::8],
    )
    t = np.stack([some.t_xx[0].ravel(), some.t_yy[0].ravel()], axis=-1)
    passing = np.angle(t[np.all(np.abs(t) ** 2 / 1.7601 >= 0.5, axis=-1)])
    assert 0 < passing.shape[0] < t.shape[0]
    cells = 2.0 * math.pi * np.arange(128) / 128
    apart_x, apart_y = (np.abs(np.angle(np.exp(1j * (cells[:, None] - passing[:, k])))) for k in (0, 1))
    nearest = np.array([np.maximum(apart_x, row).min(axis=1) for row in apart_y])  # indexed [phi_y, phi_x]
    figures = library.quality(some)
    assert figures["torus_coverage"] == pytest.approx(np.mean(nearest <= 0.1), abs=1e-12)
    assert figures["worst_hole_rad"] == pytest.approx(nearest.max(), abs=1e-12)
    hole = [round(figures[f"worst_hole_phase_{axis}_rad"] % (2.0 * math.pi) / (2.0 * math.pi) * 128) for axis in "yx"]
    assert nearest[hole[0] % 128, hole[1] % 128] == pytest.approx(nearest.max(), abs=1e-12)


def test_a_spline_states_what_it_misses_at_a_ridge_beside_the_edge(smooth_library: Library) -> None:
    """A pole 1.5 nm off a side of 5 nm steps: nothing beyond the edge tells how sharp it is, only the model does."""
    built, model = sharp_library(smooth_library, 1.02, 0.01)
    width_nm = np.random.default_rng(6).uniform(240.0, 250.0, 2000)
    length_nm = np.full(2000, 170.0)
    held = built.surface(width_nm, length_nm)
    assert np.all(np.abs(held.t_xx - model(width_nm, length_nm)[:, 0]) <= held.error)
