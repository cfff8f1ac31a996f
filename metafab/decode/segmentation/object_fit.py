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
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.segmentation.layer_light import LayerOptics, at_depth, texture_amplitude
from metafab.decode.segmentation.null_channel import Rectangle
from metafab.decode.segmentation.prepared_frame import PreparedFrame

#: Least side of the window, its rim that is not compared, and its least room about a blob, downsampled pixels.
_SIDE, _RIM, _ROOM = 44, 6, 8
#: Rms contrast of both textures, and the model's error at a pixel as a share of the surface's light.
_TEXTURE, _MODEL_ERROR = 0.3, 0.006
#: Error of depth in standard errors of the posterior: rms of 53 squares of 20 to 39 px in three frames (1.0, 1.4, 1.8).
_ERROR_RATIO = 1.45
#: Most Gauss-Newton steps, which cross the calibrated depths, steps of conjugate gradients in each, and relative change
#: of depth that ends them.
_ROUNDS, _STEPS, _SETTLED = 24, 60, 1e-3
#: Draws of the textures: they move the depth by 0.2 of its error.
_DRAWS = 4
#: Steps by which the model is differentiated: of the logarithm of vergence, of middle and half sides in downsampled
#: pixels, and of the mean intensities over the surface's.
_DIFFERENCES = np.array([0.003, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05, 0.05, 0.05])
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
    free = np.arange(9) >= 5  # the textures are unknown at first, and only mean intensities follow without them
    of_textures = np.zeros(9)
    for _ in range(_ROUNDS):
        change, textures = _Linear.of(window, unknowns, textures, free).solved(of_textures)
        unknowns = unknowns + np.clip(change, -_LARGEST, _LARGEST)
        unknowns[3:5] = np.maximum(unknowns[3:5], _LEAST_HALF)
        unknowns[5:] = np.clip(unknowns[5:], *_LEVELS)
        if not math.log(surface[0]) < unknowns[0] < nearest:
            return None
        if free.all() and abs(change[0]) < _SETTLED:
            if of_textures.any():
                break
            of_textures = _determinant_slopes(window, unknowns)
        free = np.ones(9, dtype=bool)
    error = _ERROR_RATIO * _Linear.of(window, unknowns, textures, free).depth_error()
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
    share: NDArray[np.float32]  # (2, 1, 1), light of the surface in each image over the mean
    texture: NDArray[np.float32]  # (n, n // 2 + 1), amplitude of a texture

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
        texture = texture_amplitude((n, n), step)
        factors = share[:, None, None].astype(np.float32)
        return cls(optics, images, weight, pair, surface_per_m, surface * factors, light, factors, texture)

    def spectra(self, pictures: NDArray[np.float32]) -> _Spectra:
        return np.asarray(scipy.fft.rfft2(pictures))

    def pictures(self, spectra: _Spectra) -> NDArray[np.float32]:
        return np.asarray(scipy.fft.irfft2(spectra, (self.side, self.side)))


