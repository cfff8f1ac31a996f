"""A supercell: several different pillars in one period, its diffraction orders, and the local-period approximation.

The library solves every pillar in a lattice of equal pillars (local-period approximation). A supercell holds n_y x n_x
different pillars, as a lens does. The diffraction orders of the supercell minus those predicted from the single pillars
are the coupling between neighbours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.cell.pillar import PillarCell
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
from metafab.core.errors import InputError

IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class Supercell:
    """Pillars of many sizes in one period.

    InputError for sizes of another shape or beyond the period, or a cell that no supercell solver treats.
    """

    #: Period of one site, outline, materials, and light along the axis; its own pillar size is ignored. Pillars are
    #: upright, without layers, on an isotropic substrate in a rectangular lattice; not rings.
    cell: PillarCell
    size_nm: FloatArray  #: Shape (n_y, n_x, 2), (width, length) at each site, lowest y first; (0, 0) for no pillar.

    def __post_init__(self) -> None:
        shape = np.shape(self.size_nm)
        if len(shape) != 3 or shape[2] != 2 or 0 in shape:
            raise InputError.single("supercell", "size_nm", "shape (n_y, n_x, 2), at least one pillar", f"{shape}")
        sizes = np.asarray(self.size_nm, dtype=np.float64)
        if not (np.all(sizes >= 0.0) and np.all(sizes <= self.cell.period_nm)):
            expected = f"0 to the period of {self.cell.period_nm} nm"
            raise InputError.single("supercell", "size_nm", expected, f"{sizes.max():g} nm")
        remedy = "remove it to compute the coupling between neighbours"
        treated = () if self.cell.shape == "ring" else ("shape, corner_radius_nm",)
        faults = self.cell.untreated("a supercell", treated, remedy)
        if faults:
            raise InputError("supercell", faults)

    @property
    def shape(self) -> tuple[int, int]:
        """Sites along (y, x)."""
        return self.size_nm.shape[0], self.size_nm.shape[1]

    @property
    def period_um(self) -> tuple[float, float]:
        """Period of the supercell along (x, y)."""
        n_y, n_x = self.shape
        return n_x * self.cell.period_nm[0] * 1e-3, n_y * self.cell.period_nm[1] * 1e-3

    def exchanged(self) -> Supercell:
        """The supercell with x and y exchanged; polarisations and orders exchange with them."""
        return Supercell(exchanged_site(self.cell), np.ascontiguousarray(self.size_nm.transpose(1, 0, 2)[:, :, ::-1]))

    def periodic_cells(self) -> dict[tuple[float, float], PillarCell]:
        """Each distinct (width, length) -> the cell of a lattice of such pillars alone."""
        sizes = np.unique(self.size_nm.reshape(-1, 2), axis=0)
        return {
            (float(w), float(length)): replace(self.cell, width_nm=float(w), length_nm=float(length))
            for w, length in sizes
        }

    def propagating_orders(self, polarisation: Polarisation) -> IntArray:
        """Orders (m, n) along (x, y) that propagate behind the pillars, shape (n_orders, 2), sorted by n, then m."""
        reach = self.cell.n_out[POLARISATIONS.index(polarisation)].real / (self.cell.wavelength_nm * 1e-3)
        m, n = (np.arange(-math.floor(reach * p), math.floor(reach * p) + 1) for p in self.period_um)
        orders = np.stack(np.meshgrid(m, n), axis=-1).reshape(-1, 2)
        return np.asarray(orders[np.hypot(*(orders / self.period_um).T) < reach * (1.0 - 1e-9)], dtype=np.intp)

    def wavevectors_per_um(self, orders: IntArray) -> FloatArray:
        """(k_x, k_y) of ``orders``, shape (n_orders, 2), in rad/um; shape (n_orders, 2)."""
        return np.asarray(2.0 * np.pi * orders / self.period_um, dtype=np.float64)

    def relative_power(self, orders: IntArray, amplitude: ComplexArray, polarisation: Polarisation) -> FloatArray:
        """Power of orders along z over that of an incident wave of unit amplitude, shape (n_orders,).

        A wave of tangential field E carries k_z |E|^2 + |k.E|^2 / k_z, because its E_z is -k.E / k_z. Orders, shape
        (n_orders, 2), propagate; their amplitudes are E_x and E_y, shape (n_orders, 2). The polarisation is that of the
        incident wave.
        """
        axis = POLARISATIONS.index(polarisation)
        vacuum = 2.0 * math.pi / (self.cell.wavelength_nm * 1e-3)
        k = self.wavevectors_per_um(orders)
        k_z = np.sqrt((vacuum * self.cell.n_out[axis].real) ** 2 - np.sum(k**2, axis=-1))
        power = k_z * np.sum(np.abs(amplitude) ** 2, axis=-1) + np.abs(np.sum(k * amplitude, axis=-1)) ** 2 / k_z
        return np.asarray(power / (vacuum * self.cell.n_in[axis].real), dtype=np.float64)

    def local_period(self, orders: IntArray, responses: ComplexArray) -> ComplexArray:
        """Amplitudes of orders by the local-period approximation, with one sample per site, shape (n_orders,).

        ``orders`` has the shape (n_orders, 2). ``responses``, shape (n_y, n_x), are the zero-order t of each pillar in
        its own periodic cell.
        """
        along_x, along_y = (wave.conj() for wave in self._waves(orders))
        return np.asarray(np.einsum("oy,yx,ox->o", along_y, responses, along_x, optimize=True) / responses.size)

    def at_sites(self, orders: IntArray, amplitude: ComplexArray) -> ComplexArray:
        """Sum of orders, shape (n_orders, 2), with amplitudes (n_orders,) at the sites: shape (n_y, n_x)."""
        along_x, along_y = self._waves(orders)
        return np.asarray((along_y * amplitude[:, None]).T @ along_x)

    def _waves(self, orders: IntArray) -> tuple[ComplexArray, ComplexArray]:
        """Phase factors of orders at the sites from the middle of the supercell: (n_orders, n_x), (n_orders, n_y)."""
        n_y, n_x = self.shape
        x, y = (((np.arange(count) + 0.5) / count - 0.5) for count in (n_x, n_y))
        return np.exp(2j * np.pi * orders[:, :1] * x), np.exp(2j * np.pi * orders[:, 1:] * y)


def exchanged_site(cell: PillarCell) -> PillarCell:
    """The cell of a supercell's sites with x and y exchanged; its own pillar size stays."""
    return replace(cell, period_nm=cell.period_nm[::-1], n_substrate=cell.n_substrate[::-1])


