"""The null channel of a surface, and the evidence of rectangles and ellipses of light before it.

Both images of a surface, each blurred once more by the other's PSF at the surface's depth, are equal up to contrast. In
their difference, the null channel, the surface vanishes with any texture, seen or hidden. What is left is the light of
an object at another depth, less the mean light that the object hides, in the object's place.

The evidence of a rectangle of even light with a texture of 1/k spectrum is that of a Gaussian process, with the texture
and both mean intensities integrated out. It needs one Cholesky factor of a matrix of the rectangle's pixels. An ellipse
is that rectangle without its corners: it has the same unknowns, of which those that it does not cover follow the prior.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.special import j1

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.matching.levels import LOWEST_FREQUENCY
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.layered.layer_light import LayerOptics, at_depth
from metafab.decode.segmentation.prepared_frame import PreparedFrame

#: Side of the square about a pixel in which a null channel is computed, downsampled pixels.
WINDOW = 96
#: Side of the middle of the window where its taper is 1, downsampled pixels.
_EVEN = 44
#: Rms contrast of an object's texture.
_TEXTURE = 0.2
#: Prior rms of an object's mean light less the surface's, over the surface's.
_LEVEL = 0.7
#: Error of the pair as a share of the surface's light.
_MODEL_ERROR = 0.01
#: Least light of an object over the surface's.
_LEAST_LIGHT = 0.1
#: Side of the window over which the residual of the null channel is averaged, downsampled pixels.
_POOLED = 5
#: Last diagonal element of a matrix whose last row is the target: above twice any evidence, so that its Cholesky factor
#: exists.
_UNREACHED = 1e30

#: Points along each side of a pixel by which the share of it that an ellipse covers is counted.
_POINTS = 5

#: Middle (row, column) and half sides (rows, columns), downsampled pixels; of an ellipse, those of its bounding box.
Rectangle = NDArray[np.float64]


@dataclass(frozen=True)
class NullChannel:
    """The null channel of a surface in a window, and the pair there; transforms of shape (n, n // 2 + 1)."""

    optics: LayerOptics  #: The pair.
    nodes: NDArray[np.complex64]  #: Shape (n_depth, 2, n, n // 2 + 1), transforms of the pair at the calibrated depths.
    crossed: NDArray[np.complex128]  #: Shape (2, n, n // 2 + 1), factor of each image's transform.
    spectrum: NDArray[np.complex128]  #: Transform of the null channel.
    precision: FloatArray  #: Inverse power of its noise and of the model's error.
    light: float  #: Mean light of the surface, electrons.

    @classmethod
    def of(
        cls, prepared: PreparedFrame, optics: LayerOptics, middle: tuple[int, int], surface_per_m: float
    ) -> NullChannel | None:
        """The null channel about a pixel; None without light in both images."""
        n, step = WINDOW, prepared.downsampling.step
        images, inside = prepared.about(middle, n)
        level = np.median(images[:, inside], axis=1).astype(np.float64)
        if not (level > 0.0).all():
            return None
        window = np.where(inside, images - level[:, None, None], 0.0)
        fade = (n - _EVEN) // 2
        taper = np.ones(n)
        taper[:fade] = np.sin(0.5 * np.pi * (np.arange(fade) + 0.5) / fade) ** 2
        taper[n - fade :] = taper[fade - 1 :: -1]
        nodes = optics.pair_about(middle, n)
        light = float(level.mean())
        surface = at_depth(optics, nodes, surface_per_m)
        crossed = surface[::-1] * (light / level * np.array([1.0, -1.0]))[:, None, None]
        noise = (level + prepared.levels.read_noise_e**2) * (n / step) ** 2
        both = np.abs(surface[0] * surface[1]) ** 2
        error = 2.0 * (_MODEL_ERROR * light * n) ** 2 * both * _texture_power(n, step)
        power = (np.abs(crossed) ** 2 * noise[:, None, None]).sum(axis=0) + error + 1e-6 * noise.mean()
        spectrum = (crossed * scipy.fft.rfft2(window * taper[:, None] * taper)).sum(axis=0)
        return cls(optics, nodes, crossed, spectrum, 1.0 / power, light)

    def response(self, vergence_per_m: float) -> NDArray[np.complex128]:
        """Transforms of the null channel of a point of light at a depth in either image: shape (2, n, n // 2 + 1)."""
        return np.asarray(self.crossed * at_depth(self.optics, self.nodes, vergence_per_m))


def _texture_power(n: int, step: int) -> FloatArray:
    """Spectrum of a texture of unit variance, mean 1 over all n x n frequencies: shape (n, n // 2 + 1)."""
    ky, kx = frequencies((n, n), step)
    power = 1.0 / (ky[:, None] ** 2 + kx[None, :] ** 2 + LOWEST_FREQUENCY**2)
    return np.asarray(power * (n * n / (BOTH_HALVES * power).sum()))


#: Weights of the frequencies of real transforms: all but the first and last column stand for two.
BOTH_HALVES = np.full(WINDOW // 2 + 1, 2.0)
BOTH_HALVES[[0, -1]] = 1.0


def ellipse_light(
    ky: FloatArray, kx: FloatArray, middle: tuple[FloatArray, FloatArray], half: tuple[FloatArray, FloatArray]
) -> NDArray[np.complex128]:
    """Transform of ellipses of unit height.

    Args:
        ky: frequencies along y, cycles a pixel; all arguments have shapes that broadcast.
        kx: frequencies along x.
        middle: row and column.
        half: half axes along y and x, pixels.
    """
    # Bessel's function over its argument is 1/2 at zero.
    argument = np.maximum(2.0 * np.pi * np.hypot(half[0] * ky, half[1] * kx), 1e-9)
    area = np.pi * half[0] * half[1]
    return np.asarray(2.0 * area * j1(argument) / argument * np.exp(-2j * np.pi * (middle[0] * ky + middle[1] * kx)))


class ShapeEvidence:
    """Evidence of rectangles, or of ellipses, of light at all depths; earlier results are cached."""

    def __init__(self, channel: NullChannel, *, is_round: bool = False) -> None:
        """Evidence of objects before the surface of a null channel; ellipses if they are round."""
        self._channel, self.is_round, n = channel, is_round, WINDOW
        self._frequencies = scipy.fft.fftfreq(n), scipy.fft.rfftfreq(n)
        self._pixel = np.sinc(self._frequencies[0])[:, None] * np.sinc(self._frequencies[1])
        self._waves = tuple(np.exp(2j * np.pi * np.arange(n)[:, None] * one) for one in self._frequencies)
        self._data = channel.spectrum * channel.precision
        self._evidence: dict[tuple[float, ...], float] = {}
        self._responses: dict[tuple[float, ...], _Response] = {}
        self._sides: dict[tuple[int, float, float], _Side] = {}

    @property
    def of_ellipses(self) -> ShapeEvidence:
        """The evidence of ellipses before the same surface."""
        return ShapeEvidence(self._channel, is_round=True)

    def at(self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray) -> float:
        """Logarithm of the evidence over that of no object.

        Args:
            vergence_per_m: 1/depth.
            rectangle: shape (4,).
            light: shape (2,), light of the texture in both images over the surface's.
        """
        place = vergence_per_m, *rectangle.tolist(), *light.tolist()
        kept = self._evidence.get(place)
        if kept is None:
            kept = self._evidence[place] = self._solution(vergence_per_m, rectangle, light).evidence
        return kept

    def light(self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray) -> FloatArray:
        """Mean light of a rectangle in both images over that of the surface, shape (2,), given that of its texture."""
        return self._solution(vergence_per_m, rectangle, light).light

    def left(self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray) -> NDArray[np.float32]:
        """Energy that a rectangle leaves in the null channel over that of noise: shape (n, n)."""
        n, channel, solution = WINDOW, self._channel, self._solution(vergence_per_m, rectangle, light)
        extent = self._extent(rectangle)
        texture = scipy.fft.rfft2(solution.texture) * self._pixel
        both = light[:, None, None] * texture + solution.levels[:, None, None] * extent.light
        model = (channel.response(vergence_per_m) * both).sum(axis=0)
        left = scipy.fft.irfft2((channel.spectrum - model) * (n * np.sqrt(channel.precision)), (n, n)) ** 2
        return np.asarray(window_means(left.astype(np.float32)[None], _POOLED)[0])

    def cover(self, rectangle: Rectangle) -> FloatArray:
        """Share of each pixel that a rectangle covers: shape (n, n)."""
        cover, extent = np.zeros((WINDOW, WINDOW)), self._extent(rectangle)
        cover[extent.at] = extent.cover
        return cover

    def _response(self, vergence_per_m: float, light: FloatArray) -> _Response:
        place = vergence_per_m, *light.tolist()
        kept = self._responses.get(place)
        if kept is None:
            n, (x, y) = WINDOW, self._channel.response(vergence_per_m)
            lit = light[0] * x + light[1] * y
            weight = self._channel.precision * BOTH_HALVES
            lags = scipy.fft.irfft2((lit.real**2 + lit.imag**2) * self._channel.precision * self._pixel**2, (n, n))
            kept = self._responses[place] = _Response(
                np.hstack([weight * (i.real * j.real + i.imag * j.imag) for i, j in ((x, x), (x, y), (y, y))]),
                np.stack((x, y)) * (lit.conj() * weight * self._pixel),
                np.hstack([one.conj() * self._data * BOTH_HALVES for one in (x, y)]),
                scipy.fft.irfft2(lit.conj() * self._data * self._pixel, (n, n)) * n**2,
                np.roll(lags, n // 2, 1)[:, ::-1] * n**2,
            )
        return kept

    def _extent(self, rectangle: Rectangle) -> _Rectangle | _Ellipse:
        """Extent of a shape in the window."""
        middle_y, middle_x, half_y, half_x = rectangle.tolist()
        y, x = self._side(0, middle_y, half_y), self._side(1, middle_x, half_x)
        if not self.is_round:
            return _Rectangle(y, x)
        ky, kx = self._frequencies
        middle, half = (middle_y, middle_x), (half_y, half_x)
        waves = (self._waves[0][y.at], self._waves[1][x.at])
        light = ellipse_light(ky[:, None], kx[None, :], *((np.array(a), np.array(b)) for a, b in (middle, half)))
        return _Ellipse((y.at, x.at), _covered(middle, half, y.at, x.at), light, waves)

    def _side(self, axis: int, middle: float, half: float) -> _Side:
        kept = self._sides.get((axis, middle, half))
        if kept is None:
            first, last = math.floor(middle - half + 0.5), math.ceil(middle + half - 0.5)
            pixels, frequency = np.arange(first, last + 1), self._frequencies[axis]
            cover = np.minimum(pixels + 0.5, middle + half) - np.maximum(pixels - 0.5, middle - half)
            light = 2.0 * half * np.sinc(2.0 * half * frequency) * np.exp(-2j * np.pi * middle * frequency)
            wave = self._waves[axis][first : last + 1] * light
            kept = _Side(slice(first, last + 1), cover, light, np.abs(light) ** 2, wave)
            self._sides[axis, middle, half] = kept
        return kept

    def _solution(self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray) -> _Solution:
        """Texture and mean intensities of a rectangle, and their evidence.

        The unknowns are the texture of each pixel, of the covariance of :func:`_inverse_covariance`, and both means,
        independent and of unit variance in the prior.
        """
        response, unit = self._response(vergence_per_m, light), self._channel.light
        level, extent = _LEVEL * unit, self._extent(rectangle)
        cover = (_TEXTURE * unit) * extent.cover
        inverse, half_determinant = _inverse_covariance(*cover.shape, self._channel.optics.downsampling.step)
        # The means are those of the exact shape: its sides need not lie between pixels.
        among, means = extent.among(response), extent.means(response)
        levels = extent.at_pixels(response) * (level * cover)
        # The last row of the Cholesky factor of a matrix with the target as last row is the solution of the lower one.
        count = cover.size
        matrix = np.empty((count + 3, count + 3))
        _fill(matrix, inverse, cover, response.lags)
        matrix[count:-1, :count] = levels.reshape(2, -1)
        matrix[count:-1, count:-1] = level**2 * among[[[0, 1], [1, 2]]] + np.eye(2)
        matrix[-1, :count] = (cover * response.data[extent.at]).ravel()
        matrix[-1, count:-1] = level * means
        matrix[-1, -1] = _UNREACHED
        # The transpose is in LAPACK's order of elements.
        factor, failed = dpotrf(matrix.T, lower=False, clean=False, overwrite_a=True)
        if failed:
            raise np.linalg.LinAlgError(f"the system of a rectangle of {cover.shape} pixels is not positive definite")
        half = factor[:-1, -1]
        evidence = 0.5 * half @ half - np.log(np.diagonal(factor)[:-1]).sum() - half_determinant
        return _Solution(float(evidence), factor, cover, extent.at, unit)


@dataclass(frozen=True)
class _Response:
    """Terms of the evidence at one depth, for a texture lit differently in both images; a lit pixel has light 1."""

    pairs: FloatArray  # (n, 3 (n // 2 + 1)), products of both images' responses, side by side: x x, x y, y y
    lit: NDArray[np.complex128]  # (2, n, n // 2 + 1), products of either image's response and a lit pixel's
    matched: NDArray[np.complex128]  # (n, 2 (n // 2 + 1)), matched filter output of both images, side by side
    data: FloatArray  # (n, n), matched filter output for a lit pixel
    lags: FloatArray  # (n, n), correlation of lit pixels' responses at lags (i, n // 2 - 1 - j)


@dataclass(frozen=True)
class _Side:
    """Extent of a rectangle along one axis."""

    at: slice  # pixels that it covers
    cover: FloatArray  # shares of them
    light: NDArray[np.complex128]  # (n or n // 2 + 1,), transform of light of height 1
    power: FloatArray  # its squared magnitude
    wave: NDArray[np.complex128]  # (n_pixels, n or n // 2 + 1), its correlation with light at each pixel, transformed


@dataclass(frozen=True)
class _Rectangle:
    """A rectangle in the window: all sums over frequencies are products of its two sides."""

    y: _Side
    x: _Side

    @property
    def at(self) -> tuple[slice, slice]:
        """Rows and columns that it covers."""
        return self.y.at, self.x.at

    @property
    def cover(self) -> FloatArray:
        """Shares of these pixels, shape (rows, columns)."""
        return self.y.cover[:, None] * self.x.cover

    @property
    def light(self) -> NDArray[np.complex128]:
        """Transform of light of height 1, shape (n, n // 2 + 1)."""
        return np.outer(self.y.light, self.x.light)

    def among(self, response: _Response) -> FloatArray:
        """Products of both images' responses to the light, shape (3,): x x, x y, y y."""
        return np.asarray((self.y.power @ response.pairs).reshape(3, -1) @ self.x.power)

    def means(self, response: _Response) -> FloatArray:
        """Matched filter output of both images for the light, shape (2,)."""
        return np.asarray(((self.y.light.conj() @ response.matched).reshape(2, -1) @ self.x.light.conj()).real)

    def at_pixels(self, response: _Response) -> FloatArray:
        """Products of either image's response to the light and that of each lit pixel, shape (2, rows, columns)."""
        return np.asarray((self.y.wave @ response.lit @ self.x.wave.T).real)


@dataclass(frozen=True)
class _Ellipse:
    """An ellipse in the window; fields and methods as those of :class:`_Rectangle`."""

    at: tuple[slice, slice]
    cover: FloatArray
    light: NDArray[np.complex128]
    waves: tuple[NDArray[np.complex128], NDArray[np.complex128]]  # (rows, n), (columns, n // 2 + 1)

    def among(self, response: _Response) -> FloatArray:
        power = np.abs(self.light) ** 2
        return np.asarray((response.pairs.reshape(len(power), 3, -1) * power[:, None]).sum(axis=(0, 2)))

    def means(self, response: _Response) -> FloatArray:
        matched = response.matched.reshape(len(self.light), 2, -1)
        return np.asarray((matched * self.light.conj()[:, None]).sum(axis=(0, 2)).real)

    def at_pixels(self, response: _Response) -> FloatArray:
        return np.asarray((self.waves[0] @ (response.lit * self.light) @ self.waves[1].T).real)


def _covered(middle: tuple[float, float], half: tuple[float, float], rows: slice, columns: slice) -> FloatArray:
    """Share of each pixel of a box that an ellipse covers, by points in it: shape (rows, columns)."""
    points = (np.arange(_POINTS) + 0.5) / _POINTS - 0.5
    y, x = (
        (((np.arange(at.start, at.stop)[:, None] + points).ravel() - place) / length) ** 2
        for at, place, length in zip((rows, columns), middle, half, strict=True)
    )
    inside = (y[:, None] + x <= 1.0).reshape(-1, _POINTS, x.size // _POINTS, _POINTS)
    return np.asarray(inside.mean(axis=(1, 3)))


@dataclass(frozen=True)
class _Solution:
    """Evidence of a rectangle, and the solution from which its texture and mean intensities follow."""

    evidence: float  # natural logarithm, over that of no object
    factor: FloatArray  # Cholesky factor; its last column holds the solution of the lower system
    cover: FloatArray  # (rows, columns), standard deviation of the texture at each covered pixel, electrons
    at: tuple[slice, ...]  # rows and columns of these pixels in the window
    unit: float  # mean light of the surface, electrons

    @cached_property
    def _unknowns(self) -> FloatArray:
        return np.asarray(
            solve_triangular(self.factor[:-1, :-1], self.factor[:-1, -1], lower=False, check_finite=False)
        )

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
        texture = np.zeros((WINDOW, WINDOW))
        texture[self.at] = self.cover * self._unknowns[:-2].reshape(self.cover.shape)
        return texture


@lru_cache(maxsize=64)
def _inverse_covariance(rows: int, columns: int, step: int) -> tuple[FloatArray, float]:
    """Inverse of a texture's covariance on the pixels of a rectangle, and half its logarithmic determinant."""
    n = WINDOW
    lags = scipy.fft.irfft2(_texture_power(n, step), (n, n))
    y, x = (one.ravel() for one in np.indices((rows, columns)))
    covariance = lags[y[:, None] - y, x[:, None] - x] / lags[0, 0] + 1e-6 * np.eye(y.size)
    factor, _ = dpotrf(covariance, lower=True)
    inverse, _ = dpotri(factor, lower=True)
    return np.ascontiguousarray(inverse), float(np.log(np.diag(factor)).sum())


@compiled
def _fill(matrix: FloatArray, inverse: FloatArray, cover: FloatArray, lags: FloatArray) -> None:
    """Lower triangle of the pixels' part of a system: inverse covariance, and correlation of lit pixels' responses.

    ``lags`` are those of :class:`_Response`, equal for opposite lags.
    """
    rows, columns = cover.shape
    middle = lags.shape[1] // 2 - 1
    for i in range(rows):
        for j in range(columns):
            row, own, lit = matrix[i * columns + j], inverse[i * columns + j], cover[i, j]
            for k in range(i + 1):
                to, of, with_, at = row[k * columns :], own[k * columns :], cover[k], lags[i - k, middle - j :]
                for m in range(columns):
                    to[m] = of[m] + lit * with_[m] * at[m]
