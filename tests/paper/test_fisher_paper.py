"""Fisher information of Shen 2023: "two orders of magnitude over a standard lens", and where that holds.

At equal aperture (2 mm, 800 nm) and equal electrons, known point source: the lens is blind at focus, where its PSF
changes only to second order, and there alone the helix is far ahead; over a range of depths the two are alike. For a
twin image of unknown texture the lens and the double helix tell nothing, and the conjugate single helix does.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.twin_images import most_likely_defocus, twin_images
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.information.psf_stacks import point_information, twin_depth_information
from metafab.information.texture import PointSource, Texture
from metafab.phase import DoubleHelixPhase, Pupil, compare_masks, optimise_peak, propose
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.pupil import FocalPlane, pupil_field, rim_defocus_per_dioptre_rad, rim_defocus_rad
from metafab.phase.studies.compare import reference_masks
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
        "double helix": pupil_field(DoubleHelixPhase(1.0, 0.35, 5), PUPIL, 1.0),
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


def test_the_edge_of_the_two_orders_of_magnitude() -> None:
    """Ratio of the information, spiral over lens: above 100 within 0.02 dioptre of focus, below 2 from 0.2 on."""
    away = np.array([0.005, 0.02, 0.03, 0.2, 0.5])
    bounds = compare_masks(
        reference_masks(PUPIL, 4, 0.5), PUPIL, 1.0 / (1.0 / FOCUS_M - away), focus_depth_m=FOCUS_M,
        aperture_um=2.0 * RADIUS_UM, wavelength_um=WAVELENGTH_UM, source=PointSource(), texture=Texture(),
    )  # fmt: skip
    ratio = (bounds.point_m[0] / bounds.point_m[1]) ** 2
    assert (np.diff(ratio) < 0.0).all()
    assert ratio[1] > 100.0 > ratio[2]
    assert ratio[3] < 2.0 and ratio[4] < 1.0
    # Near focus a lens' blur is of second order: its information grows with the square of the distance.
    assert ratio[0] / ratio[1] == pytest.approx(16.0, rel=0.02)


def test_only_the_conjugate_single_helix_tells_the_depth_of_an_unknown_texture(masks: dict[str, ComplexArray]) -> None:
    range_m = 1.0 / np.linspace(4.0, 1.0 / 0.6, 25)
    told = {
        name: twin_depth_information(_stack(field, range_m), range_m, PIXEL_UM, Texture()).mean()
        for name, field in masks.items()
    }
    assert told["lens"] < 1e-9 * told["single helix"]
    assert told["double helix"] < 1e-9 * told["single helix"]
    assert told["single helix"] > 1.2 * told["plain spiral"]


def test_five_centimetres_see_200_m_to_below_one_per_cent() -> None:
    """Supplementary 6 at the pupil level: the bound, and maximum likelihood on simulated twin images, 150 to 250 m.

    One piece of unknown texture of 96 x 96 Nyquist pixels, 3000 electrons a pixel, contrast 0.25.
    """
    best = propose(150.0, 250.0, aperture_um=5e4, wavelength_um=0.8)[0]
    assert (best.crlb_m / best.depth_m).max() < 0.01
    pupil, random = Pupil(48), np.random.default_rng(3)
    mask, problem = spiral_field(pupil, best.zones, best.exponent), BlindInformation(pupil, np.zeros(1), Texture())
    per_dioptre = rim_defocus_per_dioptre_rad(25_000.0, 0.8)
    ends = rim_defocus_rad([140.0, 270.0], best.focus_depth_m, 25_000.0, 0.8)
    errors = []
    for depth_m in (150.0, 200.0, 250.0):
        defocus = float(rim_defocus_rad(depth_m, best.focus_depth_m, 25_000.0, 0.8))
        for _ in range(8):
            images = twin_images(problem, mask, defocus, random)
            found = most_likely_defocus(images, problem, mask, float(ends[0]), float(ends[1]))
            errors.append(1.0 / (depth_m * (1.0 / best.focus_depth_m + found / per_dioptre)) - 1.0)
    assert np.abs(errors).max() < 0.01
    # The estimator reaches the bound: 24 draws know a standard deviation to 1 / sqrt(48) = 14 %, three times that.
    promised = np.sqrt(np.mean((best.crlb_m / best.depth_m) ** 2))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(promised, rel=0.45)


def test_without_a_helix_the_likelihood_does_not_know_the_depth() -> None:
    """Two equal images: only the blur is left as a witness, and it is the same on both sides of focus."""
    pupil, random = Pupil(32), np.random.default_rng(5)
    problem = BlindInformation(pupil, np.zeros(1), Texture(read_noise_e=0.0, electrons=1e5))
    spiral = spiral_field(pupil, 4, 0.5)
    lens = np.ones(pupil.count, dtype=complex)
    spread = {}
    for name, mask in (("spiral", spiral), ("lens", lens)):
        found = [
            most_likely_defocus(twin_images(problem, mask, 3.0, random), problem, mask, -10.0, 10.0) for _ in range(6)
        ]
        spread[name] = float(np.abs(np.array(found) - 3.0).max())
    assert spread["spiral"] < 0.02
    # The sign of a lens' defocus cannot be told: some draws come out at -3.
    assert spread["lens"] > 5.0