@dataclass(frozen=True)
class _Scene:
    """The surface and the object of given unknowns in a window."""

    window: _Window
    object: _Spectra  # (2, n, n // 2 + 1), the pair at the object's depth times its light over the surface's
    cover: NDArray[np.float32]  # (n, n), share of each pixel that the object covers, low frequencies
    seen: NDArray[np.float32]  # (n, n), share of the aperture that sees the surface
    balance: NDArray[np.float32]  # (2, n, n), share of the surface's blurred light that the camera adds
    mean: NDArray[np.float32]  # (2, n, n), images without textures, electrons

    @classmethod
    def of(cls, window: _Window, unknowns: _Unknowns) -> _Scene:
        n, vergence = window.side, math.exp(unknowns[0])
        middle_y, middle_x, half_y, half_x = unknowns[1:5].tolist()
        y, x = (
            2.0 * half * np.sinc(2.0 * half * one) * np.exp(-2j * np.pi * middle * one)
            for one, middle, half in zip(frequencies((n, n), 1), (middle_y, middle_x), (half_y, half_x), strict=True)
        )
        cover = np.outer(y, x).astype(np.complex64)
        pair = at_depth(window.optics, window.pair, vergence)
        hidden = cover * window.optics.aperture(vergence - window.surface_per_m, (n, n))
        through, own = (one[:, :1, :1].real for one in (window.surface, pair))
        blurred = window.pictures(pair * cover)
        veil, light = blurred / own, window.light
        wall, lit = ((light * one)[:, None, None].astype(np.float32) for one in (unknowns[5:7], unknowns[7:]))
        return cls(
            window,
            pair * (lit / light),
            window.pictures(cover),
            1.0 - window.pictures(hidden),
            window.pictures(window.surface * hidden) / through - veil,
            wall * through * (1.0 - veil) + lit * blurred,
        )

    def textured(self, textures: _Spectra) -> NDArray[np.float32]:
        """Images of both textures, shape (2, n, n), electrons; ``textures`` are white, shape (2, n, n // 2 + 1)."""
        window, scale = self.window, np.float32(_TEXTURE * self.window.light)
        behind, before = window.pictures(window.texture * textures) * scale
        seen, own = window.spectra(behind * self.seen), window.spectra(before * self.cover)
        whole = window.pictures(window.surface * window.spectra(behind))
        return np.asarray(window.pictures(window.surface * seen + self.object * own) + whole * self.balance)

    def adjoint(self, images: NDArray[np.float32]) -> _Spectra:
        """Adjoint of :meth:`textured`."""
        window, scale = self.window, np.float32(_TEXTURE * self.window.light)
        spectra, added = window.spectra(images), window.spectra(images * self.balance)
        behind = window.pictures((spectra * window.surface.conj()).sum(axis=0)) * self.seen
        behind += window.pictures((added * window.surface.conj()).sum(axis=0))
        before = window.pictures((spectra * self.object.conj()).sum(axis=0)) * self.cover
        return np.asarray(window.spectra(np.stack([behind, before]) * scale) * window.texture)


def _moved(window: _Window, unknowns: _Unknowns, numbers: NDArray[np.intp]) -> Iterator[_Scene]:
    """The scene with one unknown after the other moved by its difference."""
    for number in numbers.tolist():
        other = unknowns.copy()
        other[number] += _DIFFERENCES[number]
        yield _Scene.of(window, other)


