"""Depth and outline of a small object by a model of both images: a surface, and a rectangle or an ellipse before it.

An object no larger than the blur hides part of the texture behind it. The model has the occlusion of the camera
(:mod:`metafab.camera.rendering.occlusion`): the object hides a share of the aperture from each point of the surface,
and a pixel with the share a covered shows 1 - a of the surface's light.

Both textures have a 1/k spectrum. A Gauss-Newton step solves by conjugate gradients for them and for the changes of
depth, rectangle and mean intensities at once. These steps converge to the joint maximum of the posterior, whose depth
is biased away from the surface, where two textures explain more. So the last steps maximise the marginal posterior: the
textures are integrated out, which adds half the gradient of the log-determinant of their information matrix. By
Fisher's identity that is a mean over draws from their posterior; each draw is a solve with random right sides. The
standard error of the depth is that of the posterior of all unknowns, times a measured ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import default_workers, kept_threads
from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.segmentation.layered.layer_light import LayerOptics, at_depth, texture_amplitude
from metafab.decode.segmentation.objects.null_channel import Rectangle, ellipse_light
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
#: Relative change of depth in a Gauss-Newton step that ends the fit.
_SETTLED = 2e-3
#: Steps of conjugate gradients in a Gauss-Newton step, and in one after the start or a large change of depth.
_STEPS, _STEPS_FAR = 60, 20
#: Relative change of depth that is large.
_FAR = 0.03
#: Relative change of depth below which the textures are integrated out.
_NEAR = 0.003
#: Draws of the textures; their randomness moves the depth by 0.2 of its error.
_DRAWS = 4
#: Steps by which the model is differentiated: of the logarithm of vergence, of middle and half sides in downsampled
#: pixels; it is linear in the mean intensities.
_DIFFERENCES = np.array([0.003, 0.1, 0.1, 0.1, 0.1])
#: Number of the unknowns before the mean intensities.
_LEVELS_AT = len(_DIFFERENCES)
#: Largest changes in one Gauss-Newton step, and standard deviations of the weak prior of a step.
_LARGEST = np.array([0.06, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
_PRIOR = np.array([3.0, 60.0, 60.0, 60.0, 60.0, 10.0, 10.0, 30.0, 30.0])
#: Least and largest mean intensity over the surface's, and least half side, downsampled pixels.
_LEVELS, _LEAST_HALF = (0.1, 3.0), 0.8
#: Square of the preconditioned gradient below which the conjugate gradients have converged.
_CONVERGED = 1e-12

#: Least divisor of conjugate gradients.
_LEAST = float(np.finfo(np.float64).tiny)
#: Most objects that are fitted at once: their data stay in a core's cache.
_AT_ONCE = 10

#: Logarithm of vergence, rectangle, and mean intensity of the surface and of the object in both images: shape (k, 9).
_Unknowns = FloatArray
_Spectra = NDArray[np.complex64]


@dataclass(frozen=True)
class FittedObject:
    """A rectangle of light before a surface."""

    vergence_per_m: float  #: 1/depth.
    relative_error: float  #: Standard error of the depth over the depth.
    rectangle: Rectangle  #: Middle from the window's middle, and half sides.


@dataclass(frozen=True)
class ObjectStart:
    """Where the fit of an object begins."""

    middle: tuple[int, int]  #: Downsampled pixel (row, column) in the middle of its window.
    extent: int  #: Largest side of its blob, downsampled pixels.
    surface_per_m: float  #: 1/depth of the surface behind it.
    level_e: FloatArray  #: Mean light of the surface in both images, shape (2,); only their ratio is used.
    vergence_per_m: float  #: 1/depth.
    rectangle: Rectangle  #: Middle from the window's middle, and half sides.
    is_round: bool = False  #: Whether the object is an ellipse.

    def side(self, optics: LayerOptics) -> int:
        """Side of the window, downsampled pixels."""
        wanted = max(_SIDE, optics.kernels.shape[-1], self.extent + 2 * _RIM + _ROOM)
        return 2 * int(scipy.fft.next_fast_len(-(-wanted // 2), real=True))


def fitted_objects(
    prepared: PreparedFrame, optics: LayerOptics, starts: Sequence[ObjectStart]
) -> list[FittedObject | None]:
    """Fit objects, each by itself; None for those beyond their surface or the nearest calibrated depth.

    Objects with windows of equal size are fitted a few at a time, as calls cost more than small transforms; all cores
    share the batches.
    """
    sides = [start.side(optics) for start in starts]
    order = sorted(range(len(starts)), key=lambda number: sides[number])
    groups = [list(group) for _, group in groupby(order, key=lambda number: sides[number])]
    count = min(_AT_ONCE, -(-len(starts) // default_workers()))
    batches = [group[at : at + count] for group in groups for at in range(0, len(group), count)]
    fitted: dict[int, FittedObject | None] = {}
    with kept_threads() as pool:
        found = pool.map(lambda batch: _fitted(prepared, optics, [starts[number] for number in batch]), batches)
        for batch, one in zip(batches, found, strict=True):
            fitted.update(zip(batch, one, strict=True))
    return [fitted[number] for number in range(len(starts))]


def _fitted(prepared: PreparedFrame, optics: LayerOptics, starts: Sequence[ObjectStart]) -> list[FittedObject | None]:
    """Fit a batch with windows of equal size; each Gauss-Newton step treats those that have not settled together."""
    window, count = _Window.of(prepared, optics, starts), len(starts)
    origin = np.array([window.side // 2, window.side // 2, 0.0, 0.0])
    depths = np.log([[one.vergence_per_m] for one in starts])
    unknowns = np.hstack([depths, [one.rectangle + origin for one in starts], np.ones((count, 4))])
    textures = np.zeros((count, 2, window.side, window.side // 2 + 1), dtype=np.complex64)
    farthest = np.log(window.surface_per_m)
    nearest = math.log(float(1.0 / optics.calibration.kernels.psf.depth_m.min()))
    of_textures, integrated = np.zeros((count, 9)), np.zeros(count, dtype=bool)
    before, moved, steps = np.zeros(count), np.zeros(count), np.full(count, _STEPS_FAR)
    inside, going = np.ones(count, dtype=bool), np.ones(count, dtype=bool)
    for number in range(_ROUNDS):
        # Without textures, only mean intensities are fitted.
        first = 0 if number else _LEVELS_AT
        for most in np.unique(steps[going]).tolist():
            at = np.flatnonzero(going & (steps == most))
            linear = _Linear.of(window.taken(at), unknowns[at], textures[at], first)
            change, change_of_textures = linear.solved(of_textures[at], most)
            # A step of depth opposite to the last one is shortened by the secant rule: in full it would undo up to 0.9
            # of the last one, because the textures follow the depth only in part.
            back, share = before[at] * change[:, 0] < 0.0, np.ones(len(at))
            np.divide(moved[at], before[at] - change[:, 0], out=share, where=back)
            share = np.minimum(share, 1.0)
            step = np.clip(share[:, None] * change, -_LARGEST, _LARGEST)
            before[at], moved[at] = change[:, 0], step[:, 0]
            unknowns[at] += step
            textures[at] += _wide(share) * change_of_textures
        unknowns[:, 3:5] = np.maximum(unknowns[:, 3:5], _LEAST_HALF)
        unknowns[:, 5:] = np.clip(unknowns[:, 5:], *_LEVELS)
        inside &= (farthest < unknowns[:, 0]) & (unknowns[:, 0] < nearest)
        going &= inside
        if first:
            continue
        steps = np.where(np.abs(before) < _FAR, _STEPS, _STEPS_FAR)
        going &= ~(integrated & (np.abs(before) < _SETTLED))
        at = np.flatnonzero(going & ~integrated & (np.abs(before) < _NEAR))
        if at.size:
            of_textures[at], before[at] = _determinant_slopes(window.taken(at), unknowns[at]), 0.0
            integrated[at] = True
        if not going.any():
            break
    fitted: list[FittedObject | None] = [None] * count
    at = np.flatnonzero(inside)
    if at.size:
        errors = _ERROR_RATIO * _Linear.of(window.taken(at), unknowns[at], textures[at], 0).depth_errors()
        for number, error in zip(at.tolist(), errors.tolist(), strict=True):
            fitted[number] = FittedObject(math.exp(unknowns[number, 0]), error, unknowns[number, 1:5] - origin)
    return fitted


@dataclass(frozen=True)
class _Window:
    """Squares about k objects, and the surfaces behind them."""

    optics: LayerOptics
    images: NDArray[np.float32]  # (k, 2, n, n), electrons
    weight: NDArray[np.float32]  # (k, 2, n, n), inverse deviation of noise and model; 0 where nothing is compared
    pair: _Spectra  # (k, n_depth, 2, n, n // 2 + 1), transforms of the pair at the calibrated depths
    surface_per_m: FloatArray  # (k,)
    surface: _Spectra  # (k, 2, n, n // 2 + 1), transforms of the pair at the surface's depth, times its share of light
    light: NDArray[np.float32]  # (k, 1, 1, 1), mean light of the surface, electrons
    amplitude: NDArray[np.float32]  # (k, 1, n, n // 2 + 1), amplitude of both textures' spectrum, electrons
    is_round: NDArray[np.bool_]  # (k,), whether the object is an ellipse

    @property
    def side(self) -> int:
        return int(self.images.shape[-1])

    @classmethod
    def of(cls, prepared: PreparedFrame, optics: LayerOptics, starts: Sequence[ObjectStart]) -> _Window:
        """The windows of starts whose windows are of equal size."""
        n, step = starts[0].side(optics), prepared.downsampling.step
        parts = []
        for start in starts:
            square, inside = prepared.about(start.middle, n)
            inside[:_RIM] = inside[-_RIM:] = inside[:, :_RIM] = inside[:, -_RIM:] = False
            pair = optics.pair_about(start.middle, n)
            surface = at_depth(optics, pair, start.surface_per_m)
            through = surface[:, 0, 0].real
            share = start.level_e / through
            share = share / share.mean()
            median = np.median(square[:, inside], axis=1)
            level = np.float32((median / through / share).mean())
            noise = (np.maximum(median, 0.0) + prepared.levels.read_noise_e**2) / step**2
            weight = (inside / np.sqrt(noise + (_MODEL_ERROR * level) ** 2)[:, None, None]).astype(np.float32)
            factors = share[:, None, None].astype(np.float32)
            parts.append((square, weight, pair, np.asarray(start.surface_per_m), surface * factors, level))
        images, weight, pair, surface_per_m, surface, mean = (np.stack(one) for one in zip(*parts, strict=True))
        light, is_round = mean.reshape(-1, 1, 1, 1), np.array([start.is_round for start in starts])
        amplitude = np.float32(_TEXTURE) * light * texture_amplitude((n, n), step)
        return cls(optics, images, weight, pair, surface_per_m, surface, light, amplitude, is_round)

    def taken(self, at: NDArray[np.intp]) -> _Window:
        """Some of the windows."""
        return _Window(self.optics, *(getattr(self, one.name)[at] for one in fields(self)[1:]))

    def spectra(self, pictures: NDArray[np.float32]) -> _Spectra:
        return np.asarray(scipy.fft.rfft2(pictures))

    def pictures(self, spectra: _Spectra) -> NDArray[np.float32]:
        return np.asarray(scipy.fft.irfft2(spectra, (self.side, self.side)))


@dataclass(frozen=True)
class _Depth:
    """Optics of the objects' depths in windows."""

    pair: _Spectra  # (k, 2, n, n // 2 + 1), the pair
    aperture: _Spectra  # (k, n, n // 2 + 1), share of the aperture that a point covers before the surface

    @classmethod
    def of(cls, window: _Window, log_vergence: FloatArray) -> _Depth:
        optics, size, vergence = window.optics, (window.side, window.side), np.exp(log_vergence)
        before = (vergence - window.surface_per_m).tolist()
        pairs = (at_depth(optics, *one) for one in zip(window.pair, vergence.tolist(), strict=True))
        return cls(np.stack(list(pairs)), np.stack([optics.aperture(one, size) for one in before]))


