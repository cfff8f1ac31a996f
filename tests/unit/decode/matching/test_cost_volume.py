"""Products of the twins between candidates, over segments, and their correlation."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.matching.cost_volume import CostVolume, correlation, correlation_less


def test_a_volume_between_its_candidates() -> None:
    """Products that are cubic in vergence are interpolated exactly."""
    nodes = np.linspace(1.0, 2.0, 9)
    parts = (nodes[None, :, None, None] ** 3 * np.array([1.0, 2.0, 3.0])[:, None, None, None]).astype(np.float32)
    volume = CostVolume(nodes, np.broadcast_to(parts, (3, 9, 4, 4)).copy(), 1.0, 1.0)
    np.testing.assert_allclose(volume.at(np.array([1.37]))[:, 0, 0, 0], 1.37**3 * np.array([1.0, 2.0, 3.0]), rtol=1e-5)
    # A depth of its own at each pixel, to the nearest of 64 steps between candidates; beyond the ends, theirs.
    own = np.array([[1.0, 1.2, 1.37, 1.63], [1.9, 2.0, 2.5, 0.5]] * 2)
    want = np.clip(own, 1.0, 2.0) ** 3 * np.array([1.0, 2.0, 3.0])[:, None, None]
    np.testing.assert_allclose(volume.at(own[None])[:, 0], want, rtol=3.0 * 0.5 / 64 / 8)
    assert volume.halved().products.shape == (3, 9, 2, 2)
    label = np.array([[0, 1, 1, 2]] * 4, dtype=np.int32)
    sums = volume.label_sums(label, 3)
    assert sums.shape == (3, 3, 9)
    for number, pixels in ((1, 8.0), (2, 4.0), (3, 0.0)):
        np.testing.assert_allclose(sums[number - 1, 2], 3.0 * pixels * nodes**3, rtol=1e-6)


def test_correlation_is_blind_to_contrast() -> None:
    a = np.random.default_rng(4).normal(size=100)
    for ratio in (0.1, 1.0, 7.0):
        b = ratio * a
        assert correlation(np.array([(a * b).sum(), (a * a).sum(), (b * b).sum()])) == pytest.approx(1.0)


def test_scores_are_the_correlation_less_a_penalty() -> None:
    """Without light in one of the twins, too."""
    rng = np.random.default_rng(7)
    products = rng.uniform(0.1, 1.0, size=(3, 2, 5, 6)).astype(np.float32)
    products[:, 0, 0, 0] = 0.0
    penalty = rng.uniform(size=(2, 5, 6)).astype(np.float32)
    assert np.allclose(correlation_less(products, penalty), correlation(products) - penalty, rtol=0.0, atol=1e-6)
