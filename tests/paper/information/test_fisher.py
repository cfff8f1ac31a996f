"""Fisher information of Shen 2023: "two orders of magnitude over a standard lens", and where that holds.

At equal aperture (2 mm, 800 nm) and equal electrons, known point source: at focus the PSF of a lens changes only to
second order, and there alone the helix is far ahead; over a range of depths the two are alike. For twin images of
unknown texture the lens and the double helix have no information, and the conjugate single helix has.
"""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.information.fisher import point_information, twin_depth_information
from metafab.information.texture import PointSource, Texture
from metafab.phase import DoubleHelixPhase, Pupil, optimise_peak
from metafab.phase.pupil import FocalPlane, pupil_field, rim_defocus_rad
from metafab.phase.terms.helices import spiral_field

FOCUS_M, RADIUS_UM, WAVELENGTH_UM, IMAGE_UM = 0.30, 1000.0, 0.8, 21429.0
PUPIL = Pupil(64)
STEP = 0.75  # optical units, half of the intensity's Nyquist step
PIXEL_UM = STEP * WAVELENGTH_UM * IMAGE_UM / (2.0 * np.pi * RADIUS_UM)


def _stack(field: ComplexArray, depth_m: FloatArray) -> FloatArray:
    """Conjugate pair, shape (2, n_depth, n, n), 1/um^2 per unit power."""
    plane = FocalPlane(PUPIL, 30.0, STEP)
    psf = plane.psf(field, rim_defocus_rad(depth_m, FOCUS_M, RADIUS_UM, WAVELENGTH_UM))
    # Peak of a clear aperture: area / (lambda s')^2 per unit power.
    psf *= np.pi * RADIUS_UM**2 / (WAVELENGTH_UM * IMAGE_UM) ** 2
    return np.stack([psf, psf[:, ::-1, ::-1]])


@pytest.fixture(scope="module")
def masks() -> dict[str, ComplexArray]:
    return {
        "lens": np.ones(PUPIL.count, dtype=complex),
        "single helix": pupil_field(optimise_peak(4, pupil=PUPIL).term(1.0), PUPIL, 1.0),
        "plain spiral": spiral_field(PUPIL, 4, 0.5),
        "double helix": pupil_field(DoubleHelixPhase(radius_um=1.0, waist=0.35, modes=5), PUPIL, 1.0),
    }


def test_two_orders_of_magnitude_hold_at_focus_only(masks: dict[str, ComplexArray]) -> None:
    # Away from focus by 0.01 dioptre; a dense stack so that the spline follows the lens' even blur.
    near_focus_m = 1.0 / (1.0 / FOCUS_M - np.linspace(-0.05, 0.05, 21))
    at = 12  # +0.01 dioptre
    ratio = {
        name: point_information(_stack(field, near_focus_m), near_focus_m, PIXEL_UM, PointSource())[at]
        for name, field in masks.items()
    }
    assert ratio["plain spiral"] > 100.0 * ratio["lens"]
    range_m = 1.0 / np.linspace(4.0, 1.0 / 0.6, 25)
    mean = {
        name: point_information(_stack(field, range_m), range_m, PIXEL_UM, PointSource()).mean()
        for name, field in masks.items()
    }
    assert 0.3 < mean["plain spiral"] / mean["lens"] < 3.0


def test_only_the_conjugate_single_helix_has_depth_information_for_unknown_texture(
    masks: dict[str, ComplexArray],
) -> None:
    range_m = 1.0 / np.linspace(4.0, 1.0 / 0.6, 25)
    information = {
        name: twin_depth_information(_stack(field, range_m), range_m, PIXEL_UM, Texture()).mean()
        for name, field in masks.items()
    }
    assert information["lens"] < 1e-9 * information["single helix"]
    assert information["double helix"] < 1e-9 * information["single helix"]
    assert information["single helix"] > 1.2 * information["plain spiral"]