@dataclass(frozen=True)
class _Scene:
    """The surfaces and the objects of given unknowns in windows."""

    window: _Window
    levels: NDArray[np.float32]  # (k, 2, 2, 1, 1), mean intensities of the surface and of the object in both images
    means: NDArray[np.float32]  # (k, 2, 2, n, n), images of the surface and of the object per mean intensity, electrons
    depth: _Depth  # optics of the object's depth
    cover: NDArray[np.float32]  # (k, 1, n, n), share of each pixel that the object covers, low frequencies
    seen: NDArray[np.float32]  # (k, 1, n, n), share of the aperture that sees the surface
    balance: NDArray[np.float32]  # (k, 2, n, n), share of the whole surface's image added to keep radiance

    @classmethod
    def of(cls, window: _Window, depth: _Depth, unknowns: _Unknowns) -> _Scene:
        cover = _covers(window.side, unknowns[:, 1:5], window.is_round)
        hidden = cover * depth.aperture[:, None]
        through, own = (one[..., :1, :1].real for one in (window.surface, depth.pair))
        blurred = window.pictures(depth.pair * cover)
        veil = blurred / own
        covered, open_share = window.pictures(np.stack([cover, hidden]))
        return cls(
            window,
            unknowns[:, 5:].reshape(-1, 2, 2, 1, 1).astype(np.float32),
            np.stack([window.light * through * (1.0 - veil), window.light * blurred], axis=1),
            depth,
            covered,
            1.0 - open_share,
            window.pictures(window.surface * hidden) / through - veil,
        )

    @cached_property
    def object(self) -> _Spectra:
        """The pair times the objects' mean intensities, shape (k, 2, n, n // 2 + 1)."""
        return np.asarray(self.depth.pair * self.levels[:, 1])

    @property
    def mean(self) -> NDArray[np.float32]:
        """Images without textures, shape (k, 2, n, n), electrons."""
        return np.asarray((self.levels * self.means).sum(axis=1))

    def textured(self, textures: _Spectra) -> NDArray[np.float32]:
        """Images of both textures, electrons: shape (..., k, 2, n, n).

        ``textures``: white ones, shape (..., k, 2, n, n // 2 + 1).
        """
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
        """Shares of both textures that are seen, shape (k, 2, n, n)."""
        return np.concatenate([self.seen, self.cover], axis=1)

    def slopes(self, unknowns: _Unknowns, textures: _Spectra, mean: bool, first: int) -> NDArray[np.float32]:
        """Derivatives of the images by each unknown from the ``first`` one on: shape (n_free, ..., k, 2, n, n).

        ``mean``: of all light, or of the textures alone.
        """
        window, here = self.window, self.textured(textures)
        part = window.pictures(
            self.depth.pair * window.spectra(window.pictures(window.amplitude * textures[..., 1:, :, :]) * self.cover)
        )
        slopes = np.zeros((9, *here.shape), dtype=np.float32)
        for image in range(2):
            slopes[7 + image, ..., image, :, :] = part[..., image, :, :]
            if mean:
                slopes[5 + image, :, image] = self.means[:, 0, image]
                slopes[7 + image, :, image] += self.means[:, 1, image]
        for number in range(first, _LEVELS_AT):
            other = unknowns.copy()
            other[:, number] += _DIFFERENCES[number]
            moved = _Scene.of(window, _Depth.of(window, other[:, 0]) if number == 0 else self.depth, other)
            change = moved.textured(textures) - here
            slopes[number] = (change + (moved.mean - self.mean) if mean else change) / np.float32(_DIFFERENCES[number])
        return slopes[first:]


