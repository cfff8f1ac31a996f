"""Depth and outline of a small object by a model of both images: a surface, and a rectangle of light before it.

An object no larger than the blur hides part of the texture behind it. The model has the occlusion of the camera
(:mod:`metafab.camera.rendering.occlusion`): the object hides a share of the aperture from each point of the surface,
and a pixel of which it covers the share a shows 1 - a of the light of the surface.

Both textures have a 1/k spectrum. A Gauss-Newton step solves by conjugate gradients for them and for the changes of
depth, rectangle and mean intensities at once. Where that settles, textures are the most probable ones, and depth leans
to where two textures explain most: away from the surface. Integrated out, they add half the gradient of the logarithm
of their information's determinant (Fisher's identity), a mean over draws from their posterior, each of which is a solve
with random right sides. The standard error of the depth is that of the posterior of all unknowns, times the ratio that
was measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.segmentation.layer_light import LayerOptics, at_depth, texture_amplitude
from metafab.decode.segmentation.null_channel import Rectangle
from metafab.decode.segmentation.prepared_frame import PreparedFrame

#: Least side of the window, downsampled pixels.
_SIDE = 44
#: Rim of the window that is not compared, and least room about a blob inside of it, downsampled pixels.
_RIM, _ROOM = 6, 8
#: Rms contrast of both textures, and the model's error at a pixel as a share of the surface's light.
_TEXTURE, _MODEL_ERROR = 0.3, 0.006
#: Error of depth in standard errors of the posterior: rms of 53 squares of 20 to 39 px in three frames (1.0, 1.4, 1.8).
_ERROR_RATIO = 1.45
#: Most Gauss-Newton steps, which cross the calibrated depths.
_ROUNDS = 24
#: Relative change of depth that ends them.
_SETTLED = 2e-3
#: Steps of conjugate gradients in each of them, and fewer at first or after a large change of depth.
_STEPS, _STEPS_FAR = 60, 20
#: Relative change of depth that is large.
_FAR = 0.03
#: Relative change of depth below which the textures are integrated out.
_NEAR = 0.003
#: Draws of the textures: they move the depth by 0.2 of its error.
_DRAWS = 4
#: Steps by which the model is differentiated: of the logarithm of vergence, of middle and half sides in downsampled
#: pixels; it is linear in the mean intensities.
_DIFFERENCES = np.array([0.003, 0.1, 0.1, 0.1, 0.1])
#: Number of the unknowns before the mean intensities.
_LEVELS_AT = len(_DIFFERENCES)
#: Largest changes in one Gauss-Newton step, and standard deviations of a weak prior of all steps.
_LARGEST = np.array([0.06, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
_PRIOR = np.array([3.0, 60.0, 60.0, 60.0, 60.0, 10.0, 10.0, 30.0, 30.0])
#: Least and largest mean intensity over the surface's, and least half side, downsampled pixels.
_LEVELS, _LEAST_HALF = (0.1, 3.0), 0.8
#: Square of the preconditioned gradient below which the conjugate gradients have converged.
_CONVERGED = 1e-12

#: Logarithm of vergence, rectangle, and mean intensity of the surface and of the object in both images: shape (9,).
_Unknowns = FloatArray
_Spectra = NDArray[np.complex64]


@dataclass(frozen=True)
class FittedObject:
    """A rectangle of light before a surface."""

    vergence_per_m: float  #: 1/depth.
    relative_error: float  #: Standard error of the depth over the depth.
    rectangle: Rectangle  #: Middle from the window's middle, and half sides.


def fitted_object(
    prepared: PreparedFrame,
    optics: LayerOptics,
    middle: tuple[int, int],
    extent: int,
    surface: tuple[float, FloatArray],
    start: tuple[float, Rectangle],
) -> FittedObject | None:
    """Fit the object in a window about a pixel (row, column); None beyond the surface or the nearest calibrated depth.

    Args:
        prepared: the frame.
        optics: the pair on its downsampled pixels.
        middle: the pixel.
        extent: largest side of the object's blob, downsampled pixels.
        surface: 1/depth of the surface, and its mean light in both images, shape (2,), of which the ratio counts.
        start: 1/depth of the object, and its rectangle, the middle from the window's.
    """
    window = _Window.of(prepared, optics, middle, extent, *surface)
    origin = np.array([window.side // 2, window.side // 2, 0.0, 0.0])
    unknowns = np.concatenate([[math.log(start[0])], start[1] + origin, np.ones(4)])
    textures = np.zeros((2, window.side, window.side // 2 + 1), dtype=np.complex64)
    nearest = math.log(float(1.0 / optics.calibration.kernels.psf.depth_m.min()))
    first = _LEVELS_AT  # first free unknown: without textures, only mean intensities are fitted
    of_textures, before, moved, steps = np.zeros(9), 0.0, 0.0, _STEPS_FAR
    for _ in range(_ROUNDS):
        change, change_of_textures = _Linear.of(window, unknowns, textures, first).solved(of_textures, steps)
        # A step of depth that turns back ends at the zero of the secant. Full ones undo up to 0.9 of the last: textures
        # follow depth only in part.
        share = min(1.0, moved / (before - change[0])) if before * change[0] < 0.0 else 1.0
        step = np.clip(share * change, -_LARGEST, _LARGEST)
        before, moved = change[0], step[0]
        steps = _STEPS if not first and abs(before) < _FAR else _STEPS_FAR
        unknowns, textures = unknowns + step, textures + np.float32(share) * change_of_textures
        unknowns[3:5] = np.maximum(unknowns[3:5], _LEAST_HALF)
        unknowns[5:] = np.clip(unknowns[5:], *_LEVELS)
        if not math.log(surface[0]) < unknowns[0] < nearest:
            return None
        if not first and of_textures.any() and abs(change[0]) < _SETTLED:
            break
        if not first and not of_textures.any() and abs(change[0]) < _NEAR:
            of_textures, before = _determinant_slopes(window, unknowns), 0.0
        first = 0
    error = _ERROR_RATIO * _Linear.of(window, unknowns, textures, 0).depth_error()
    return FittedObject(math.exp(unknowns[0]), error, unknowns[1:5] - origin)


@dataclass(frozen=True)
class _Window:
    """A square about an object, and the surface behind it."""

    optics: LayerOptics
    images: NDArray[np.float32]  # (2, n, n), electrons
    weight: NDArray[np.float32]  # (2, n, n), inverse deviation of noise and model; 0 where nothing is compared
    pair: _Spectra  # (n_depth, 2, n, n // 2 + 1), transforms of the pair at the calibrated depths
    surface_per_m: float
    surface: _Spectra  # (2, n, n // 2 + 1), those at the surface
    light: float  # mean light of the surface, electrons
    amplitude: NDArray[np.float32]  # (n, n // 2 + 1), that of both textures, electrons

    @property
    def side(self) -> int:
        return int(self.images.shape[-1])

    @classmethod
    def of(
        cls,
        prepared: PreparedFrame,
        optics: LayerOptics,
        middle: tuple[int, int],
        extent: int,
        surface_per_m: float,
        level_e: FloatArray,
    ) -> _Window:
        wanted = max(_SIDE, optics.kernels.shape[-1], extent + 2 * _RIM + _ROOM)
        n, step = 2 * scipy.fft.next_fast_len(-(-wanted // 2), real=True), prepared.downsampling.step
        images, inside = prepared.about(middle, n)
        inside[:_RIM] = inside[-_RIM:] = inside[:, :_RIM] = inside[:, -_RIM:] = False
        pair = optics.pair_about(middle, n)
        surface = at_depth(optics, pair, surface_per_m)
        through = surface[:, 0, 0].real
        share = level_e / through
        share = share / share.mean()
        median = np.median(images[:, inside], axis=1)
        light = float((median / through / share).mean())
        variance = (np.maximum(median, 0.0) + prepared.levels.read_noise_e**2) / step**2 + (_MODEL_ERROR * light) ** 2
        weight = (inside / np.sqrt(variance)[:, None, None]).astype(np.float32)
        amplitude = np.float32(_TEXTURE * light) * texture_amplitude((n, n), step)
        factors = share[:, None, None].astype(np.float32)
        return cls(optics, images, weight, pair, surface_per_m, surface * factors, light, amplitude)

    def spectra(self, pictures: NDArray[np.float32]) -> _Spectra:
        return np.asarray(scipy.fft.rfft2(pictures))

    def pictures(self, spectra: _Spectra) -> NDArray[np.float32]:
        return np.asarray(scipy.fft.irfft2(spectra, (self.side, self.side)))


@dataclass(frozen=True)
class _Depth:
    """Optics of an object's depth in a window."""

    pair: _Spectra  # (2, n, n // 2 + 1), the pair
    aperture: _Spectra  # (n, n // 2 + 1), share of the aperture that a point covers before the surface

    @classmethod
    def of(cls, window: _Window, log_vergence: float) -> _Depth:
        vergence, optics = math.exp(log_vergence), window.optics
        aperture = optics.aperture(vergence - window.surface_per_m, (window.side, window.side))
        return cls(at_depth(optics, window.pair, vergence), aperture)


