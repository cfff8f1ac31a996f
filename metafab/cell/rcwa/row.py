"""A row of M different pillars along x by the Fourier modal method: a period of M cells by one cell.

There is no mirror symmetry along x, and every pillar has its own length. Along x the coordinate map increases the
resolution at all 2 M walls. Along y the pillars share one map, and the basis has even or odd parity. With U_i and V_i
the overlaps of pillar i with the functions along x and y, Li's rules become (J. Opt. Soc. Am. A 14, 2758, 1997)

    eps_u: sum over the bands b of y between one length and the next, [inverse rule in x of the pillars in b] (x) V_b,
    eps_v: sum over i, U_i (x) [inverse rule in y of pillar i] + eps_around (1 - sum U_i) (x) 1,
    eps_z: eps_around + (eps_pillar - eps_around) sum over i, U_i (x) V_i.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from metafab.cell.rcwa.basis.axis import AxisBasis, AxisParity, outline_bases, symmetric_axis
from metafab.cell.rcwa.basis.coordinates import IntArray, Matrix, stretched
from metafab.cell.rcwa.basis.transverse import TransverseBasis, transverse_basis
from metafab.cell.rcwa.certificate import solve
from metafab.cell.rcwa.jones import one_thread
from metafab.cell.rcwa.layers.factorisation import inverse_rule
from metafab.cell.rcwa.scattering.half_space import plane_waves
from metafab.cell.rcwa.scattering.modes import layer_modes, match_modes
from metafab.cell.rcwa.symmetry import permittivity
from metafab.cell.response import CellNumerics
from metafab.cell.supercell import Supercell, SupercellOrders, SupercellResponse, relative_rms
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
from metafab.core.errors import InputError

#: Target error of each pillar in its own periodic cell.
_SINGLE_CELL_ERROR = 1e-3
#: Gauss-Legendre nodes for the phase of a basis function, per interval of the map.
_NODES = 16


@dataclass(frozen=True)
class RowNumerics:
    """Numerics of a row.

    Attributes:
        orders_x: harmonics along x per site and direction, of a coarse and a fine truncation. The fine one is the
            result; its difference from the coarse one is the error.
        orders_y: cosines along y besides the constant, of both truncations.
    """

    orders_x: tuple[int, int] = (3, 4)
    orders_y: tuple[int, int] = (4, 5)


@dataclass(frozen=True)
class _Interval:
    """Part of a period of the map: dx/du = m [1 + A cos(2 pi s / l)], s from its middle; lengths in sites."""

    middle: float
    length: float
    middle_x: float
    rise: float
    amplitude: float

    def harmonics(self, k: IntArray, period: float) -> ComplexArray:
        """Integral of dx/du exp(-2 pi i k u / period) over the interval, divided by the period; shapes (n,)."""
        turns = k * self.length / period
        side = 0.5 * self.amplitude * (np.sinc(turns - 1.0) + np.sinc(turns + 1.0))
        return np.asarray(self.rise / period * (np.sinc(turns) + side) * np.exp(-2j * np.pi * k * self.middle / period))

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(x, dx/du) at ``s`` from the middle; shapes (n,)."""
        turn, mean = 2.0 * np.pi * s / self.length, self.rise / self.length
        x = self.middle_x + mean * (s + self.amplitude * self.length / (2.0 * np.pi) * np.sin(turn))
        return x, mean * (1.0 + self.amplitude * np.cos(turn))


@dataclass(frozen=True)
class RowAxis:
    """The x axis of a row.

    Attributes:
        wavenumber: shape (n,), rad/nm, the zero order first, then by magnitude.
        pillars: shape (M, n, n), the indicator of each pillar between the basis functions.
        order: shape (n,), diffraction order of each function.
        phase: shape (n,), overlap <function | plane wave of its order>; its modulus is 1 if the basis resolves the
            wave.
    """

    wavenumber: FloatArray
    pillars: ComplexArray
    order: IntArray
    phase: ComplexArray


