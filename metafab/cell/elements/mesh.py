"""Mesh of a supercell: the corners of the pillars are its vertices, and pillars and gaps its elements.

Element (b, a) is a quadrilateral between the vertices (b, a) and (b + 1, a + 1): a pillar where both numbers are even,
a gap otherwise. In the gaps, the element's sides run from the corners of one pillar to those of the next, so that each
pillar has its own walls along both axes. The map from the square -1..1 to the element is bilinear.

At a corner of a pillar the transverse field is singular: in the distance r it is the gradient of r^tau Phi(theta), with
Phi even about the bisector and eps tan(tau pi / 4) continued as eps_around tan(3 tau pi / 4) (Meixner, IEEE Trans.
Antennas Propag. 20, 442, 1972). Polynomials converge slowly there. One such function a corner, which the bilinear
function of the vertex confines to the four elements around it, joins the basis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metafab.cell.elements.line import Shapes
from metafab.cell.supercell import Supercell
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError

#: Smallest gap between pillars, as a share of the period: below it an element degenerates.
_SMALLEST_GAP = 0.01
#: Size of the elements of a site without a pillar, as a share of the period.
_EMPTY_SITE = 0.5
#: Unit of distance from a corner, nm, for functions of order one.
_UNIT_NM = 100.0


@dataclass(frozen=True)
class Mesh:
    """Vertices of a supercell."""

    x: FloatArray  #: Shape (2 n_y, 2 n_x), nm from the middle of the supercell.
    y: FloatArray  #: Shape of ``x``.
    solid: np.ndarray  #: Shape (n_y, n_x), whether a pillar stands at the site.
    period_nm: tuple[float, float]  #: (x, y) period of the supercell.

    @property
    def shape(self) -> tuple[int, int]:
        """Elements along (y, x)."""
        return self.x.shape[0], self.x.shape[1]

    def corners(self, b: int, a: int) -> tuple[FloatArray, FloatArray]:
        """X and y of the vertices of an element, each of shape (2, 2), indexed [along y, along x]."""
        n_b, n_a = self.shape
        rows, columns = np.array([b, b + 1]), np.array([a, a + 1])
        picked = np.ix_(rows % n_b, columns % n_a)
        return self.x[picked] + (columns // n_a) * self.period_nm[0], self.y[picked] + (
            rows[:, None] // n_b
        ) * self.period_nm[1]

    def is_pillar(self, b: int, a: int) -> bool:
        """Whether an element lies in a pillar."""
        return bool(a % 2 == 0 and b % 2 == 0 and self.solid[b // 2, a // 2])


def mesh_of(supercell: Supercell) -> Mesh:
    """Mesh of a supercell; InputError for pillars that touch or nearly touch."""
    n_y, n_x = supercell.shape
    period = np.array(supercell.cell.period_nm)
    size = supercell.size_nm
    solid = np.all(size > 0.0, axis=-1)
    if np.any(size > period * (1.0 - _SMALLEST_GAP)):
        expected = f"gaps between pillars of {100.0 * _SMALLEST_GAP:.0f} % of the period or more"
        got = f"{np.min(period - size.max(axis=(0, 1))):g} nm beside the largest pillar"
        raise InputError.single("supercell", "size_nm", expected, got, "use meep")
    half = 0.5 * np.where(solid[..., None], size, _EMPTY_SITE * period)
    middle_x = (np.arange(n_x) + 0.5 - n_x / 2) * period[0]
    middle_y = (np.arange(n_y) + 0.5 - n_y / 2) * period[1]
    x, y = np.empty((2 * n_y, 2 * n_x)), np.empty((2 * n_y, 2 * n_x))
    for b, side_y in enumerate((-1.0, 1.0)):
        for a, side_x in enumerate((-1.0, 1.0)):
            x[b::2, a::2] = middle_x + side_x * half[..., 0]
            y[b::2, a::2] = middle_y[:, None] + side_y * half[..., 1]
    return Mesh(x, y, solid, (n_x * period[0], n_y * period[1]))


@dataclass(frozen=True)
class Geometry:
    """The bilinear map of an element at quadrature points, each of shape (q_x, q_y)."""

    x: FloatArray  #: nm.
    y: FloatArray  #: nm.
    x_u: FloatArray  #: Derivative of x along the first side of the square; likewise the others.
    x_v: FloatArray  #: Derivative of x along the second side.
    y_u: FloatArray  #: Derivative of y along the first side.
    y_v: FloatArray  #: Derivative of y along the second side.

    @property
    def area(self) -> FloatArray:
        """Determinant of the map, shape (q_x, q_y)."""
        return self.x_u * self.y_v - self.x_v * self.y_u

    def physical(self, along_u: FloatArray, along_v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(E_x, E_y) of covariant components (E_u, E_v), any shapes that end with (q_x, q_y)."""
        area = self.area
        e_x = (self.y_v * along_u - self.y_u * along_v) / area
        return e_x, (self.x_u * along_v - self.x_v * along_u) / area


