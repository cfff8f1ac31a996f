"""Outlines between downsampled pixels, on the frame's pixels."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from metafab.decode.images.pixel_outlines import DEVIATION, REACH, on_pixels
from metafab.decode.registration.downsampling import repeated

SHAPE = (90, 150)


def line(angle_deg: float, step: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Segments on two sides of a straight line, on all pixels, and on downsampled ones by their middles."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    angle = np.radians(angle_deg)
    true = (1 + ((x - 74.3) * np.cos(angle) + (y - 44.6) * np.sin(angle) > 0.0)).astype(np.int32)
    return true, np.ascontiguousarray(true[::step, ::step])


@pytest.mark.parametrize("step", [2, 3, 4])
@pytest.mark.parametrize("angle_deg", [10.0, 27.0, 45.0, -62.0])
def test_a_slanted_outline_has_fewer_pixels_on_the_wrong_side(angle_deg: float, step: int) -> None:
    """Steps of a downsampled pixel leave a quarter of its side wrong on average, the Gaussian about half of that."""
    true, label = line(angle_deg, step)
    wrong = (on_pixels(label, step, SHAPE)(label) != true).sum()
    assert wrong < 0.6 * (repeated(label, step, SHAPE) != true).sum()


def test_an_upright_outline_stays_where_it_is() -> None:
    label = np.ones((30, 50), dtype=np.int32)
    label[:, 20:] = 2
    np.testing.assert_array_equal(on_pixels(label, 3, SHAPE)(label), repeated(label, 3, SHAPE))


def test_bars_and_specks_keep_their_pixels() -> None:
    label = np.ones((30, 50), dtype=np.int32)
    label[np.arange(2, 28), np.arange(10, 36)] = 2
    label[np.arange(2, 28), np.arange(11, 37)] = 2
    label[5, 40] = 3
    np.testing.assert_array_equal(on_pixels(label, 3, SHAPE)(label), repeated(label, 3, SHAPE))


def test_values_come_from_the_nearest_pixel_of_the_heaviest_segment() -> None:
    """By plain sums, on large segments with jagged outlines; beyond the border the outermost pixels weigh again."""
    rng, step = np.random.default_rng(1), 3
    y, x = np.mgrid[:30, :50]
    label = (1 + (x + 3.0 * np.sin(0.7 * y) + rng.normal(0.0, 0.7, (30, 50)) > 20.0)).astype(np.int32)
    label[18:, 28:] = 0
    values = rng.random(label.shape)
    found_label, found = (on_pixels(label, step, SHAPE)(each) for each in (label, values))
    moved = np.argwhere(found_label != repeated(label, step, SHAPE))
    stay = np.argwhere(found_label == repeated(label, step, SHAPE))
    np.testing.assert_array_equal(found[tuple(stay.T)], repeated(values, step, SHAPE)[tuple(stay.T)])
    assert len(moved) > 50
    reach = np.arange(-REACH, REACH + 1)
    for row, column in moved:
        rows = (min((row + 1) // step, 29) + reach)[:, None]
        columns = (min((column + 1) // step, 49) + reach)[None, :]
        weight = np.exp(-0.5 * ((rows - row / step) ** 2 + (columns - column / step) ** 2) / DEVIATION**2)
        around = label[rows.clip(0, 29), columns.clip(0, 49)]
        heaviest = int(np.argmax([weight[around == number].sum() for number in range(3)]))
        assert found_label[row, column] == heaviest
        inside = (rows >= 0) & (rows < 30) & (columns >= 0) & (columns < 50) & (around == heaviest)
        place = np.unravel_index(np.where(inside, weight, -1.0).argmax(), weight.shape)
        assert found[row, column] == values[rows[place[0], 0], columns[0, place[1]]]


def test_one_segment_is_repeated() -> None:
    label = np.ones((30, 50), dtype=np.int32)
    values = np.arange(1500.0).reshape(30, 50)
    np.testing.assert_array_equal(on_pixels(label, 3, SHAPE)(values), repeated(values, 3, SHAPE))


@pytest.mark.parametrize("beyond", [-2.0, -1.0, 1.0, 2.0])
def test_a_displaced_outline_stands_on_the_frame_s_pixels(beyond: float) -> None:
    """Whichever segment a pixel belongs to, within half a pixel; without displacement nothing changes."""
    label = np.ones((30, 50), dtype=np.int32)
    label[:, 20:] = 2
    displaced = np.where(label == 1, beyond, -beyond).astype(np.float32)
    found = on_pixels(label, 3, SHAPE, displaced)(label)
    last = np.nonzero(repeated(label, 3, SHAPE)[45] == 1)[0][-1]
    assert np.nonzero(found[45] == 1)[0][-1] - last == pytest.approx(beyond, abs=0.5)
    still = on_pixels(label, 3, SHAPE, np.zeros_like(displaced))(label)
    np.testing.assert_array_equal(still, on_pixels(label, 3, SHAPE)(label))
