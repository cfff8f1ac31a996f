"""The blur of a layer against the direct convolution with the pair, and its adjoint."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve

from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.decode.registration.calibration import Calibration
from metafab.decode.registration.downsampling import Downsampling
from metafab.decode.registration.twins import TwinGrid
from metafab.decode.segmentation.layer_light import LayerOptics
from tests.conjugate_pair import PIXEL_UM, helix_psf

SHAPE, MARGIN = (96, 120), 24


@pytest.fixture(scope="module")
def optics() -> LayerOptics:
    psf = helix_psf(1.0 / np.linspace(1 / 0.0034, 1 / 0.0025, 7))
    image_map = ImageMap.from_psf(psf)
    window = (MARGIN, MARGIN, *SHAPE)
    x_um, y_um = image_map.to_sensor_um(0, np.zeros(1), np.zeros(1))
    origin_um = (
        float(x_um[0]) - PIXEL_UM * (MARGIN + SHAPE[1] // 2),
        float(y_um[0]) - PIXEL_UM * (MARGIN + SHAPE[0] // 2),
    )
    frame = (SHAPE[0] + 2 * MARGIN, SHAPE[1] + 2 * MARGIN)
    grid = TwinGrid.at(image_map, frame, origin_um, PIXEL_UM, MARGIN, window)
    calibration = Calibration(PairKernels(psf), grid, image_map)
    return LayerOptics.of(calibration, Downsampling(2, SHAPE, MARGIN))


def everywhere(optics: LayerOptics) -> np.ndarray:
    rows, columns = (n + 2 * optics.downsampling.margin for n in optics.downsampling.shape)
    return np.ones((rows, columns), dtype=bool)


def test_a_flat_layer_is_convolved_with_the_pair(optics: LayerOptics) -> None:
    """Light without the highest frequencies is blurred at every second pixel as on all pixels."""
    vergence = 1.0 / 0.0029
    layer = optics.layer(np.full(optics.downsampling.shape, vergence), everywhere(optics))
    full = np.zeros((144, 168))
    full[48:96, 48:120] = np.random.default_rng(3).uniform(size=(48, 72))
    full = gaussian_filter(full, 2.5)
    kernels = np.tensordot(optics.calibration.depth_weights(vergence), optics.calibration.stack[:, :, 0], axes=(0, 1))
    images = layer.blurred(full[::2, ::2].astype(np.float32))
    for image, kernel in zip(images, kernels, strict=True):
        # A kernel of even size has its origin at the middle pixel after half of it.
        expected = fftconvolve(full, np.pad(kernel, ((0, 1), (0, 1))), mode="same")[::2, ::2]
        # The spectrum of the Gaussian is 3e-4 at the limit of the downsampled pixels, and folds back there.
        assert np.abs(image - expected).max() < 3e-3 * expected.max()


@pytest.mark.parametrize("rise", [0.0, 0.15])
def test_the_adjoint_is_that_of_the_blur(optics: LayerOptics, rise: float) -> None:
    rng = np.random.default_rng(1)
    tilt = 1.0 + rise * np.linspace(-0.5, 0.5, optics.downsampling.shape[1])
    vergence = np.broadcast_to(tilt / 0.0029, optics.downsampling.shape)
    layer = optics.layer(vergence, everywhere(optics))
    light, images = rng.normal(size=layer.shape), rng.normal(size=(2, *layer.shape))
    one = np.vdot(images, layer.blurred(light.astype(np.float32)))
    other = np.vdot(layer.adjoint(images.astype(np.float32)), light)
    # Single precision, over sums of 10^4 products of order 1.
    assert abs(one - other) < 1e-4 * np.linalg.norm(images) * np.linalg.norm(light)


def test_a_tilted_layer_has_the_depth_of_its_place(optics: LayerOptics) -> None:
    tilt = np.linspace(0.95, 1.05, optics.downsampling.shape[1])
    vergence = np.broadcast_to(tilt / 0.0029, optics.downsampling.shape)
    tilted = optics.layer(vergence, everywhere(optics))
    margin = optics.downsampling.margin
    for column in (8, 52):
        flat = optics.layer(np.full(vergence.shape, vergence[0, column]), everywhere(optics))
        light = np.zeros(flat.shape, dtype=np.float32)
        light[flat.shape[0] // 2, margin + column] = 1.0
        images, expected = tilted.blurred(light), flat.blurred(light)
        # A change of vergence by the whole 10 % changes the images by their own size; the basis leaves 6 %.
        assert np.linalg.norm(images - expected) < 0.1 * np.linalg.norm(expected)


def test_texture_has_unit_variance(optics: LayerOptics) -> None:
    layer = optics.layer(np.full(optics.downsampling.shape, 1.0 / 0.0029), everywhere(optics))
    white = np.random.default_rng(5).normal(size=(40, *layer.shape)).astype(np.float32)
    textures = np.stack([layer.filtered(one, layer.texture) for one in white])
    # 1/k^2 has most of its power in few waves: 40 pictures scatter by some 10 %.
    assert abs(textures.var() - 1.0) < 0.3
