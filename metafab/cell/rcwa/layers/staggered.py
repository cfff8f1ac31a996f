"""The layer of a hexagonal lattice: two rectangles in a centred cell, one in its middle and one at its corners.

The cell is a period long along x and two rows along y. About the first pillar it has the same two mirror planes as a
single one, so the symmetry classes are those of :mod:`metafab.cell.rcwa.basis.transverse`, over half a cell along
each axis.
There the first pillar covers u_1 (x) v_1, from the origin on, and the second u_2 (x) v_2, up to the far ends. Their
lengths never overlap along v, their widths may along u. Li's rules (J. Opt. Soc. Am. A 14, 2758, 1997) then hold strip
by strip: E_u is normal to walls along u, within each interval of v,

    eps_u = rule(u_1) (x) v_1 + rule(u_2) (x) v_2 + eps_around 1 (x) (1 - v_1 - v_2),

and likewise for E_v, with a strip of its own where both pillars stand at one u, and permittivity
rule(v_1 + v_2). E_z follows the direct rule.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.cell.rcwa.basis.axis import Matrix
from metafab.cell.rcwa.basis.transverse import TransverseBasis
from metafab.cell.rcwa.layers.factorisation import assembled, inverse_rule, kron
from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class Strips:
    """One family's indicators along one axis: the first pillar, the second, and where both stand.

    Attributes:
        first: shape (n, n); ``second`` and ``both`` likewise.
        second: see ``first``.
        both: see ``first``; zero where the pillars do not overlap along the axis.
    """

    first: FloatArray
    second: FloatArray
    both: FloatArray


def staggered_matrices(
    basis: TransverseBasis, gap: TransverseBasis, k0_per_nm: float, eps_pillar: complex, eps_around: complex
) -> tuple[Matrix, Matrix]:
    """P and Q of the layer in the (TM, TE) basis.

    Args:
        basis: symmetry class with the first pillar's outline.
        gap: the same with the outline of the gap that the second pillar leaves about the origin.
        k0_per_nm: vacuum wave number.
        eps_pillar: permittivity of the pillars; a real number gives real matrices.
        eps_around: permittivity around them.

    Returns:
        P and Q, each of shape (n, n).
    """
    u_a, u_b = _strips(basis.u.a, gap.u.a), _strips(basis.u.b, gap.u.b)
    v_a, v_b = _strips(basis.v.a, gap.v.a), _strips(basis.v.b, gap.v.b)
    eps_u = _permittivity(v_a, u_a, eps_pillar, eps_around, normal_first=False)
    eps_v = _permittivity(u_b, v_b, eps_pillar, eps_around, normal_first=True)
    pillars = kron(u_b.first, v_a.first) + kron(u_b.second, v_a.second)
    eta_z = np.linalg.inv(eps_around * np.eye(len(pillars)) + (eps_pillar - eps_around) * pillars)
    around_u, around_v = (eps_around * np.eye(len(eps)) for eps in (eps_u, eps_v))
    return assembled(basis, k0_per_nm, eps_u - around_u, eps_v - around_v, eta_z, eps_around)


def _strips(outline: FloatArray, gap: FloatArray) -> Strips:
    """Indicators from those of [0, first wall] and of [0, second wall]."""
    whole = np.eye(len(outline))
    # Walls change places where the pillars overlap: the first then ends behind the beginning of the second.
    overlap = float(np.trace(outline)) > float(np.trace(gap))
    return Strips(outline, whole - gap, outline - gap if overlap else np.zeros_like(whole))


def _permittivity(
    strips: Strips, across: Strips, eps_pillar: complex, eps_around: complex, *, normal_first: bool
) -> Matrix:
    """Direct rule over strips, in each of them the inverse rule across its walls.

    Args:
        strips: along the axis that the field is tangential to.
        across: along the axis that it is normal to.
        eps_pillar: permittivity of the pillars.
        eps_around: around them.
        normal_first: whether the strips' axis is the first factor.
    """
    whole = np.eye(len(across.first))
    parts = [
        (strips.first - strips.both, across.first),
        (strips.second - strips.both, across.second),
        (strips.both, across.first + across.second),
    ]
    outside = np.eye(len(strips.first)) - strips.first - strips.second + strips.both
    total = _product(outside, eps_around * whole, normal_first)
    for strip, filled in parts:
        if np.any(strip):
            total = total + _product(strip, inverse_rule(filled, eps_pillar, eps_around), normal_first)
    return total


def _product(strip: Matrix, rule: Matrix, strip_first: bool) -> Matrix:
    return kron(strip, rule) if strip_first else kron(rule, strip)
