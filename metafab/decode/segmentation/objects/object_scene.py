"""Images of small objects before a surface in windows: their textures' linear map, its adjoint, and slopes.

The model has the occlusion of the camera (:mod:`metafab.camera.rendering.occlusion`): the object hides a share of the
aperture from each point of the surface, and a pixel with the share a covered shows 1 - a of the surface's light. Both
textures have a 1/k spectrum and the contrast of the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.segmentation.layered.layer_light import at_depth
from metafab.decode.segmentation.objects.null_channel import ellipse_light
from metafab.decode.segmentation.objects.object_window import ObjectWindow, Spectra, blurred, distances

#: Steps by which the model is differentiated: of the logarithm of vergence, of middle and half sides in downsampled
#: pixels; it is linear in the mean intensities.
_DIFFERENCES = np.array([0.003, 0.1, 0.1, 0.1, 0.1])
#: Number of the unknowns before the mean intensities.
LEVELS_AT = len(_DIFFERENCES)

#: Logarithm of vergence, rectangle, and mean intensity of the surface and of the object in both images: shape (k, 9).
Unknowns = FloatArray


@dataclass(frozen=True)
class DepthOptics:
    """Optics of the objects' depths in windows."""

    pair: Spectra  #: Shape (k, 3, 2, n, n // 2 + 1), the pair and its changes along y and x.
    aperture: Spectra  #: Shape (k, n, n // 2 + 1), share of the aperture that a point covers before the surface.

    @classmethod
    def of(cls, window: ObjectWindow, log_vergence: FloatArray) -> DepthOptics:
        """Optics of objects at the logarithm of their vergence, shape (k,)."""
        optics, size, vergence = window.optics, (window.side, window.side), np.exp(log_vergence)
        before = (vergence - window.surface_per_m).tolist()
        pairs = (at_depth(optics, *one) for one in zip(window.pair, vergence.tolist(), strict=True))
        return cls(np.stack(list(pairs)), np.stack([optics.aperture(one, size) for one in before]))


