"""Bounds of several masks at the level of the pupil against those of sampled PSF stacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metafab.information.fisher import depth_crlb_m, point_information, twin_depth_information
from metafab.information.texture import PointSource, Texture
from metafab.phase import Pupil, compare_masks
from metafab.phase.pupil import rim_defocus_rad
from metafab.phase.studies.compare import reference_masks

PUPIL = Pupil(32)
DEPTH_M = 1.0 / np.linspace(4.0, 3.0, 13)
SETTING = {"focus_depth_m": 0.28, "aperture_um": 2000.0, "wavelength_um": 0.8}
NOISE = {"source": PointSource(), "texture": Texture()}


def test_bounds_at_the_pupil_are_those_of_a_sampled_stack() -> None:
    """The same masks through the matrix Fourier transform, splined over depth: another code from mask to bound."""
    masks = reference_masks(PUPIL, 4, 0.5)
    bounds = compare_masks(masks, PUPIL, DEPTH_M, **SETTING, **NOISE)  # type: ignore[arg-type]
    assert bounds.masks == ("standard lens", "plain spiral", "double helix")
    # Nyquist steps of pi / 2 in a window of 64, as the pupil's own transform has them; sums of PSFs are 1.
    axis = (np.arange(64) - 32) * np.pi / 2.0
    defocus = rim_defocus_rad(DEPTH_M, 0.28, 1000.0, 0.8)
    for row, field in enumerate(masks.values()):
        stack = np.empty((2, DEPTH_M.size, 64, 64))
        kernel = np.exp(-1j * np.outer(axis, PUPIL.axis))
        for polarisation in (0, 1):
            for column, w in enumerate(defocus):
                grid = np.zeros((32, 32), dtype=complex)
                grid[PUPIL.inside] = field[polarisation] * np.exp(1j * w * PUPIL.radius_squared)
                amplitude = kernel @ grid @ kernel.T
                stack[polarisation, column] = np.abs(amplitude) ** 2 / (64**2 * PUPIL.count)
        point = depth_crlb_m(point_information(stack, DEPTH_M, 1.0, PointSource()))
        inner = slice(2, -2)  # splines are weak at their ends
        if row:  # at focus the lens has next to nothing, which a spline cannot follow
            np.testing.assert_allclose(bounds.point_m[row, inner], point[inner], rtol=5e-3)
        if np.isfinite(bounds.texture_m[row]).all():
            texture = depth_crlb_m(twin_depth_information(stack, DEPTH_M, 1.0, Texture()))
            np.testing.assert_allclose(bounds.texture_m[row, inner], texture[inner], rtol=5e-3)


def test_only_the_single_helix_has_information_about_unknown_texture() -> None:
    bounds = compare_masks(reference_masks(PUPIL, 4, 0.5), PUPIL, DEPTH_M, **SETTING, **NOISE)  # type: ignore[arg-type]
    readable = np.isfinite(bounds.texture_m)
    assert readable[1].all() and not readable[0].any() and not readable[2].any()
    assert np.isfinite(bounds.point_m[1:]).all()


def test_bounds_fall_with_light_and_grow_with_noise() -> None:
    def bound(**change: float) -> np.ndarray:
        source, texture = replace(PointSource(), **change), replace(Texture(), **change)
        masks = {"spiral": reference_masks(PUPIL, 4, 0.5)["plain spiral"]}
        bounds = compare_masks(masks, PUPIL, DEPTH_M[:3], **SETTING, source=source, texture=texture)
        return np.stack([bounds.point_m, bounds.texture_m])

    assert (bound(electrons=1e5) < bound(electrons=1e4)).all()
    assert (bound(read_noise_e=20.0) > bound(read_noise_e=2.0)).all()
    # Without any other noise, photons alone: a hundred times the light, a tenth of the deviation.
    dark = {"background_e": 0.0, "read_noise_e": 0.0}
    ratio = bound(electrons=1e6, **dark)[0] / bound(electrons=1e4, **dark)[0]
    np.testing.assert_allclose(ratio, 0.1, rtol=1e-9)


def test_pixels_without_light_and_noise_do_no_harm() -> None:
    """A clear aperture of Nyquist samples has exact zeros; without any noise they are 0 / 0."""
    quiet = {
        "source": PointSource(electrons=100.0, background_e=0.0, read_noise_e=0.0),
        "texture": Texture(read_noise_e=0.0),
    }
    bounds = compare_masks(reference_masks(PUPIL, 4, 0.5), PUPIL, DEPTH_M, **SETTING, **quiet)  # type: ignore[arg-type]
    assert not np.isnan(bounds.point_m).any()
