"""Outlines become as short as the doubt about their pixels allows, and go along edges of the light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.decode.images.deconvolution import SharpImages
from metafab.decode.images.shortest_outlines import shortest_outlines
from tests.unit.decode.images.test_contrast_outlines import EDGE, SHAPE, STEP, regions, scalloped

STEEP = 2.0


def light(of_right: float) -> SharpImages:
    """Even images, brighter by a factor to the right of the edge."""
    picture = np.where(np.indices((SHAPE[0] * STEP, SHAPE[1] * STEP))[1] >= EDGE * STEP - STEP // 2, of_right, 1.0)
    images = np.stack([picture, picture]).astype(np.float32)
    return SharpImages(images, np.ones_like(images))


def test_a_jagged_outline_becomes_straight_and_its_doubt_less() -> None:
    before = regions(scalloped(), right=0.45)
    after = shortest_outlines(before, light(1.0), STEP)
    first, last = ((one.grown == 2).argmax(axis=1) for one in (before, after))
    assert np.std(last) < 0.6 * np.std(first)
    assert abs(last.mean() - first.mean()) < 0.5
    assert after.right is not None
    at_outline = np.abs(np.indices(SHAPE)[1] - EDGE + 2) <= 1
    stayed = at_outline & (after.grown == before.grown)
    assert (after.right[stayed] > 0.5).all() and (after.right <= 0.8).all()


def test_an_outline_goes_to_an_edge_of_the_light_within_reach() -> None:
    """The pixels that the outline leaves are given to the segment across it, unless they are sure."""
    after = shortest_outlines(regions(scalloped(), right=0.7), light(STEEP), STEP)
    assert ((after.grown == 2) == (np.indices(SHAPE)[1] >= EDGE)).all()
    sure = shortest_outlines(regions(scalloped(), right=0.999), light(1.1), STEP)
    assert (sure.grown != scalloped()).mean() < 0.02


@pytest.mark.parametrize("why", ["interior", "foreign light", "plain object"])
def test_pixels_that_are_certain_stay(why: str) -> None:
    before = regions(scalloped(), right=0.0 if why == "foreign light" else 0.6)
    if why == "interior":
        before = replace(before, interior=before.grown)
    if why == "plain object":
        before = replace(before, depths=tuple(replace(one, of_outline=True) for one in before.depths))
    assert shortest_outlines(before, light(STEEP), STEP) is before


def test_a_round_segment_keeps_its_size() -> None:
    """The cost of length alone makes this disc 4.7 % smaller."""
    y, x = np.indices(SHAPE)
    centre, radius = (SHAPE[0] // 2, SHAPE[1] // 2), SHAPE[0] // 3
    away = np.hypot(y - centre[0], x - centre[1]) - radius
    label = np.where(away <= 0.0, 2, 1).astype(np.int32)
    before = replace(regions(label), right=0.5 + 0.49 * np.minimum(np.abs(away) / 6.0, 1.0))
    after = shortest_outlines(before, light(1.0), STEP)
    assert abs((after.grown == 2).sum() / (label == 2).sum() - 1.0) < 0.035
