"""The exact pair of a scene: its own depths, its own field, and a frame that shows what optics says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from metafab.camera import PairKernels, capture, exact_psf
from metafab.core.errors import InputError
from metafab.optics import Imaging, Psf, PsfNumerics, relative_l2
from metafab.optics import psf as pair_of
from metafab.optics.sources.source import IdealField
from metafab.spec import Scene, SceneObject
from tests.optics_lens import eq_2, eq_3_and_4, ideal, imaging

FIELD_PX = (24, 24)
TARGET = 0.01
DEPTHS_M = (0.00085, 0.00095)


@pytest.fixture(scope="module")
def lens() -> tuple[Imaging, IdealField]:
    optics = imaging(pixel_um=1.5)
    return optics, ideal(optics, eq_2(optics), eq_3_and_4(optics))


@pytest.fixture(scope="module")
def scene() -> Scene:
    tilted = SceneObject(depth_m=DEPTHS_M[0], centre=(-0.01, 0.0), size=(0.01, 0.03), tilt=(0.008, 0.0))
    flat = SceneObject(depth_m=DEPTHS_M[1], centre=(0.02, 0.01), size=(0.0013, 0.0013), texture="uniform")
    return Scene(objects=(tilted, flat), field_px=FIELD_PX, photons_per_pixel=1e9, read_noise_e=0.0)


@pytest.fixture(scope="module")
def exact(lens: tuple[Imaging, IdealField], scene: Scene) -> Psf:
    return exact_psf(scene, lens[1], lens[0], PsfNumerics(window_px=32, target_error=TARGET))


def test_every_step_of_the_scene_has_its_own_depth(exact: Psf) -> None:
    assert exact.depth_m == pytest.approx([DEPTHS_M[0] * 0.998, DEPTHS_M[0] * 1.002, DEPTHS_M[1]], rel=1e-12)


def test_pairs_between_its_field_points_are_the_computed_ones(lens: tuple[Imaging, IdealField], exact: Psf) -> None:
    """In a direction that no refinement looked at."""
    direction = (0.0113, -0.0071)
    computed = pair_of(lens[1], lens[0], [DEPTHS_M[1]], PsfNumerics(window_px=32, target_error=1e-3), tangent=direction)
    kernels = PairKernels(exact)
    weights = kernels.field_weights(np.array(direction[0]), np.array(direction[1]))
    got = np.einsum("pyxij,yx->pij", kernels.at_depth(DEPTHS_M[1]), weights)
    own = PairKernels(computed).at_depth(DEPTHS_M[1])[:, 0, 0]
    for polarisation in (0, 1):
        a, b = got[polarisation] / got[polarisation].sum(), own[polarisation] / own[polarisation].sum()
        # Blocks and the field each keep to the target.
        assert relative_l2(a, b) < 2.0 * TARGET
    assert 0.0 < exact.details.field_interpolation_error <= TARGET


def test_a_dot_shows_the_psf_of_its_own_depth_and_direction(
    lens: tuple[Imaging, IdealField], scene: Scene, exact: Psf
) -> None:
    """The dot covers less than a pixel: its image is its PSF, and a pair of another depth is told apart."""
    dot = dataclasses.replace(scene, objects=scene.objects[1:])
    frame = capture(dot, exact)
    x_image = frame.frame[:, : frame.frame.shape[1] // 2]
    direction = scene.objects[1].centre
    errors = []
    for depth_m in (DEPTHS_M[1], DEPTHS_M[0]):
        own = pair_of(lens[1], lens[0], [depth_m], PsfNumerics(window_px=32, target_error=1e-3), tangent=direction)
        place = (np.array(own.centre_um[0, 0]) - np.array(frame.origin_um)) / frame.pixel_um
        rows, columns = (np.fft.fftfreq(n)[:, None] for n in x_image.shape)
        y, x = np.mgrid[-16:16, -16:16]
        grid = own.psf[0, 0]
        # The frame's spectrum against the PSF's own, each shifted to where the image point is.
        spectrum = np.exp(-2j * np.pi * rows * (y[:, 0] + place[1])) @ grid
        spectrum = spectrum @ np.exp(-2j * np.pi * columns * (x[0] + place[0])).T
        spectrum *= np.sinc(rows) * np.sinc(columns.T)
        picture = np.fft.ifft2(spectrum).real
        errors.append(relative_l2(x_image / x_image.sum(), picture / picture.sum()))
    # The dot is spread over up to four pixels when it is drawn on the grid.
    assert errors[0] < 0.06
    assert errors[1] > 0.12


def test_films_of_too_many_depths_are_refused(lens: tuple[Imaging, IdealField], scene: Scene) -> None:
    away = dataclasses.replace(scene.objects[0], velocity_m_per_s=(0.0, 0.0, 1e-5))
    film = dataclasses.replace(scene, objects=(away,), frames=200)
    with pytest.raises(InputError, match="at most 256 depths"):
        exact_psf(film, lens[1], lens[0])
