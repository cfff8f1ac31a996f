"""Outlines between segments of unlike contrast stand where the contrast changes; all others stay."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from metafab.decode.images.contrast_outlines import moved_outlines
from metafab.decode.images.deconvolution import SharpImages
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import Regions, SegmentDepth

STEP, SHAPE = 4, (40, 60)
EDGE = 30
LIT = np.ones((SHAPE[0] * STEP, SHAPE[1] * STEP), dtype=bool)


def regions(label: NDArray[np.int32], right: float | None = 0.8) -> Regions:
    count = int(label.max())
    depths = tuple(SegmentDepth(2.0 + k, 1e-3, 0.9, 1.0, Plane(2.0 + k)) for k in range(count))
    column = np.indices(SHAPE)[1]
    inside = np.where(np.abs(column - EDGE) > 8, label, 0).astype(np.int32)
    sure = None if right is None else np.full(SHAPE, right)
    return Regions(count, depths, label, inside, label, sure)


def scalloped() -> NDArray[np.int32]:
    """Segment 2 reaches up to 4 downsampled pixels into segment 1, whose outline is straight."""
    row, column = np.indices(SHAPE)
    return np.where(column >= EDGE - 2 + np.round(2.0 * np.cos(row / 3.0)), 2, 1).astype(np.int32)


def sharp(contrast: float, seed: int = 1) -> SharpImages:
    """Images of 3000 electrons a pixel; the right part has another contrast, and both vary by a fifth."""
    rng = np.random.default_rng(seed)
    column = np.indices((SHAPE[0] * STEP, SHAPE[1] * STEP))[1]
    light = 3000.0 * (1.0 + 0.2 * rng.normal(size=column.shape))
    ratio = np.where(column >= EDGE * STEP - STEP // 2, contrast, 1.0)
    images = np.stack([light * 2.0 * ratio / (1.0 + ratio), light * 2.0 / (1.0 + ratio)])
    images += np.sqrt(3.0 * 3000.0) * rng.normal(size=images.shape)
    return SharpImages(images.astype(np.float32), np.full(images.shape, 3.0, dtype=np.float32))


def straight() -> NDArray[np.bool_]:
    return np.asarray(np.indices(SHAPE)[1] >= EDGE)


@pytest.mark.parametrize("contrast", [0.6, 1.3, 2.5])
def test_an_outline_moves_to_where_the_contrast_changes(contrast: float) -> None:
    before = regions(scalloped())
    after = moved_outlines(before, sharp(contrast), STEP, LIT)
    wrong = [int(((one.grown == 2) != straight()).sum()) for one in (before, after)]
    assert wrong[0] > 60
    # A window of 7 pixels across the edge holds both: the pixels next to it may go either way.
    assert wrong[1] < 20
    np.testing.assert_array_equal(after.label, after.grown)
    moved = after.grown != before.grown
    assert not after.interior[moved].any()
    assert after.right is not None
    assert (after.right[moved] > 0.8).all()
    # What the contrast confirms is surer than before, and what it says nothing of is as sure.
    assert after.right[:, EDGE + 1].min() > 0.9
    assert (after.right[:, :10] == 0.8).all()


def test_equal_contrasts_and_a_fast_segmentation_change_nothing() -> None:
    before = regions(scalloped())
    assert moved_outlines(before, sharp(1.0), STEP, LIT) is before
    unjudged = regions(scalloped(), right=None)
    assert moved_outlines(unjudged, sharp(2.5), STEP, LIT) is unjudged
    alone = regions(np.ones(SHAPE, dtype=np.int32))
    assert moved_outlines(alone, sharp(2.5), STEP, LIT) is alone


def test_only_asked_pixels_move() -> None:
    before, upper = regions(scalloped()), np.indices(SHAPE)[0] < 20
    after = moved_outlines(before, sharp(2.5), STEP, LIT, upper)
    np.testing.assert_array_equal(after.grown[20:], before.grown[20:])
    assert (after.grown[:20] != before.grown[:20]).any()


def test_no_island_of_another_segment_is_made() -> None:
    """A spot of the other contrast within the reach, but not connected with its segment, stays."""
    images = sharp(2.5)
    images.images[:, 60:76, 60:76] = images.images[:, 60:76, 200:216]
    after = moved_outlines(regions(scalloped()), images, STEP, LIT)
    assert (after.grown[15:19, 15:19] == 1).all()


def test_a_sliver_that_is_cut_off_goes_with_the_pixels_that_cut_it_off() -> None:
    """Segment 1 lies over the outermost columns of segment 2; of these, windows on the rim mix both contrasts."""
    column = np.indices(SHAPE)[1]
    label = np.where((column >= EDGE) & (column < EDGE + 5), 1, scalloped())
    label[:, EDGE - 4 : EDGE] = 1
    images, dark = sharp(2.5), (EDGE - 2) * STEP
    images.images[:, :, EDGE * STEP - 2 : (EDGE + 1) * STEP] = images.images[:, :, 8 : 10 + STEP]
    lit = LIT.copy()
    lit[:, dark - 2 * STEP : dark + STEP] = False
    before = regions(label.astype(np.int32))
    after = moved_outlines(before, images, STEP, lit)
    in_gap_lit = moved_outlines(before, images, STEP, LIT)
    assert (before.grown[:, EDGE : EDGE + 5] == 1).all()
    assert (after.grown[:, EDGE : EDGE + 5] == 2).all()
    # While light joins them with their segment, they stay.
    assert (in_gap_lit.grown[:, EDGE] == 1).all()
    assert (after.grown[:, : EDGE - 4] == 1).all()
    assert after.right is not None
    assert after.right[:, EDGE].max() < 0.5


def test_a_pixel_goes_to_the_surface_that_fills_most_of_it_whatever_the_spreads_of_their_contrasts() -> None:
    images, rng = sharp(2.5), np.random.default_rng(2)
    first = EDGE * STEP - STEP // 2
    images.images[:, :, first] = images.images[:, :, first - 1]
    images.images[0, :, : first + 1] *= np.exp(0.1 * rng.normal(size=(SHAPE[0], 1))).repeat(STEP, 0)
    after = moved_outlines(regions(scalloped()), images, STEP, LIT)
    assert (after.grown[:, EDGE] == 2).mean() > 0.9
