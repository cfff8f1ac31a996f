"""The layer of a pillar whose cross-section is a union of nested rectangles (a cross, rounded corners, an ellipse).

Rectangle k is narrower and longer than the one before it. In the strip of v that it adds, the pillar is as wide as it
is, so that Li's rules (J. Opt. Soc. Am. A 14, 2758, 1997) hold strip by strip: with u_k and v_k the indicators of its
sizes, v_0 = 0 and u_(n+1) = 0,

    eps_u - eps_around = sum_k (rule(u_k) - eps_around) (x) (v_k - v_(k-1)),
    eps_v - eps_around = sum_k (u_k - u_(k+1)) (x) (rule(v_k) - eps_around),

and E_z follows the direct rule. All rectangles share one coordinate map (:mod:`metafab.cell.rcwa.basis.shared_map`).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from metafab.cell.rcwa.basis.axis import Matrix
from metafab.cell.rcwa.basis.transverse import TransverseBasis
from metafab.cell.rcwa.layers.factorisation import assembled, contrast


def nested_matrices(
    bases: Sequence[TransverseBasis], k0_per_nm: float, eps_pillar: complex, eps_around: complex
) -> tuple[Matrix, Matrix]:
    """P and Q of the layer in the (TM, TE) basis.

    Args:
        bases: symmetry class with the outline of each rectangle, from the widest to the longest.
        k0_per_nm: vacuum wave number.
        eps_pillar: permittivity of the pillar; a real number gives real matrices.
        eps_around: permittivity around it.

    Returns:
        P and Q, each of shape (n, n).
    """
    u_b, v_a = [basis.u.b for basis in bases], [basis.v.a for basis in bases]
    added_v = [v_a[0], *(v - shorter for shorter, v in pairwise(v_a))]
    added_u = [*(u - narrower for u, narrower in pairwise(u_b)), u_b[-1]]
    contrast_u = [contrast(basis.u.a, eps_pillar, eps_around) for basis in bases]
    contrast_v = [contrast(basis.v.b, eps_pillar, eps_around) for basis in bases]
    inside = _sum_of_products(u_b, added_v)
    eps_z = eps_around * np.eye(len(inside)) + (eps_pillar - eps_around) * inside
    return assembled(
        bases[0],
        k0_per_nm,
        _sum_of_products(contrast_u, added_v),
        _sum_of_products(added_u, contrast_v),
        np.linalg.inv(eps_z),
        eps_around,
    )


def _sum_of_products(first: Sequence[Matrix], second: Sequence[Matrix]) -> Matrix:
    """Sum of the Kronecker products of pairs, as one product of matrices: shape (n m, n m)."""
    stacked = [np.stack([each.ravel() for each in factors]) for factors in (first, second)]
    n, m = len(first[0]), len(second[0])
    return np.asarray((stacked[0].T @ stacked[1]).reshape(n, n, m, m).transpose(0, 2, 1, 3).reshape(n * m, n * m))