@dataclass(frozen=True)
class WindowScene:
    """The surfaces and the objects of given unknowns in windows."""

    window: ObjectWindow  #: The windows.
    #: Shape (k, 2, 2, 1, 1), mean intensities of the surface and of the object in both images.
    levels: NDArray[np.float32]
    #: Shape (k, 2, 2, n, n), images of the surface and of the object per mean intensity, electrons.
    means: NDArray[np.float32]
    depth: DepthOptics  #: Optics of the object's depth.
    cover: NDArray[np.float32]  #: Shape (k, 1, n, n), share of each pixel that the object covers, low frequencies.
    seen: NDArray[np.float32]  #: Shape (k, 1, n, n), share of the aperture that sees the surface.
    balance: NDArray[np.float32]  #: Shape (k, 2, n, n), share of the whole surface's image added to keep radiance.

    @classmethod
    def of(cls, window: ObjectWindow, depth: DepthOptics, unknowns: Unknowns) -> WindowScene:
        """Scenes of the unknowns, shape (k, 9), whose logarithms of vergence are those of ``depth``."""
        cover = _covers(window.side, unknowns[:, 1:5], window.is_round)
        hidden = cover * depth.aperture[:, None]
        through, own = (one[:, 0, :, :1, :1].real for one in (window.surface, depth.pair))
        covered, open_share = window.pictures(np.stack([cover, hidden]))
        image = window.pictures(blurred(depth.pair, window.moments(covered[:, 0])))
        veil = image / own
        return cls(
            window,
            unknowns[:, 5:].reshape(-1, 2, 2, 1, 1).astype(np.float32),
            np.stack([window.light * through * (1.0 - veil), window.light * image], axis=1),
            depth,
            covered,
            1.0 - open_share,
            window.pictures(window.surface[:, 0] * hidden) / through - veil,
        )

    @cached_property
    def object(self) -> Spectra:
        """The pair and its changes times the objects' mean intensities, shape (k, 3, 2, n, n // 2 + 1)."""
        return np.asarray(self.depth.pair * self.levels[:, 1, None])

    @property
    def mean(self) -> NDArray[np.float32]:
        """Images without textures, shape (k, 2, n, n), electrons."""
        return np.asarray((self.levels * self.means).sum(axis=1))

    def textured(self, textures: Spectra) -> NDArray[np.float32]:
        """Images of both textures, electrons: shape (..., k, 2, n, n).

        ``textures``: white ones, shape (..., k, 2, n, n // 2 + 1).
        """
        window, spectra = self.window, self.window.amplitude * textures
        surface, seen = spectra[..., :1, :, :], window.pictures(spectra) * self._shares
        light = window.moments(seen)
        both = blurred(window.surface, light[..., 0, :, :, :]) + blurred(self.object, light[..., 1, :, :, :])
        images, whole = window.pictures(np.stack([both, window.surface[:, 0] * surface]))
        return np.asarray(images + whole * self.balance)

    def adjoint(self, images: NDArray[np.float32]) -> Spectra:
        """Adjoint of :meth:`textured`: images, shape (..., k, 2, n, n), to spectra (..., k, 2, n, n // 2 + 1)."""
        window = self.window
        spectra, added = window.spectra(np.stack([images, images * self.balance]))
        both = (window.surface.conj(), self.object.conj())
        light = np.stack([(spectra[..., None, :, :, :] * one).sum(axis=-3) for one in both], axis=-4)
        seen = (window.pictures(light) * distances(window.side)).sum(axis=-3)
        found = window.spectra(seen * self._shares)
        found[..., 0, :, :] += (added * both[0][:, 0]).sum(axis=-3)
        found *= window.amplitude
        return found

    @cached_property
    def _shares(self) -> NDArray[np.float32]:
        """Shares of both textures that are seen, shape (k, 2, n, n)."""
        return np.concatenate([self.seen, self.cover], axis=1)

    def slopes(self, unknowns: Unknowns, textures: Spectra, mean: bool, first: int) -> NDArray[np.float32]:
        """Derivatives of the images by each unknown from the ``first`` one on: shape (n_free, ..., k, 2, n, n).

        ``mean``: of all light, or of the textures alone.
        """
        window, here = self.window, self.textured(textures)
        of_object = window.pictures(window.amplitude * textures[..., 1:, :, :]) * self.cover
        part = window.pictures(blurred(self.depth.pair, window.moments(of_object[..., 0, :, :])))
        slopes = np.zeros((9, *here.shape), dtype=np.float32)
        for image in range(2):
            slopes[7 + image, ..., image, :, :] = part[..., image, :, :]
            if mean:
                slopes[5 + image, :, image] = self.means[:, 0, image]
                slopes[7 + image, :, image] += self.means[:, 1, image]
        for number in range(first, LEVELS_AT):
            other = unknowns.copy()
            other[:, number] += _DIFFERENCES[number]
            moved = WindowScene.of(window, DepthOptics.of(window, other[:, 0]) if number == 0 else self.depth, other)
            change = moved.textured(textures) - here
            slopes[number] = (change + (moved.mean - self.mean) if mean else change) / np.float32(_DIFFERENCES[number])
        return slopes[first:]


def _covers(n: int, rectangles: FloatArray, is_round: NDArray[np.bool_]) -> Spectra:
    """Transforms of the objects' shares of pixels, shape (k, 1, n, n // 2 + 1), given their rectangles, (k, 4)."""
    middle_y, middle_x, half_y, half_x = rectangles[:, :, None].swapaxes(0, 1)
    ky, kx = frequencies((n, n), 1)
    y, x = (
        2.0 * half * np.sinc(2.0 * half * one) * np.exp(-2j * np.pi * middle * one)
        for one, middle, half in ((ky, middle_y, half_y), (kx, middle_x, half_x))
    )
    cover = (y[:, None, :, None] * x[:, None, None, :]).astype(np.complex64)
    if is_round.any():
        places = rectangles[is_round].T[:, :, None, None, None]
        cover[is_round] = ellipse_light(ky[:, None], kx, (places[0], places[1]), (places[2], places[3]))
    return np.asarray(cover)