@dataclass(frozen=True)
class _Linear:
    """The model about given unknowns, linear in the textures and in changes of the unknowns."""

    scene: _Scene
    textures: _Spectra
    first: int  # first unknown that changes
    slopes: NDArray[np.float32]  # (k, n_free, 2 * n * n), weighted images of a change by one
    left: NDArray[np.float32]  # (k, 2, n, n), weighted images less the model's
    power: NDArray[np.float32]  # (k, 2, n, n // 2 + 1), information about the textures, for preconditioning

    @classmethod
    def of(cls, window: _Window, unknowns: _Unknowns, textures: _Spectra, first: int) -> _Linear:
        scene = _Scene.of(window, _Depth.of(window, unknowns[:, 0]), unknowns)
        slopes = scene.slopes(unknowns, textures, True, first) * window.weight
        power = np.stack([(np.abs(one) ** 2).sum(axis=1) for one in (window.surface, scene.object)], axis=1)
        power *= window.amplitude**2 * np.square(window.weight).mean(axis=(1, 2, 3), keepdims=True)
        left = window.weight * (window.images - scene.mean - scene.textured(textures))
        flat = np.ascontiguousarray(slopes.swapaxes(0, 1)).reshape(len(left), -1, left[0].size)
        return cls(scene, textures, first, flat, left, power)

    def solved(self, of_textures: _Unknowns, steps: int) -> tuple[_Unknowns, _Spectra]:
        """Changes of the unknowns, 0 for fixed ones, and of the textures.

        ``of_textures``: slopes of half the logarithm of the determinant of the textures' information.
        """
        gradient = self.scene.adjoint(self.scene.window.weight * self.left) - self.textures
        change = np.zeros(of_textures.shape)
        of_free = _times(_flat(self.left), self.slopes.swapaxes(1, 2)) - of_textures[:, self.first :]
        textures, change[:, self.first :] = self._solution(gradient, of_free, steps)
        return change, textures

    def drawn(self, count: int) -> _Spectra:
        """Textures drawn from their posterior about its mean, with all unknowns fixed: shape (count, k, 2, ...)."""
        window, random = self.scene.window, np.random.default_rng(0)
        # One draw for all windows: an object's fit does not depend on those that are computed with it.
        both = random.standard_normal((count, 2, 1, *window.images.shape[1:])).astype(np.float32)
        noise, white = both.swapaxes(0, 1)
        right = self.scene.adjoint(window.weight * noise) + window.spectra(white)
        return self._solution(right, np.zeros((*right.shape[:2], 0)), _STEPS)[0]

    def depth_errors(self) -> FloatArray:
        """Standard error of the logarithm of vergence, the first unknown, with all others unknown too: shape (k,)."""
        first = np.zeros(self.slopes.shape[:2])
        first[:, 0] = 1.0
        _, column = self._solution(np.zeros_like(self.textures), first, _STEPS)
        variance = column[:, 0]
        return np.where(variance > 0.0, np.sqrt(np.abs(variance)), np.inf)

    def _solution(self, right: _Spectra, right_free: FloatArray, steps: int) -> tuple[_Spectra, FloatArray]:
        """Product of the inverse information matrix and the right sides, by preconditioned conjugate gradients.

        Right sides have shapes (..., k, 2, n, n // 2 + 1) and (..., k, n_free); leading axes are those of as many
        systems.
        """
        weight, slopes = self.scene.window.weight, self.slopes[:, : right_free.shape[-1]]
        back = slopes.swapaxes(1, 2)
        prior = 1.0 / _PRIOR[self.first :][: slopes.shape[1]] ** 2
        inverse = np.linalg.inv(slopes @ back + np.diag(prior))
        through = (1.0 / (1.0 + self.power)).astype(np.float32)
        textures, free = np.zeros_like(right), np.zeros(right_free.shape)
        ahead, ahead_free = through * right, _times(right_free, inverse)
        norm = _product(right, ahead) + (right_free * ahead_free).sum(axis=-1)
        for _ in range(steps):
            images = self.scene.textured(ahead)
            images *= weight
            images += _times(ahead_free.astype(np.float32), slopes).reshape(images.shape)
            along = self.scene.adjoint(weight * images)
            along += ahead
            along_free = _times(_flat(images), back) + prior * ahead_free
            # A system that has converged stays, while others go on: its solution does not depend on theirs.
            curvature = _product(ahead, along) + (ahead_free * along_free).sum(axis=-1)
            length = np.where(norm < _CONVERGED, 0.0, norm / np.maximum(curvature, _LEAST))
            textures, free = textures + _wide(length) * ahead, free + length[..., None] * ahead_free
            right, right_free = right - _wide(length) * along, right_free - length[..., None] * along_free
            next_, next_free = through * right, _times(right_free, inverse)
            before, norm = norm, _product(right, next_) + (right_free * next_free).sum(axis=-1)
            if (norm < _CONVERGED).all():
                break
            ratio = norm / np.maximum(before, _LEAST)
            ahead = next_ + _wide(ratio) * ahead
            ahead_free = next_free + ratio[..., None] * ahead_free
        return textures, free