def geometry(corners: tuple[FloatArray, FloatArray], u: Shapes, v: Shapes) -> Geometry:
    """The map of an element with vertices ``corners``, each of shape (2, 2), indexed [along v, along u]."""
    (x, y), (n_u, n_v) = corners, (u.nodal[:2], v.nodal[:2])
    d_u, d_v = u.nodal_slope[:2], v.nodal_slope[:2]

    def mapped(place: FloatArray, along_u: FloatArray, along_v: FloatArray) -> FloatArray:
        return np.asarray(along_u.T @ place.T @ along_v)

    return Geometry(
        mapped(x, n_u, n_v), mapped(y, n_u, n_v),
        mapped(x, d_u, n_v), mapped(x, n_u, d_v), mapped(y, d_u, n_v), mapped(y, n_u, d_v),
    )  # fmt: skip


def singular_exponent(eps_pillar: float, eps_around: float) -> float:
    """Tau of a right-angled corner, 2/3 to 1, from the permittivities inside and around it; 1 where they are equal."""
    from scipy.optimize import brentq

    if eps_pillar == eps_around:
        return 1.0

    def jump(tau: float) -> float:
        small, large = 0.25 * math.pi * tau, 0.75 * math.pi * tau
        return eps_pillar * math.sin(small) * math.cos(large) + eps_around * math.cos(small) * math.sin(large)

    low, high = 2.0 / 3.0, 1.0 - 1e-9
    return float(brentq(jump, low, high)) if jump(low) * jump(high) < 0.0 else 1.0


def corner_function(
    tau: float, place: Geometry, corner_nm: tuple[float, float], inwards: tuple[int, int], *, inside: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """r^tau Phi(theta) of one corner and its gradient (x, y) at points, each of shape (q_x, q_y).

    ``inwards`` are the signs of (x, y) from the corner into the pillar; ``inside`` says whether the points lie in it.
    """
    d_x, d_y = place.x - corner_nm[0], place.y - corner_nm[1]
    r = np.hypot(d_x, d_y)
    # theta from the bisector, and its sense.
    along, across = inwards[0] * d_x + inwards[1] * d_y, inwards[0] * d_y - inwards[1] * d_x
    theta = np.arctan2(across, along)
    if inside:
        phi, slope = np.cos(tau * theta), -tau * np.sin(tau * theta)
    else:
        share = math.cos(0.25 * math.pi * tau) / math.cos(0.75 * math.pi * tau)
        rest = np.pi - np.abs(theta)
        phi, slope = share * np.cos(tau * rest), share * tau * np.sin(tau * rest) * np.sign(theta)
    power = (r / _UNIT_NM) ** tau
    radial, turning = tau * power * phi / r, power * slope / r
    return power * phi, (radial * d_x - turning * d_y) / r, (radial * d_y + turning * d_x) / r