@dataclass(frozen=True)
class _Scene:
    """The surface and the object of given unknowns in a window."""

    window: _Window
    levels: NDArray[np.float32]  # (2, 2, 1, 1), mean intensities of the surface and of the object in both images
    means: NDArray[np.float32]  # (2, 2, n, n), images of the surface and of the object per mean intensity, electrons
    pair: _Spectra  # (2, n, n // 2 + 1), the pair at the object's depth
    cover: NDArray[np.float32]  # (n, n), share of each pixel that the object covers, low frequencies
    seen: NDArray[np.float32]  # (n, n), share of the aperture that sees the surface
    balance: NDArray[np.float32]  # (2, n, n), share of the surface's blurred light that the camera adds

    @classmethod
    def of(cls, window: _Window, depth: _Depth, unknowns: _Unknowns) -> _Scene:
        n, (middle_y, middle_x, half_y, half_x) = window.side, unknowns[1:5].tolist()
        y, x = (
            2.0 * half * np.sinc(2.0 * half * one) * np.exp(-2j * np.pi * middle * one)
            for one, middle, half in zip(frequencies((n, n), 1), (middle_y, middle_x), (half_y, half_x), strict=True)
        )
        cover = np.outer(y, x).astype(np.complex64)
        hidden = cover * depth.aperture
        through, own = (one[:, :1, :1].real for one in (window.surface, depth.pair))
        blurred = window.pictures(depth.pair * cover)
        veil, light = blurred / own, np.float32(window.light)
        covered, open_share = window.pictures(np.stack([cover, hidden]))
        return cls(
            window,
            unknowns[5:].reshape(2, 2, 1, 1).astype(np.float32),
            np.stack([light * through * (1.0 - veil), light * blurred]),
            depth.pair,
            covered,
            1.0 - open_share,
            window.pictures(window.surface * hidden) / through - veil,
        )

    @cached_property
    def object(self) -> _Spectra:
        """The pair times the object's mean intensities, shape (2, n, n // 2 + 1)."""
        return np.asarray(self.pair * self.levels[1])

    @property
    def mean(self) -> NDArray[np.float32]:
        """Images without textures, shape (2, n, n), electrons."""
        return np.asarray((self.levels * self.means).sum(axis=0))

    def textured(self, textures: _Spectra) -> NDArray[np.float32]:
        """Images of both textures, shape (..., 2, n, n), electrons; these are white, shape (..., 2, n, n // 2 + 1)."""
        window, spectra = self.window, self.window.amplitude * textures
        surface, seen = spectra[..., :1, :, :], window.pictures(spectra) * self._shares
        light = window.spectra(seen)
        both = np.stack(
            [window.surface * light[..., :1, :, :] + self.object * light[..., 1:, :, :], window.surface * surface]
        )
        images, whole = window.pictures(both)
        return np.asarray(images + whole * self.balance)

    def adjoint(self, images: NDArray[np.float32]) -> _Spectra:
        """Adjoint of :meth:`textured`."""
        window = self.window
        spectra, added = window.spectra(np.stack([images, images * self.balance]))
        surface = window.surface.conj()
        light = np.stack([(spectra * one).sum(axis=-3) for one in (surface, self.object.conj())], axis=-3)
        found = window.spectra(window.pictures(light) * self._shares)
        found[..., 0, :, :] += (added * surface).sum(axis=-3)
        found *= window.amplitude
        return found

    @cached_property
    def _shares(self) -> NDArray[np.float32]:
        """Shares of both textures that are seen, shape (2, n, n)."""
        return np.stack([self.seen, self.cover])

    def slopes(self, unknowns: _Unknowns, textures: _Spectra, mean: bool, first: int) -> NDArray[np.float32]:
        """Derivatives of the images by each unknown from the ``first`` one on: shape (n_free, ..., 2, n, n).

        ``mean``: of all light, or of the textures alone.
        """
        window, here = self.window, self.textured(textures)
        part = window.pictures(
            self.pair * window.spectra(window.pictures(window.amplitude * textures[..., 1:, :, :]) * self.cover)
        )
        slopes = np.zeros((9, *here.shape), dtype=np.float32)
        for image in range(2):
            slopes[7 + image, ..., image, :, :] = part[..., image, :, :]
            if mean:
                slopes[5 + image, image], object_mean = self.means[:, image]
                slopes[7 + image, image] += object_mean
        own = _Depth.of(window, unknowns[0])
        for number in range(first, _LEVELS_AT):
            other = unknowns.copy()
            other[number] += _DIFFERENCES[number]
            moved = _Scene.of(window, _Depth.of(window, other[0]) if number == 0 else own, other)
            change = moved.textured(textures) - here
            slopes[number] = (change + (moved.mean - self.mean) if mean else change) / np.float32(_DIFFERENCES[number])
        return slopes[first:]


