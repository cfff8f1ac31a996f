"""Plain dim ground about textured objects: the twins agree in the blur of outlines, far beyond these."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from metafab.camera import RawFrame
from metafab.optics.point_spread import Psf
from tests.physics.decode.segmentation.continuous import pictures


def frame_of(psf: Psf, seed: int) -> RawFrame:
    """Textured hills of a third of the picture before a ground without texture of a third of their light."""
    rng = np.random.default_rng(seed)
    texture = pictures.texture(rng)
    hills, slow = (gaussian_filter(rng.normal(size=pictures.SHAPE), px, mode="wrap") for px in (14.0, 50.0))
    near, rise = hills > np.quantile(hills, 2.0 / 3.0), slow / np.abs(slow).max()
    light = np.where(near, np.exp(0.5 * texture), 0.35)
    return pictures.photographed(light, 1.0 / np.where(near, 375.0 + 15.0 * rise, 315.0 + 20.0 * rise), psf)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ground_that_shows_the_blur_of_outlines_alone_is_not_sure(seed: int) -> None:
    psf = pictures.calibration()
    error, sure = pictures.judged(frame_of(psf, seed), psf)
    # Measured: of 21, 17 and 15 % of the pixels 3.9, 1.2 and 2.9 % are wrong. While no measure told the blur of an
    # outline from texture, it was 56, 48 and 63 % of 71, 62 and 78 %.
    assert sure.mean() > 0.1 and (error[sure] > 0.05).mean() < 0.06
