"""The decoder's parts by themselves: resampling, reducing, tiles, filters, segments."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import scipy.fft
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.interpolate import BSpline
from scipy.ndimage import binary_dilation, binary_opening, uniform_filter

from metafab.decode.evaluation.metrics import structural_similarity
from metafab.decode.images import contrast
from metafab.decode.images import deconvolution as restore
from metafab.decode.images.compose import lit_about
from metafab.decode.matching import cost_volume as volume_module
from metafab.decode.matching import filters, mixing, peaks, pooling
from metafab.decode.matching.cost_volume import Volume, correlation
from metafab.decode.matching.depth import parabola, spline_peaks, standard_error
from metafab.decode.registration import calibration, reduce, resample, tiles, twins
from metafab.decode.registration.reduce import Reduction, enlarged, repeated
from metafab.decode.registration.resample import Resampler
from metafab.decode.registration.tiles import Tiling
from metafab.decode.segmentation.frame_statistics import Seen
from metafab.decode.segmentation.segment import grown, interior, opened, split, textured
from metafab.optics.interpolation.field import spline_weights


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
    along = resample._across_plain(rows, made.column, resample._TABLE)
    np.testing.assert_allclose(resample._across(rows, made.column, resample._TABLE), along, atol=1e-5)
    down = resample._across_plain(along, made.row, resample._TABLE)
    np.testing.assert_allclose(resample._across(along, made.row, resample._TABLE), down, atol=1e-5)
    np.testing.assert_allclose(made(image), down, atol=1e-5)


@pytest.mark.parametrize("every", [1, 2, 3, 4])
def test_reducing_keeps_slow_waves_and_nothing_faster(every: int) -> None:
    """Away from the fading margin a slow wave keeps its amplitude; one that would look like another is gone."""
    reduction = Reduction(every, (90, 118), 12)
    i, j = np.mgrid[-12:102, -12:130].astype(float)
    for k, share in ((0.02, 1.0), (0.3 / every, 1.0), (0.75 / every, 0.0)):
        if k >= 0.5:
            continue
        images = np.stack([wave(i, j, k, 0.0), 5.0 + wave(i, j, 0.0, k)]).astype(np.float32)
        small = reduction.images(reduction.spectra(images))[:, *reduction.inner]
        assert small.shape[1:] == reduction.shape == (-(-90 // every), -(-118 // every))
        inner = slice(12 // every, small.shape[1] - 12 // every)
        want = np.stack([share * wave(i, j, k, 0.0), 5.0 + share * wave(i, j, 0.0, k)])[:, 12:102:every, 12:130:every]
        # The margin's fall from 1 to 0 and the step behind it ring: a few per cent, a margin away.
        np.testing.assert_allclose(small[:, inner, inner], want[:, inner, inner], atol=0.05)


def test_a_reduced_pixel_has_the_noise_it_says() -> None:
    reduction = Reduction(3, (240, 240), 12)
    images = np.random.default_rng(5).normal(size=(2, 264, 264)).astype(np.float32)
    small = reduction.images(reduction.spectra(images))[:, *reduction.inner]
    # 12800 pixels: 1.2 % for the variance; the row and column of the highest frequency are left out, 2 / 88.
    assert small.var() == pytest.approx(reduction.variance_left, rel=0.06)


@settings(max_examples=40, deadline=None)
@given(n_y=st.integers(1, 30), n_x=st.integers(1, 30), every=st.sampled_from([1, 2, 3, 4]))
def test_enlarging_meets_the_small_pixels(n_y: int, n_x: int, every: int) -> None:
    small = np.random.default_rng(n_y * 31 + n_x).normal(size=(-(-n_y // every), -(-n_x // every)))
    for large in (enlarged(small, every, (n_y, n_x)), repeated(small, every, (n_y, n_x))):
        assert large.shape == (n_y, n_x)
        np.testing.assert_allclose(large[::every, ::every], small)


def test_enlarging_is_linear_in_between() -> None:
    small = np.array([[0.0, 2.0], [4.0, 6.0]])
    np.testing.assert_allclose(enlarged(small, 2, (3, 3)), [[0.0, 1.0, 2.0], [2.0, 3.0, 4.0], [4.0, 5.0, 6.0]])
    np.testing.assert_allclose(enlarged(small, 4, (1, 5)), [[0.0, 0.5, 1.0, 1.5, 2.0]])


@settings(max_examples=25, deadline=None)
@given(
    n_y=st.integers(1, 17),
    n_x=st.integers(1, 17),
    block=st.integers(1, 5),
    n_basis=st.integers(1, 4),
    n_mixtures=st.integers(1, 6),
    seed=st.integers(0, 99),
)
def test_mixtures_are_sums_by_their_blocks_shares(
    n_y: int, n_x: int, block: int, n_basis: int, n_mixtures: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    passed = rng.normal(size=(2, n_basis, n_y, n_x)).astype(np.float32)
    blocks = -(-n_y // block), -(-n_x // block)
    shares = rng.normal(size=(2, *blocks, n_mixtures, n_basis)).astype(np.float32)
    lit = rng.random((n_y, n_x)) < 0.1
    wanted = mixing.touched(lit, block)
    want = mixing._products_plain(passed, shares, block, wanted)
    np.testing.assert_allclose(mixing.agreement(passed, shares, block, lit), want, atol=1e-4)
    whole = [np.repeat(np.repeat(shares[p], block, axis=0), block, axis=1)[:n_y, :n_x] for p in (0, 1)]
    a, b = (np.einsum("yxvk,kyx->vyx", part, images) for part, images in zip(whole, passed, strict=True))
    of_lit = wanted.repeat(block, axis=0).repeat(block, axis=1)[:n_y, :n_x]
    assert of_lit[lit].all()
    np.testing.assert_allclose(want, np.stack([a * b, a * a, b * b]) * of_lit, atol=1e-4)
    assert not want[..., ~of_lit].any()


@settings(max_examples=60, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 60), st.integers(1, 60)),
    margin=st.integers(1, 12),
    core=st.tuples(st.floats(2.0, 80.0), st.floats(2.0, 80.0)),
)
def test_tiles_give_the_window_back(shape: tuple[int, int], margin: int, core: tuple[float, float]) -> None:
    tiling = Tiling.over(shape, margin, core)
    image = np.random.default_rng(3).normal(size=(shape[0] + 2 * margin, shape[1] + 2 * margin))
    back = np.full(shape, np.nan)
    for tile, core_px in enumerate(tiling.cores(scipy.fft.rfft2(list(tiling.cut(image, np.arange(tiling.n_tiles)))))):
        rows, columns = back[tiling.place(tile)].shape
        assert np.isnan(back[tiling.place(tile)]).all()
        back[tiling.place(tile)] = core_px[:rows, :columns]
    np.testing.assert_allclose(back, image[margin:-margin, margin:-margin], atol=1e-5)


def test_only_touched_tiles_are_cut() -> None:
    tiling = Tiling.over((40, 60), 4, (20.0, 20.0))
    mask = np.zeros((40, 60), dtype=bool)
    mask[25, 45] = True
    assert tiling.touched(mask).tolist() == [5]
    assert mask[tiling.place(5)].sum() == 1
    assert tiling.numbers(np.where(mask, 7, 0).astype(np.int32), 9) == [(5, 7)]
    assert tiling.numbers(np.zeros((40, 60), dtype=np.int32), 9) == []
    label = np.random.default_rng(2).integers(0, 3, (40, 60), dtype=np.int32)
    found = tiles._numbers(label, tiling.core, tiling.counts, 4)
    assert (found == tiles._numbers_plain(label, tiling.core, tiling.counts, 4)).all()


@settings(max_examples=40, deadline=None)
@given(n_y=st.integers(1, 30), n_x=st.integers(1, 30), reach=st.integers(0, 9), seed=st.integers(0, 99))
def test_means_are_those_of_the_plain_filter(n_y: int, n_x: int, reach: int, seed: int) -> None:
    pictures = np.random.default_rng(seed).normal(size=(2, 3, n_y, n_x)).astype(np.float32)
    window = 2 * reach + 1
    want = uniform_filter(pictures, (0, 0, window, window), mode="reflect")
    np.testing.assert_allclose(pooling.window_means(pictures, window), want, atol=1e-5)
    flat = pictures.reshape(6, n_y, n_x)
    np.testing.assert_allclose(
        pooling.halved(pictures).reshape(6, -1), pooling._halved_plain(flat).reshape(6, -1), atol=1e-5
    )


@settings(max_examples=25, deadline=None)
@given(n_y=st.integers(1, 9), n_x=st.integers(1, 9), count=st.integers(0, 4), seed=st.integers(0, 99))
def test_sums_by_label_are_sums_over_masks(n_y: int, n_x: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pictures = rng.normal(size=(3, n_y, n_x)).astype(np.float32)
    label = rng.integers(0, count + 1, (n_y, n_x)).astype(np.int32)
    want = [[picture[label == k].sum(dtype=np.float64) for k in range(1, count + 1)] for picture in pictures]
    for got in (
        pooling.label_sums(pictures, label, count),
        pooling._label_sums_plain(pictures.reshape(3, -1), label.ravel(), count),
    ):
        assert got.shape == (3, count)
        np.testing.assert_allclose(got, np.reshape(want, (3, count)), atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(
    n_y=st.integers(1, 20),
    n_x=st.integers(1, 20),
    count=st.integers(3, 6),
    reach=st.integers(0, 4),
    seed=st.integers(0, 99),
)
def test_compiled_peaks_are_the_plain_ones(n_y: int, n_x: int, count: int, reach: int, seed: int) -> None:
    parts = np.random.default_rng(seed).random((3, count, n_y, n_x)).astype(np.float32)
    parts[0] -= 0.5
    window = 2 * reach + 1
    best, around, common = peaks.peaks(parts, window)
    _, want_around, want_common = peaks._peaks_plain(parts, window)
    # Candidates may be as good as each other to single precision.
    agreement = correlation(pooling.window_means(parts, window))
    chosen = np.take_along_axis(agreement, best[None], axis=0)[0]
    np.testing.assert_allclose(chosen, agreement.max(axis=0), atol=1e-5)
    np.testing.assert_allclose(common, want_common, atol=1e-5)
    same = best == agreement.argmax(axis=0)
    np.testing.assert_allclose(around[:, same], want_around[:, same], atol=1e-4)


def test_the_compiled_wiener_filter_is_the_plain_one() -> None:
    rng = np.random.default_rng(2)
    transfer, spectra = (rng.normal(size=(2, 2, 4, 3)) + 1j * rng.normal(size=(2, 2, 4, 3))).astype(np.complex64)
    ratio = rng.random((4, 3)).astype(np.float32)
    wiener = np.conj(transfer) / (np.abs(transfer) ** 2 + ratio)
    for filtered in (restore._wiener, restore._wiener_plain):
        got, gain = filtered(transfer, spectra, ratio)
        np.testing.assert_allclose(got, wiener * spectra, rtol=1e-4, atol=1e-6)
        # Parseval: the first and last column stand for themselves, the one between for two.
        squares = np.abs(wiener) ** 2
        np.testing.assert_allclose(gain, (squares @ np.array([1.0, 2.0, 1.0])).sum(axis=-1) / 16.0, rtol=1e-4)


def _places(nodes: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of candidates at a fine grid of depths, and the nearest of it for each pixel."""
    fine = np.linspace(nodes[0], nodes[-1], 641)
    return spline_weights(nodes, fine).T.astype(np.float32), np.abs(own[..., None] - fine).argmin(axis=-1)


