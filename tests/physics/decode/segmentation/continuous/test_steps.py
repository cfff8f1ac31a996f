"""Pictures on many steps of depth, which no few layers explain: their depths, and no sureness where they are wrong."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from metafab.camera import RawFrame
from metafab.optics.point_spread import Psf
from tests.physics.decode.segmentation.continuous import pictures

NEAR_M, FAR_M, STEPS = 0.00252, 0.00345, 4


def frame_of(psf: Psf, seed: int) -> RawFrame:
    """A 1/k texture of which each quarter, by the light about a pixel, has a depth of its own."""
    light = pictures.texture(np.random.default_rng(seed))
    slow = gaussian_filter(light, 6.0, mode="wrap")
    step = np.digitize(slow, np.quantile(slow, np.arange(1, STEPS) / STEPS)) / (STEPS - 1.0)
    depth_m = 1.0 / (1.0 / FAR_M + (1.0 / NEAR_M - 1.0 / FAR_M) * step)
    return pictures.photographed(np.exp(0.5 * light), depth_m, psf)


@pytest.mark.parametrize("seed", [1, 2])
def test_steps_that_layers_do_not_explain_are_decoded_as_surfaces_and_doubted(seed: int) -> None:
    """By layers, whose interiors hold light of other depths, 47 and 28 % of the sure pixels were wrong."""
    psf = pictures.calibration()
    error, sure = pictures.judged(frame_of(psf, seed), psf)
    # Measured: 1.0 and 0.7 % of 20 and 31 % of the pixels are wrong, the mean error is 2.8 and 2.2 %.
    assert sure.mean() > 0.1 and (error[sure] > 0.05).mean() < 0.02
    assert np.nanmean(error) < 0.04 and np.isfinite(error).mean() > 0.6
