"""The bound of unknown texture against maximum likelihood on simulated twin images."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.mask.twin_images import most_likely_defocus, twin_images
from metafab.information.texture import Texture
from metafab.phase import Pupil, propose
from metafab.phase.optimise.blind import BlindInformation
from metafab.phase.pupil import rim_defocus_per_dioptre_rad, rim_defocus_rad
from metafab.phase.terms.helices import spiral_field


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
            estimate = most_likely_defocus(images, problem, mask, float(ends[0]), float(ends[1]))
            errors.append(1.0 / (depth_m * (1.0 / best.focus_depth_m + estimate / per_dioptre)) - 1.0)
    assert np.abs(errors).max() < 0.01
    # The estimator reaches the bound: 24 draws give a standard deviation to 1 / sqrt(48) = 14 %, three times that.
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
        estimate = [
            most_likely_defocus(twin_images(problem, mask, 3.0, random), problem, mask, -10.0, 10.0) for _ in range(6)
        ]
        spread[name] = float(np.abs(np.array(estimate) - 3.0).max())
    assert spread["spiral"] < 0.02
    # The sign of a lens' defocus is ambiguous: some draws come out at -3.
    assert spread["lens"] > 5.0
