"""The decoder's parts by themselves: resampling, reducing, tiles, filters, segments."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.decode import resample
from metafab.decode.depth import parabola, standard_error
from metafab.decode.reduce import doubled, enlarged, passband, reduced, repeated
from metafab.decode.resample import Resampler
from metafab.decode.segment import grown, split, textured
from metafab.decode.tiles import Tiling
from metafab.decode.volume import Volume, correlation


def wave(row: np.ndarray, column: np.ndarray, ky: float, kx: float) -> np.ndarray:
    return np.cos(2.0 * np.pi * (ky * row + kx * column))


@pytest.mark.parametrize(("ky", "kx"), [(0.0, 0.0), (0.05, 0.1), (0.2, -0.25), (0.3, 0.3)])
def test_a_wave_is_resampled_where_the_map_says(ky: float, kx: float) -> None:
    """Shift, stretch and shear as the paper's lens has them; the filter errs by 0.5 % up to 0.3 cycles a pixel."""
    i, j = np.mgrid[:40, :60].astype(float)
    row, column = 5.3 + 1.01 * i + 0.02 * j, 7.7 + 0.98 * j - 0.03 * i
    image = wave(*np.mgrid[:70, :90].astype(float), ky, kx).astype(np.float32)
    got = Resampler.of(row, column, image.shape)(image)
    # Two passes of 0.5 %, each to the nearest of 512 fractions (1e-3 pixels times a slope of 2).
    np.testing.assert_allclose(got, wave(row, column, ky, kx), atol=0.014)


def test_the_plain_resampler_does_what_the_compiled_one_does() -> None:
    rng = np.random.default_rng(1)
    image = rng.normal(size=(50, 60)).astype(np.float32)
    i, j = np.mgrid[:50, :60].astype(float)
    made = Resampler.of(i * 1.05 - 2.0 + 0.01 * j, j * 0.97 + 3.0 - 0.02 * i, image.shape)
    rows = image[made.first_row : made.first_row + made.column.shape[0]]
    along = resample._along_rows_plain(rows, made.column, resample._TABLE)
    np.testing.assert_allclose(resample._along_rows(rows, made.column, resample._TABLE), along, atol=1e-5)
    down = resample._down_columns_plain(along, made.row, resample._TABLE)
    np.testing.assert_allclose(resample._down_columns(along, made.row, resample._TABLE), down, atol=1e-5)
    np.testing.assert_allclose(made(image), down, atol=1e-5)


@pytest.mark.parametrize("every", [1, 2, 4])
def test_reducing_keeps_slow_waves_as_its_passband_says(every: int) -> None:
    i, j = np.mgrid[:96, :96].astype(float)
    for k in (0.0, 0.03, 0.3 / every):
        small = reduced(wave(i, j, k, 0.0).astype(np.float32), every)
        inner = slice(5, small.shape[0] - 5)
        want = passband(every, np.array(k)) * wave(i, j, k, 0.0)[::every, ::every]
        np.testing.assert_allclose(small[inner, inner], want[inner, inner], atol=1e-5)


@pytest.mark.parametrize("every", [2, 4])
def test_reducing_keeps_out_what_would_be_mistaken(every: int) -> None:
    """Three quarters of a cycle a small pixel would look like a quarter."""
    assert abs(float(passband(every, np.array(0.75 / every)))) < 0.05
    assert float(passband(every, np.array(0.1 / every))) > 0.99


