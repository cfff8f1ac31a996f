"""Probability of the right segment beside surfaces without a depth."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from metafab.decode.segmentation.fit import Misfit
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.regions import right_by_misfit, unknown_objects
from metafab.decode.segmentation.segments import Regions, SegmentDepth

SHAPE = (20, 40)
WALL = np.ones(SHAPE, dtype=np.int32)
#: A plain card at the left.
CARD = np.zeros(SHAPE, dtype=bool)
CARD[:, :10] = True


def regions_of(grown: np.ndarray, *, outline: bool = False) -> Regions:
    """A wall, and a card of segment 2 whose depth may be that of its outline."""
    depths = (SegmentDepth(2.0, 1e-3, 0.9, 1.0, Plane(2.0)), SegmentDepth(3.0, 1e-3, 0.9, 1.0, Plane(3.0)))
    card = SegmentDepth(3.0, 1e-3, 0.9, 1.0, Plane(3.0), of_outline=outline)
    return Regions(2, (depths[0], card), grown, grown, grown)


def test_a_plain_object_without_a_depth_of_its_own_is_unknown() -> None:
    prepared: Any = SimpleNamespace(plain_objects=CARD.astype(np.int32))
    assert (unknown_objects(prepared, regions_of(WALL)) == CARD).all()
    own = np.where(CARD, 2, 1).astype(np.int32)
    assert not unknown_objects(prepared, regions_of(own, outline=True)).any()


def test_pixels_beside_an_unknown_surface_are_doubted_as_beside_an_outline() -> None:
    fits = Misfit(np.ones(SHAPE, dtype=np.float32), np.zeros(SHAPE, dtype=np.float32), 1e-3)

    def right(unknown: np.ndarray) -> np.ndarray:
        return right_by_misfit(regions_of(WALL), fits.over_noise, fits, lambda number, error: fits, 3, unknown)[0]

    alone, beside = right(np.zeros(SHAPE, dtype=bool)), right(CARD)
    assert (alone > 0.99).all()
    # Even odds at the outline, nine in ten at 6 to 9 px.
    assert (beside[:, 10] < 0.6).all() and (beside[:, 12] < 0.9).all()
    assert (np.diff(beside[0, 10:]) > 0.0).all() and beside[0, -1] > 0.98
