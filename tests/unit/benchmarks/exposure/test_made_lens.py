"""Sums over sizes give the wanted wave of a mask; the crystal's limits are those of the closed form."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.exposure import made_lens_sizes
from benchmarks.exposure.made_lens import (
    BIAS_NM,
    RANGES,
    Explanation,
    Interval,
    PrintedLens,
    credible,
    extinctions,
    ghost_over_own,
    predictions,
)
from benchmarks.exposure.made_lens_sizes import WALLS_DEG, Sizes, SizeSums
from metafab.cell.rcwa import zero_order
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library.axes import corner_cell
from metafab.spec import Device, load_design
from tests.main_job import SMALL


def test_sums_over_sizes_are_the_mean_of_all_sites() -> None:
    """120 x 120 random pillars of two sizes with random targets, site by site and by size, and a bias by 2 nm."""
    rng = np.random.default_rng(3)
    lattice = Lattice(period_dbu=(700, 700), shape=(120, 120), database_unit_nm=0.5)
    index = rng.integers(0, 3, lattice.shape).astype(np.uint16)
    sizes = np.array([[0, 0], [240, 320], [400, 200]], dtype=np.int32)  # 120 x 160 and 200 x 100 nm
    target_rad = rng.uniform(-math.pi, math.pi, (2, *lattice.shape))
    x_um, y_um = lattice.x_um(), lattice.y_um()

    def profile(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        here = np.searchsorted(y_um, rows - 1e-6), np.searchsorted(x_um, columns - 1e-6)
        return target_rad[:, here[0][:, None], here[1]]

    design = load_design(SMALL)
    object.__setattr__(design, "device", Device(aperture_um=42.0, focal_length_mm=1.0, aperture_shape="square"))
    sums = SizeSums.of(PillarMap.from_array(lattice, sizes, index, 50), profile, design)  # type: ignore[arg-type]
    table = rng.normal(size=(106, 106, 2)) + 1j * rng.normal(size=(106, 106, 2))
    lens = PrintedLens.of(sums, Sizes(table), 2.0, 2.0)
    amplitude = np.zeros((3, 2), dtype=complex)
    for number, (width, length) in enumerate(((122, 162), (202, 102)), start=1):
        amplitude[number] = table[(length - 70) // 2, (width - 70) // 2]
    a = np.moveaxis(amplitude[index], -1, 0)
    wanted = np.abs((a * np.exp(-1j * target_rad)).mean(axis=(1, 2))) ** 2
    np.testing.assert_allclose((lens.wanted_x, lens.wanted_y), wanted, rtol=1e-9)
    assert lens.transmitted == pytest.approx((np.abs(a) ** 2).mean(), rel=1e-9)
    assert lens.straight == pytest.approx((np.abs(a.mean(axis=(1, 2))) ** 2).mean(), rel=1e-9)


def test_light_in_the_wrong_image_is_that_of_a_wave_plate() -> None:
    """At 500 um 3.54 waves: nearly all light at 45 degrees, none when aligned; 4.8 degrees leave 35.6."""
    angles = np.array([0.0, 4.8, 45.0])
    ghost = ghost_over_own(angles, np.full(3, 500.0))
    assert ghost[0] == 0.0
    assert 1.0 / ghost[1] == pytest.approx(35.6, rel=0.02)
    assert ghost[2] > 20.0


def test_quantiles_are_weighted() -> None:
    values = np.arange(101.0)
    interval = Interval.of(values, np.where(values >= 50.0, 1.0, 0.0))
    assert (interval.low, interval.high) == pytest.approx((52.0, 98.0), abs=1.0)
    assert interval.middle == pytest.approx(75.0, abs=1.0)


def test_sloped_walls_are_solved_once_for_both_polarisations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes 8 nm apart: each solved one is the solver's, with width along x; the file is used again."""
    nodes = np.arange(150.0, 175.0, 8.0)
    monkeypatch.setattr(made_lens_sizes, "_SOLVED_NM", nodes)
    monkeypatch.setattr(made_lens_sizes, "TABLE_NM", nodes)
    cell = load_design(SMALL).unit_cell
    sizes = Sizes.solved(cell, 86.0, tmp_path, slices=2)
    t = np.diagonal(zero_order(corner_cell(cell, 150.0, 174.0, {"sidewall_angle_deg": 86.0}), 5, "adaptive", 2).t)
    np.testing.assert_allclose(sizes.at(np.array([150.0]), np.array([174.0]))[0], t / math.sqrt(1.7601), rtol=1e-9)
    np.testing.assert_allclose(sizes.t, sizes.t.transpose(1, 0, 2)[..., ::-1])
    assert [path.name for path in tmp_path.iterdir()] == ["walls_86_2.npy"]
    np.testing.assert_array_equal(Sizes.solved(cell, 86.0, tmp_path, slices=2).t, sizes.t)