def _covers(n: int, rectangles: FloatArray, is_round: NDArray[np.bool_]) -> _Spectra:
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


def _determinant_slopes(window: _Window, unknowns: _Unknowns) -> _Unknowns:
    """Slopes of half the logarithm of the determinant of the textures' information, from draws of the textures."""
    none = np.zeros((len(unknowns), 2, window.side, window.side // 2 + 1), dtype=np.complex64)
    linear = _Linear.of(window, unknowns, none, unknowns.shape[1])
    draws = linear.drawn(_DRAWS)
    at = np.square(window.weight) * linear.scene.textured(draws)
    slopes = linear.scene.slopes(unknowns, draws, False, 0)
    return np.asarray((slopes * at).sum(axis=(1, 3, 4, 5), dtype=np.float64).T / _DRAWS)


def _times(rows: NDArray[Any], matrices: NDArray[Any]) -> NDArray[Any]:
    """Products of rows, shape (..., k, n), and matrices, shape (k, n, m): shape (..., k, m)."""
    return np.asarray((rows[..., None, :] @ matrices)[..., 0, :])


def _flat(images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Images of shape (..., 2, n, n) as rows of shape (..., 2 * n * n)."""
    return images.reshape(*images.shape[:-3], -1)


def _wide(factors: FloatArray) -> NDArray[np.float32]:
    """Factors of transforms of shape (..., 2, n, n // 2 + 1)."""
    return factors[..., None, None, None].astype(np.float32)


def _product(one: _Spectra, other: _Spectra) -> FloatArray:
    """Dot products of pictures, shape (..., 2, n, n), of transforms (..., 2, n, n // 2 + 1): shape (...)."""
    of_column = np.einsum("...iyx,...iyx->...x", one.view(np.float32), other.view(np.float32)).astype(np.float64)
    both = 2.0 * of_column.sum(axis=-1) - of_column[..., :2].sum(axis=-1) - of_column[..., -2:].sum(axis=-1)
    return np.asarray(both / one.shape[-2] ** 2)
