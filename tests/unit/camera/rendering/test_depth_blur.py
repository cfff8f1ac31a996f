"""Blur of a surface of continuous depth, beside the sum over its pixels."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.depth_blur import DepthBlur
from metafab.core.conventions import FloatArray
from metafab.optics.point_spread import Psf, PsfField
from tests.conjugate_pair import helix_psf

SHAPE = (20, 31)


def pair(depths: int, field: tuple[int, int] | None) -> Psf:
    """A pair over some depths; over a field of (n_y, n_x) points it is another one at each."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0025, 1 / 0.0035, depths))
    if field is None:
        return psf
    n_y, n_x = field
    rng = np.random.default_rng(2)
    brightness = rng.uniform(0.5, 1.5, (2, 1, n_y, n_x, 1, 1))
    images = (psf.psf[:, :, None, None] * brightness + 0.2 * psf.psf[::-1, :, None, None]).astype(np.float32)
    centres = np.broadcast_to(psf.centre_um[:, :, None, None], (2, depths, n_y, n_x, 2)).copy()
    return dataclasses.replace(
        psf, field=PsfField(np.linspace(-0.1, 0.1, n_x), np.linspace(-0.06, 0.06, n_y), images, centres)
    )


def summed(kernels: PairKernels, light: FloatArray, depth_m: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Sum of the kernels of x polarisation at the depth and in the direction of each pixel."""
    k_y, k_x = kernels.shape
    image = np.zeros((SHAPE[0] + k_y - 1, SHAPE[1] + k_x - 1))
    for row, column in np.argwhere(light > 0.0):
        weights = kernels.field_weights(x[row, column], y[row, column])
        kernel = np.tensordot(weights, kernels.at_depth(float(depth_m[row, column]))[0], axes=2)
        image[row : row + k_y, column : column + k_x] += light[row, column] * kernel
    return image


@pytest.mark.parametrize(("depths", "field"), [(9, (3, 5)), (5, (4, 1)), (3, None), (1, (2, 2))])
def test_each_pixel_is_blurred_at_its_depth_and_direction(depths: int, field: tuple[int, int] | None) -> None:
    """The basis leaves out a millionth of the energy, that is a thousandth of the light of one pixel."""
    kernels = PairKernels(pair(depths, field))
    rng = np.random.default_rng(1)
    depth_m = rng.uniform(0.00251, 0.00349, SHAPE) if depths > 1 else np.full(SHAPE, 0.0025)
    light = rng.uniform(0.0, 1.0, SHAPE) * (rng.random(SHAPE) < 0.4)
    y, x = np.meshgrid(np.linspace(-0.05, 0.05, SHAPE[0]), np.linspace(-0.09, 0.09, SHAPE[1]), indexing="ij")
    wanted = summed(kernels, light, depth_m, x, y)
    found = DepthBlur.of(kernels, 0)(light, 1.0 / depth_m, x, y)
    assert np.linalg.norm(found - wanted) < 1e-3 * np.linalg.norm(wanted)


def test_the_dark_stays_dark() -> None:
    blur, dark = DepthBlur.of(PairKernels(pair(5, None)), 1), np.zeros(SHAPE)
    k_y, k_x = blur.basis.shape[1:]
    image = blur(dark, dark, dark, dark)
    assert image.shape == (SHAPE[0] + k_y - 1, SHAPE[1] + k_x - 1)
    assert not image.any()