def solve_row(
    supercell: Supercell, polarisation: Polarisation, numerics: RowNumerics = RowNumerics()
) -> SupercellResponse:
    """Solve a row of pillars at normal incidence, and each pillar in its own periodic cell.

    Args:
        supercell: one site along y; for a row along y, see :meth:`Supercell.exchanged`.
        polarisation: of the incident wave.
        numerics: truncations.

    Raises:
        InputError: more than one row, or orders along y that propagate.
    """
    start = time.perf_counter()
    order = supercell.propagating_orders(polarisation)
    if supercell.shape[0] != 1:
        got = f"{supercell.shape[0]} rows"
        raise InputError.single("supercell", "size_nm", "one row along x for rcwa", got, "use meep")
    if np.any(order[:, 1] != 0):
        expected = "a y period so short that no order along y propagates behind the pillars"
        raise InputError.single("supercell", "period_nm", expected, f"{supercell.cell.period_nm[1]:g} nm")
    coarse_x, fine_x = numerics.orders_x
    coarse_y, fine_y = numerics.orders_y
    coarse = row_orders(supercell, polarisation, order[:, 0], coarse_x, coarse_y)
    fine = row_orders(supercell, polarisation, order[:, 0], fine_x, fine_y)
    axis = POLARISATIONS.index(polarisation)
    cells = supercell.periodic_cells()
    t_single = {size: solve(cell, CellNumerics(_SINGLE_CELL_ERROR)).t[axis, axis] for size, cell in cells.items()}
    amplitude = np.zeros((len(order), 2), dtype=np.complex128)
    amplitude[:, axis] = fine
    return SupercellResponse(
        supercell=supercell,
        polarisation=polarisation,
        order=order,
        amplitude=amplitude,
        responses=np.array([[t_single[float(w), float(length)] for w, length in supercell.size_nm[0]]]),
        error=float(np.max(np.abs(fine - coarse))),
        seconds=time.perf_counter() - start,
    )


def supercell_orders(supercell: Supercell, numerics: RowNumerics = RowNumerics()) -> SupercellOrders:
    """Transmitted orders of a row along x or along y for both incident polarisations.

    Args:
        supercell: one site along x or along y.
        numerics: truncations.

    Raises:
        InputError: neither side is a single site, or orders across the row propagate.
    """
    start = time.perf_counter()
    if 1 not in supercell.shape:
        got = f"{supercell.shape[1]} x {supercell.shape[0]} pillars"
        raise InputError.single("supercell", "size_nm", "a row along x or along y for rcwa", got, "use meep")
    along_y = supercell.shape[0] > 1
    row = supercell.exchanged() if along_y else supercell
    order = row.propagating_orders("x")
    t = np.zeros((2, len(order), 2, 2), dtype=np.complex128)
    for fineness in (0, 1):
        for axis, light in enumerate(POLARISATIONS):
            truncation = numerics.orders_x[fineness], numerics.orders_y[fineness]
            t[fineness, :, axis, axis] = row_orders(row, light, order[:, 0], *truncation)
    coarse, fine = t[..., ::-1, ::-1] if along_y else t
    order = order[:, ::-1] if along_y else order
    return SupercellOrders(supercell, order, fine, relative_rms(fine - coarse, fine), time.perf_counter() - start)


def row_orders(
    supercell: Supercell, polarisation: Polarisation, order: IntArray, orders_x: int, orders_y: int
) -> ComplexArray:
    """Transmitted amplitudes of a row at one truncation: E along the polarisation of the incident wave.

    Args:
        supercell: one site along y.
        polarisation: of the incident wave.
        order: shape (n,), numbers m of the orders (m, 0).
        orders_x: harmonics along x per site and direction.
        orders_y: cosines along y besides the constant.

    Returns:
        Shape (n,).
    """
    cell, axis = supercell.cell, POLARISATIONS.index(polarisation)
    width, length = supercell.size_nm[0].T
    along_x = row_axis(cell.period_nm[0], width, orders_x)
    bases = outline_bases(cell.period_nm[1], tuple(map(float, length)), orders_y, "adaptive")
    with one_thread():
        basis, p, q = _matrices(along_x, bases, supercell, polarisation)
        incident = basis.zero_order()[:, axis : axis + 1]
        incoming = plane_waves(basis, cell.k0_per_nm, permittivity(cell.n_in[axis]))
        outgoing = plane_waves(basis, cell.k0_per_nm, permittivity(cell.n_out[axis]))
        field = match_modes(layer_modes(p, q), cell.k0_per_nm * cell.height_nm, incoming, outgoing, incident)
    # Orders (m, 0) lie in the xz plane, so that (TM, TE) are E_x and E_y.
    n_v = basis.v.label_a.size if polarisation == "x" else basis.v.label_b.size
    first = 0 if polarisation == "x" else along_x.wavenumber.size * basis.v.label_a.size
    place = np.array([int(np.flatnonzero(along_x.order == m)[0]) for m in order])
    return np.asarray(field.transmitted[first + place * n_v, 0] * along_x.phase[place].conj())


