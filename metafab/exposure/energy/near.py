"""Energy of the nearest pillars, in closed form: tables over pairs of sizes, and the loop that adds them up.

A Gaussian of range beta deposits on the point (x, y) from a rectangle of width w and length l at the origin

    1/4 [erf((x + w/2) / beta) - erf((x - w/2) / beta)] [erf((y + l/2) / beta) - erf((y - l/2) / beta)];

other outlines are sums of rectangles (:mod:`metafab.exposure.energy.shapes`). Each pillar has three energies: at its
centre, the mean over the middles of its two x edges, and the mean over the middles of its two y edges. They depend on
the size of the source, the width or length of the target, and the offset between their sites, and are tabulated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.shapes import Part, Shapes
from metafab.layout import Lattice

#: Gaussians that reach an edge after this many ranges are left out there: 1e-8 of their energy.
_REACH = 4.0


@dataclass(frozen=True)
class NearTables:
    """Energy per unit dose from one pillar of a block of (2 down + 1) x (2 right + 1) sites.

    ``reach`` is (down, right). Offsets (a, b) in (x, y), of either sign, have the number a + (right + 1) b.
    """

    reach: tuple[int, int]  #: (rows, columns) from a site to the last ones of the block.
    centre: Float32Array  #: Shape (n_offsets, n_sizes), at the centre of the target.
    #: Shape (n_offsets, n_widths, n_sizes), mean over the two edges along x of a target of each width.
    edge_x: Float32Array
    #: Shape (n_offsets, n_lengths, n_sizes), mean over the two edges along y of a target of each length.
    edge_y: Float32Array
    width_of: NDArray[np.int32]  #: Shape (n_sizes,), index of each size's width.
    length_of: NDArray[np.int32]  #: Shape (n_sizes,), index of each size's length.


def near_tables(psf: BeamPsf, shapes: Shapes, lattice: Lattice, reach: tuple[int, int]) -> NearTables:
    """Tabulate the near field of each size within a reach of (rows, columns)."""
    down, right = reach
    targets = [np.unique(side, return_inverse=True) for side in shapes.size_nm.T]
    count, offsets = len(shapes.size_nm), (down + 1) * (right + 1)
    centre = np.zeros((offsets, count))
    edges = [np.zeros((offsets, side.size, count)) for side, _ in targets]
    largest_nm = shapes.size_nm.max(axis=0)
    for number in range(offsets):
        steps = np.array([number % (right + 1), number // (right + 1)])
        if lattice.hexagonal and steps.sum() % 2:
            continue
        offset_nm = steps * lattice.period_nm
        for weight, beta in zip(psf.weight, psf.range_nm, strict=True):
            if np.max(offset_nm - largest_nm) > _REACH * beta:
                continue
            for axis, along in enumerate((shapes, shapes.turned())):
                here_nm, across_nm = (float(value) for value in offset_nm[[axis, 1 - axis]])
                for part in along.parts(beta):
                    at = weight * part.along_y(across_nm, beta)
                    if axis == 0:
                        centre[number] += at * _along_x(np.zeros(1), here_nm, part, beta)[0]
                    if number:
                        edges[axis][number] += at * _at_edges(targets[axis][0], here_nm, part, beta)
    edge_x, edge_y = (table.astype(np.float32) for table in edges)
    width_of, length_of = (index.astype(np.int32) for _, index in targets)
    return NearTables(reach, centre.astype(np.float32), edge_x, edge_y, width_of, length_of)


def _along_x(place_nm: FloatArray, offset_nm: float, part: Part, beta: float) -> FloatArray:
    """Profile along x at ``place_nm`` (n,) of rectangles at an offset: shape (n, n_sizes)."""
    half_nm, size_of = np.unique(part.half_width_nm, return_inverse=True)
    distance = place_nm[:, None] - offset_nm
    profile = 0.5 * (erf((distance + half_nm) / beta) - erf((distance - half_nm) / beta))
    return np.asarray(profile[:, size_of])


def _at_edges(size_nm: FloatArray, offset_nm: float, part: Part, beta: float) -> FloatArray:
    """Mean of the profile over both edges of targets of each size: shape (n_targets, n_sizes)."""
    before, behind = (_along_x(sign * size_nm, offset_nm, part, beta) for sign in (0.5, -0.5))
    return 0.5 * (before + behind)


@compiled
def add_near(
    size_index: NDArray[np.uint16],
    dose: Float32Array,
    centre: Float32Array,
    edge_x: Float32Array,
    edge_y: Float32Array,
    width_of: NDArray[np.int32],
    length_of: NDArray[np.int32],
    reach: tuple[int, int],
    energy: Float32Array,
) -> None:
    """Add the energy of the neighbours within reach, and at the centre also of the pillar itself.

    Args:
        size_index: shape (n_y + 2 down, n_x + 2 right), the tile with a margin of the reach.
        dose: of that shape, relative to the base dose.
        centre: as in :class:`NearTables`, like the next four.
        edge_x: mean over the edges along x.
        edge_y: mean over the edges along y.
        width_of: width of each size.
        length_of: length of each size.
        reach: (down, right), rows and columns to the last neighbour.
        energy: shape (3, n_y, n_x), at the centre, the x edges and the y edges; added to in place.
    """
    n_y, n_x = energy.shape[1:]
    reach_y, reach_x = reach
    for row in range(n_y):
        for column in range(n_x):
            target = size_index[row + reach_y, column + reach_x]
            if target == 0:
                continue
            w, length = width_of[target], length_of[target]
            at_centre = centre[0, target] * dose[row + reach_y, column + reach_x]
            at_x = np.float32(0.0)
            at_y = np.float32(0.0)
            for down in range(-reach_y, reach_y + 1):
                for right in range(-reach_x, reach_x + 1):
                    if down == 0 and right == 0:
                        continue
                    source = size_index[row + reach_y + down, column + reach_x + right]
                    if source == 0:
                        continue
                    pair = abs(right) + (reach_x + 1) * abs(down)
                    d = dose[row + reach_y + down, column + reach_x + right]
                    at_centre += d * centre[pair, source]
                    at_x += d * edge_x[pair, w, source]
                    at_y += d * edge_y[pair, length, source]
            energy[0, row, column] += at_centre
            energy[1, row, column] += at_x
            energy[2, row, column] += at_y
