"""A scene of known polarisation as six images, with its truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.camera.capture import FixedPattern, expose
from metafab.camera.kernels import pixel_transfer
from metafab.camera.rendering.occlusion import PINHOLE, Occluder, visible_piece, visible_share
from metafab.camera.rendering.picture import require_objects
from metafab.camera.rendering.render import Renderer
from metafab.camera.rendering.windows import shifts_px_m
from metafab.core.conventions import FloatArray
from metafab.core.numeric.interpolation import spline_weights
from metafab.core.numeric.spectra import convolved
from metafab.optics.polarisation_states import StokesPsf
from metafab.spec import Scene


@dataclass(frozen=True)
class StokesFrame:
    """Six images of one exposure on one grid of directions, and their truth."""

    #: Shape (6, n_y, n_x), electrons, of the field and the margin of its blur; inverted, as on the sensor.
    images: FloatArray
    read_noise_e: float  #: Standard deviation of the read noise.
    #: Shape (4, n_y, n_x), true Stokes parameters of the scene, in electrons of the six images' mean.
    stokes: FloatArray
    depth_m: FloatArray  #: Shape (n_y, n_x), true depth; NaN where there is no object.
    label: NDArray[np.int32]  #: Shape (n_y, n_x), number of the object from 1, 0 for none.


def kernels_at(psf: StokesPsf, depth_m: float) -> FloatArray:
    """Return the blur kernels of one depth, shape (6, 4, n, n), integrated over the pixel.

    They are scaled so that for unpolarised light at the middle depth the sums of the six kernels have the mean 1.
    """
    weights = spline_weights(1.0 / psf.depth_m, 1.0 / depth_m)
    sampled = np.einsum("kjdyx,d->kjyx", psf.psf, weights)
    window = psf.psf.shape[-2:]
    kernels = scipy.fft.irfft2(scipy.fft.rfft2(sampled) * pixel_transfer((window[0], window[1])), window)
    return np.asarray(kernels * psf.pixel_um**2 / psf.instrument[:, 0].mean())


def photograph(scene: Scene, psf: StokesPsf, *, seed: int | None = None) -> StokesFrame:
    """Expose one frame: Eq. 1 of Shen 2023 for four Stokes parameters and six images; near objects hide far ones.

    Every direction has the PSFs of the axis (``field_px`` should be small), without vignetting; objects stand
    where they begin. ``photons_per_pixel`` is the mean of the six images for an unpolarised surface of brightness 1.
    The field stop passes ``field_px`` pixels and nothing of the margin around them. The seed of textures and noise is
    that of the scene by default.
    """
    require_objects(scene)
    seed = scene.seed if seed is None else seed
    pixel_tangent = psf.pixel_um / psf.sensor_distance_um
    margin = psf.psf.shape[-1] // 2
    stop = np.pad(np.ones(scene.field_px), margin)
    n_y, n_x = stop.shape
    tangent_x, tangent_y = np.meshgrid(
        -(np.arange(n_x) - n_x // 2) * pixel_tangent, -(np.arange(n_y) - n_y // 2) * pixel_tangent
    )
    electrons = scene.photons_per_pixel * scene.quantum_efficiency
    pieces = list(Renderer.of(scene, pixel_tangent, seed).pieces(tangent_x, tangent_y))
    masks = [Occluder.of(piece) for piece in pieces]
    shifts = shifts_px_m(psf.aperture_um, tangent_x, tangent_y)
    images, stokes = np.zeros((len(psf.psf), n_y, n_x)), np.zeros((4, n_y, n_x))
    depth_m, label = np.full((n_y, n_x), np.nan), np.zeros((n_y, n_x), dtype=np.int32)
    for number, (piece, mask) in enumerate(zip(pieces, masks, strict=True), start=1):
        state = np.array([1.0, *scene.objects[piece.label - 1].stokes_vector])
        crop, nearer = (piece.rows, piece.columns), masks[number:]
        for step_depth_m, brightness in zip(
            piece.depth_m, visible_piece(piece, nearer, shifts).brightness, strict=True
        ):
            light = np.zeros((n_y, n_x))
            light[crop] = electrons * brightness
            images += _blurred(light * stop, np.einsum("kjyx,j->kyx", kernels_at(psf, float(step_depth_m)), state))
        sharp = electrons * visible_piece(piece, nearer, PINHOLE).brightness.sum(axis=0) * stop[crop]
        stokes[:, *crop] += sharp * state[:, None, None]
        piece.write_truth(mask.coverage * stop[crop], depth_m, label)
    # The background is unpolarised and has no structure: it is not blurred. It is hidden like a surface at the farthest
    # depth.
    sky = Occluder.everywhere((n_y, n_x), float(psf.depth_m[-1]))
    gain = kernels_at(psf, float(psf.depth_m[psf.depth_m.size // 2]))[:, 0].sum(axis=(-2, -1))
    light = electrons * scene.background * stop
    images += gain[:, None, None] * light * visible_share(sky, masks, shifts)
    stokes[0] += light * visible_share(sky, masks, PINHOLE)
    rng = np.random.default_rng(np.random.SeedSequence((seed, 0x570CE5)))
    exposed = expose(images, scene, FixedPattern.of(scene, images.shape, seed), rng)
    return StokesFrame(exposed, scene.read_noise_e, stokes, depth_m, label)


def _blurred(image: FloatArray, kernels: FloatArray) -> FloatArray:
    """Convolutions (n, n_y, n_x) of an image with kernels (n, k_y, k_x), origin [k_y // 2, k_x // 2]; dark outside."""
    (n_y, n_x), (k_y, k_x) = image.shape, kernels.shape[-2:]
    whole = convolved(image, kernels)
    return np.asarray(whole[:, k_y // 2 : k_y // 2 + n_y, k_x // 2 : k_x // 2 + n_x])
