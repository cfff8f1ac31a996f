"""Energy of the 3 x 3 nearest pillars, in closed form: tables over pairs of sizes, and the loop that adds them up.

A Gaussian of range beta deposits on the point (x, y) from a rectangle of width w and length l at the origin

    1/4 [erf((x + w/2) / beta) - erf((x - w/2) / beta)] [erf((y + l/2) / beta) - erf((y - l/2) / beta)].

Each pillar has three energies: at its centre, the mean over the middles of its two x edges, and the mean over the
middles of its two y edges. They depend on the size of the source, the width or length of the target, and the offset
between their sites, and are tabulated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.exposure.electrons.beam import BeamPsf


@dataclass(frozen=True)
class NearTables:
    """Energy per unit dose from one pillar of a 3 x 3 block; offsets (0, 0), (1, 0), (0, 1), (1, 1) in (x, y)."""

    centre: Float32Array  #: Shape (4, n_sizes), at the centre of the target.
    edge_x: Float32Array  #: Shape (4, n_widths, n_sizes), mean over the two edges along x of a target of each width.
    edge_y: Float32Array  #: Shape (4, n_lengths, n_sizes), mean over the two edges along y of a target of each length.
    width_of: NDArray[np.int32]  #: Shape (n_sizes,), index of each size's width.
    length_of: NDArray[np.int32]  #: Shape (n_sizes,), index of each size's length.


def near_tables(psf: BeamPsf, size_nm: FloatArray, period_nm: tuple[float, float]) -> NearTables:
    """Tabulate the near field of each size (width, length), shape (n_sizes, 2); (0, 0) is no pillar."""
    width, width_of = np.unique(size_nm[:, 0], return_inverse=True)
    length, length_of = np.unique(size_nm[:, 1], return_inverse=True)
    count = len(size_nm)
    centre = np.zeros((4, count))
    edge_x, edge_y = np.zeros((4, width.size, count)), np.zeros((4, length.size, count))
    for weight, beta in zip(psf.weight, psf.range_nm, strict=True):
        along_x = [_at(np.zeros(1), a * period_nm[0], width, beta)[0] for a in (0, 1)]
        along_y = [_at(np.zeros(1), b * period_nm[1], length, beta)[0] for b in (0, 1)]
        for pair in range(4):
            a, b = pair % 2, pair // 2
            x, y = along_x[a][width_of], along_y[b][length_of]
            centre[pair] += weight * x * y
            edge_x[pair] += weight * _at_edges(a * period_nm[0], width, beta)[:, width_of] * y
            edge_y[pair] += weight * _at_edges(b * period_nm[1], length, beta)[:, length_of] * x
    return NearTables(
        centre.astype(np.float32),
        edge_x.astype(np.float32),
        edge_y.astype(np.float32),
        width_of.astype(np.int32),
        length_of.astype(np.int32),
    )


def _at(place: FloatArray, offset: float, size: FloatArray, beta: float) -> FloatArray:
    """Profile along one axis at ``place`` (n,) of sources of ``size`` (m,) at ``offset``: shape (n, m)."""
    distance = place[:, None] - offset
    return np.asarray(0.5 * (erf((distance + 0.5 * size) / beta) - erf((distance - 0.5 * size) / beta)))


def _at_edges(offset: float, size: FloatArray, beta: float) -> FloatArray:
    """Mean of the profile over both edges of targets of each size: shape (n_targets, n_sources)."""
    return 0.5 * (_at(0.5 * size, offset, size, beta) + _at(-0.5 * size, offset, size, beta))


@compiled
def add_near(
    size_index: NDArray[np.uint16],
    dose: Float32Array,
    centre: Float32Array,
    edge_x: Float32Array,
    edge_y: Float32Array,
    width_of: NDArray[np.int32],
    length_of: NDArray[np.int32],
    energy: Float32Array,
) -> None:
    """Add the energy of the eight neighbours, and at the centre also of the pillar itself.

    Args:
        size_index: shape (n_y + 2, n_x + 2), the tile with a margin of one site.
        dose: shape (n_y + 2, n_x + 2), relative to the base dose.
        centre: as in :class:`NearTables`, like the next four.
        edge_x: mean over the edges along x.
        edge_y: mean over the edges along y.
        width_of: width of each size.
        length_of: length of each size.
        energy: shape (3, n_y, n_x), at the centre, the x edges and the y edges; added to in place.
    """
    n_y, n_x = energy.shape[1:]
    for row in range(n_y):
        for column in range(n_x):
            target = size_index[row + 1, column + 1]
            if target == 0:
                continue
            w, length = width_of[target], length_of[target]
            at_centre = centre[0, target] * dose[row + 1, column + 1]
            at_x = np.float32(0.0)
            at_y = np.float32(0.0)
            for down in range(-1, 2):
                for right in range(-1, 2):
                    if down == 0 and right == 0:
                        continue
                    source = size_index[row + 1 + down, column + 1 + right]
                    if source == 0:
                        continue
                    pair = abs(right) + 2 * abs(down)
                    d = dose[row + 1 + down, column + 1 + right]
                    at_centre += d * centre[pair, source]
                    at_x += d * edge_x[pair, w, source]
                    at_y += d * edge_y[pair, length, source]
            energy[0, row, column] += at_centre
            energy[1, row, column] += at_x
            energy[2, row, column] += at_y
