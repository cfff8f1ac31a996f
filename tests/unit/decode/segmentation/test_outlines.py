"""Outlines: straight where nothing speaks against it, and where the scores say elsewhere."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.outlines import refined_outlines

SHAPE = (60, 80)
EVERYWHERE = np.ones(SHAPE, dtype=bool)


def disc(radius: float) -> NDArray[np.bool_]:
    row, column = np.ogrid[: SHAPE[0], : SHAPE[1]]
    return (row - 30) ** 2 + (column - 40) ** 2 < radius**2


def scores_of(truth: NDArray[np.intp], layers: int, noise: float, seed: int) -> NDArray[np.float32]:
    """0.4 for the layer that is there, with noise in each pixel."""
    scores = np.float32(0.4) * (truth == np.arange(layers)[:, None, None])
    return scores + noise * np.random.default_rng(seed).normal(size=scores.shape).astype(np.float32)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 999), layers=st.integers(2, 5))
def test_outlines_are_found_through_noise(seed: int, layers: int) -> None:
    """One pixel in eight or more is wrong by itself; a disc and an edge come out but for some of their outlines."""
    truth = np.where(disc(18.0), 1, 0).astype(np.intp)
    truth[:, 70:] = layers - 1
    scores = scores_of(truth, layers, 0.25, seed)
    alone = scores.argmax(axis=0)
    assert np.mean(alone != truth) > 0.11
    assert np.mean(refined_outlines(alone, scores, EVERYWHERE, 7) != truth) < 0.012


def test_one_layer_is_everywhere() -> None:
    layer = np.zeros(SHAPE, dtype=np.intp)
    np.testing.assert_array_equal(
        refined_outlines(layer, np.zeros((1, *SHAPE), dtype=np.float32), EVERYWHERE, 7), layer
    )


def test_what_is_not_allowed_is_not_taken() -> None:
    truth = disc(18.0).astype(np.intp)
    scores = scores_of(truth, 2, 0.25, 3)
    scores[1, :, :40] = -np.inf
    got = refined_outlines(scores.argmax(axis=0), scores, EVERYWHERE, 7)
    assert not got[:, :40].any()
    assert got[20:40, 44:54].all()


def test_pixels_without_a_layer_have_no_share() -> None:
    """A strip of three pixels beside darkness stays, whatever layer the darkness was given."""
    truth = np.zeros(SHAPE, dtype=np.intp)
    truth[:, 37:40] = 1
    lit = np.zeros(SHAPE, dtype=bool)
    lit[:, 37:40] = True
    scores = 0.2 * scores_of(truth, 2, 0.0, 0)
    scores[:, ~lit] = 0.0
    np.testing.assert_array_equal(refined_outlines(truth, scores, lit, 7)[lit], 1)
    assert not refined_outlines(truth, scores, EVERYWHERE, 7)[lit].any()


@pytest.mark.parametrize("shape", [(23, 40), (9, 3), (4, 4)])
@pytest.mark.parametrize("reach", [1, 3])
def test_a_round_takes_the_largest_sum_of_share_and_score(shape: tuple[int, int], reach: int) -> None:
    rng = np.random.default_rng(3)
    layer, counted = rng.integers(0, 4, shape), rng.random(shape) < 0.8
    scores = rng.normal(0.0, 0.2, (4, *shape)).astype(np.float32)
    scores[2, :2] = -np.inf
    members = (layer == np.arange(4)[:, None, None]) & counted
    plain = (window_means(members.astype(np.float32), 2 * reach + 1) + scores).argmax(axis=0)
    got = refined_outlines(layer, scores, counted, 2 * reach + 1, rounds=1)
    assert (got == plain).mean() > 0.99  # sums that are nearly equal