def row_axis(period_nm: float, width_nm: FloatArray, orders: int) -> RowAxis:
    """Basis of the x axis of a row: the plane waves of the empty row in stretched harmonics.

    They solve D v = k F v, where D holds the wave numbers in u and F is the Gram matrix of dx/du.

    Args:
        period_nm: period of one site.
        width_nm: shape (M,), widths of the pillars, centred on their sites; 0 for no pillar.
        orders: harmonics per site and direction.
    """
    count = len(width_nm)
    intervals, owner = _intervals(np.asarray(width_nm, dtype=np.float64) / period_nm, orders)
    harmonic = np.arange(-orders * count, orders * count + 1)
    difference = harmonic[:, None] - harmonic
    lags = np.arange(-2 * orders * count, 2 * orders * count + 1)
    parts = np.array([part.harmonics(lags, count) for part in intervals])
    gram = parts.sum(axis=0)[difference + 2 * orders * count]
    # L^-1 D L^-H has real eigenvalues; zero is exactly one of them.
    lower = np.linalg.cholesky(gram)
    half = np.linalg.solve(lower, np.diag(2.0 * np.pi / (count * period_nm) * harmonic).astype(np.complex128))
    reduced = np.linalg.solve(lower, half.conj().T)
    value, vector = np.linalg.eigh(0.5 * (reduced + reduced.conj().T))
    vector = np.linalg.solve(lower.conj().T, vector)
    # Ascending wave numbers are ascending orders, the constant in the middle.
    first = np.argsort(np.abs(harmonic), kind="stable")
    value, vector, order = value[first], vector[:, first], harmonic[first]
    value[0], vector[:, 0] = 0.0, np.where(harmonic == 0, 1.0, 0.0)
    phase = _phases(intervals, harmonic, vector, order, count)
    pillars = np.zeros((count, len(order), len(order)), dtype=np.complex128)
    for i, part in zip(owner, parts, strict=True):
        if i >= 0:
            matrix = vector.conj().T @ part[difference + 2 * orders * count] @ vector
            pillars[i] += 0.5 * (matrix + matrix.conj().T)
    return RowAxis(value, pillars, order, phase)


def _intervals(fill: FloatArray, orders: int) -> tuple[list[_Interval], list[int]]:
    """Pillars and gaps of a row in sites from its middle, and the pillar of each interval (-1 for a gap).

    Every site has an equal part of the range of u. Within it, the walls lie as in the map of a single pillar.
    """
    maps = [stretched(1.0, float(f), orders) for f in fill]
    walls_x, walls_u, owner = [], [], []
    for i, (f, single) in enumerate(zip(fill, maps, strict=True)):
        middle = i + 0.5 - len(fill) / 2.0
        if f > 0.0:
            walls_x += [middle - f / 2.0, middle + f / 2.0]
            walls_u += [middle - single.wall_fraction / 2.0, middle + single.wall_fraction / 2.0]
            owner += [i, -1]
    if not owner:
        return [_Interval(0.0, float(len(fill)), 0.0, float(len(fill)), 0.0)], [-1]
    walls_x.append(walls_x[0] + len(fill))
    walls_u.append(walls_u[0] + len(fill))
    intervals, owners = [], []
    for j, i in enumerate(owner):
        rise, length = walls_x[j + 1] - walls_x[j], walls_u[j + 1] - walls_u[j]
        if rise <= 1e-12:
            continue
        single = maps[max(i, 0)]
        amplitude = 1.0 - (single.slope_inside if i >= 0 else single.slope_outside)
        middle_u, middle_x = 0.5 * (walls_u[j] + walls_u[j + 1]), 0.5 * (walls_x[j] + walls_x[j + 1])
        intervals.append(_Interval(middle_u, length, middle_x, rise, amplitude))
        owners.append(i)
    return intervals, owners


