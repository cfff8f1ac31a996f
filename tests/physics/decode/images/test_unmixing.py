"""Ghosts of a birefringent substrate in the frame, and their removal by the calibrated shares."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from metafab.camera import capture
from metafab.decode import decode
from metafab.decode.images.unmixing import Unmixing
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

DEPTHS_M = 1.0 / np.linspace(1 / 0.00245, 1 / 0.0035, 9)
SCENE = Scene(
    objects=(SceneObject(depth_m=0.0029, size=(0.15, 0.15), polarisation_contrast=2.5),), photons_per_pixel=2e4, seed=4
)


def ghosted(crossed: float) -> Psf:
    """The pair behind a wave plate that brings a share of each polarisation into the other image."""
    pair = helix_psf(DEPTHS_M)
    ghost = dataclasses.replace(pair, psf=crossed * pair.psf, efficiency=crossed * pair.efficiency)
    own = dataclasses.replace(pair, psf=(1.0 - crossed) * pair.psf, efficiency=(1.0 - crossed) * pair.efficiency)
    return dataclasses.replace(own, ghost=ghost)


def test_a_frame_holds_both_polarisations_in_each_image() -> None:
    """The sum of each image: own and crossed light of an object of contrast 2.5, relative to the pair's throughput."""
    quiet = dataclasses.replace(SCENE, read_noise_e=0.0)
    plain, mixed = (capture(quiet, psf).frame for psf in (helix_psf(DEPTHS_M), ghosted(0.2)))
    half = plain.shape[1] // 2
    x, y = plain[:, :half].sum(), plain[:, half:].sum()
    got = mixed[:, :half].sum(), mixed[:, half:].sum()
    np.testing.assert_allclose(got, (x + 0.25 * y, y + 0.25 * x), rtol=2e-3)


@pytest.mark.parametrize("crossed", [0.0, 0.2, 0.35, 0.9])
def test_contrast_and_depth_are_those_of_the_object(crossed: float) -> None:
    """At 0.9 each image shows mostly the other polarisation, and is decoded all the same."""
    psf = ghosted(crossed)
    image = decode(capture(SCENE, psf), psf)
    assert image.nmae == pytest.approx(0.0, abs=5e-3)
    assert image.figures.contrast_error < 0.02
    blind = dataclasses.replace(psf, ghost=None)
    if crossed == 0.2:
        assert decode(capture(SCENE, psf), blind).figures.contrast_error > 0.2


def test_images_that_hold_the_same_light_are_said_to() -> None:
    psf = ghosted(0.5)
    image = decode(capture(SCENE, psf), psf)
    assert image.figures.warning == Unmixing.WARNING
    assert image.nmae == pytest.approx(0.0, abs=5e-3)


def test_separation_inverts_the_mixture_and_carries_the_noise() -> None:
    share = np.broadcast_to(np.array([0.1, 0.3], dtype=np.float32)[:, None, None], (2, 3, 4))
    light = np.stack([np.full((3, 4), 700.0), np.full((3, 4), 200.0)]).astype(np.float32)
    mixed = np.stack([0.9 * light[0] + 0.1 * light[1], 0.3 * light[0] + 0.7 * light[1]]).astype(np.float32)
    gain = np.ones((2, 3, 4), dtype=np.float32)
    Unmixing(share).separate(mixed, gain)
    np.testing.assert_allclose(mixed, light, rtol=1e-5)
    np.testing.assert_allclose(gain[:, 0, 0], [(0.7**2 + 0.1**2) / 0.36, (0.9**2 + 0.3**2) / 0.36], rtol=1e-5)