def test_a_volume_between_its_candidates() -> None:
    """Products that are cubic in vergence are interpolated exactly."""
    nodes = np.linspace(1.0, 2.0, 9)
    parts = (nodes[None, :, None, None] ** 3 * np.array([1.0, 2.0, 3.0])[:, None, None, None]).astype(np.float32)
    volume = Volume(nodes, np.broadcast_to(parts, (3, 9, 4, 4)).copy(), 1.0, 1.0)
    np.testing.assert_allclose(volume.at(np.array([1.37]))[:, 0, 0, 0], 1.37**3 * np.array([1.0, 2.0, 3.0]), rtol=1e-5)
    # A depth of its own at each pixel, to the nearest of 64 steps between candidates; beyond the ends, theirs.
    own = np.array([[1.0, 1.2, 1.37, 1.63], [1.9, 2.0, 2.5, 0.5]] * 2)
    for one in (volume.at(own[None])[:, 0], volume_module._mixed_plain(volume.parts, *_places(nodes, own))):
        want = np.clip(own, 1.0, 2.0) ** 3 * np.array([1.0, 2.0, 3.0])[:, None, None]
        np.testing.assert_allclose(one, want, rtol=3.0 * 0.5 / 64 / 8)
    assert volume.halved().parts.shape == (3, 9, 2, 2)
    label = np.array([[0, 1, 1, 2]] * 4, dtype=np.int32)
    sums = volume.over(label, 3)
    assert sums.shape == (3, 3, 9)
    for number, pixels in ((1, 8.0), (2, 4.0), (3, 0.0)):
        np.testing.assert_allclose(sums[number - 1, 2], 3.0 * pixels * nodes**3, rtol=1e-6)


