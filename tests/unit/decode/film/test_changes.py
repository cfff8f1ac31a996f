"""What changed between two frames, and the parts of the window that are decoded again for it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.camera import RawFrame
from metafab.decode.film.changes import ChangeDetector, PatchMeans, changed_rectangles
from metafab.decode.matching.levels import Levels

LEVELS = Levels(signal=1000.0, noise_variance=1004.0, texture_rms=200.0, read_noise_e=2.0)


def detector(n_y: int = 60, n_x: int = 80, side: int = 3, margin: int = 4) -> ChangeDetector:
    """Two images beside each other, the second a pixel lower."""
    row, column = np.mgrid[:n_y, :n_x].astype(np.int32) * side
    return ChangeDetector(np.stack([row, row + 1]), np.stack([column, column + n_x * side]), side, margin)


def noisy(rng: np.random.Generator, light: np.ndarray) -> RawFrame:
    return RawFrame(rng.poisson(light).astype(np.float64), 3.45, (0.0, 0.0), 2.0, saturation_e=1e5)


def test_noise_is_no_change_and_a_change_is_found_where_it_is() -> None:
    """8 standard deviations; a step of 100 e in 1000 e, 3.2 of a pixel's noise, is 22 of a window's mean square."""
    rng, places = np.random.default_rng(1), detector()
    light = np.full((181, 480), 1000.0) * (1.0 + 0.3 * rng.random((181, 480)))
    first = places.patch_means(noisy(rng, light))
    for _ in range(20):
        assert not places.changed(places.patch_means(noisy(rng, light)), first, LEVELS).any()
    for left in (0, 240):  # in either image
        brighter = light.copy()
        brighter[90:120, left + 60 : left + 90] += 100.0
        moved = places.changed(places.patch_means(noisy(rng, brighter)), first, LEVELS)
        assert moved[31:39, 21:29].all()
        # Windows reach 3 squares.
        moved[26:44, 16:34] = False
        assert not moved.any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
def test_a_pixel_that_breaks_is_a_change_and_one_that_stays_broken_none(value: float) -> None:
    rng, places = np.random.default_rng(2), detector()
    light = np.full((181, 480), 1000.0)
    whole, other = noisy(rng, light), noisy(rng, light)
    for frame in (whole, other):
        frame.frame[7, 10] = value
    first = places.patch_means(whole)
    assert not places.changed(places.patch_means(other), first, LEVELS).any()
    assert np.isfinite(first.mean).all()
    other.frame[100, 100] = value
    moved = places.changed(places.patch_means(other), first, LEVELS)
    assert np.argwhere(moved).tolist() == [[33, 33]]


def test_pixels_near_the_full_well_are_full_by_chance() -> None:
    """Light of a texture about a full well of 1000 e: half of its pixels flicker, and 100 e more fill them all."""
    rng, places = np.random.default_rng(6), detector()
    light = np.full((181, 480), 990.0) + 30.0 * rng.random((181, 480))

    def frame(light: np.ndarray) -> RawFrame:
        return dataclasses.replace(noisy(rng, light), saturation_e=1000.0)

    first = places.patch_means(frame(light))
    again = [places.patch_means(frame(light)) for _ in range(20)]
    assert 0.4 < first.full.mean() / 9 < 0.8
    assert all(np.mean(means.full != first.full) > 0.5 for means in again)
    assert not any(places.changed(means, first, LEVELS).any() for means in again)
    brighter = light.copy()
    brighter[90:120, 60:90] += 100.0
    moved = places.changed(places.patch_means(frame(brighter)), first, LEVELS)
    assert moved[32:38, 22:28].all()
    moved[26:44, 16:34] = False
    assert not moved.any()


def test_a_single_light_that_is_switched_on_and_saturates_is_seen() -> None:
    rng, places = np.random.default_rng(7), detector()
    light = np.full((181, 480), 1000.0)
    first, lamp = places.patch_means(noisy(rng, light)), noisy(rng, light)
    lamp.frame[100, 100] = 2e5
    moved = places.changed(places.patch_means(lamp), first, LEVELS)
    assert moved[30:37, 30:37].all()
    assert moved.sum() == 49


def test_means_of_few_pixels_are_noisier() -> None:
    """Of each square two of nine pixels are left: its mean has 4.5 times the variance of the others'."""
    rng, places = np.random.default_rng(8), detector()
    light = np.full((181, 480), 1000.0)
    dead = rng.permuted(np.tile(np.arange(9) > 1, (60, 160, 1)), axis=-1).reshape(60, 160, 3, 3)
    hidden = np.zeros(light.shape, dtype=bool)
    hidden[:180] = dead.swapaxes(1, 2).reshape(180, 480)

    def frame(light: np.ndarray) -> RawFrame:
        whole = noisy(rng, light)
        whole.frame[hidden] = np.nan
        return whole

    first = places.patch_means(frame(light))
    assert first.invalid[0].min() == first.invalid[0].max() == 7
    for _ in range(5):
        assert not places.changed(places.patch_means(frame(light)), first, LEVELS).any()
    assert places.changed(places.patch_means(frame(light + 100.0)), first, LEVELS).mean() > 0.99


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.uint16, np.uint8, np.int32])
@pytest.mark.parametrize("limit", [None, 180.0])
def test_compiled_means_are_the_plain_ones(dtype: type, limit: float | None) -> None:
    """Squares beyond the frame repeat its edge."""
    frame = np.random.default_rng(3).integers(0, 255, (30, 40)).astype(dtype)
    if frame.dtype.kind == "f":
        frame[::7, ::5] = np.nan
    row, column = np.random.default_rng(4).integers(-5, 45, (2, 2, 7, 9)).astype(np.int32)
    places = ChangeDetector(row, column, 2, 1)
    means = places.patch_means(RawFrame(frame, 3.45, (0.0, 0.0), 1.0, saturation_e=limit))
    rows, columns = (np.stack([first, first + 1], axis=-1) for first in (row, column))
    values = frame[rows.clip(0, 29)[..., :, None], columns.clip(0, 39)[..., None, :]].astype(np.float64)
    valid, level = np.isfinite(values), np.inf if limit is None else limit
    full, invalid = (valid & (values >= level)).sum(axis=(-2, -1)), (~valid).sum(axis=(-2, -1))
    mean = np.minimum(np.where(valid, values, 0.0), level).sum(axis=(-2, -1)) / np.maximum(4 - invalid, 1)
    np.testing.assert_allclose(means.mean, mean, rtol=1e-6)
    np.testing.assert_array_equal(means.full, full)
    np.testing.assert_array_equal(means.invalid, invalid)
    assert full.any() == (limit is not None)
    assert invalid.any() == np.isnan(frame).any()


