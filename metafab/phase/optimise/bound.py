"""Upper bounds of the lobe peaks of any mask, tight enough to certify the optimum.

The weighted sum of peaks is p^H G p with G = sum_d w_d f_d f_d^H over the target waves f_d, for a mask p with |p| <= 1
at each of n samples. Two bounds:

- spectral: n times the largest eigenvalue of G;
- dual: for any positive d, p^H G p <= sum(d) times the largest eigenvalue of D^-1/2 G D^-1/2. The best d belongs to the
  relaxation in which each sample of the mask is a unit vector of a few components instead of one phase. The iteration
  of the mask solves the relaxation, too (Burer and Monteiro, Mathematical Programming 95, 329, 2003).

G has few target waves, so both eigenvalues are those of small matrices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray

#: Components of a sample in the relaxation: one more than the rank of the optimal solutions met so far.
_COMPONENTS = 4


@dataclass(frozen=True)
class PeakBound:
    """Upper bounds of the weighted mean of the target peaks, Strehl ratios."""

    spectral: float  #: From the largest eigenvalue of G; holds for any mask of the same mean square.
    dual: float  #: The tighter bound; holds for every mask with |p| <= 1 everywhere.
    start: ComplexArray  #: Shape (n_waves,), wave amplitudes of the main component of the relaxed solution.


def peak_bound(waves: ComplexArray, weights: FloatArray, iterations: int, seed: int) -> PeakBound:
    """Bound the sum over d of weights_d |<f_d, p>|^2 for all masks p.

    ``waves`` are the target waves f_d at the samples of the pupil, shape (n_waves, n), modulus 1; weights are positive,
    of sum 1. The bounds hold after any number of steps of the relaxation, which starts at random.
    """
    count = waves.shape[1]
    root = np.sqrt(weights)[:, None] * waves
    spectral = _largest_eigenvalue(root, np.ones(count)) / count
    random = np.random.default_rng(seed)
    shape = (_COMPONENTS, len(waves))
    amplitude = random.normal(size=shape) + 1j * random.normal(size=shape)
    adjoint = waves.conj().T / count
    drive = amplitude @ waves
    d, reached = _norm(drive), 0.0
    for step in range(iterations):
        amplitude = (drive / d @ adjoint) * weights
        drive = amplitude @ waves
        d = _norm(drive)
        # The mean of d rises to the bound; the first step still has the scale of the random start.
        value = float(d.mean())
        if step and value - reached < 1e-7 * value:
            break
        reached = value
    dual = _largest_eigenvalue(root, d) / count**2 * float(d.sum())
    _, values, right = np.linalg.svd(amplitude, full_matrices=False)
    return PeakBound(spectral, min(dual, spectral), values[0] * right[0])


def worst_peak_bound(waves: ComplexArray, start: ComplexArray, iterations: int) -> PeakBound:
    """Bound the smallest of the peaks |<f_d, p>|^2 for all masks p, by their weighted mean at the least weights.

    The weights come from the relaxation with levelled peaks: a depth gains weight while its peak is below the mean. The
    bounds hold after any number of steps. ``waves`` are as in :func:`peak_bound`; ``start``, shape (n_waves,), holds
    the wave amplitudes of a mask with about equal peaks.
    """
    count = waves.shape[1]
    adjoint = waves.conj().T / count
    # A second component, a quarter turn away, lets the relaxation leave the mask.
    amplitude = np.stack([start, 0.1j * start * np.exp(1j * np.arange(start.size))])
    gain = np.linalg.norm(amplitude, axis=0)
    for _ in range(iterations):
        drive = amplitude @ waves
        response = (drive / _norm(drive)) @ adjoint
        size = np.linalg.norm(response, axis=0)
        gain = gain * size.mean() / size
        amplitude = gain * response / size
    weights = gain / size
    return peak_bound(waves, weights / weights.sum(), iterations, seed=0)


def _norm(drive: ComplexArray) -> FloatArray:
    """Length of each sample's vector, kept away from zero; shape (n,)."""
    length = np.sqrt((np.abs(drive) ** 2).sum(axis=0))
    return np.asarray(np.maximum(length, 1e-6 * math.sqrt(float(np.mean(length**2)))), dtype=np.float64)


def _largest_eigenvalue(root: ComplexArray, d: FloatArray) -> float:
    scaled = root / np.sqrt(d)
    return float(np.linalg.eigvalsh(scaled @ scaled.conj().T)[-1])
