"""Saturated frames: the reason is named, errors hold, and segments of which most pixels are saturated have no depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.camera import capture
from metafab.decode import Image4D, decode
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

DEPTH_M, CONTRAST = 0.0029, 2.0
WALL = SceneObject(depth_m=DEPTH_M, size=(0.085, 0.080), polarisation_contrast=CONTRAST)
SCENE = Scene(objects=(WALL,), field_px=(96, 80), read_noise_e=2.0, seed=1)


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(np.linspace(0.0025, 0.0034, 7))


def decoded(psf: Psf, saturated: float, seed: int = 1) -> Image4D:
    """The 4D image of a wall whose brightest pixels, a share ``saturated`` of the frame, are clipped."""
    frame = capture(SCENE, psf, seed=seed)
    if saturated == 0.0:
        return decode(frame, psf)
    level = float(np.quantile(frame.frame, 1.0 - saturated))
    return decode(replace(frame, frame=np.minimum(frame.frame, level), saturation_e=level), psf)


@pytest.mark.parametrize("saturated", [0.06, 0.1])
def test_a_wall_of_which_most_pixels_are_saturated_has_no_depth_and_the_reason_is_named(
    psf: Psf, saturated: float
) -> None:
    image = decoded(psf, saturated)
    assert not np.isfinite(image.depth_m).any()
    assert not image.confidence.any()
    assert all(np.isinf(one.error_m) and np.isinf(one.contrast_error) for one in image.segments)
    assert "saturated" in str(image.figures.warning)
    assert "calibration" not in str(image.figures.warning)


@pytest.mark.parametrize("saturated", [0.01, 0.02, 0.03])
@pytest.mark.parametrize("seed", [1, 2])
def test_errors_of_a_partly_saturated_wall_hold(psf: Psf, saturated: float, seed: int) -> None:
    image = decoded(psf, saturated, seed)
    for one in image.segments:
        assert abs(one.depth_m - DEPTH_M) < 3.0 * one.error_m
        assert abs(one.contrast - CONTRAST) < 3.0 * one.contrast_error


def test_few_saturated_pixels_change_no_error(psf: Psf) -> None:
    """A few highlights spoil a quarter of the wall; its depth is measured on the other pixels."""
    few, whole = decoded(psf, 2e-5), decoded(psf, 0.0)
    assert 0 < (few.figures.pixels_broken or 0) < 100
    assert few.figures.warning is None
    assert few.segments[0].error_m == pytest.approx(whole.segments[0].error_m, rel=0.3)
    assert few.segments[0].contrast_error == pytest.approx(whole.segments[0].contrast_error, rel=0.02)
