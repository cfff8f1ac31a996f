"""Printed edges by the threshold model: the resist stays (negative tone) where its energy exceeds the clearing energy.

Along the axis of a pillar through its edge, displaced outwards by s, the pillar's own energy is

    S(s) = sum over Gaussians, weight / 2 [erf((w + s) / beta) - erf(s / beta)] erf(l / (2 beta)),

with the pillar's width w and length l and the ranges beta. It falls steeply, while the energy of all other pillars
changes little over a few nanometres. Other outlines add up rectangles (:mod:`metafab.exposure.energy.shapes`). The
printed edge lies at the s that solves dose S(s) = clearing energy - energy of the others, by a table of S for each
size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.shapes import Shapes

#: Number of displacements in the table.
_NODES = 161
#: Displacement above which the steps of the table grow in proportion to it, nm.
_EVEN_NM = 0.05
#: Largest displacement, nm.
_REACH_NM = 120.0


@dataclass(frozen=True)
class EdgeTables:
    """Energy per unit dose of a pillar at its own edges."""

    displacement_nm: Float32Array  #: Shape (n_nodes,), ascending, 0 among them; positive outwards.
    #: Shape (2, n_sizes, n_nodes), at the displaced x and y edges; descending along the last axis.
    energy: Float32Array
    at_edge: Float32Array  #: Shape (2, n_sizes), at the drawn edges.
    slope_per_nm: Float32Array  #: Shape (2, n_sizes), decrease of energy per nm at the drawn edges, positive.

    @classmethod
    def of(cls, psf: BeamPsf, shapes: Shapes) -> EdgeTables:
        """Tabulate pillars of some shapes."""
        reach = np.arcsinh(_REACH_NM / _EVEN_NM)
        turn = np.linspace(-reach, reach, _NODES)
        displacement = _REACH_NM * np.sinh(turn) / np.sinh(reach)
        displacement[_NODES // 2] = 0.0
        energy = np.zeros((2, len(shapes.size_nm), _NODES))
        slope = np.zeros((2, len(shapes.size_nm)))
        for axis, along in enumerate((shapes, shapes.turned())):
            edge = 0.5 * along.size_nm[:, 0]
            # Beyond the pillar's middle the energy falls again: the table stays monotone up to there.
            place = edge[:, None] + np.maximum(displacement, -edge[:, None])
            for weight, beta in zip(psf.weight, psf.range_nm, strict=True):
                for part in along.parts(beta, on_axis=True):
                    middle, half = weight * part.along_y(0.0, beta), part.half_width_nm
                    energy[axis] += (
                        0.5
                        * middle[:, None]
                        * (erf((place + half[:, None]) / beta) - erf((place - half[:, None]) / beta))
                    )
                    drop = np.exp(-(((edge - half) / beta) ** 2)) - np.exp(-(((edge + half) / beta) ** 2))
                    slope[axis] += middle * drop / (np.sqrt(np.pi) * beta)
        parts = (displacement, energy, energy[:, :, _NODES // 2], slope)
        return cls(*(np.ascontiguousarray(part, dtype=np.float32) for part in parts))


def corner_radius_nm(
    psf: BeamPsf, shapes: Shapes, dose: FloatArray, others: FloatArray, moved_nm: FloatArray, clearing: float
) -> FloatArray:
    """Return the radii of printed corners, shape (n,), NaN where a pillar does not print or has no corners.

    They follow from the place where the printed outline crosses the corner's diagonal: a quarter of a circle of radius
    r that touches both edges leaves r (1 - 1 / sqrt(2)) along each axis.

    Args:
        shapes: drawn shape of each pillar.
        dose: shape (n,).
        others: shape (n,), energy of all other pillars at the corners.
        moved_nm: shape (n, 2), displacement of the printed edges outwards.
        clearing: energy above which the resist stays.
    """
    if not shapes.has_corners:
        return np.full(len(dose), np.nan)
    size_nm = shapes.size_nm
    parts = [(beta, weight, list(shapes.parts(beta))) for weight, beta in zip(psf.weight, psf.range_nm, strict=True)]
    # The outline crosses the diagonal from the printed sharp corner (outside) to half the smaller side (inside).
    outer, inner = -moved_nm.mean(axis=1), 0.5 * size_nm.min(axis=1)
    for _ in range(40):
        inset = 0.5 * (outer + inner)
        x_nm, y_nm = 0.5 * size_nm.T - inset
        own = np.zeros(len(size_nm))
        for beta, weight, rectangles in parts:
            for part in rectangles:
                along_x = erf((x_nm + part.half_width_nm) / beta) - erf((x_nm - part.half_width_nm) / beta)
                own += 0.5 * weight * along_x * part.along_y(y_nm, beta)
        printed = dose * own + others > clearing
        outer, inner = np.where(printed, outer, inset), np.where(printed, inset, inner)
    gap = np.maximum(0.5 * (outer + inner) + moved_nm.mean(axis=1), 0.0)
    return np.where(np.isfinite(moved_nm).all(axis=1), gap / (1.0 - math.sqrt(0.5)), np.nan)


@compiled
def add_edge_displacements(
    size_index: NDArray[np.uint16],
    dose: Float32Array,
    others: Float32Array,
    clearing: float,
    displacement_nm: Float32Array,
    energy: Float32Array,
    result_nm: Float32Array,
) -> None:
    """Compute the displacement of the printed edges of each pillar.

    Args:
        size_index: shape (n_y, n_x).
        dose: shape (n_y, n_x).
        others: shape (2, n_y, n_x), energy of all other pillars at the x and the y edges.
        clearing: energy above which the resist stays.
        displacement_nm: shape (n_nodes,), of :class:`EdgeTables`.
        energy: shape (2, n_sizes, n_nodes), of :class:`EdgeTables`.
        result_nm: shape (2, n_y, n_x), written; -inf where a pillar does not print.
    """
    last = displacement_nm.size - 1
    for axis in range(2):
        for row in range(size_index.shape[0]):
            for column in range(size_index.shape[1]):
                size = size_index[row, column]
                if size == 0:
                    result_nm[axis, row, column] = 0.0
                    continue
                wanted = (clearing - others[axis, row, column]) / dose[row, column]
                table = energy[axis, size]
                if wanted >= table[0]:
                    result_nm[axis, row, column] = -np.inf
                    continue
                low, high = 0, last
                while high - low > 1:
                    middle = (low + high) // 2
                    if table[middle] > wanted:
                        low = middle
                    else:
                        high = middle
                drop = table[low] - table[high]
                share = (table[low] - wanted) / drop if drop > 0.0 else 0.0
                share = min(max(share, 0.0), 1.0)
                step = displacement_nm[high] - displacement_nm[low]
                result_nm[axis, row, column] = displacement_nm[low] + share * step
