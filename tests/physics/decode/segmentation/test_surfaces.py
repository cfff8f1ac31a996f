"""Small tilted objects are planes, and small flat ones that touch are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.camera import capture
from metafab.decode import Image4D, decode
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

POSTER = SceneObject(depth_m=0.0032, centre=(0.0, 0.03), size=(0.19, 0.13), texture_contrast=0.4)
#: 94 x 47 pixels, 4 % deeper at one end: three cells of 36 pixels, and RANSAC asks for ten.
SHEET = SceneObject(
    depth_m=0.0027,
    centre=(0.01, -0.075),
    size=(0.15, 0.075),
    tilt=(0.04, 0.0),
    polarisation_contrast=2.5,
    texture_contrast=0.3,
)


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(1.0 / np.linspace(1 / 0.00245, 1 / 0.0035, 9))


def decoded(psf: Psf, seed: int, *objects: SceneObject) -> Image4D:
    return decode(capture(Scene(objects=objects, field_px=(160, 128), seed=seed), psf), psf)


def test_a_small_tilted_sheet_is_a_plane(psf: Psf) -> None:
    """Two flat steps would err by 0.5 % in the mean, and by half a step, 1 %, where they meet and end."""
    change = 0.04 / 0.0027 / (0.15 * psf.sensor_distance_um / psf.pixel_um)
    images = [decoded(psf, seed, POSTER, SHEET) for seed in (1, 2, 3)]
    sheets = [
        max((one for one in image.segments if one.depth_m < 0.0029), key=lambda one: one.pixels) for image in images
    ]
    assert all(np.hypot(one.slope_x_per_m, one.slope_y_per_m) > 0.0 for one in sheets)
    slopes = [one.slope_x_per_m for one in sheets]
    assert np.mean(slopes) == pytest.approx(change, rel=0.1)


def test_two_small_flat_objects_that_touch_stay_flat(psf: Psf) -> None:
    near, far = (
        replace(SHEET, depth_m=0.0027 * (1.0 + rise), tilt=(0.0, 0.0), size=(0.075, 0.096), centre=(middle, -0.045))
        for rise, middle in ((-0.02, -0.0375), (0.02, 0.0375))
    )
    image = decoded(psf, 1, POSTER, near, far)
    assert all(one.slope_x_per_m == 0.0 and one.slope_y_per_m == 0.0 for one in image.segments)
    assert len(image.segments) == 3