@settings(max_examples=40, deadline=None)
@given(fraction=st.floats(0.0, 1.0), powers=st.lists(st.floats(-2.0, 2.0), min_size=6, max_size=6))
def test_quintic_weights_are_the_splines(fraction: float, powers: list[float]) -> None:
    """They are positive, sum to 1, and give what SciPy's spline of the same coefficients gives at that place."""
    weights = calibration._quintic_weights(np.array(fraction))
    assert weights.min() >= -1e-15
    assert weights.sum() == pytest.approx(1.0)
    spline = BSpline(np.arange(12.0), np.array(powers), 5)
    assert weights @ np.array(powers) == pytest.approx(float(spline(5.0 + fraction)), abs=1e-9)


def test_a_stretched_kernel_keeps_its_light_and_its_shape() -> None:
    """A Gaussian of 4 pixels, stretched by 3 % and sheared: the closed form to 1e-4 of its peak."""
    y, x = np.mgrid[:48, :48] - 24.0
    kernel = np.exp(-0.5 * (x * x + y * y) / 16.0).astype(np.float32)
    stretch = np.array([[1.03, 0.02], [-0.01, 0.98]])
    got = calibration.stretched(kernel[None], stretch)[0]
    u, v = stretch[0, 0] * x + stretch[0, 1] * y, stretch[1, 0] * x + stretch[1, 1] * y
    want = np.exp(-0.5 * (u * u + v * v) / 16.0) * np.linalg.det(stretch)
    np.testing.assert_allclose(got, want, atol=1e-4)
    assert got.sum() == pytest.approx(kernel.sum(), rel=1e-3)


