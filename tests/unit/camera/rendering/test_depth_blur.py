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
    found = DepthBlur.of(kernels, 0)(light[None], 1.0 / depth_m[None], x, y)
    assert np.linalg.norm(found - wanted) < 1e-3 * np.linalg.norm(wanted)


def test_the_dark_stays_dark() -> None:
    blur, dark = DepthBlur.of(PairKernels(pair(5, None)), 1), np.zeros(SHAPE)
    k_y, k_x = blur.basis.shape[1:]
    image = blur(dark[None], dark[None], dark, dark)
    assert image.shape == (SHAPE[0] + k_y - 1, SHAPE[1] + k_x - 1)
    assert not image.any()


def test_light_of_surfaces_on_one_grid_adds_up() -> None:
    blur, rng = DepthBlur.of(PairKernels(pair(5, (2, 2))), 0), np.random.default_rng(3)
    light, depth_m = rng.uniform(0.0, 1.0, (2, *SHAPE)), rng.uniform(0.00251, 0.00349, (2, *SHAPE))
    y, x = np.meshgrid(np.linspace(-0.05, 0.05, SHAPE[0]), np.linspace(-0.09, 0.09, SHAPE[1]), indexing="ij")
    both = blur(light, 1.0 / depth_m, x, y)
    alone = sum(blur(light[one : one + 1], 1.0 / depth_m[one : one + 1], x, y) for one in range(2))
    # Single precision.
    assert np.abs(both - alone).max() < 1e-5 * both.max()


def test_coverage_of_a_surface_that_fills_the_view_is_1() -> None:
    blur = DepthBlur.of(PairKernels(pair(5, (2, 2))), 0)
    k_y, k_x = blur.basis.shape[1:]
    shape = (2 * k_y, 2 * k_x)
    y, x = np.meshgrid(np.zeros(shape[0]), np.full(shape[1], 0.01), indexing="ij")
    covered = blur.coverage(np.ones((1, *shape)), np.full((1, *shape), 1.0 / 0.0029), x, y)
    inside = (slice(k_y, shape[0]), slice(k_x, shape[1]))
    assert np.abs(covered[inside] - 1.0).max() < 1e-5
