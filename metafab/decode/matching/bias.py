"""Correction of the matched filters for the bias of the correlation's maximum.

The expected correlation of the filtered twins of a texture follows from the pair and the filters alone. Its maximum
lies beside the true depth, because filters are mixtures of a few basis images, are cut off, follow the pair's change
over its own width to first order only, and because the maximum is interpolated between candidates: by 0.1 to 0.2 % of
the depth for the paper's lens, in a pattern over the field that no texture averages out. Candidates take the filters of
depths beside their own, such that the maxima of their own depths lie on them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import kept_threads
from metafab.decode.matching.depth import spline_peaks
from metafab.decode.matching.space_variance import FirstMoments

#: Largest bias that is corrected, steps from candidate to candidate; a larger one is another maximum.
_LARGEST = 0.25
#: Ridge of the shifts' equations, relative to the square of a common shift: alternating ones would be large.
_RIDGE = 0.01
#: Candidates on each side of the true one for which the pair's change over its own width counts.
_NEAR = 3


def unbiased(weights: NDArray[Any], places: FloatArray) -> NDArray[Any]:
    """Weights of the filters' basis for candidates at other places: shape (2, n_candidates, n_field, n_basis).

    Args:
        weights: shape (2, n_candidates, n_field, n_basis), those at the candidates.
        places: shape (n_field, n_candidates), of :func:`unbiased_places`.
    """
    count = weights.shape[1]
    spline = make_interp_spline(np.arange(count), np.eye(count), k=min(3, count - 1))
    at = spline(np.clip(places, 0.0, count - 1.0)).astype(np.float32)
    return np.ascontiguousarray(np.einsum("fvc,pcfk->pvfk", at, weights))


def unbiased_places(
    filters: NDArray[np.complex64],
    transfer: NDArray[np.complex64],
    gradient: NDArray[np.float32] | None,
    moments: FirstMoments,
    spectra: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Depths whose filters put the expected maxima on the candidates: shape (n_field, n_candidates), in their steps.

    Args:
        filters: shape (2, n_candidates, n_field, n_ky, n_kx), transforms of the candidates' filters, with
            the likelihood's weights.
        transfer: shape (2, 2 n_candidates - 1, n_field, n_ky, n_kx), transfer functions of the pair at every half step
            between candidates.
        gradient: shape (2, n_field, n_field), weights of the field points in the pair's slope over (x, y), per pixel;
            None to leave it out.
        moments: products of images with the offsets of their pixels.
        spectra: power of texture and of noise, shape (n_ky, n_kx).
    """
    count = filters.shape[1]
    halves = np.full(filters.shape[4], 2.0)
    halves[[0, -1]] = 1.0
    texture, noise = (np.repeat((one * halves).astype(np.float32), 2) for one in spectra)

    def of_field(number: int) -> FloatArray:
        mixed, pair = np.ascontiguousarray(filters[:, :, number]), transfer[:, :, number]
        from_noise = _power(mixed, noise)
        # Few points take part in the slopes at one: those of its row and its column.
        slopes = np.zeros((2, 0)) if gradient is None else gradient[:, number]
        points = np.flatnonzero(slopes.any(axis=0))
        changes = np.tensordot(slopes[:, points], transfer[:, :, points], axes=(1, 2)) if points.size else ()
        correlation = np.empty((pair.shape[1], count))
        for true in range(pair.shape[1]):
            seen = mixed * pair[:, true, None]
            if points.size:
                # A point at a distance from the pixel is blurred by the pair of its own place.
                near = slice(max((true + 1) // 2 - _NEAR, 0), min(true // 2 + _NEAR + 1, count))
                seen[:, near] -= moments(*(mixed[:, near] * change[:, true, None] for change in changes))
            power = _power(seen, texture) + from_noise
            correlation[true] = _inner(seen[0], seen[1], texture) / np.sqrt(power[0] * power[1])
        return _moved(correlation)

    with kept_threads() as pool:
        return np.stack(pool.map(of_field, range(filters.shape[2])))


def _moved(correlation: FloatArray) -> FloatArray:
    """Places of the filters, shape (n,), that put the maxima of rows of the correlation on their places.

    ``correlation``: shape (2 n - 1, n), values at the n candidates for a texture at every half step.
    """
    count = correlation.shape[1]
    own, true = np.arange(count, dtype=np.float64), 0.5 * np.arange(len(correlation))
    slope = make_interp_spline(own, np.eye(count), k=min(5, count - 1)).derivative()
    peaks = spline_peaks(correlation)
    bias = peaks.place - true
    # Near the ends of the range the maximum may be missing.
    known = peaks.inside & (np.abs(bias) <= _LARGEST) & (true >= 1.0) & (true <= count - 2.0)
    # Change of each maximum by that of each filter's place.
    by_place = (slope(true) * (correlation @ slope(own).T) / np.maximum(peaks.curvature, 1e-12)[:, None])[known]
    system = by_place.T @ by_place + _RIDGE * np.eye(count)
    return np.asarray(own - np.linalg.solve(system, by_place.T @ bias[known]))


def _power(spectra: NDArray[np.complex64], weight: NDArray[np.float32]) -> FloatArray:
    return _inner(spectra, spectra, weight)


def _inner(a: NDArray[np.complex64], b: NDArray[np.complex64], weight: NDArray[np.float32]) -> FloatArray:
    """Real part of the weighted inner products of transforms (..., n_ky, n_kx); weights are (2 n_ky n_kx,)."""
    first, second = (np.reshape(one, (*one.shape[:-2], -1)).view(np.float32) for one in (a, b))
    return np.asarray((first * second * weight).sum(axis=-1, dtype=np.float64))