@dataclass(frozen=True)
class SupercellResponse:
    """Transmitted orders of a supercell for one polarisation."""

    supercell: Supercell  #: The supercell that was solved.
    polarisation: Polarisation  #: Of the incident wave.
    order: IntArray  #: Shape (n_orders, 2), orders (m, n) that propagate behind the pillars.
    #: Shape (n_orders, 2), E_x and E_y over incident E in the planes of the conventions, with phases from the middle of
    #: the supercell.
    amplitude: ComplexArray
    #: Shape (n_y, n_x), zero-order t of each pillar in its own periodic cell, by the same solver.
    responses: ComplexArray
    #: Estimate of the largest absolute error of an amplitude: truncation (rcwa), or the remainder of the decaying field
    #: (meep: the error of the grid is common to ``amplitude`` and ``responses``).
    error: float
    seconds: float  #: Time that the solution took.

    @property
    def co_polarised(self) -> ComplexArray:
        """Amplitudes of the incident polarisation, shape (n_orders,)."""
        return np.asarray(self.amplitude[:, POLARISATIONS.index(self.polarisation)])

    @property
    def local_period(self) -> ComplexArray:
        """Amplitudes by the local-period approximation, shape (n_orders,)."""
        return self.supercell.local_period(self.order, self.responses)

    @property
    def efficiency(self) -> FloatArray:
        """Transmitted over incident power of each order, shape (n_orders,)."""
        return self.supercell.relative_power(self.order, self.amplitude, self.polarisation)

    @property
    def local_period_efficiency(self) -> FloatArray:
        """Transmitted over incident power of each order by the local-period approximation, shape (n_orders,)."""
        predicted = np.zeros_like(self.amplitude)
        predicted[:, POLARISATIONS.index(self.polarisation)] = self.local_period
        return self.supercell.relative_power(self.order, predicted, self.polarisation)

    @property
    def coupling_error(self) -> float:
        """Error of the local-period approximation: root of the squared amplitude differences summed over all orders."""
        return float(np.sqrt(np.sum(np.abs(self.co_polarised - self.local_period) ** 2)))


@dataclass(frozen=True)
class SupercellOrders:
    """Transmitted orders of a supercell for both incident polarisations: the result of every solver of supercells."""

    supercell: Supercell  #: The supercell that was solved.
    order: IntArray  #: Shape (n_orders, 2), all orders (m, n) that propagate behind the pillars.
    #: Shape (n_orders, 2, 2), E of each order over incident E, indexed [order, out, in] in the basis (x, y), in the
    #: planes of the conventions, with phases from the middle of the supercell.
    t: ComplexArray
    #: Relative error of ``t``: root of the squared errors summed over orders and polarisations, over that of ``t``
    #: itself.
    error: float
    seconds: float  #: Time that the solution took.

    def efficiency(self, polarisation: Polarisation) -> FloatArray:
        """Transmitted over incident power of each order for an incident polarisation, shape (n_orders,)."""
        amplitude = self.t[:, :, POLARISATIONS.index(polarisation)]
        return self.supercell.relative_power(self.order, amplitude, polarisation)


def relative_rms(difference: ComplexArray, t: ComplexArray) -> float:
    """Norm of ``difference`` over the norm of ``t``, both of any shape; 0 where both vanish."""
    norm = float(np.linalg.norm(difference))
    return norm / float(np.linalg.norm(t)) if norm else 0.0