@settings(max_examples=40, deadline=None)
@given(n_y=st.integers(1, 30), n_x=st.integers(1, 30), every=st.sampled_from([1, 2, 4]))
def test_enlarging_meets_the_small_pixels(n_y: int, n_x: int, every: int) -> None:
    small = np.random.default_rng(n_y * 31 + n_x).normal(size=(-(-n_y // every), -(-n_x // every)))
    for large in (enlarged(small, every, (n_y, n_x)), repeated(small, every, (n_y, n_x))):
        assert large.shape == (n_y, n_x)
        np.testing.assert_allclose(large[::every, ::every], small)


def test_doubling_is_linear_in_between() -> None:
    np.testing.assert_allclose(doubled(np.array([[0.0, 2.0], [4.0, 6.0]]), (3, 3))[:2, :2], [[0.0, 1.0], [2.0, 3.0]])


@settings(max_examples=60, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 60), st.integers(1, 60)),
    margin=st.integers(1, 12),
    core=st.tuples(st.floats(2.0, 80.0), st.floats(2.0, 80.0)),
)
def test_tiles_give_the_window_back(shape: tuple[int, int], margin: int, core: tuple[float, float]) -> None:
    tiling = Tiling.over(shape, margin, core)
    image = np.random.default_rng(3).normal(size=(shape[0] + 2 * margin, shape[1] + 2 * margin))
    tiles = np.arange(tiling.n_tiles)
    back = tiling.join(tiling.cut(image, tiles), tiles)
    np.testing.assert_allclose(back, image[margin:-margin, margin:-margin], atol=1e-5)


def test_only_touched_tiles_are_cut() -> None:
    tiling = Tiling.over((40, 60), 4, (20.0, 20.0))
    mask = np.zeros((40, 60), dtype=bool)
    mask[25, 45] = True
    assert tiling.touched(mask).tolist() == [5]
    image = np.ones((48, 68))
    joined = tiling.join(tiling.cut(image, np.array([5])), np.array([5]))
    assert joined[20:, 40:].min() == pytest.approx(1.0)
    assert not joined[:20].any()


def test_a_volume_between_its_candidates() -> None:
    """Products that are cubic in vergence are interpolated exactly."""
    nodes = np.linspace(1.0, 2.0, 9)
    parts = (nodes[None, :, None, None] ** 3 * np.array([1.0, 2.0, 3.0])[:, None, None, None]).astype(np.float32)
    volume = Volume(nodes, np.broadcast_to(parts, (3, 9, 4, 4)).copy(), 1.0, 1.0)
    np.testing.assert_allclose(volume.at(1.37)[:, 0, 0], 1.37**3 * np.array([1.0, 2.0, 3.0]), rtol=1e-5)
    assert volume.halved().parts.shape == (3, 9, 2, 2)
    np.testing.assert_allclose(volume.over(np.ones((4, 4), dtype=bool))[0], 16.0 * nodes**3, rtol=1e-6)


def test_correlation_is_blind_to_contrast() -> None:
    a = np.random.default_rng(4).normal(size=100)
    for contrast in (0.1, 1.0, 7.0):
        b = contrast * a
        assert correlation(np.array([(a * b).sum(), (a * a).sum(), (b * b).sum()])) == pytest.approx(1.0)


def test_a_parabola_is_found() -> None:
    def value(at: float) -> float:
        return 0.9 - 0.2 * (at - 0.3) ** 2

    shift, height, curvature = parabola(*(np.array(value(d)) for d in (-1.0, 0.0, 1.0)))
    assert (shift, height, curvature) == pytest.approx((0.3, 0.9, 0.4))


def test_errors_shrink_with_the_root_of_the_samples() -> None:
    one, four = (float(standard_error(np.array(0.8), np.array(2.0), n)) for n in (100.0, 400.0))
    assert one == pytest.approx(2.0 * four)


def test_the_mixture_along_an_outline_is_no_segment_of_its_own() -> None:
    layer = np.ones((60, 90), dtype=np.int32)
    layer[:, 45:] = 2
    layer[10:30, 40:50] = 3  # 200 pixels of every second: 800 of the frame, just a window
    lit = np.ones(layer.shape, dtype=bool)
    assert split(layer, lit, 32, 2).max() == 2
    assert split(np.where(layer == 3, 3, 0), lit, 32, 2).max() == 1  # by itself it is one


def test_growth_stops_at_its_reach() -> None:
    segment = np.zeros((9, 9), dtype=np.int32)
    segment[4, 4] = 7
    assert (grown(segment, 2.0) > 0).sum() == 13
    assert not grown(np.zeros((9, 9), dtype=np.int32), 2.0).any()


def test_texture_at_the_outline_alone_is_none() -> None:
    region = np.zeros((60, 60), dtype=bool)
    region[5:55, 5:55] = True
    outline = region.copy()
    outline[15:45, 15:45] = False
    assert not textured(region, outline, 10)
    assert textured(region, region, 10)
    assert textured(region, outline, 30)  # too small to have an inside
