"""Zero-order Jones matrices of a cell at one truncation, summed over its symmetry classes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from metafab.cell.pillar import PillarCell, Slice
from metafab.cell.rcwa.basis.coordinates import Formulation
from metafab.cell.rcwa.layers.factorisation import largest_eigenvalue
from metafab.cell.rcwa.scattering import stack
from metafab.cell.rcwa.scattering.doubling import LitLayer, solve_by_doubling
from metafab.cell.rcwa.scattering.half_space import PlaneWaves, Waves, magnetic
from metafab.cell.rcwa.scattering.modes import NO_MODES, Conditioning, FaceFields, layer_modes, match_modes
from metafab.cell.rcwa.symmetry import SymmetryClass, permittivity, polarisations_swap, symmetry_classes
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.parallel.executor import one_blas_thread


@dataclass(frozen=True)
class ZeroOrder:
    """Jones matrices at one truncation."""

    #: Shape (2, 2), [out, in] of the transverse field in the basis (x, y), at the planes of the conventions.
    t: ComplexArray
    r: ComplexArray  #: Shape (2, 2), likewise for reflection.
    #: Shape (2,), power in all transmitted orders for incident x and y, over the incident power.
    transmitted_power: FloatArray
    reflected_power: FloatArray  #: Shape (2,), likewise for reflection.
    coefficients: int  #: Unknowns of the largest symmetry class.
    inconsistency: float  #: Violation of reciprocity by rounding, as an amplitude; 0 where modes were used.
    conditioning: Conditioning  #: Conditioning of the worst layer's modes; 0 where none were used.
    #: Largest :meth:`SolvedClass.near_field` of the classes; 0 where the solver does not compute it.
    near_field: float = 0.0
    kept: tuple[SolvedClass, ...] = ()  #: The symmetry classes that were solved, if they were kept.


@dataclass(frozen=True)
class SolvedClass:
    """One symmetry class and its field at the two ends of the layers."""

    case: SymmetryClass  #: The class.
    incoming: Waves  #: Waves of the half space that the light comes from.
    outgoing: Waves  #: Waves of the half space behind.
    faces: FaceFields  #: Transmitted and reflected field of incident E_x = 1 and E_y = 1.
    lit: LitLayer | None  #: Fields lit from either side, with the steps of the doubling; None where they were not kept.

    def near_field(self) -> float:
        """Squared E and H of all waves but the zero order's at the two faces, over the squared incident E.

        Transverse fields, H in units of E over the impedance of vacuum. It is of one polarisation under light along z,
        where a class holds one.
        """
        sides = (self.outgoing, self.faces.transmitted), (self.incoming, self.faces.reflected)
        fields = [field for waves, e in sides for field in (e, magnetic(waves, e))]
        return sum(_squared(each) - _squared(self.case.incident.T @ each) for each in fields)

    def shares_of_power(self) -> tuple[FloatArray, FloatArray]:
        """Transmitted and reflected power of each coefficient over the incident power, 0 where no light comes in.

        Two arrays of shape (n, 2), for incident x and y. A wave vector has two coefficients, of x and y; only the sum
        of their two shares is a power.
        """

        def across(waves: Waves, field: ComplexArray) -> FloatArray:
            return np.asarray((np.conj(field) * magnetic(waves, field)).real)

        sent = np.sum(across(self.incoming, self.case.incident), axis=0)
        over_sent = np.where(sent > 0.0, 1.0 / np.where(sent > 0.0, sent, 1.0), 0.0)
        transmitted = across(self.outgoing, self.faces.transmitted)
        reflected = across(self.incoming, self.faces.reflected)
        return transmitted * over_sent, reflected * over_sent


def zero_order(
    cell: PillarCell,
    orders: int,
    formulation: Formulation = "adaptive",
    steps: int = 1,
    *,
    by_modes: bool = False,
    keep: bool = False,
) -> ZeroOrder:
    """Solve ``cell`` for its Jones matrices with ``orders`` cosines besides the constant along each axis.

    One BLAS thread is used: on matrices of this size more threads cost time.

    Args:
        orders: cosines along each axis.
        formulation: "adaptive" or "fourier".
        steps: a sloped pillar is cut into this number of steps of equal height, each as wide as the pillar in the
            step's middle; :func:`metafab.cell.rcwa.slicing.smooth` takes the limit of many.
        by_modes: solve by modes even where doubling is faster and accurate: an independent check.
        keep: keep the solved classes, for their derivatives.

    Raises:
        InputError: light at an angle meets a birefringent substrate of unknown index along z, or comes out of a biaxial
            or an absorbing one.
    """
    t, r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    power, kept = np.zeros((2, 2)), []
    largest, inconsistency, worst, near_field = 0, 0.0, NO_MODES, 0.0
    with one_blas_thread():
        for solved in solved_classes(cell, orders, formulation, steps, by_modes=by_modes, keep=keep):
            kept += [solved] if keep else []
            incident, faces = solved.case.incident, solved.faces
            t, r = t + incident.T @ faces.transmitted, r + incident.T @ faces.reflected
            power = power + np.stack([np.sum(each, axis=0) for each in solved.shares_of_power()])
            largest = max(largest, solved.case.basis.size)
            inconsistency, worst = max(inconsistency, faces.inconsistency), worst.worse(faces.conditioning)
            near_field = max(near_field, solved.near_field())
            if polarisations_swap(cell):
                t, r, power = t + t[::-1, ::-1], r + r[::-1, ::-1], power + power[:, ::-1]
                break
    return ZeroOrder(t, r, power[0], power[1], largest, inconsistency, worst, near_field, tuple(kept))


def solved_classes(
    cell: PillarCell,
    orders: int,
    formulation: Formulation,
    steps: int = 1,
    *,
    by_modes: bool = False,
    keep: bool = False,
) -> Iterator[SolvedClass]:
    """Solve the symmetry classes of ``cell`` one by one; arguments as in :func:`zero_order`."""
    for case in symmetry_classes(cell, orders, formulation, steps):
        incoming, outgoing = case.outer_waves()
        yield SolvedClass(case, incoming, outgoing, *_solve(case, incoming, outgoing, by_modes=by_modes, keep=keep))


def _solve(
    case: SymmetryClass, incoming: Waves, outgoing: Waves, *, by_modes: bool, keep: bool
) -> tuple[FaceFields, LitLayer | None]:
    """Fields at the faces of the layer or stack, by doubling where that is accurate; and its steps if they are kept."""
    if len(case.layers) > 1 or not isinstance(incoming, PlaneWaves) or not isinstance(outgoing, PlaneWaves):
        upwards = [
            stack.StackLayer(*case.matrices(i), case.thickness_k0(i), _largest_eigenvalue(layer))
            for i, layer in enumerate(case.layers)
        ]
        layers = upwards if case.cell.side == "substrate" else upwards[::-1]
        return stack.through_stack(layers, incoming, outgoing, case.incident, slabs=not by_modes), None
    if not by_modes:
        largest_a = _largest_eigenvalue(case.layers[0])
        p, q = case.matrices()
        lit = solve_by_doubling(p, q, case.thickness_k0(), incoming, outgoing, case.incident, largest_a, keep=keep)
        if lit is not None:
            return lit.faces, lit if keep else None
    return match_modes(layer_modes(*case.matrices()), case.thickness_k0(), incoming, outgoing, case.incident), None


def _squared(field: ComplexArray) -> float:
    return float(np.vdot(field, field).real)


def _largest_eigenvalue(layer: Slice) -> float:
    return largest_eigenvalue(permittivity(layer.n_inside), permittivity(layer.n_around))


class Amplitudes(Protocol):
    """A result with Jones matrices."""

    @property
    def t(self) -> ComplexArray:
        """Jones matrix of transmission, shape (2, 2)."""

    @property
    def r(self) -> ComplexArray:
        """Jones matrix of reflection, shape (2, 2)."""


def distance(one: Amplitudes, other: Amplitudes) -> float:
    """Largest absolute difference of any amplitude."""
    return float(max(np.abs(one.t - other.t).max(), np.abs(one.r - other.r).max()))
