"""Light of pixels at the edge of a plain surface: what tells the surface from the object, and what does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.segmentation.objects.plain_edges import light_odds

SHAPE, STEP, LEVEL, NOISE = (60, 120), 3, 1000.0, 20.0
COLUMN = np.broadcast_to(np.arange(SHAPE[1]), SHAPE)
#: An object, a strip along it that is a segment of its own, and a segment far from both; the surface between them.
OBJECT, STRIP, ALONE = COLUMN < 40, (COLUMN >= 40) & (COLUMN < 45), COLUMN >= 115
LABEL = np.select([OBJECT, STRIP, ALONE], [1, 2, 3]).astype(np.int32)
SURFACE = (COLUMN >= 45) & (COLUMN < 115)


def odds(texture: float, asked: NDArray[np.bool_], inside: NDArray[np.bool_]) -> FloatArray:
    """Odds by a plain surface, before which an object of its mean light has some texture."""
    rng = np.random.default_rng(1)
    light = LEVEL + NOISE * rng.standard_normal((2, *SHAPE))
    light += np.where(inside, texture * LEVEL * rng.standard_normal(SHAPE), 0.0)
    return light_odds(light.astype(np.float32), SURFACE, LABEL, inside, asked, STEP)


def test_a_pixel_with_the_light_of_the_surface_is_more_likely_the_surfaces() -> None:
    inside = COLUMN < 36
    own, edge = (odds(0.3, asked, inside) for asked in (inside, OBJECT & ~inside))
    # The edge has no texture here: the density there falls with the spread of the object's light, ln(300 / 20) = 2.7.
    assert np.median(own) > 10.0 and (own > 0.0).mean() > 0.9
    assert -5.0 < np.median(edge) < -1.5 and (edge < 0.0).mean() > 0.95


def test_faint_texture_and_the_light_of_the_surface_tell_nothing() -> None:
    assert np.abs(np.median(odds(0.0, OBJECT & (COLUMN >= 36), COLUMN < 36))) < 0.3


def test_a_strip_beside_an_object_is_the_surfaces_and_a_segment_by_itself_is_not_told() -> None:
    inside = COLUMN < 36
    assert (odds(0.3, STRIP, inside) < 0.0).mean() > 0.95
    np.testing.assert_array_equal(odds(0.3, ALONE, inside), 0.0)
