"""Depth of the outline of a plain object, drawn by the blur of what is behind it."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.numeric.distance import distance
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.objects.plain_objects import change_across

NODES = np.linspace(1.5, 4.0, 13)
SHAPE = (60, 60)
#: A card of 40 x 40 pixels.
CARD = np.zeros(SHAPE, dtype=bool)
CARD[10:50, 10:50] = True
#: Frame pixels from one downsampled pixel to the next.
STEP = 3


def volume_of(vergence_per_m: np.ndarray) -> CostVolume:
    """Twins that are equal at 1/depth of each pixel, with 1 % of noise."""
    rho = 0.99 * np.exp(-0.5 * ((NODES[:, None, None] - vergence_per_m) / 0.6) ** 2)
    return CostVolume(NODES, np.stack([rho, np.ones_like(rho), np.ones_like(rho)]).astype(np.float32), 1.0, 1.0)


@pytest.mark.parametrize("drawn", [0.0, 0.1])
def test_a_depth_that_changes_across_the_rim_counts_as_error_and_an_even_one_does_not(drawn: float) -> None:
    within_px = distance(~CARD) * STEP
    true = np.full(SHAPE, 3.0)
    true[within_px <= 6.0] *= 1.0 - drawn
    # The noise of some hundred pixels, each known to 2 %, is taken off.
    assert change_across(volume_of(true), CARD, STEP) == pytest.approx(drawn, abs=0.01)


def test_a_rim_without_an_inner_half_has_no_known_change() -> None:
    line = np.zeros(SHAPE, dtype=bool)
    line[30:32, 10:50] = True
    assert not change_across(volume_of(np.full(SHAPE, 3.0)), line, STEP) < 1.0
