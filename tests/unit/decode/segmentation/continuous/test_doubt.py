"""Probability of a right depth: falls with misfit, towards outlines, in dim places, and where another costs no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metafab.decode.segmentation.continuous.doubt import right_depth
from metafab.decode.segmentation.continuous.surface import Surface

SHAPE = (40, 60)
COLUMN = np.broadcast_to(np.arange(60), SHAPE)


def surface(near_per_m: float) -> Surface:
    """Two sides of an outline between columns 29 and 30, one of 2 / m, that the twins fit to their noise."""
    none, ones = np.zeros(SHAPE, dtype=np.float32), np.ones(SHAPE, dtype=np.float32)
    return Surface(np.where(COLUMN < 30, near_per_m, 2.0), none, none, 10.0 * ones, none, none, 0.9 * ones, 0.8)


def test_pixels_near_an_outline_are_doubted() -> None:
    right = right_depth(surface(3.0), 3)
    assert (np.diff(right[0, :30]) <= 0.0).all() and (np.diff(right[0, 30:]) >= 0.0).all()
    assert right[0, 29] < 0.85 and right[0, 5] > 0.95  # measured: 0.70 and 0.99
    # Frame pixels count: an outline is as near to the same pixels sampled more densely.
    np.testing.assert_allclose(right_depth(surface(3.0), 1)[0, 30:60:3], right[0, 30:40], atol=0.02)


def test_an_outline_between_depths_that_are_one_within_5_percent_raises_no_doubt() -> None:
    right = right_depth(surface(2.08), 3)
    assert np.ptp(right) == 0.0 and right[0, 0] > 0.95


def test_misfit_and_another_depth_of_equal_cost_raise_doubt() -> None:
    seen = surface(2.0)
    clear = right_depth(seen, 3)
    for doubtful in (
        replace(seen, misfit=seen.misfit + 1.0),
        replace(seen, best_misfit=seen.best_misfit + 1.0),
        replace(seen, margin=0.0 * seen.margin),
        replace(seen, dimness=seen.dimness - 1.0),
        replace(seen, coherence=seen.coherence - 0.5),
        replace(seen, frame_coherence=0.5),
    ):
        assert (right_depth(doubtful, 3) < clear).all()
    hopeless = replace(seen, misfit=seen.misfit + 3.0, best_misfit=seen.best_misfit + 3.0, margin=0.0 * seen.margin)
    assert (right_depth(hopeless, 3) < 0.25).all()


def test_no_plain_pixel_is_sure() -> None:
    seen = surface(2.0)
    faintness = np.where(COLUMN < 10, np.float32(0.6), np.float32(0.0))
    right = right_depth(replace(seen, faintness=faintness), 3)
    assert (right[:, :10] < 0.9).all() and (right[:, 10:] > 0.9).all()
    hopeless = replace(seen, misfit=seen.misfit + 5.0)
    assert (right_depth(replace(hopeless, faintness=faintness), 3) <= right_depth(hopeless, 3)).all()
