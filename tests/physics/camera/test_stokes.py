"""Full-Stokes frames: the field stop and the sensor are those of the camera."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from metafab.camera.stokes import photograph
from metafab.optics.polarisation_states import StokesPsf
from metafab.spec import Scene, SceneObject
from tests.stokes_lens import perfect_psf, whole_lens


@pytest.fixture(scope="module")
def whole_psf() -> StokesPsf:
    """Of perfect pillars on the small lens' whole aperture."""
    return perfect_psf(whole_lens(), [0.0025, 0.0027, 0.0029, 0.0031, 0.0034], window_px=48)


def test_the_field_stop_passes_its_pixels_and_the_margin_their_blur(whole_psf: StokesPsf) -> None:
    """A surface beyond the field is cut at the stop, not at the frame: what it sends into the field is all there."""
    piece = SceneObject(depth_m=0.0029, size=(1.0, 1.0), texture="uniform")
    scene = Scene(objects=(piece,), field_px=(64, 80), photons_per_pixel=50000.0, read_noise_e=0.0)
    frame = photograph(scene, whole_psf)
    assert frame.images.shape == (6, 64 + 48, 80 + 48)
    assert np.isfinite(frame.depth_m).sum() == 64 * 80
    # All light of the field lands in the frame: the mean image of unpolarised light has gain 1.
    total = frame.images.sum() / 6.0
    assert total == pytest.approx(frame.stokes[0].sum(), rel=0.01)


def test_the_sensor_is_that_of_the_camera(whole_psf: StokesPsf) -> None:
    piece = SceneObject(depth_m=0.0029, size=(0.05, 0.05), texture="uniform")
    plain = Scene(objects=(piece,), field_px=(96, 96), photons_per_pixel=2000.0)
    full = dataclasses.replace(plain, full_well_e=1500.0, bit_depth=8, hot_pixels=0.01)
    images = photograph(full, whole_psf).images
    assert images.max() == 1500.0
    assert np.unique(images).size <= 256
    corner = images[:, :12, :12]
    assert 0 < (corner == 1500.0).sum() < 0.05 * corner.size
    lit = dataclasses.replace(plain, background=0.5)
    added = photograph(lit, whole_psf).images - photograph(plain, whole_psf).images
    middle, beside, beyond = (added[:, rows, 66:78].mean() for rows in (slice(69, 75), slice(26, 36), slice(4, 20)))
    # The piece of 31 pixels hides what is behind it, but for the halo of its blur; the stop cuts the background, too.
    assert middle < 300.0
    assert beside == pytest.approx(1000.0, rel=0.1)
    assert beyond == pytest.approx(0.0, abs=1.0)
