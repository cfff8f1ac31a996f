"""Ridges of misfit, by synthetic pictures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.decode.segmentation.fit import Misfit
from metafab.decode.segmentation.objects.bars import Ridge, ridges

SHAPE, STEP = (90, 120), 3


def misfit_of(over_noise: FloatArray) -> Misfit:
    wide = over_noise.astype(np.float32)
    return Misfit(wide, np.full(SHAPE, 0.2, dtype=np.float32), 1e-3)


def found(over_noise: FloatArray) -> list[Ridge]:
    return ridges(np.ones(SHAPE, dtype=np.int32), misfit_of(over_noise), np.zeros(SHAPE, dtype=bool), STEP)


@pytest.mark.parametrize("angle_deg", [0.0, 27.0, 90.0])
def test_a_broken_ridge_is_followed_in_any_direction(angle_deg: float) -> None:
    """Its weak parts have a misfit of 2.2, below that of foreign light."""
    along = np.array([math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))])
    truth = Ridge(np.array([44.0, 61.0]), along, 60.0, 1)
    core, place = truth.band(SHAPE, 2.5)
    over_noise = np.where(core, np.where(np.abs(place - 8.0) < 6.0, 2.2, 9.0), 0.8)
    (ridge,) = found(over_noise)
    assert abs(ridge.along @ along) > math.cos(math.radians(1.5))
    assert abs((ridge.middle - truth.middle) @ truth.across) < 0.3
    # Its ends are less sharp: the mean along it takes 9 pixels, and what blur adds is taken off.
    assert abs((ridge.middle - truth.middle) @ along) < 2.0
    assert abs(ridge.length - (60.0 - 2.0 * 11.0 / STEP)) < 10.0


def test_discs_and_short_ridges_are_no_bars() -> None:
    row, column = np.indices(SHAPE)
    disc = np.hypot(row - 30.0, column - 30.0) < 9.0
    short = (np.abs(row - 60) <= 1) & (np.abs(column - 80) <= 8)
    assert not found(np.where(disc | short, 9.0, 0.8))


def test_a_patch_whose_mean_reaches_the_bound_at_one_place_is_no_bar() -> None:
    """A line was fitted to that place."""
    patch = np.zeros(SHAPE, dtype=bool)
    patch[40:42, 50:59] = True
    assert not found(np.where(patch, 5.2, 0.8))