def test_the_basis_leaves_out_what_it_may() -> None:
    """Rows of falling strength: the least number of columns that hold them, and no more missing than asked."""
    rng = np.random.default_rng(6)
    directions, _ = np.linalg.qr(rng.normal(size=(200, 12)))
    strengths = 2.0 ** -np.arange(12.0)
    table = (rng.permutation(np.eye(60))[:, :12] * strengths @ directions.T).astype(np.float32)
    counts = []
    for error in (0.3, 0.05, 0.01):
        columns = filters._range(table, error)
        np.testing.assert_allclose(columns.T @ columns, np.eye(columns.shape[1]), atol=1e-5)
        missing = np.linalg.norm(table - columns @ (columns.T @ table)) / np.linalg.norm(table)
        assert missing <= error * 1.001
        left = np.sqrt((strengths[columns.shape[1] - 1 :] ** 2).sum() / (strengths**2).sum())
        assert left > error  # one column less would not do
        counts.append(columns.shape[1])
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]


def test_correlation_is_blind_to_contrast() -> None:
    a = np.random.default_rng(4).normal(size=100)
    for ratio in (0.1, 1.0, 7.0):
        b = ratio * a
        assert correlation(np.array([(a * b).sum(), (a * a).sum(), (b * b).sum()])) == pytest.approx(1.0)


def test_a_spline_finds_what_a_parabola_misses() -> None:
    """A Gaussian of 2.5 steps: the parabola through three of its values is up to 0.01 steps off, the spline 5e-4."""
    true = np.linspace(3.0, 9.0, 41)
    values = np.exp(-0.5 * ((np.arange(13) - true[:, None]) / 2.5) ** 2)
    place, height, curvature, inside = spline_peaks(values)
    assert inside.all()
    assert np.abs(place - true).max() < 6e-4
    np.testing.assert_allclose(height, 1.0, atol=1e-4)
    np.testing.assert_allclose(curvature, 1.0 / 2.5**2, rtol=0.02)
    best = values.argmax(axis=1)
    below, at, above = (values[np.arange(41), best + d] for d in (-1, 0, 1))
    assert np.abs(best + parabola(below, at, above)[0] - true).max() > 3e-3


@pytest.mark.parametrize("count", [3, 4, 5, 13])
def test_a_peak_at_an_end_is_said(count: int) -> None:
    rising = np.arange(count, dtype=np.float64)[None]
    for values in (rising, -rising):
        assert not spline_peaks(values)[3].any()


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


@given(lit=arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12)))
def test_images_are_made_sharp_two_pixels_beyond_what_is_lit(lit: np.ndarray) -> None:
    seen = cast("Seen", SimpleNamespace(lit=lit))
    np.testing.assert_array_equal(lit_about(seen), binary_dilation(lit, iterations=2))


