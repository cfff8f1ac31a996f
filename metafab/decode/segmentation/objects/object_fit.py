"""Depth and outline of a small object by a model of both images: a surface, and a rectangle or an ellipse before it.

An object no larger than the blur hides part of the texture behind it. The model has the occlusion of the camera
(:mod:`metafab.camera.rendering.occlusion`): the object hides a share of the aperture from each point of the surface,
and a pixel with the share a covered shows 1 - a of the surface's light.

Both textures have a 1/k spectrum and the contrast of the surface, and light is blurred by the pair of its own place
(:mod:`metafab.decode.segmentation.objects.object_window`). A Gauss-Newton step solves by conjugate gradients for the
textures and for the changes of depth, rectangle and mean intensities at once. These steps converge to the joint maximum
of the posterior, whose depth is biased away from the surface, where two textures explain more. So the last steps
maximise the marginal posterior: the textures are integrated out, which adds half the gradient of the log-determinant of
their information matrix. By Fisher's identity that is a mean over draws from their posterior; each draw is a solve with
random right sides. The standard error of the depth is that of the posterior of all unknowns, times a measured ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import default_workers, kept_threads
from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.segmentation.layered.layer_light import LayerOptics, at_depth
from metafab.decode.segmentation.objects.null_channel import Rectangle, ellipse_light
from metafab.decode.segmentation.objects.object_window import ObjectStart, ObjectWindow, Spectra, blurred, distances
from metafab.decode.segmentation.prepared_frame import PreparedFrame

#: Error of depth in standard errors of the posterior: rms of 100 squares of 20 to 39 px in five frames.
_ERROR_RATIO = 1.2
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


@dataclass(frozen=True)
class FittedObject:
    """A rectangle of light before a surface."""

    vergence_per_m: float  #: 1/depth.
    relative_error: float  #: Standard error of the depth over the depth.
    rectangle: Rectangle  #: Middle from the window's middle, and half sides.


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
    window, count = ObjectWindow.of(prepared, optics, starts), len(starts)
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
class _Depth:
    """Optics of the objects' depths in windows."""

    pair: Spectra  # (k, 3, 2, n, n // 2 + 1), the pair and its changes along y and x
    aperture: Spectra  # (k, n, n // 2 + 1), share of the aperture that a point covers before the surface

    @classmethod
    def of(cls, window: ObjectWindow, log_vergence: FloatArray) -> _Depth:
        optics, size, vergence = window.optics, (window.side, window.side), np.exp(log_vergence)
        before = (vergence - window.surface_per_m).tolist()
        pairs = (at_depth(optics, *one) for one in zip(window.pair, vergence.tolist(), strict=True))
        return cls(np.stack(list(pairs)), np.stack([optics.aperture(one, size) for one in before]))


@dataclass(frozen=True)
class _Scene:
    """The surfaces and the objects of given unknowns in windows."""

    window: ObjectWindow
    levels: NDArray[np.float32]  # (k, 2, 2, 1, 1), mean intensities of the surface and of the object in both images
    means: NDArray[np.float32]  # (k, 2, 2, n, n), images of the surface and of the object per mean intensity, electrons
    depth: _Depth  # optics of the object's depth
    cover: NDArray[np.float32]  # (k, 1, n, n), share of each pixel that the object covers, low frequencies
    seen: NDArray[np.float32]  # (k, 1, n, n), share of the aperture that sees the surface
    balance: NDArray[np.float32]  # (k, 2, n, n), share of the whole surface's image added to keep radiance

    @classmethod
    def of(cls, window: ObjectWindow, depth: _Depth, unknowns: _Unknowns) -> _Scene:
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
        """Adjoint of :meth:`textured`."""
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

    def slopes(self, unknowns: _Unknowns, textures: Spectra, mean: bool, first: int) -> NDArray[np.float32]:
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
    textures: Spectra
    first: int  # first unknown that changes
    slopes: NDArray[np.float32]  # (k, n_free, 2 * n * n), weighted images of a change by one
    left: NDArray[np.float32]  # (k, 2, n, n), weighted images less the model's
    power: NDArray[np.float32]  # (k, 2, n, n // 2 + 1), information about the textures, for preconditioning

    @classmethod
    def of(cls, window: ObjectWindow, unknowns: _Unknowns, textures: Spectra, first: int) -> _Linear:
        scene = _Scene.of(window, _Depth.of(window, unknowns[:, 0]), unknowns)
        slopes = scene.slopes(unknowns, textures, True, first) * window.weight
        pairs = window.surface[:, 0], scene.object[:, 0]
        power = np.stack([(np.abs(one) ** 2).sum(axis=1) for one in pairs], axis=1)
        power *= window.amplitude**2 * np.square(window.weight).mean(axis=(1, 2, 3), keepdims=True)
        left = window.weight * (window.images - scene.mean - scene.textured(textures))
        flat = np.ascontiguousarray(slopes.swapaxes(0, 1)).reshape(len(left), -1, left[0].size)
        return cls(scene, textures, first, flat, left, power)

    def solved(self, of_textures: _Unknowns, steps: int) -> tuple[_Unknowns, Spectra]:
        """Changes of the unknowns, 0 for fixed ones, and of the textures.

        ``of_textures``: slopes of half the logarithm of the determinant of the textures' information.
        """
        gradient = self.scene.adjoint(self.scene.window.weight * self.left) - self.textures
        change = np.zeros(of_textures.shape)
        of_free = _times(_flat(self.left), self.slopes.swapaxes(1, 2)) - of_textures[:, self.first :]
        textures, change[:, self.first :] = self._solution(gradient, of_free, steps)
        return change, textures

    def drawn(self, count: int) -> Spectra:
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

    def _solution(self, right: Spectra, right_free: FloatArray, steps: int) -> tuple[Spectra, FloatArray]:
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


def _determinant_slopes(window: ObjectWindow, unknowns: _Unknowns) -> _Unknowns:
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


def _product(one: Spectra, other: Spectra) -> FloatArray:
    """Dot products of pictures, shape (..., 2, n, n), of transforms (..., 2, n, n // 2 + 1): shape (...)."""
    of_column = np.einsum("...iyx,...iyx->...x", one.view(np.float32), other.view(np.float32)).astype(np.float64)
    both = 2.0 * of_column.sum(axis=-1) - of_column[..., :2].sum(axis=-1) - of_column[..., -2:].sum(axis=-1)
    return np.asarray(both / one.shape[-2] ** 2)
