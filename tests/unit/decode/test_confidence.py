"""The probability that a depth is right."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.confidence import confidence, right_segment, same_side

FAR = np.array(np.inf)


def test_a_segment_is_doubted_where_the_twins_do_not_fit() -> None:
    fits = right_segment(np.array([0.5, 1.0, 2.0, 5.0, 50.0]), np.ones(5), FAR)
    assert fits[0] == fits[1] > 0.99
    assert (np.diff(fits[1:]) < 0.0).all()
    assert fits[-1] < 0.5  # no depth is claimed


def test_a_segment_is_doubted_near_an_outline_unless_the_depth_across_it_fits_worse() -> None:
    no_better, at_outline, away = right_segment(
        np.array([1.0, 1.0, 1.0]), np.array([1.0, 10.0, 1.0]), np.array([0.0, 0.0, 60.0])
    ).tolist()
    assert no_better < 0.6
    assert at_outline > no_better + 0.15
    assert away > 0.95


def test_noise_alone_is_a_normal_distribution() -> None:
    """5 % is one standard error of 5 %, and five of 1 %."""
    error = np.array([0.05, 0.01])
    assert confidence(error, np.full(2, np.inf), 1.0) == pytest.approx([0.6827, 1.0], abs=1e-4)
    assert confidence(np.full(2, np.inf), error, 0.5) == pytest.approx([0.3413, 0.5], abs=1e-4)
    assert (confidence(np.full(2, np.inf), np.full(2, np.inf), 1.0) == 0.0).all()


@pytest.mark.parametrize("step", [1, 2, 3, 4])
def test_pixels_of_a_downsampled_one_lie_across_an_outline_as_often_as_stated(step: int) -> None:
    """Straight outlines anywhere, each downsampled pixel given to the side of most of its pixels."""
    beyond = np.arange(8 * step) + 0.5 > np.linspace(3.5 * step, 4.5 * step, 2001)[1:-1, None]
    blocks = beyond.reshape(len(beyond), 8, step)
    label = blocks.mean(axis=2) > 0.5
    right = (blocks == label[..., None]).mean(axis=2)
    beside = np.zeros(label.shape, dtype=bool)
    beside[:, 1:] |= label[:, 1:] != label[:, :-1]
    beside[:, :-1] |= label[:, 1:] != label[:, :-1]
    stated = same_side(np.where(label, 3.0, 2.0), step)
    assert stated[beside] == pytest.approx(right[beside].mean(), abs=1e-3)
    assert (stated[~beside] == 1.0).all() and (right[~beside] == 1.0).all()


def test_an_outline_between_depths_that_are_one_within_5_percent_raises_no_doubt() -> None:
    vergence = np.array([[2.0, 2.05, np.nan, 2.0]] * 3)
    assert (same_side(vergence, 3) == 1.0).all()
