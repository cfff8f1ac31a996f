"""Null energy of twins, and the segments across outlines."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.segmentation.fit import TwinEnergies, across_outlines


@pytest.mark.parametrize("contrast", [0.4, 1.0, 2.5, -1.0])
def test_noise_is_left_of_equal_twins_whatever_their_contrast(contrast: float) -> None:
    rng = np.random.default_rng(1)
    texture, noise = rng.normal(0.0, 20.0, 20000), rng.normal(0.0, 1.0, (2, 20000))
    a, b = contrast * texture + noise[0], texture + noise[1]
    of = TwinEnergies(np.array([np.mean(a * b), np.mean(a * a), np.mean(b * b)]))
    # The mean of 20000 squares of variance 2 is known to 1 %.
    assert float(of.null_energy) == pytest.approx(1.0, abs=0.04)
    assert float(of.energy) == pytest.approx(400.0 * (1.0 + contrast**2), rel=0.05)
    other = rng.normal(0.0, 20.0, 20000)
    unlike = TwinEnergies(np.array([np.mean(a * other), np.mean(a * a), np.mean(other * other)]))
    assert float(unlike.null_energy) > 50.0


def test_the_segment_across_the_nearest_outline() -> None:
    label = np.ones((6, 12), dtype=np.int32)
    label[:, 5:9], label[:, 9:] = 2, 3
    across, away = across_outlines(label)
    assert across[0].tolist() == [2, 2, 2, 2, 2, 1, 1, 3, 3, 2, 2, 2]
    assert away[0].tolist() == [4, 3, 2, 1, 0, 0, 1, 1, 0, 0, 1, 2]


def test_darkness_is_no_outline() -> None:
    label = np.zeros((6, 12), dtype=np.int32)
    label[:, 5:9] = 1
    across, away = across_outlines(label)
    assert not across.any() and np.isinf(away).all()