@dataclass(frozen=True)
class _Linear:
    """The model about given unknowns, linear in the textures and in changes of the unknowns."""

    scene: _Scene
    textures: _Spectra
    free: NDArray[np.bool_]  # (9,), unknowns that change
    slopes: NDArray[np.float32]  # (n_free, 2, n, n), weighted images of a change by one
    left: NDArray[np.float32]  # (2, n, n), weighted images less the model's
    power: NDArray[np.float32]  # (2, n, n // 2 + 1), information about the textures, for preconditioning

    @classmethod
    def of(cls, window: _Window, unknowns: _Unknowns, textures: _Spectra, free: NDArray[np.bool_]) -> _Linear:
        scene = _Scene.of(window, unknowns)
        model = scene.mean + scene.textured(textures)
        numbers = np.flatnonzero(free)
        slopes = [
            (moved.mean + moved.textured(textures) - model) / difference * window.weight
            for difference, moved in zip(_DIFFERENCES[numbers], _moved(window, unknowns, numbers), strict=True)
        ]
        scale = (_TEXTURE * window.light * window.texture) ** 2 * np.square(window.weight).mean()
        power = np.stack([(np.abs(one) ** 2).sum(axis=0) * scale for one in (window.surface, scene.object)])
        left = window.weight * (window.images - model)
        of_free = np.array(slopes, dtype=np.float32).reshape(-1, *model.shape)
        return cls(scene, textures, free, of_free, left, power)

    def solved(self, of_textures: _Unknowns) -> tuple[_Unknowns, _Spectra]:
        """Changes of the unknowns, 0 for fixed ones, and the textures.

        ``of_textures``: slopes of half the logarithm of the determinant of the textures' information.
        """
        gradient = self.scene.adjoint(self.scene.window.weight * self.left) - self.textures
        change = np.zeros(9)
        of_free = np.tensordot(self.slopes, self.left, axes=3) - of_textures[self.free]
        textures, change[self.free] = self._solution(gradient, of_free)
        return change, self.textures + textures

    def drawn(self, random: np.random.Generator) -> _Spectra:
        """Textures drawn from their posterior about its mean, with all unknowns fixed."""
        window = self.scene.window
        noise, white = (random.standard_normal(window.images.shape).astype(np.float32) for _ in range(2))
        right = self.scene.adjoint(window.weight * noise) + window.spectra(white)
        return self._solution(right, np.zeros(0))[0]

    def depth_error(self) -> float:
        """Standard error of the logarithm of vergence, the first unknown, with all others unknown too."""
        first = np.zeros(len(self.slopes))
        first[0] = 1.0
        _, column = self._solution(np.zeros_like(self.textures), first)
        variance = float(column[0])
        return math.sqrt(variance) if variance > 0.0 else math.inf

    def _solution(self, right: _Spectra, right_free: FloatArray) -> tuple[_Spectra, FloatArray]:
        """Product of the inverse information matrix and the right sides, by preconditioned conjugate gradients."""
        weight, prior = self.scene.window.weight, 1.0 / _PRIOR[self.free] ** 2
        inverse = np.linalg.inv(np.tensordot(self.slopes, self.slopes, axes=([1, 2, 3],) * 2) + np.diag(prior))
        textures, free = np.zeros_like(self.textures), np.zeros(len(self.slopes))
        ahead, ahead_free = right / (1.0 + self.power), inverse @ right_free
        norm = _product(right, ahead) + float(right_free @ ahead_free)
        for _ in range(_STEPS):
            if norm < _CONVERGED:
                break
            images = weight * self.scene.textured(ahead)
            images += np.tensordot(ahead_free.astype(np.float32), self.slopes, axes=1)
            along = self.scene.adjoint(weight * images) + ahead
            along_free = np.tensordot(self.slopes, images, axes=3) + prior * ahead_free
            length = np.float32(norm / (_product(ahead, along) + float(ahead_free @ along_free)))
            textures, free = textures + length * ahead, free + length * ahead_free
            right, right_free = right - length * along, right_free - length * along_free
            next_, next_free = right / (1.0 + self.power), inverse @ right_free
            before, norm = norm, _product(right, next_) + float(right_free @ next_free)
            ahead, ahead_free = next_ + np.float32(norm / before) * ahead, next_free + norm / before * ahead_free
        return textures, free


def _determinant_slopes(window: _Window, unknowns: _Unknowns) -> _Unknowns:
    """Slopes of half the logarithm of the determinant of the textures' information, from draws of the textures."""
    none = np.zeros((2, window.side, window.side // 2 + 1), dtype=np.complex64)
    linear = _Linear.of(window, unknowns, none, np.zeros(9, dtype=bool))
    random = np.random.default_rng(0)
    draws = [linear.drawn(random) for _ in range(_DRAWS)]
    at = [window.weight * linear.scene.textured(draw) for draw in draws]
    slopes = np.zeros(9)
    for number, moved in enumerate(_moved(window, unknowns, np.arange(9))):
        images = (window.weight * moved.textured(draw) for draw in draws)
        slopes[number] = np.mean([float(((one - here) * here).sum()) for one, here in zip(images, at, strict=True)])
    return np.asarray(slopes / _DIFFERENCES)


def _product(one: _Spectra, other: _Spectra) -> float:
    """Dot product of pictures, shape (..., n, n), of transforms (..., n, n // 2 + 1)."""
    both = one.real * other.real + one.imag * other.imag
    return float(2.0 * both.sum() - both[..., 0].sum() - both[..., -1].sum()) / float(one.shape[-2] ** 2)
