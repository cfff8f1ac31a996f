"""Frames of the exact camera, over a field and a filter's band, decoded with the calibration alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.camera import capture, exact_psf
from metafab.decode import decode
from metafab.optics import PsfNumerics, depth_nodes, psf
from metafab.spec import Scene, SceneObject
from tests.optics_lens import eq_2, eq_3_and_4, ideal, imaging

DEPTH_M = 0.00309
FIELD_PX = 128
FILTER_FWHM_NM = 10.0


@pytest.mark.slow
def test_depth_over_field_and_band_by_the_calibration_alone() -> None:
    """A textured plane over +-5.9 degrees in a filter of 10 nm, through pairs that the decoder never saw.

    The camera's pairs stand at the plane's own depth, at 8 x 4 directions or more and on windows of 64 pixels; the
    calibration has 6 depths around it, 5 x 3 directions, 48 pixels. The texture's own noise leaves 0.1 % (1.6e4 pixels,
    1e4 electrons); the rest of 0.3 % is what the calibration may cost. One pair for the whole field costs more.
    """
    lens = imaging(aperture_um=200.0, focal_length_mm=1.0, pixel_um=2.4)
    source = ideal(lens, eq_2(lens, 4), eq_3_and_4(lens))
    half = 0.5 * FIELD_PX * lens.pixel_um / lens.sensor_distance_um
    plane = SceneObject(depth_m=DEPTH_M, size=(3.0 * half, 3.0 * half), texture_contrast=0.3)
    scene = Scene(objects=(plane,), field_px=(FIELD_PX, FIELD_PX), photons_per_pixel=1e4, read_noise_e=2.0)
    reach = 1.02 * half * np.linspace(-1.0, 1.0, 5)
    depths_m = depth_nodes(lens, 0.83 * 0.003, 1.18 * 0.003, 1e-2)
    assert not np.isclose(depths_m, DEPTH_M, rtol=5e-3).any()
    one_wavelength = PsfNumerics(window_px=48, target_error=3e-3)
    numerics = replace(one_wavelength, filter_fwhm_nm=FILTER_FWHM_NM)
    calibration = psf(source, lens, depths_m, numerics, field_tangents=(reach, reach[::2]))
    exact = exact_psf(scene, source, lens, PsfNumerics(window_px=64, target_error=1e-2, filter_fwhm_nm=FILTER_FWHM_NM))
    one_pair = psf(source, lens, depths_m, one_wavelength)
    errors, naive = [], []
    for seed in (1, 2, 3):
        frame = capture(scene, exact, seed=seed)
        image = decode(frame, calibration)
        assert image.figures.warning is None
        assert image.figures.share_decoded > 0.99
        errors.append(image.nmae)
        naive.append(decode(frame, one_pair).nmae)
    assert np.mean(errors) < 0.003
    assert np.mean(naive) > 0.006
