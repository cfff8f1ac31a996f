"""Standard deviation of samples with outliers."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.numeric.spread import normal_sigma


def test_normal_samples_have_their_standard_deviation_though_a_tenth_are_outliers() -> None:
    """A tenth of outliers moves the median to the quantile 0.5 / 0.9 of the others: 1.13 times as far."""
    deviation = np.random.default_rng(0).normal(0.0, 3.0, (2, 100_000)) * [[1.0], [2.0]]
    assert normal_sigma(deviation, axis=1) == pytest.approx([3.0, 6.0], rel=0.01)
    deviation[:, ::10] = 1e6
    assert normal_sigma(deviation, axis=1) == pytest.approx([3.39, 6.78], rel=0.01)