def test_a_bias_is_excluded_where_no_other_factor_explains_the_efficiency() -> None:
    """A share of 1 - bias^2 / 900 at vertical walls, less by 0.1 for each two degrees, without roughness."""
    shares = 1.0 - BIAS_NM**2 / 900.0 - 0.1 * np.arange(WALLS_DEG.size)[::-1, None]
    walls = np.broadcast_to(shares[:, None], (WALLS_DEG.size, 2, BIAS_NM.size))
    known = Explanation(WALLS_DEG, np.array([0.0, 5.0]), BIAS_NM, walls, walls, walls, 1.0)
    misfit = known.misfit(0.5, 35.6)
    high = float(np.prod([RANGES[name][1] for name in ("neighbours", "beam on the aperture")])) * shares
    low = float(np.prod([RANGES[name][0] for name in ("neighbours", "beam on the aperture")])) * shares * 35.6 / 36.6
    assert np.array_equal(misfit == 0.0, (low <= 0.5) & (high >= 0.5))
    assert misfit[-1, BIAS_NM == 0.0] == pytest.approx((low[-1].max() / 0.5 - 1.0) / 0.02)
    drawn = known.draws(0.5, 35.6)
    bias_nm, wall_deg, cells, (least, most) = credible(drawn)
    assert cells.shape == (bias_nm.size - 1, wall_deg.size - 1)
    assert cells[cells >= least].sum() == pytest.approx(0.954 * cells.sum(), rel=0.01)
    assert cells[cells >= most].sum() == pytest.approx(0.683 * cells.sum(), rel=0.01)
    # The set of the draws lies within what is not excluded.
    vertical = misfit[-1]
    centres = 0.5 * (bias_nm[1:] + bias_nm[:-1])
    inside = np.interp(centres[cells[:, -1] >= most], BIAS_NM, vertical)
    assert inside.max() < 2.0


def test_predictions_carry_the_uncertainties_of_the_known_factors() -> None:
    """A share that does not depend on bias, index and height: neighbours, propagation, beam and crystal are left."""
    flat = np.full((WALLS_DEG.size, 2, BIAS_NM.size), 0.8)
    known = Explanation(WALLS_DEG, np.array([0.0, 5.0]), BIAS_NM, flat, flat, flat, 1.0)
    found = predictions(known, 0.7, [1.0] * 4, 35.6)
    corrected, causes = found["with correction"], found["with all known causes"]
    # Quantiles of a uniform factor of 0.945 to 0.975 times a normal one of 0.5 %: variances add up.
    spread = 1.645 * math.hypot(0.015 / math.sqrt(3.0) / 0.96, 5e-3)
    assert (corrected.high - corrected.low) / 1.4 == pytest.approx(spread, rel=0.08)
    assert corrected.middle == pytest.approx(0.7, rel=2e-3)
    assert found["without correction"].high == pytest.approx(corrected.high, rel=1e-9)
    assert causes.middle == pytest.approx(0.7 * 0.9325 / (1.0 + 0.5 / 35.6), rel=3e-3)
    less = predictions(known, 0.7, [0.9, 0.95, 1.0, 1.0], 35.6)["with correction"]
    assert less.middle == pytest.approx(0.95 * 0.7, rel=3e-3)


def test_extinction_of_an_aligned_lens_is_set_by_what_is_left_without_the_crystal() -> None:
    """At 45 degrees the crystal decides: mean of its plate over thickness and filter. Aligned, the rest does."""
    found = extinctions()
    aligned, turned, anywhere = found.values()
    # Means: neighbours 0.0024, polariser 0.0005, its rotation 0.0004, that of the crystal 0.0008, file 0.0001.
    assert 1.0 / aligned.middle == pytest.approx(0.0042, rel=0.1)
    assert turned.low < 0.1 < turned.middle < 3.0
    assert turned.middle < anywhere.middle < aligned.middle
    assert turned.high > 20.0
