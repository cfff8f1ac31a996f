"""Contrast of pixels and the light of segments, against plain NumPy."""

from __future__ import annotations

import numpy as np

from metafab.decode.images.contrast import SegmentLight, contrast_with_error


def test_ratios_and_light_are_those_of_plain_sums() -> None:
    rng = np.random.default_rng(5)
    images = rng.normal(20.0, 15.0, (2, 33, 41)).astype(np.float32)
    gain, about = rng.random((2, 2, 33, 41)).astype(np.float32)
    lit = rng.random((33, 41)) < 0.7
    variance = gain * (30.0 * about + np.float32(4.0))
    x, y = images
    known = lit & (y > 0.0)
    ratio = np.divide(x, y, out=np.full(lit.shape, np.nan), where=known)
    error = np.divide(np.sqrt(variance[0] + ratio**2 * variance[1]), y, out=np.full(lit.shape, np.nan), where=known)
    for got, want in zip(contrast_with_error(images, variance, lit), (ratio, error), strict=True):
        np.testing.assert_allclose(got, want, rtol=2e-6)
    segment, inner = rng.integers(0, 4, (2, 33, 41), dtype=np.int32)
    light = SegmentLight.of(images, segment, inner, 5)
    within = (inner * (segment > 0)).ravel()
    np.testing.assert_array_equal(light.pixels, np.bincount(segment.ravel(), minlength=6)[1:])
    np.testing.assert_array_equal(light.inner, np.bincount(within, minlength=6)[1:])
    np.testing.assert_allclose(
        light.light_e, [np.bincount(within, image.ravel(), 6)[1:] for image in images], rtol=1e-9
    )
