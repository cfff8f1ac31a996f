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
from metafab.decode.segmentation.layered.layer_light import LayerLight, LayerOptics
from metafab.decode.segmentation.layered.tile_shares import TileLayers
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


def flat(optics: LayerOptics, tiles: list[int], vergence_per_m: list[float]) -> LayerLight:
    """Layers of one depth each, one to a tile."""
    tile = np.array(tiles)
    return optics.light(tile, np.arange(tile.size), np.array(vergence_per_m), np.ones((tile.size, 2), dtype=np.float32))


def test_a_layer_is_convolved_with_the_pair(optics: LayerOptics) -> None:
    """Light without the highest frequencies is blurred at every second pixel as on all pixels."""
    vergence = 1.0 / 0.0029
    layer = flat(optics, [0], [vergence])
    rows, columns = (2 * n for n in layer.size)
    full = np.zeros((rows, columns))
    full[rows // 3 : rows // 2, columns // 3 : columns // 2] = np.random.default_rng(3).uniform(
        size=(rows // 2 - rows // 3, columns // 2 - columns // 3)
    )
    full = gaussian_filter(full, 2.5)
    kernels = np.tensordot(optics.calibration.depth_weights(vergence), optics.calibration.stack[:, :, 0], axes=(0, 1))
    images = layer.rendered(layer.spectra(full[::2, ::2].astype(np.float32)[None]))[0]
    for image, kernel in zip(images, kernels, strict=True):
        # A kernel of even size has its origin at the middle pixel after half of it.
        expected = fftconvolve(full, np.pad(kernel, ((0, 1), (0, 1))), mode="same")[::2, ::2]
        # The spectrum of the Gaussian is 3e-4 at the limit of the downsampled pixels, and folds back there.
        assert np.abs(image - expected).max() < 3e-3 * expected.max()


def test_the_adjoint_is_that_of_the_blur(optics: LayerOptics) -> None:
    """Three layers in two pictures, with gains."""
    rng = np.random.default_rng(1)
    of_tile, vergence = np.array([0, 0, 1]), np.array([1.0, 1.1, 1.05]) / 0.0029
    gains = rng.uniform(0.5, 1.5, size=(3, 2)).astype(np.float32)
    layers = optics.light(np.zeros(3, dtype=int), of_tile, vergence, gains)
    light, images = rng.normal(size=(3, *layers.size)), rng.normal(size=(2, 2, *layers.size))
    one = np.vdot(images, layers.rendered(layers.spectra(light.astype(np.float32))))
    other = np.vdot(layers.adjoint(images.astype(np.float32)), light)
    # Single precision, over sums of 10^4 products of order 1.
    assert abs(one - other) < 1e-4 * np.linalg.norm(images) * np.linalg.norm(light)


def test_layers_of_a_tile_add_up(optics: LayerOptics) -> None:
    rng = np.random.default_rng(2)
    vergence = [1.0 / 0.0029, 1.1 / 0.0029]
    both = optics.light(np.zeros(2, dtype=int), np.zeros(2, dtype=int), np.array(vergence), np.ones((2, 2), np.float32))
    light = rng.normal(size=(2, *both.size)).astype(np.float32)
    apart = flat(optics, [0, 0], vergence)
    images = apart.rendered(apart.spectra(light)).sum(axis=0)
    # Rounding of single precision.
    assert np.abs(both.rendered(both.spectra(light))[0] - images).max() < 1e-5 * np.abs(images).max()


def test_texture_has_unit_variance(optics: LayerOptics) -> None:
    layer = flat(optics, [0], [1.0 / 0.0029])
    white = np.random.default_rng(5).normal(size=(40, *layer.size)).astype(np.float32)
    textures = layer.pictures(layer.texture * layer.spectra(white))
    # 1/k^2 has most of its power in few waves: 40 pictures scatter by some 10 %.
    assert abs(textures.var() - 1.0) < 0.3


def test_an_aperture_is_covered_by_the_shifted_outline(optics: LayerOptics) -> None:
    """The covered share of a smooth outline is its mean over the shifts that the aperture's points see."""
    shifts = np.array([[-3.0, 1.0], [0.0, 0.0], [2.0, -4.0], [5.0, 2.0]])
    vars(optics)["shifts_px_m"] = shifts
    rows, columns = optics.tiling.size
    share = gaussian_filter((np.arange(columns) > columns // 2) * np.ones((rows, 1)), 2.0, mode="wrap")
    covered = np.fft.irfft2(np.fft.rfft2(share) * optics.aperture(1.0), (rows, columns))
    expected = np.mean([np.roll(share, (-int(y), -int(x)), axis=(0, 1)) for x, y in shifts], axis=0)
    del vars(optics)["shifts_px_m"]
    # Whole shifts are exact; transfer functions are of single precision.
    assert np.abs(covered - expected).max() < 1e-5


def test_even_light_has_no_seam_where_a_layer_hides_another(optics: LayerOptics) -> None:
    """An object as bright as the even wall behind it does not show: its outline has no misfit.

    By the visible light of the wall alone, the images would differ by several per cent along the outline.
    """
    far, near = 1.0 / 0.0032, 1.0 / 0.0026
    shifts = np.array([[x, y] for x in (-6.0, 0.0, 6.0) for y in (-6.0, 0.0, 6.0)]) / (near - far)
    vars(optics)["shifts_px_m"] = shifts
    gains, of_tile = np.ones((2, 2), dtype=np.float32), np.zeros(2, dtype=np.intp)
    light = optics.light(of_tile, of_tile, np.array([far, near]), gains)
    light.transfer[:] /= light.transfer[:, :, :1, :1]  # equal throughput at both depths
    rows, columns = light.size
    object_share = np.zeros(light.size, dtype=np.float32)
    object_share[rows // 4 : rows // 2, columns // 4 : columns // 2] = 1.0
    whole = np.ones((2, *light.size), dtype=bool)
    images = np.full((1, 2, *light.size), 1000.0, dtype=np.float32)
    weight = np.full_like(images, 0.1)  # 1 % of the light
    aperture = optics.aperture(near - far)
    del vars(optics)["shifts_px_m"]
    model = TileLayers(light, gains, [(0, 1, aperture)], images, weight, images[:, 0], whole, whole, 1.0)
    misfit = model.misfit(np.stack([1.0 - object_share, object_share]))
    assert misfit.max() < 1e-6