def _phases(
    intervals: list[_Interval], harmonic: IntArray, vector: ComplexArray, order: IntArray, count: int
) -> ComplexArray:
    """<basis function | plane wave of its order>, by Gauss-Legendre quadrature over each interval."""
    node, weight = np.polynomial.legendre.leggauss(_NODES * max(1, math.ceil(max(p.length for p in intervals))))
    total = np.zeros(len(order), dtype=np.complex128)
    for part in intervals:
        s = 0.5 * part.length * node
        x, slope = part.at(s)
        functions = np.exp(2j * np.pi / count * np.outer(harmonic, part.middle + s)).T @ vector
        waves = np.exp(2j * np.pi / count * np.outer(x, order))
        total += (0.5 * part.length / count * weight * slope) @ (functions.conj() * waves)
    return total


def _matrices(
    row: RowAxis, bases: tuple[AxisBasis, ...], supercell: Supercell, polarisation: Polarisation
) -> tuple[TransverseBasis, Matrix, Matrix]:
    """The transverse basis and P, Q of :mod:`metafab.cell.rcwa.layers.factorisation`."""
    cell, length_nm = supercell.cell, supercell.size_nm[0, :, 1]
    eps_pillar, eps_around = permittivity(cell.n_pillar), permittivity(cell.n_ambient)
    along_y = [symmetric_axis(basis, even_first=polarisation == "x") for basis in bases]
    v, step = along_y[0], eps_pillar - eps_around
    n = row.wavenumber.size
    label = np.arange(n)
    u = AxisParity(row.pillars[0].real, row.pillars[0].real, label, label, row.wavenumber)
    basis = transverse_basis(u, v)

    one_u, one_a, one_b = np.eye(n), np.eye(len(v.a)), np.eye(len(v.b))
    eps_u: Matrix = np.zeros((n * len(v.a),) * 2, dtype=np.complex128)
    below = np.zeros_like(one_a)
    for bound in np.unique(length_nm):
        up_to = along_y[int(np.flatnonzero(length_nm == bound)[0])].a
        longer = row.pillars[length_nm >= bound].sum(axis=0)
        eps_u = eps_u + np.kron(inverse_rule(longer, eps_pillar, eps_around), up_to - below)
        below = up_to
    eps_u = eps_u + eps_around * np.kron(one_u, one_a - below)
    eps_v = eps_around * np.kron(one_u - row.pillars.sum(axis=0), one_b)
    eps_z = eps_around * np.kron(one_u, one_a)
    for pillar, parity in zip(row.pillars, along_y, strict=True):
        eps_v = eps_v + np.kron(pillar, inverse_rule(parity.b, eps_pillar, eps_around))
        eps_z = eps_z + step * np.kron(pillar, parity.a)

    k_u = np.diag(row.wavenumber / cell.k0_per_nm)
    k_v = np.where(v.label_a[:, None] == v.label_b, v.wavenumber[v.label_b], 0.0) / cell.k0_per_nm
    from_e_z = np.concatenate([np.kron(k_u, one_a), np.kron(one_u, k_v.T)])
    from_h_z = np.concatenate([np.kron(one_u, k_v), -np.kron(k_u, one_b)])
    p = np.eye(basis.size) - from_e_z @ np.linalg.solve(eps_z, from_e_z.T)
    q = (-from_h_z @ from_h_z.T).astype(np.complex128)
    n_u = len(eps_u)
    q[:n_u, :n_u] += eps_u
    q[n_u:, n_u:] += eps_v
    # P and Q are Hermitian, not symmetric: transform the rows, then the columns.
    p, q = (basis.rows_to_tm_te(basis.rows_to_tm_te(matrix).T).T for matrix in (p, q))
    return basis, p, q
