"""Small objects before a surface, from the light that does not fit the surface's depth.

Both images of a surface, each blurred once more by the other's PSF at the surface's depth, are equal up to contrast. In
their difference, the null channel, the surface vanishes with any texture, seen or hidden. What is left is the light of
an object at another depth, and the mean light that the object hides, as if negative and in the object's place.

An object is a rectangle of even light, of a contrast of its own, with a texture of 1/k spectrum. Its evidence is that
of a Gaussian process, with the texture and both mean intensities integrated out. Depth, place and size maximise it by
ascent. The evidence falls for rectangles that are too large as well as for those that are too small.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.ndimage import find_objects
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.matching.levels import LOWEST_FREQUENCY
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.layer_light import LayerOptics
from metafab.decode.segmentation.prepared_frame import PreparedFrame

#: Side of the square about a blob in which the null channel is computed, and its even part, downsampled pixels.
_WINDOW, _EVEN = 96, 44
#: Largest side of a blob that is searched, downsampled pixels: larger objects have segments.
_LARGEST_BLOB = 36
#: Fewest downsampled pixels of a blob, as windows and blur make it wide even for a small object, and the misfit that
#: one of them has at least.
_FEWEST, _PEAK_MISFIT = 40, 6.0
#: Most blobs that are searched; those of the largest misfit are taken.
_MOST_BLOBS = 40
#: Rms contrast of an object's texture, rms of its mean intensities over the surface's, and the pair's error as a share
#: of the surface's light.
_TEXTURE, _LEVEL, _MODEL_ERROR = 0.2, 0.7, 0.01
#: Candidate depths: from this ratio to the surface's vergence to this share of the largest calibrated one, their
#: number, and how many of them are refined.
_NEAREST_RATIO, _RANGE_SHARE, _CANDIDATES, _REFINED = 1.12, 0.97, 9, 2
#: Steps of the sides of rectangles, downsampled pixels: at each candidate, and while depth is refined.
_COARSE_STEPS, _FINE_STEPS = (2.0, 1.0), (0.5, 0.25, 0.12)
#: Moves of a rectangle (middle and half sides along y and x): as a whole, and each of its sides.
_MOVES = np.array(
    [[1, 0, 0, 0], [0, 1, 0, 0], *([y, x, abs(y), abs(x)] for y, x in ((0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5)))]
)
#: Most sweeps over the sides in one step, and least half side.
_SWEEPS, _LEAST_HALF = 5, 0.6
#: Extent of a blob beyond its object on each side: blur and the misfit's window, downsampled pixels.
_HALO = 4.0
#: Evidence over that of no object, and over that of light at the surface's own depth, that an object needs.
_LEAST_EVIDENCE, _LEAST_MARGIN = 60.0, 20.0
#: Mean energy over that of noise that an object leaves in its blob at most: true ones left 0.8 to 1.8, light of other
#: causes 40 or more.
_LEFT = 3.0
#: Error of depth in standard errors of the evidence at the best rectangle: measured on 20 objects of 20 to 39 px, where
#: what is not a rectangle of even light, and the pair's own error, outweigh noise.
_ERROR_RATIO = 4.0
#: Least light of an object over the surface's.
_LEAST_LIGHT = 0.1
#: Side of the window over which what is left in the null channel is averaged, downsampled pixels.
_POOLED = 5

Rectangle = NDArray[np.float64]


@dataclass(frozen=True)
class SmallObject:
    """An object that the segmentation by windows does not see; rows and columns of the downsampled pixels."""

    vergence_per_m: float  #: 1/depth.
    relative_error: float  #: Standard error of the depth over the depth.
    evidence: float  #: Natural logarithm of its probability over that of the surface alone.
    mask: NDArray[np.bool_]  #: Shape (n_y, n_x) of the blob, pixels more than half covered.
    misfit: NDArray[np.float32]  #: Shape (n_y, n_x) of the blob, energy left in the null channel over that of noise.
    blob: tuple[slice, slice]  #: Rows and columns of the blob.


def small_objects(
    prepared: PreparedFrame,
    optics: LayerOptics,
    vergence_per_m: FloatArray,
    foreign: NDArray[np.bool_],
    misfit: NDArray[np.float32],
) -> list[SmallObject]:
    """Search the small objects behind light that does not fit its segment's depth.

    Args:
        prepared: the frame.
        optics: the pair on its downsampled pixels.
        vergence_per_m: shape (n_y, n_x), 1/depth of each pixel's segment; NaN for none.
        foreign: shape (n_y, n_x), whether a pixel holds light that does not fit its segment.
        misfit: shape (n_y, n_x), misfit of each pixel at its segment's depth.

    Returns:
        The objects found, those of the largest misfit first; none where light of the surface's depth explains as much.
    """
    component, _ = connected_components(foreign)
    blobs: list[tuple[float, tuple[slice, slice], NDArray[np.bool_]]] = []
    for number, (rows, columns) in enumerate(find_objects(component), start=1):
        at = rows, columns
        own = np.asarray(component[at] == number)
        strength = misfit[at][own]
        if own.sum() >= _FEWEST and strength.max() >= _PEAK_MISFIT and max(own.shape) <= _LARGEST_BLOB:
            blobs.append((float(strength.sum()), at, own))
    found = []
    for _, at, own in sorted(blobs, key=lambda one: -one[0])[:_MOST_BLOBS]:
        weight = np.where(own, misfit[at], np.float32(0.0)).astype(np.float64)
        one = _search(prepared, optics, float(np.median(vergence_per_m[at][own])), at, weight)
        if one is not None:
            found.append(one)
    return found


def _search(
    prepared: PreparedFrame, optics: LayerOptics, surface_per_m: float, at: tuple[slice, slice], weight: FloatArray
) -> SmallObject | None:
    """The object in a blob: ``weight``, shape (n_y, n_x), is its misfit, 0 outside; None if nothing fits."""
    total = weight.sum()
    row, column = (float((weight.sum(axis=1 - axis) * np.arange(weight.shape[axis])).sum() / total) for axis in (0, 1))
    middle = round(at[0].start + row), round(at[1].start + column)
    channel = _NullChannel.of(prepared, optics, middle, surface_per_m)
    if channel is None:
        return None
    # Rectangles are in the channel's window, whose middle is that of the blob.
    first = np.array([at[0].start - middle[0], at[1].start - middle[1]]) + _WINDOW // 2
    limits = np.array([first - 0.5, first + weight.shape - np.array(0.5)])
    half = np.maximum(1.5, 0.5 * math.sqrt(np.count_nonzero(weight)) - _HALO)
    start = np.array([first[0] + row, first[1] + column, half, half])
    largest = _RANGE_SHARE * float(1.0 / optics.calibration.kernels.psf.depth_m.min())
    candidates = np.linspace(_NEAREST_RATIO * surface_per_m, largest, _CANDIDATES)
    if largest <= candidates[0]:
        return None
    fit = _Fit(channel, limits, (surface_per_m, largest / _RANGE_SHARE))
    coarse = [(*fit.ascended(vergence, start, np.ones(2), _COARSE_STEPS), vergence) for vergence in candidates.tolist()]
    best = sorted(coarse, key=lambda one: -one[0])[:_REFINED]
    refined = [fit.refined(vergence, one, float(candidates[1] - candidates[0])) for _, one, vergence in best]
    evidence, vergence, rectangle, light = max(refined, key=lambda one: one[0])
    beside, _ = fit.ascended(surface_per_m, rectangle, light, (1.0,))
    around = [fit.evidence(vergence * (1.0 + one), rectangle, light) for one in (-0.01, 0.01)]
    curvature = (2.0 * evidence - around[0] - around[1]) / 0.01**2
    if evidence < _LEAST_EVIDENCE or evidence - beside < _LEAST_MARGIN or curvature <= 0.0 or vergence > largest:
        return None
    cover, left = fit.explained(vergence, rectangle, light)
    inside = tuple(slice(int(f), int(f) + n) for f, n in zip(first, weight.shape, strict=True))
    cover, left = cover[inside], left[inside]
    own = weight > 0.0
    if left[own].mean() > _LEFT or not (cover > 0.5).any():
        return None
    error = _ERROR_RATIO / math.sqrt(curvature)
    return SmallObject(vergence, error, evidence, cover > 0.5, left, at)


@dataclass(frozen=True)
class _NullChannel:
    """The null channel of a surface in a window, and the pair there; transforms of shape (n, n // 2 + 1)."""

    optics: LayerOptics
    nodes: NDArray[np.complex64]  # (n_depth, 2, n, n // 2 + 1), transforms of the pair at the calibrated depths
    crossed: NDArray[np.complex64]  # (2, n, n // 2 + 1), what multiplies each image's transform
    spectrum: NDArray[np.complex128]  # of the null channel
    precision: FloatArray  # inverse power of its noise and of the model's error
    light: float  # mean light of the surface, electrons

    @classmethod
    def of(
        cls, prepared: PreparedFrame, optics: LayerOptics, middle: tuple[int, int], surface_per_m: float
    ) -> _NullChannel | None:
        """The null channel about a pixel; None without light in both images."""
        n, margin, step = _WINDOW, prepared.downsampling.margin, prepared.downsampling.step
        window, level = np.zeros((2, n, n)), np.zeros(2)
        corner = [place + margin - n // 2 for place in middle]
        part = tuple(slice(max(0, c), min(c + n, m)) for c, m in zip(corner, prepared.images.shape[1:], strict=True))
        images = prepared.images[:, *part]
        level = np.median(images, axis=(1, 2)).astype(np.float64)
        if not (level > 0.0).all():
            return None
        to = tuple(slice(p.start - c, p.stop - c) for p, c in zip(part, corner, strict=True))
        window[:, *to] = images - level[:, None, None]
        fade = (n - _EVEN) // 2
        taper = np.ones(n)
        taper[:fade] = np.sin(0.5 * np.pi * (np.arange(fade) + 0.5) / fade) ** 2
        taper[n - fade :] = taper[fade - 1 :: -1]
        block = optics.field_weights.shape[0] / prepared.downsampling.shape[0]
        at = [min(int(place * block), m - 1) for place, m in zip(middle, optics.field_weights.shape[:2], strict=True)]
        kernels = np.tensordot(optics.field_weights[at[0], at[1]], np.moveaxis(optics.kernels, 2, 0), axes=(0, 0))
        size = kernels.shape[-1]
        padded = np.zeros((*kernels.shape[:2], n, n), dtype=np.float32)
        padded[..., :size, :size] = kernels
        centred = np.roll(padded, (-(size // 2), -(size // 2)), (-2, -1))
        nodes = scipy.fft.rfft2(centred).astype(np.complex64).swapaxes(0, 1)
        light = float(level.mean())
        surface = _mixed(optics, nodes, surface_per_m)
        crossed = surface[::-1] * (light / level * np.array([1.0, -1.0]))[:, None, None]
        noise = (level + prepared.levels.read_noise_e**2) * (n / step) ** 2
        both = np.abs(surface[0] * surface[1]) ** 2
        error = 2.0 * (_MODEL_ERROR * light * n) ** 2 * both * _texture_power(n, step)
        power = (np.abs(crossed) ** 2 * noise[:, None, None]).sum(axis=0) + error + 1e-6 * noise.mean()
        spectrum = (crossed * scipy.fft.rfft2(window * taper[:, None] * taper)).sum(axis=0)
        return cls(optics, nodes, crossed, spectrum, 1.0 / power, light)

    def response(self, vergence_per_m: float) -> NDArray[np.complex128]:
        """Transforms of the null channel of a point of light at a depth in either image: shape (2, n, n // 2 + 1)."""
        return np.asarray(self.crossed * _mixed(self.optics, self.nodes, vergence_per_m))


def _mixed(optics: LayerOptics, nodes: NDArray[np.complex64], vergence_per_m: float) -> NDArray[np.complex64]:
    weights = optics.calibration.depth_weights(np.array([vergence_per_m]))[0]
    return np.asarray(np.tensordot(weights.astype(np.float32), nodes, axes=(0, 0)))


def _texture_power(n: int, step: int) -> FloatArray:
    """Spectrum of a texture of unit variance, mean 1 over all n x n frequencies: shape (n, n // 2 + 1)."""
    ky, kx = frequencies((n, n), step)
    power = 1.0 / (ky[:, None] ** 2 + kx[None, :] ** 2 + LOWEST_FREQUENCY**2)
    return np.asarray(power * (n * n / (_BOTH_HALVES * power).sum()))


#: Weights of the frequencies of real transforms: all but the first and last column stand for two.
_BOTH_HALVES = np.full(_WINDOW // 2 + 1, 2.0)
_BOTH_HALVES[[0, -1]] = 1.0


@dataclass(frozen=True)
class _Response:
    """What the evidence at one depth needs; correlations are of pixels' light, over the window's lags."""

    channel: NDArray[np.complex128]  # (2, n, n // 2 + 1), response to light in either image
    pairs: NDArray[np.complex128]  # (3, n, n // 2 + 1), products of responses over the noise: x x, x y, y y
    matched: NDArray[np.complex128]  # (2, n, n // 2 + 1), matched filter output, transformed
    data: FloatArray  # (2, n, n), matched filter output for a pixel's light
    lags: FloatArray  # (3, n n), correlation of responses: x with x, x with y, y with y


class _Fit:
    """Evidence of rectangles of light at all depths. Rectangles: middle (row, column), half sides (rows, columns)."""

    def __init__(self, channel: _NullChannel, limits: FloatArray, range_per_m: tuple[float, float]) -> None:
        """Evidence of objects before a surface.

        Args:
            channel: null channel of the surface.
            limits: shape (2, 2), least and largest (row, column) of an object's pixels.
            range_per_m: least and largest vergence.
        """
        self._channel, self._limits, self._range_per_m = channel, limits, range_per_m
        self._responses: dict[float, _Response] = {}
        n = _WINDOW
        self._pixel = np.sinc(scipy.fft.fftfreq(n))[:, None] * np.sinc(scipy.fft.rfftfreq(n))
        pixels, self._frequencies = np.arange(n), (scipy.fft.fftfreq(n), scipy.fft.rfftfreq(n))
        self._waves = tuple(np.exp(2j * np.pi * pixels[:, None] * one) for one in self._frequencies)
        self._grids: dict[tuple[int, int], tuple[NDArray[np.intp], FloatArray]] = {}
        covariance = scipy.fft.irfft2(_texture_power(n, channel.optics.downsampling.step), (n, n))
        self._covariance = (covariance / covariance[0, 0]).ravel()

    def ascended(
        self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray, steps: Sequence[float]
    ) -> tuple[float, Rectangle]:
        """Ascent over the rectangle by moves of its sides at one depth: the evidence and the rectangle."""
        best = self.evidence(vergence_per_m, rectangle, light)
        for step in steps:
            for _ in range(_SWEEPS):
                moved = False
                for move in _MOVES:
                    for change in (step, -step):
                        other = rectangle + change * move
                        if not self._is_allowed(other):
                            continue
                        evidence = self.evidence(vergence_per_m, other, light)
                        if evidence > best:
                            best, rectangle, moved = evidence, other, True
                            break
                if not moved:
                    break
        return best, rectangle

    def refined(
        self, vergence_per_m: float, rectangle: Rectangle, step_per_m: float
    ) -> tuple[float, float, Rectangle, FloatArray]:
        """Ascent over rectangle, depth and contrast: evidence, depth, rectangle and light in both images."""
        light, best = np.ones(2), -np.inf
        for step in _FINE_STEPS:
            light = self._system(vergence_per_m, rectangle, light).light
            best, rectangle = self.ascended(vergence_per_m, rectangle, light, (step,))
            for change in (step, 0.5 * step, -step, -0.5 * step):
                while self._range_per_m[0] < (other := vergence_per_m + change * step_per_m) < self._range_per_m[1]:
                    evidence = self.evidence(other, rectangle, light)
                    if evidence <= best:
                        break
                    best, vergence_per_m = evidence, other
        return best, vergence_per_m, rectangle, light

    def evidence(self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray) -> float:
        """Logarithm of the evidence over that of no object.

        Args:
            vergence_per_m: 1/depth.
            rectangle: shape (4,).
            light: shape (2,), light of the texture in both images over the surface's.
        """
        return self._system(vergence_per_m, rectangle, light).evidence

    def explained(
        self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray
    ) -> tuple[FloatArray, NDArray[np.float32]]:
        """Coverage of pixels, and energy left in the null channel over that of noise: shapes (n, n)."""
        n, channel, system = _WINDOW, self._channel, self._system(vergence_per_m, rectangle, light)
        rows, columns = _covered(rectangle)
        along_y, along_x = self._sides(rectangle)
        of_texture = scipy.fft.rfft2(system.texture) * self._pixel
        both = light[:, None, None] * of_texture + system.levels[:, None, None] * (along_y[:, None] * along_x)
        model = (self._response(vergence_per_m).channel * both).sum(axis=0)
        left = scipy.fft.irfft2((channel.spectrum - model) * (n * np.sqrt(channel.precision)), (n, n)) ** 2
        return np.outer(rows, columns), window_means(left.astype(np.float32)[None], _POOLED)[0]

    def _is_allowed(self, rectangle: Rectangle) -> bool:
        middle, half = rectangle[:2], rectangle[2:]
        low, high = self._limits
        return bool((half >= _LEAST_HALF).all() and (middle - half >= low).all() and (middle + half <= high).all())

    def _response(self, vergence_per_m: float) -> _Response:
        kept = self._responses.get(vergence_per_m)
        if kept is None:
            n, channel = _WINDOW, self._channel.response(vergence_per_m)
            pairs = np.stack([channel[i].conj() * channel[j] for i, j in ((0, 0), (0, 1), (1, 1))])
            pairs *= self._channel.precision
            matched = channel.conj() * (self._channel.spectrum * self._channel.precision)
            lags = scipy.fft.irfft2(pairs * self._pixel**2, (n, n)) * n**2
            data = scipy.fft.irfft2(matched * self._pixel, (n, n)) * n**2
            kept = _Response(channel, pairs * _BOTH_HALVES, matched * _BOTH_HALVES, data, lags.reshape(3, -1))
            self._responses[vergence_per_m] = kept
        return kept

    def _sides(self, rectangle: Rectangle) -> list[NDArray[np.complex128]]:
        """Fourier transforms of a rectangle of height 1 along y, shape (n,), and x, shape (n // 2 + 1,)."""
        return [
            2.0 * half * np.sinc(2.0 * half * one) * np.exp(-2j * np.pi * one * middle)
            for middle, half, one in zip(rectangle[:2], rectangle[2:], self._frequencies, strict=True)
        ]

    def _grid(self, rows: int, columns: int) -> tuple[NDArray[np.intp], FloatArray]:
        """Lags between the pixels of a rectangle, and the Cholesky factor of a texture's covariance on them."""
        kept = self._grids.get((rows, columns))
        if kept is None:
            y, x = (one.ravel() for one in np.indices((rows, columns)))
            lag = ((y[:, None] - y) % _WINDOW) * _WINDOW + (x[:, None] - x) % _WINDOW
            covariance = self._covariance[lag] + 1e-6 * np.eye(y.size)
            kept = self._grids[rows, columns] = lag, cholesky(covariance, lower=True, check_finite=False)
        return kept

    def _system(self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray) -> _Solution:
        """Texture and mean intensities of a rectangle, and their evidence.

        The unknowns are independent and of unit variance in the prior: one for each pixel's texture, and both means.
        """
        response, unit, level = self._response(vergence_per_m), self._channel.light, _LEVEL * self._channel.light
        rows, columns = _covered(rectangle)
        at = tuple(slice(int(one[0]), int(one[-1]) + 1) for one in (np.flatnonzero(rows), np.flatnonzero(columns)))
        part = np.outer(rows[at[0]], columns[at[1]])
        lag, texture = self._grid(*part.shape)
        cover, data = part.ravel(), response.data[:, *at].reshape(2, -1)
        prior = texture * (_TEXTURE * unit * cover)[:, None]
        of_x, crossed, of_y = (one[lag] for one in response.lags)
        textures = light[0] ** 2 * of_x + light[1] ** 2 * of_y + light[0] * light[1] * (crossed + crossed.T)
        # The means are those of the exact rectangle: its sides need not lie between pixels.
        along_y, along_x = self._sides(rectangle)
        (xx, xy, yy), power_y, power_x = response.pairs, np.abs(along_y) ** 2, np.abs(along_x) ** 2
        among = [power_y @ one.real @ power_x for one in (xx, xy, xy, yy)]
        both = np.stack([light[0] * xx + light[1] * xy.conj(), light[0] * xy + light[1] * yy]) * self._pixel
        wave_y, wave_x = self._waves[0][at[0]] * along_y, self._waves[1][at[1]] * along_x
        levels = (wave_y @ both @ wave_x.T).real.reshape(2, -1)
        count = cover.size
        matrix = np.eye(count + 2)
        matrix[:count, :count] += prior.T @ (textures @ prior)
        matrix[count:, :count] = level * (levels @ prior)
        matrix[count:, count:] += level**2 * np.reshape(among, (2, 2))
        means = (along_y.conj() @ response.matched @ along_x.conj()).real
        target = np.concatenate([prior.T @ (light @ data), level * means])
        factor = cholesky(matrix, lower=True, check_finite=False)
        half = solve_triangular(factor, target, lower=True, check_finite=False)
        evidence = float(0.5 * half @ half - np.log(np.diag(factor)).sum())
        return _Solution(evidence, factor, half, prior, at, unit)


@dataclass(frozen=True)
class _Solution:
    """Evidence of a rectangle, and what its texture and mean intensities follow from."""

    evidence: float
    factor: FloatArray
    half: FloatArray
    prior: FloatArray
    at: tuple[slice, ...]
    unit: float

    @cached_property
    def _unknowns(self) -> FloatArray:
        return np.asarray(solve_triangular(self.factor.T, self.half, lower=False, check_finite=False))

    @property
    def levels(self) -> FloatArray:
        """Mean light in both images minus that of the surface, shape (2,), electrons."""
        return self._unknowns[-2:] * (_LEVEL * self.unit)

    @property
    def light(self) -> FloatArray:
        """Mean light in both images over that of the surface, shape (2,)."""
        return np.maximum(1.0 + self.levels / self.unit, _LEAST_LIGHT)

    @property
    def texture(self) -> FloatArray:
        """Light of the texture, shape (n, n), electrons."""
        texture = np.zeros((_WINDOW, _WINDOW))
        inside = texture[self.at]
        inside[:] = (self.prior @ self._unknowns[:-2]).reshape(inside.shape)
        return texture


def _covered(rectangle: Rectangle) -> tuple[FloatArray, FloatArray]:
    """Shares of the window's rows and columns that a rectangle covers."""
    pixels = np.arange(_WINDOW)
    rows, columns = (
        np.clip(np.minimum(pixels + 0.5, middle + half) - np.maximum(pixels - 0.5, middle - half), 0.0, 1.0)
        for middle, half in zip(rectangle[:2], rectangle[2:], strict=True)
    )
    return rows, columns
