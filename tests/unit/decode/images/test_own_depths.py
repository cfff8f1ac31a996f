"""Doubt of a segment by the own depths of its pixels: where it begins, and what does not cause it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.images.own_depths import seen_elsewhere
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.objects.plain_behind import PlainPixels

SHAPE, STEP = (120, 160), 3


def _scene(noise: float = 0.01) -> tuple[PixelDepth, NDArray[np.int32], FloatArray]:
    """Two segments side by side at 2 and 3 per metre, and own depths with this relative noise."""
    label = np.where(np.arange(SHAPE[1]) < 80, 1, 2)[None] * np.ones(SHAPE, dtype=np.int32)
    vergence = np.where(label == 1, 2.0, 3.0)
    own = vergence * (1.0 + noise * np.random.default_rng(1).standard_normal(SHAPE))
    return PixelDepth(own, np.full(SHAPE, noise), np.ones(SHAPE, dtype=bool)), label.astype(np.int32), vergence


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_noise_raises_no_doubt(noise: float) -> None:
    assert seen_elsewhere(*_scene(noise), STEP).max() < 0.01


def test_a_part_that_is_seen_elsewhere_is_doubted_with_its_segment() -> None:
    pixels, label, vergence = _scene()
    own = pixels.vergence_per_m.copy()
    own[:, :30] *= 1.2  # three eighths of the first segment
    doubt = seen_elsewhere(replace(pixels, vergence_per_m=own), label, vergence, STEP)
    assert doubt[:, :25].min() == 1.0
    assert doubt[:, 30:80].min() > 0.9
    assert doubt[:, 80:].max() == 0.0


def test_depths_that_mix_along_an_outline_raise_no_doubt() -> None:
    pixels, label, vergence = _scene()
    own = pixels.vergence_per_m.copy()
    own[:, 74:86] = 2.5
    assert seen_elsewhere(replace(pixels, vergence_per_m=own), label, vergence, STEP).max() < 0.01


def test_pixels_without_a_depth_or_a_segment_do_not_count() -> None:
    pixels, label, vergence = _scene()
    own, claimed = pixels.vergence_per_m.copy(), pixels.claimed.copy()
    own[:, :30], claimed[:, :30] = 5.0, False
    assert seen_elsewhere(PixelDepth(own, pixels.relative_error, claimed), label, vergence, STEP).max() < 0.01
    label[:, :30] = 0
    assert seen_elsewhere(replace(pixels, vergence_per_m=own), label, vergence, STEP)[:, :15].max() == 0.0


def test_pixels_whose_sharp_images_show_no_texture_do_not_count() -> None:
    """Their own depth is that of what stands nearby, by its blur."""
    pixels, label, vergence = _scene()
    own, plain = pixels.vergence_per_m.copy(), np.zeros(SHAPE, dtype=bool)
    own[:, :30] *= 1.2
    plain[:, :30] = True
    light, lit = np.zeros((2, *SHAPE), dtype=np.float32), np.ones_like(plain)
    of_plain = PlainPixels(light, lit, plain, plain)
    own_depths = replace(pixels, vergence_per_m=own)
    assert seen_elsewhere(own_depths, label, vergence, STEP, lambda: of_plain).max() < 0.01
    # Texture that noise alone hides tells a depth.
    hidden = PlainPixels(light, lit, plain, np.zeros_like(plain))
    doubt = seen_elsewhere(own_depths, label, vergence, STEP, lambda: hidden)
    np.testing.assert_array_equal(doubt, seen_elsewhere(own_depths, label, vergence, STEP))


def test_few_pixels_raise_less_doubt_than_many() -> None:
    """Their windows overlap: as many pixels as one window has are one sample."""
    pixels, label, vergence = _scene()
    own, doubts = pixels.vergence_per_m.copy(), []
    own[::2, :80] *= 1.2  # every second row of the first segment: 0.5 of its pixels, as about each place
    for rows in (9, 120):
        claimed = pixels.claimed & (np.arange(SHAPE[0]) < rows)[:, None] & (np.arange(SHAPE[1]) < 10)
        doubt = seen_elsewhere(PixelDepth(own, pixels.relative_error, claimed), label, vergence, STEP)
        doubts.append(float(doubt[-1, 70]))  # of the segment, far from these pixels
    # Of 90 and of 1200 pixels, with 87 more of which 0.06 differ: 3 times 0.24 and 0.41 above those.
    np.testing.assert_allclose(doubts, [0.74, 1.0], atol=0.03)