@dataclass(frozen=True)
class _Linear:
    """The model about given unknowns, linear in the textures and in changes of the unknowns."""

    scene: _Scene
    textures: _Spectra
    first: int  # first unknown that changes
    slopes: NDArray[np.float32]  # (n_free, 2 * n * n), weighted images of a change by one
    left: NDArray[np.float32]  # (2, n, n), weighted images less the model's
    power: NDArray[np.float32]  # (2, n, n // 2 + 1), information about the textures, for preconditioning

    @classmethod
    def of(cls, window: _Window, unknowns: _Unknowns, textures: _Spectra, first: int) -> _Linear:
        scene = _Scene.of(window, _Depth.of(window, unknowns[0]), unknowns)
        slopes = scene.slopes(unknowns, textures, True, first) * window.weight
        power = np.stack([(np.abs(one) ** 2).sum(axis=0) for one in (window.surface, scene.object)])
        power *= window.amplitude**2 * np.square(window.weight).mean()
        left = window.weight * (window.images - scene.mean - scene.textured(textures))
        return cls(scene, textures, first, slopes.reshape(-1, window.images.size), left, power)

    def solved(self, of_textures: _Unknowns, steps: int) -> tuple[_Unknowns, _Spectra]:
        """Changes of the unknowns, 0 for fixed ones, and of the textures.

        ``of_textures``: slopes of half the logarithm of the determinant of the textures' information.
        """
        gradient = self.scene.adjoint(self.scene.window.weight * self.left) - self.textures
        change = np.zeros(9)
        of_free = self.slopes @ self.left.ravel() - of_textures[self.first :]
        textures, change[self.first :] = self._solution(gradient, of_free, steps)
        return change, textures

    def drawn(self, count: int) -> _Spectra:
        """Textures drawn from their posterior about its mean, with all unknowns fixed: shape (count, 2, ...)."""
        window, random = self.scene.window, np.random.default_rng(0)
        both = random.standard_normal((count, 2, *window.images.shape)).astype(np.float32)
        noise, white = both.swapaxes(0, 1)
        right = self.scene.adjoint(window.weight * noise) + window.spectra(white)
        return self._solution(right, np.zeros((count, 0)), _STEPS)[0]

    def depth_error(self) -> float:
        """Standard error of the logarithm of vergence, the first unknown, with all others unknown too."""
        first = np.zeros(len(self.slopes))
        first[0] = 1.0
        _, column = self._solution(np.zeros_like(self.textures), first, _STEPS)
        variance = float(column[0])
        return math.sqrt(variance) if variance > 0.0 else math.inf

    def _solution(self, right: _Spectra, right_free: FloatArray, steps: int) -> tuple[_Spectra, FloatArray]:
        """Product of the inverse information matrix and the right sides, by preconditioned conjugate gradients.

        Leading axes of the right sides are those of as many systems.
        """
        weight, slopes = self.scene.window.weight, self.slopes[: right_free.shape[-1]]
        prior = 1.0 / _PRIOR[self.first :][: len(slopes)] ** 2
        inverse = np.linalg.inv(slopes @ slopes.T + np.diag(prior))
        through = (1.0 / (1.0 + self.power)).astype(np.float32)
        textures, free = np.zeros_like(right), np.zeros(right_free.shape)
        ahead, ahead_free = through * right, right_free @ inverse
        norm = _product(right, ahead) + (right_free * ahead_free).sum(axis=-1)
        for _ in range(steps):
            images = self.scene.textured(ahead)
            images *= weight
            images += (ahead_free.astype(np.float32) @ slopes).reshape(images.shape)
            along = self.scene.adjoint(weight * images)
            along += ahead
            along_free = images.reshape(*images.shape[:-3], -1) @ slopes.T + prior * ahead_free
            length = norm / (_product(ahead, along) + (ahead_free * along_free).sum(axis=-1))
            wide = length[..., None, None, None].astype(np.float32)
            textures, free = textures + wide * ahead, free + length[..., None] * ahead_free
            right, right_free = right - wide * along, right_free - length[..., None] * along_free
            next_, next_free = through * right, right_free @ inverse
            before, norm = norm, _product(right, next_) + (right_free * next_free).sum(axis=-1)
            if (norm < _CONVERGED).all():
                break
            ratio = norm / before
            ahead = next_ + ratio[..., None, None, None].astype(np.float32) * ahead
            ahead_free = next_free + ratio[..., None] * ahead_free
        return textures, free


def _determinant_slopes(window: _Window, unknowns: _Unknowns) -> _Unknowns:
    """Slopes of half the logarithm of the determinant of the textures' information, from draws of the textures."""
    none = np.zeros((2, window.side, window.side // 2 + 1), dtype=np.complex64)
    linear = _Linear.of(window, unknowns, none, len(unknowns))
    draws = linear.drawn(_DRAWS)
    at = np.square(window.weight) * linear.scene.textured(draws)
    slopes = linear.scene.slopes(unknowns, draws, False, 0)
    return np.asarray((slopes * at).sum(axis=(1, 2, 3, 4), dtype=np.float64) / _DRAWS)


def _product(one: _Spectra, other: _Spectra) -> FloatArray:
    """Dot products of pictures, shape (..., 2, n, n), of transforms (..., 2, n, n // 2 + 1): shape (...)."""
    of_column = np.einsum("...iyx,...iyx->...x", one.view(np.float32), other.view(np.float32)).astype(np.float64)
    both = 2.0 * of_column.sum(axis=-1) - of_column[..., :2].sum(axis=-1) - of_column[..., -2:].sum(axis=-1)
    return np.asarray(both / one.shape[-2] ** 2)
