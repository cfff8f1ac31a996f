"""Layer of a hexagonal lattice: a centred cell with one rectangle in its middle and one at its corners.

The cell is one period long along x and two rows long along y. About the first pillar it has two mirror planes, so that
the symmetry classes are those of a single rectangle (:mod:`metafab.cell.rcwa.basis.transverse`), over half a cell along
each axis. In this quarter the first pillar covers u_1 (x) v_1 at the origin and the second u_2 (x) v_2 at the far ends.
The pillars never overlap along v, but may overlap along u. Li's rules (J. Opt. Soc. Am. A 14, 2758, 1997) then hold
strip by strip: E_u is normal to walls along u, within each interval of v,

    eps_u = rule(u_1) (x) v_1 + rule(u_2) (x) v_2 + eps_around 1 (x) (1 - v_1 - v_2).

E_v follows likewise, with one more strip where both pillars share a u, of permittivity rule(v_1 + v_2). E_z follows the
direct rule.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from metafab.cell.rcwa.basis.coordinates import Matrix
from metafab.cell.rcwa.basis.transverse import TransverseBasis
from metafab.cell.rcwa.layers.factorisation import assembled, inverse_rule, kron
from metafab.core.conventions import FloatArray


class Strips(NamedTuple):
    """Indicators of one family along one axis."""

    first: FloatArray  #: Shape (n, n), the first pillar.
    second: FloatArray  #: Shape (n, n), the second pillar.
    both: FloatArray  #: Shape (n, n), overlap of both pillars; zero if they do not overlap along the axis.


def staggered_matrices(
    basis: TransverseBasis, gap: TransverseBasis, k0_per_nm: float, eps_pillar: complex, eps_around: complex
) -> tuple[Matrix, Matrix]:
    """P and Q of the layer in the (TM, TE) basis, each of shape (n, n).

    ``basis`` is the symmetry class with the first pillar's outline, ``gap`` that with the outline of the gap that the
    second pillar leaves around the origin. A real permittivity of the pillars gives real matrices.
    """
    u_a, u_b = _strips(basis.u.a, gap.u.a), _strips(basis.u.b, gap.u.b)
    v_a, v_b = _strips(basis.v.a, gap.v.a), _strips(basis.v.b, gap.v.b)
    eps_u = _permittivity(v_a, u_a, eps_pillar, eps_around, strip_first=False)
    eps_v = _permittivity(u_b, v_b, eps_pillar, eps_around, strip_first=True)
    pillars = kron(u_b.first, v_a.first) + kron(u_b.second, v_a.second)
    eta_z = np.linalg.inv(eps_around * np.eye(len(pillars)) + (eps_pillar - eps_around) * pillars)
    around_u, around_v = (eps_around * np.eye(len(eps)) for eps in (eps_u, eps_v))
    return assembled(basis, k0_per_nm, eps_u - around_u, eps_v - around_v, eta_z, eps_around)


def _strips(outline: FloatArray, gap: FloatArray) -> Strips:
    """Indicators from those of [0, first wall] and of [0, second wall]."""
    whole = np.eye(len(outline))
    # The pillars overlap if the first ends beyond the beginning of the second.
    overlap = float(np.trace(outline)) > float(np.trace(gap))
    return Strips(outline, whole - gap, outline - gap if overlap else np.zeros_like(whole))


def _permittivity(
    strips: Strips, across: Strips, eps_pillar: complex, eps_around: complex, *, strip_first: bool
) -> Matrix:
    """Permittivity by the direct rule over strips, and by the inverse rule across the walls in each strip.

    ``strips`` and ``across`` are indicators along the axes that the field is tangential and normal to; ``strip_first``
    says whether the axis of the strips is the first factor of the Kronecker products.
    """

    def product(strip: Matrix, rule: Matrix) -> Matrix:
        return kron(strip, rule) if strip_first else kron(rule, strip)

    outside = np.eye(len(strips.first)) - strips.first - strips.second + strips.both
    total = product(outside, eps_around * np.eye(len(across.first)))
    for strip, filled in (
        (strips.first - strips.both, across.first),
        (strips.second - strips.both, across.second),
        (strips.both, across.first + across.second),
    ):
        if np.any(strip):
            total = total + product(strip, inverse_rule(filled, eps_pillar, eps_around))
    return total