def test_texture_at_the_outline_alone_is_none() -> None:
    region = np.zeros((60, 60), dtype=bool)
    region[5:55, 5:55] = True
    outline = region.copy()
    outline[15:45, 15:45] = False
    assert not textured(region, outline, 10)
    assert textured(region, region, 10)
    assert textured(region, outline, 30)  # too small to have an inside


def test_the_inside_of_a_segment_keeps_away_from_other_depths_alone() -> None:
    segment = np.zeros((120, 120), dtype=np.int32)
    segment[10:110, 10:60], segment[10:110, 60:110] = 1, 2
    inner = interior(segment, 1, 1)
    assert inner[10, 10]  # beside darkness
    assert not inner[:, 36:].any()  # 24 pixels from the other depth
    assert inner[10:110, 10:36].all()
    segment[:, :57] = 0  # too narrow for a distance of 24, or of anything
    np.testing.assert_array_equal(interior(segment, 1, 1), segment == 1)


def test_structural_similarity_against_its_closed_forms() -> None:
    """Equal images give 1; a constant offset leaves the luminance term alone (Wang et al. 2004, Eq. 6)."""
    image = np.random.default_rng(6).normal(100.0, 10.0, size=(60, 60))
    assert structural_similarity(image, image, 200.0) == pytest.approx(1.0)
    flat, raised = np.full((60, 60), 100.0), np.full((60, 60), 120.0)
    low = (0.01 * 200.0) ** 2
    want = (2.0 * 100.0 * 120.0 + low) / (100.0**2 + 120.0**2 + low)
    assert structural_similarity(raised, flat, 200.0) == pytest.approx(want)
    # Independent noise of equal variance: the structure term is the constant's share alone, near 1/7 for 10 in 200.
    other = np.random.default_rng(7).normal(100.0, 10.0, size=(60, 60))
    high = (0.03 * 200.0) ** 2
    assert structural_similarity(image, other, 200.0) == pytest.approx(high / (2.0 * 100.0 + high), abs=0.05)


def test_compiled_ratios_and_light_are_the_plain_ones() -> None:
    rng = np.random.default_rng(5)
    images = rng.normal(20.0, 15.0, (2, 33, 41)).astype(np.float32)
    gain, about = rng.random((2, 2, 33, 41)).astype(np.float32)
    lit = rng.random((33, 41)) < 0.7
    args = images, gain, 30.0 * about, np.float32(4.0), lit
    for ours, plain in zip(contrast._ratios(*args), contrast._ratios_plain(*args), strict=True):
        np.testing.assert_allclose(ours, plain, rtol=2e-6)
        assert np.isnan(ours[~lit]).all()
    segment, inner = rng.integers(0, 4, (2, 33, 41), dtype=np.int32)
    light = contrast._light(images, segment, inner, 5)
    np.testing.assert_allclose(light, contrast._light_plain(images, segment, inner, 5), rtol=1e-9)
    assert light.shape == (4, 5)


@pytest.mark.parametrize("every", [1, 2, 3, 4])
@pytest.mark.parametrize("shape", [(23, 40), (5, 3), (1, 9)])
def test_compiled_enlarging_is_the_plain_one(every: int, shape: tuple[int, int]) -> None:
    small = np.random.default_rng(6).random(tuple(-(-n // every) for n in shape))
    np.testing.assert_allclose(
        enlarged(small, every, shape), reduce._enlarged_plain(small, every, shape)[: shape[0], : shape[1]]
    )
    again = repeated(small, every, shape)
    assert again.shape == shape
    assert (again[::every, ::every] == small).all()
    assert not np.shares_memory(again, small)


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_opened_masks_are_those_of_scipy(steps: int) -> None:
    mask = np.random.default_rng(steps).random((31, 47)) < 0.93
    given = mask.copy()
    assert (opened(mask, steps) == binary_opening(mask, iterations=steps)).all()
    assert (mask == given).all()


@pytest.mark.parametrize("corner", [(-2, -1), (1, 1), (3, -9), (40, 2)])
def test_a_window_beyond_the_frame_goes_on_with_its_edge(corner: tuple[int, int]) -> None:
    frame = np.arange(30.0, dtype=np.float32).reshape(5, 6)
    rows, columns = corner[0] + np.arange(3), corner[1] + np.arange(4)
    image = twins._cut(frame, corner, (3, 4))
    assert (image == frame[np.ix_(rows.clip(0, 4), columns.clip(0, 5))]).all()
