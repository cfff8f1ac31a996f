"""The probability that a depth is right."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.confidence import confidence, right_segment

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
