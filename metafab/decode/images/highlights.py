"""Saturated and invalid pixels, and highlights about them, in the Wiener deconvolution of a tile.

The Wiener filter is the mean of a Gaussian process: sharp images have the texture's spectrum, pixels white noise. Two
facts are added. A broken pixel holds no datum: its value is free. A highlight is brighter than any texture: where the
sharp image rises far above the frame's level, its light has a variance of its own. Both are unknowns of a small linear
system, whose matrix holds the filter's kernels at the distances of the pixels. The light of highlights is taken off
the blurred tile, the rest is deconvolved, and the light is added again, so that neither the clipped pixels nor the
filter's side lobes draw tails.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
import scipy.linalg
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray

#: Least brightness of a highlight, as a multiple of the frame's level.
_BRIGHT = 4.0
#: Distance of a highlight's sharp image from its broken pixels, about the pair's width.
_REACH_PX = 12
#: Error of the calibration, as a share of a highlight's blurred light: it adds to the noise there.
_MODEL_ERROR = 0.005
#: Most unknowns of a tile and depth, 0.1 GFlop: with more of them, a surface is overexposed, and stays as it is.
_MOST_UNKNOWNS = 600
#: Share of the noise's precision that keeps the system of neighbouring free pixels regular.
_RIDGE = 1e-6


@dataclass(frozen=True)
class SeparatedTile:
    """A tile without its highlights."""

    #: Shape (n_ky, n_kx), transform of the tile with its broken pixels filled in, less the highlights.
    spectrum: NDArray[np.complex64]
    light: NDArray[np.float32]  #: Shape (n_y, n_x), sharp light of the highlights, electrons.


def one_depth_each(broken: NDArray[np.bool_], label: NDArray[np.int32], numbers: NDArray[np.intp]) -> NDArray[np.intp]:
    """Number of the depth at which each broken pixel of a tile is solved: shape (n_y, n_x); 0 for none.

    Broken pixels that touch each other belong to one highlight: all have the depth of most of them. Solved in parts,
    the pixels of the other part would pass for data. ``label``, shape (n_y, n_x), is the number of each pixel's depth,
    ``numbers``, shape (n,), are those that count.
    """
    component, count = connected_components(broken, np.ones((3, 3)))
    votes = np.stack([np.bincount(component[broken & (label == one)], minlength=count + 1) for one in numbers], axis=1)
    return np.asarray(np.where(votes.any(axis=1), numbers[votes.argmax(axis=1)], 0)[component])


def separated(
    spectrum: NDArray[np.complex64],
    transfer: NDArray[np.complex64],
    ratio: NDArray[np.float32],
    broken: NDArray[np.bool_],
    noise_variance: float,
    level_e: float,
) -> SeparatedTile | None:
    """Fill in the broken pixels of a tile, and separate the highlights about them; None with too many of them.

    Args:
        spectrum: shape (n_ky, n_kx), of the tile.
        transfer: shape (n_ky, n_kx), H of the pair at the highlights' depth.
        ratio: shape (n_ky, n_kx), noise over texture.
        broken: shape (n_y, n_x).
        noise_variance: of a pixel, electrons squared.
        level_e: brightness of the frame's lit pixels.
    """
    free = np.argwhere(broken)
    if len(free) > _MOST_UNKNOWNS:
        return None
    square = transfer.real.astype(np.float64) ** 2 + transfer.imag.astype(np.float64) ** 2
    total = np.maximum(square + ratio, 1e-30)
    precision = ratio / total
    system = _System(transfer, precision, broken.shape)
    filled = system.solved(spectrum, free, np.zeros((0, 2), dtype=np.intp), 0.0)
    wiener = scipy.fft.irfft2(np.conj(transfer) / total * filled.spectrum, broken.shape)
    near = binary_dilation(broken, iterations=_REACH_PX)
    bright = np.argwhere(near & (wiener > _BRIGHT * level_e))
    if not len(bright) or len(free) + len(bright) > _MOST_UNKNOWNS:
        return filled
    seen = np.zeros(broken.shape)
    seen[tuple(bright.T)] = wiener[tuple(bright.T)]
    blurred = float(scipy.fft.irfft2(transfer * scipy.fft.rfft2(seen), broken.shape).max())
    variance = noise_variance + (_MODEL_ERROR * blurred) ** 2
    return system.solved(spectrum, free, bright, variance / float(seen.max()) ** 2)


class _System:
    """Normal equations of the free pixels and highlights of a tile."""

    def __init__(self, transfer: NDArray[np.complex64], precision: FloatArray, shape: tuple[int, ...]) -> None:
        self.transfer, self.precision, self.shape = transfer, precision, shape
        backward = precision * np.conj(transfer)
        self.filters = (precision.astype(np.complex128), backward)
        spectra = (self.filters[0], np.conj(backward), backward * transfer)
        self.kernels = [self._image(one) for one in spectra]

    def _image(self, spectrum: NDArray[np.complexfloating[Any, Any]]) -> FloatArray:
        return np.asarray(scipy.fft.irfft2(spectrum, self.shape), dtype=np.float64)

    def _block(self, kernel: int, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> FloatArray:
        """Values of a kernel at the distances of pixels: shape (len(rows), len(columns))."""
        away = rows[:, None] - columns[None]
        return np.asarray(self.kernels[kernel][away[..., 0] % self.shape[0], away[..., 1] % self.shape[1]])

    def solved(
        self, spectrum: NDArray[np.complex64], free: NDArray[np.intp], bright: NDArray[np.intp], ridge: float
    ) -> SeparatedTile:
        """Non-negative light of the bright pixels, and with it the values of the free pixels, which have no datum.

        Both sets of pixels are (row, column), shape (n, 2). ``ridge`` is the variance of the noise over that of the
        highlights' light.
        """
        own = self._block(0, free, free) + _RIDGE * np.eye(len(free))
        light = np.zeros(self.shape)
        if len(bright):
            across = -self._block(1, free, bright)
            other = self._block(2, bright, bright) + ridge * np.eye(len(bright))
            matrix = np.block([[own, across], [across.T, other]])
            right = np.concatenate([-self._at(0, spectrum, free), self._at(1, spectrum, bright)])
            solution = _solved(matrix, right)
            light[tuple(bright.T)] = np.maximum(solution[len(free) :], 0.0)
            spectrum = np.asarray(spectrum - self.transfer * scipy.fft.rfft2(light), dtype=np.complex64)
        values = np.zeros(self.shape)
        values[tuple(free.T)] = -_solved(own, self._at(0, spectrum, free))
        whole = (spectrum + scipy.fft.rfft2(values)).astype(np.complex64)
        return SeparatedTile(whole, light.astype(np.float32))

    def _at(self, which: int, spectrum: NDArray[np.complex64], places: NDArray[np.intp]) -> FloatArray:
        """A filtered tile at pixels: shape (n,)."""
        return np.asarray(self._image(self.filters[which] * spectrum)[tuple(places.T)])


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of a positive definite system, shape (n,)."""
    return np.asarray(scipy.linalg.cho_solve(scipy.linalg.cho_factor(matrix), right))
