"""Crosses, rounded corners and ellipses as nested rectangles: the rectangles, and the matrices of their layer.

Every cross-section here is symmetric about both axes and narrows away from them. It is the union of centred rectangles,
of which each is narrower and longer than the one before. A cross is two rectangles exactly. A rounded corner of n steps
has its levels at equal angles, along x halfway between those along y, so that exchanging x and y mirrors the outline.
Its area is that of the smooth outline, which leaves an error of second order in 1/n.

In the strip of v that a rectangle adds, the pillar is as wide as that rectangle, so that Li's rules (J. Opt. Soc. Am. A
14, 2758, 1997) hold strip by strip. With u_k and v_k the indicators of the sizes, v_0 = 0 and u_(n+1) = 0,

    eps_u - eps_around = sum_k (rule(u_k) - eps_around) (x) (v_k - v_(k-1)),
    eps_v - eps_around = sum_k (u_k - u_(k+1)) (x) (rule(v_k) - eps_around),

and E_z follows the direct rule. All rectangles share one coordinate map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.basis.coordinates import Matrix
from metafab.cell.rcwa.basis.transverse import TransverseBasis
from metafab.cell.rcwa.layers.factorisation import assembled, contrast

#: Steps of a rounded corner for each cosine of the truncation: both errors fall together from one truncation to the
#: next, so that differences between truncations include the steps. On silicon and titania at twelve orders the steps
#: left less than 1e-4 of pillars with corners of 30 nm, and 1e-3 of circles.
_STEPS_PER_COSINE = 4

Rectangles = tuple[tuple[float, float], ...]


def rectangles(cell: PillarCell, width_nm: float, length_nm: float, orders: int) -> Rectangles:
    """The cross-section of ``cell`` at these sizes as nested rectangles, from the widest to the longest.

    Args:
        cell: for its ``shape`` and ``corner_radius_nm``.
        width_nm: size along x, from 0.
        length_nm: size along y, from 0.
        orders: cosines of the truncation, to which the number of steps of a rounded outline is proportional.

    Returns:
        (width, length) in nm of each; one for a rectangle, two for a cross.
    """
    if 0.0 in (width_nm, length_nm) or not cell.is_shaped:
        return ((width_nm, length_nm),)
    if cell.shape != "cross":
        return _rounded(cell, width_nm, length_nm, _STEPS_PER_COSINE * orders)
    short, long = sorted((width_nm, length_nm))
    return ((long, short), (short, long)) if short < long else ((long, short),)


def _rounded(cell: PillarCell, width_nm: float, length_nm: float, steps: int) -> Rectangles:
    """Ellipse, or rectangle with rounded corners, as nested rectangles whose union has the smooth outline's area."""
    angle = np.arange(1, steps + 1) * (math.pi / (2 * steps + 1))
    across, along = np.cos(angle - 0.5 * angle[0]), np.sin(angle)
    area = float(np.sum(across * np.diff(along, prepend=0.0)))
    quarter = 0.25 * math.pi
    if cell.shape == "ellipse":
        grown = math.sqrt(quarter / area)
        corner = np.array([0.5 * width_nm, 0.5 * length_nm])
    else:
        # The flat sides stay: the outermost levels reach them, and a larger radius keeps the area.
        grown = 1.0 / float(along[-1])
        radius = cell.corner_radius_nm * math.sqrt((1.0 - quarter) / (1.0 - area * grown**2))
        corner = np.full(2, min(radius, 0.5 * width_nm, 0.5 * length_nm))
    flat = np.array([width_nm, length_nm]) - 2.0 * corner
    levels = flat + 2.0 * corner * grown * np.stack([across, along], axis=1)
    return tuple((float(width), float(length)) for width, length in levels)


def nested_matrices(
    bases: Sequence[TransverseBasis], k0_per_nm: float, eps_pillar: complex, eps_around: complex
) -> tuple[Matrix, Matrix]:
    """P and Q of the layer in the (TM, TE) basis, each of shape (n, n).

    ``bases`` hold the symmetry class with the outline of each rectangle, from the widest to the longest. A real
    permittivity of the pillar gives real matrices.
    """
    u_b, v_a = [basis.u.b for basis in bases], [basis.v.a for basis in bases]
    added_v = [v_a[0], *(v - shorter for shorter, v in pairwise(v_a))]
    added_u = [*(u - narrower for u, narrower in pairwise(u_b)), u_b[-1]]
    contrast_u = _sum_of_products([contrast(basis.u.a, eps_pillar, eps_around) for basis in bases], added_v)
    contrast_v = _sum_of_products(added_u, [contrast(basis.v.b, eps_pillar, eps_around) for basis in bases])
    inside = _sum_of_products(u_b, added_v)
    eta_z = np.linalg.inv(eps_around * np.eye(len(inside)) + (eps_pillar - eps_around) * inside)
    return assembled(bases[0], k0_per_nm, contrast_u, contrast_v, eta_z, eps_around)


def _sum_of_products(first: Sequence[Matrix], second: Sequence[Matrix]) -> Matrix:
    """Sum of the Kronecker products of pairs, as one product of matrices; shape (n m, n m)."""
    stacked = [np.stack([each.ravel() for each in factors]) for factors in (first, second)]
    n, m = len(first[0]), len(second[0])
    return np.asarray((stacked[0].T @ stacked[1]).reshape(n, n, m, m).transpose(0, 2, 1, 3).reshape(n * m, n * m))
