"""Polarisation and depth decoded from full-Stokes frames."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.camera.stokes import StokesFrame, photograph
from metafab.decode.stokes import StokesImage, decode_stokes, stokes_errors
from metafab.optics.polarisation_states import StokesPsf
from metafab.spec import Scene, SceneObject
from tests.stokes_lens import perfect_psf, quarter_lens, whole_lens


@pytest.fixture(scope="module")
def psf() -> StokesPsf:
    return perfect_psf(quarter_lens(), [0.0025, 0.0028, 0.0031, 0.0034], window_px=32)


def decoded(psf: StokesPsf, state: tuple[float, float, float]) -> tuple[StokesFrame, StokesImage]:
    piece = SceneObject(depth_m=0.0029, size=(0.14, 0.14), stokes=state)
    frame = photograph(Scene(objects=(piece,), field_px=(112, 112), photons_per_pixel=20000.0), psf)
    return frame, decode_stokes(frame, psf)


@pytest.mark.parametrize("state", [(0.0, 0.0, 0.0), (0.6, -0.3, 0.0), (0.0, 0.2, -0.8)])
def test_polarisation_and_depth_of_a_surface_are_found(psf: StokesPsf, state: tuple[float, float, float]) -> None:
    frame, image = decoded(psf, state)
    middle = (slice(None), *(slice(n // 2 - 16, n // 2 + 16) for n in frame.depth_m.shape))
    total = image.stokes[middle].sum(axis=(1, 2))
    # 1024 pixels of some 20000 electrons in each of six images: noise is below a thousandth.
    assert total[1:] / total[0] == pytest.approx(state, abs=0.005)
    assert total[0] == pytest.approx(frame.stokes[middle].sum(axis=(1, 2))[0], rel=0.02)
    depth_m = np.nanmedian(image.depth_m[middle[1:]])
    # A quarter of the aperture turns its lobe by a sixteenth of the angle.
    assert depth_m == pytest.approx(0.0029, rel=0.03)


def test_objects_side_by_side_keep_their_depths_and_outlines() -> None:
    """No ramp of depths between two objects that touch, nothing around them, and each at its own depth."""
    whole_psf = perfect_psf(whole_lens(), [0.0025, 0.0027, 0.0029, 0.0031, 0.0034], window_px=48)
    near, far = (
        SceneObject(depth_m=z, centre=(x, 0.0), size=(0.12, 0.16), stokes=(0.3, s, 0.0))
        for z, x, s in ((0.00265, -0.06, 0.5), (0.0032, 0.06, -0.5))
    )
    scene = Scene(objects=(near, far), field_px=(112, 144), photons_per_pixel=20000.0)
    frame = photograph(scene, whole_psf)
    image = decode_stokes(frame, whole_psf)
    found = np.unique(image.depth_m[np.isfinite(image.depth_m)])
    assert found.size == 2
    assert found == pytest.approx([0.00265, 0.0032], rel=0.01)
    known, true = np.isfinite(image.depth_m), np.isfinite(frame.depth_m)
    # Along outlines of 72 by 100 pixels each, a pixel is some 5 %.
    assert (known & ~true).sum() < 0.05 * true.sum()
    assert (known & true).sum() > 0.98 * true.sum()
    # Half a window on either side of the edge that they share is a quarter of each: most of it is told apart, too.
    assert np.mean(np.abs(image.depth_m[known & true] / frame.depth_m[known & true] - 1.0) > 0.1) < 0.14
    errors = stokes_errors(image, frame)
    # Along outlines cross-talk is that of the wrong depth. No dark seam parts surfaces that touch, so the neighbour's
    # blur still counts 6 pixels inside, where this is judged: 0.0115; 12 pixels inside it is 0.004.
    assert errors.stokes_interior_error < 0.015
    assert errors.stokes_object_error < 0.03


def test_without_light_no_depth_is_claimed(psf: StokesPsf) -> None:
    dark = SceneObject(depth_m=0.0029, size=(1e-6, 1e-6))
    frame = photograph(Scene(objects=(dark,), field_px=(64, 64)), psf)
    image = decode_stokes(frame, psf)
    assert np.isnan(image.depth_m).mean() > 0.9
