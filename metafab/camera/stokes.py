"""A scene of known polarisation as six images, and its truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.camera.rendering.render import Renderer
from metafab.camera.sensor import FixedPattern, expose
from metafab.core.conventions import FloatArray
from metafab.optics.interpolation.field import spline_weights
from metafab.optics.polarisation_states import StokesPsf
from metafab.spec import Scene


@dataclass(frozen=True)
class StokesFrame:
    """Six images of one exposure on one grid of directions, and what they show.

    Attributes:
        images: shape (6, n_y, n_x), electrons, of the field and the margin that its blur needs; inverted, as on the
            sensor.
        read_noise_e: standard deviation of the read noise.
        stokes: shape (4, n_y, n_x), the scene's Stokes vectors, in electrons of the six images' mean.
        depth_m: shape (n_y, n_x), NaN where there is nothing.
        label: shape (n_y, n_x), number of the object from 1, 0 for none.
    """

    images: FloatArray
    read_noise_e: float
    stokes: FloatArray
    depth_m: FloatArray
    label: NDArray[np.int32]


def kernels_at(psf: StokesPsf, depth_m: float) -> FloatArray:
    """Kernels (6, 4, n, n) of one depth: integrated over pixels; unpolarised light's mean over the places is 1."""
    weights = spline_weights(1.0 / psf.depth_m, 1.0 / depth_m)
    own = np.einsum("kjdyx,d->kjyx", psf.psf, weights)
    n = own.shape[-1]
    pixel = np.sinc(scipy.fft.fftfreq(n))[:, None] * np.sinc(scipy.fft.rfftfreq(n))
    kernels = scipy.fft.irfft2(scipy.fft.rfft2(own) * pixel, (n, n))
    return np.asarray(kernels * psf.pixel_um**2 / psf.instrument[:, 0].mean())


def spread(images: FloatArray, kernels: FloatArray) -> FloatArray:
    """Convolutions (..., n_y, n_x) of images with kernels whose origin is [n // 2, n // 2]; outside it is dark."""
    n_y, n_x = images.shape[-2:]
    k_y, k_x = kernels.shape[-2:]
    shape = tuple(scipy.fft.next_fast_len(n + k - 1, real=True) for n, k in ((n_y, k_y), (n_x, k_x)))
    product = scipy.fft.rfft2(images, shape) * scipy.fft.rfft2(kernels, shape)
    whole = scipy.fft.irfft2(product, shape)
    return np.asarray(whole[..., k_y // 2 : k_y // 2 + n_y, k_x // 2 : k_x // 2 + n_x])


def photograph(scene: Scene, psf: StokesPsf, *, seed: int | None = None) -> StokesFrame:
    """One exposure: Eq. 1 for four Stokes parameters and six places, near before far.

    All of the field sees the pair of the axis (field_px should be small), without vignetting, and the scene as it
    stands at its beginning. ``photons_per_pixel`` is what an unpolarised surface of brightness 1 leaves in a pixel,
    mean of the six images. A field stop passes ``field_px`` pixels, and nothing of the margin about them.
    """
    seed = scene.seed if seed is None else seed
    pixel_tangent = psf.pixel_um / psf.sensor_distance_um
    margin = psf.psf.shape[-1] // 2
    n_y, n_x = (count + 2 * margin for count in scene.field_px)
    seen = np.pad(np.ones(scene.field_px), margin)
    tangent_x, tangent_y = np.meshgrid(
        -(np.arange(n_x) - n_x // 2) * pixel_tangent, -(np.arange(n_y) - n_y // 2) * pixel_tangent
    )
    renderer = Renderer.of(scene, pixel_tangent, seed)
    electrons = scene.photons_per_pixel * scene.quantum_efficiency
    images, stokes = np.zeros((6, n_y, n_x)), np.zeros((4, n_y, n_x))
    # Without structure, depth does not matter; the background is unpolarised.
    middle = kernels_at(psf, float(psf.depth_m[psf.depth_m.size // 2]))[:, 0].sum(axis=(-2, -1))
    images += electrons * scene.background * middle[:, None, None] * seen
    stokes[0] += electrons * scene.background * seen
    depth_m, label = np.full((n_y, n_x), np.nan), np.zeros((n_y, n_x), dtype=np.int32)
    for piece in renderer.pieces(tangent_x, tangent_y):
        state = np.array([1.0, *scene.objects[piece.label - 1].stokes_vector])
        spread_e, hidden = np.zeros_like(images), np.zeros_like(images)
        covered_all = np.zeros((n_y, n_x))
        for own_m, coverage, brightness in zip(piece.depth_m, piece.coverage, piece.brightness, strict=True):
            covered, light = np.zeros((2, n_y, n_x))
            covered[piece.rows, piece.columns] = coverage
            light[piece.rows, piece.columns] = electrons * brightness
            covered, light = covered * seen, light * seen
            kernels = kernels_at(psf, float(own_m))
            spread_e += spread(light, np.einsum("kjyx,j->kyx", kernels, state))
            hidden += spread(covered, kernels[:, 0] / kernels[:, 0].sum(axis=(-2, -1), keepdims=True))
            stokes = stokes * (1.0 - covered) + light * state[:, None, None]
            depth_m = np.where(covered >= 0.5, own_m, depth_m)
            covered_all += covered
        images = images * (1.0 - np.clip(hidden, 0.0, 1.0)) + spread_e
        label = np.where(covered_all >= 0.5, piece.label, label).astype(np.int32)
    rng = np.random.default_rng(np.random.SeedSequence((seed, 0x570CE5)))
    exposed = expose(images, scene, FixedPattern.of(scene, images.shape, seed), rng)
    return StokesFrame(exposed, scene.read_noise_e, stokes, depth_m, label)