def test_what_is_not_looked_at_anew_is_the_last_frames() -> None:
    """Slow changes add up until they count."""
    now, last = (
        PatchMeans(np.full((2, 3, 4), v, np.float32), *np.full((2, 2, 3, 4), k, np.uint8)) for v, k in ((1, 1), (2, 0))
    )
    anew = np.zeros((3, 4), dtype=bool)
    anew[1, 2] = True
    both = last.replaced(now, anew)
    assert (both.mean[:, anew] == 1.0).all()
    assert (both.mean[:, ~anew] == 2.0).all()
    for count in (both.full, both.invalid):
        assert (count[:, anew] == 1).all()
        assert not count[:, ~anew].any()
    rng, places = np.random.default_rng(5), detector()
    first = places.patch_means(noisy(rng, np.full((181, 480), 1000.0)))
    found = [
        places.changed(places.patch_means(noisy(rng, np.full((181, 480), e))), first, LEVELS).mean()
        for e in (1003, 1100)
    ]
    assert found[0] == 0.0
    assert found[1] > 0.99


def test_a_change_reaches_as_far_as_the_filters_do() -> None:
    places = detector(margin=8)
    moved = np.zeros((60, 80), dtype=bool)
    moved[30, 40] = True
    reached = places.affected(moved)
    assert reached.shape == (44, 64)
    assert reached.sum() == 81
    assert reached[18:27, 28:37].all()


@settings(max_examples=80, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 90), st.integers(1, 90)),
    block=st.integers(1, 9),
    places=st.lists(st.tuples(st.floats(0.0, 0.999), st.floats(0.0, 0.999)), max_size=6),
)
def test_parts_hold_all_that_is_wanted_and_do_not_overlap(
    shape: tuple[int, int], block: int, places: list[tuple[float, float]]
) -> None:
    wanted = np.zeros(shape, dtype=bool)
    for y, x in places:
        wanted[int(y * shape[0]), int(x * shape[1])] = True
    count = np.zeros(shape, dtype=int)
    for rows, columns in changed_rectangles(wanted, block):
        count[rows, columns] += 1
        assert rows.start % block == columns.start % block == 0
        for at, n in zip((rows, columns), shape, strict=True):
            assert at.stop == n or at.stop % block == 0
            assert 0 <= at.start < at.stop <= n
    assert (count[wanted] == 1).all()
    assert count.max(initial=0) <= 1
    assert wanted.any() == bool(count.any())
