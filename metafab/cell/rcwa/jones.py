"""Zero-order Jones matrices of a pillar at one truncation, by the symmetry classes that the incidence allows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

import numpy as np
from threadpoolctl import ThreadpoolController

from metafab.cell.rcwa.admittance import LayerField, through_layer
from metafab.cell.rcwa.basis import (
    AxisBasis,
    AxisParity,
    Formulation,
    Matrix,
    axis_basis,
    symmetric_axis,
    travelling_axis,
)
from metafab.cell.rcwa.doubling import Faces, through_by_doubling
from metafab.cell.rcwa.eigenmodes import LayerModes, PlaneWaves, layer_modes, plane_waves
from metafab.cell.rcwa.factorisation import largest_eigenvalue, layer_matrices
from metafab.cell.rcwa.stack import StackLayer, through_stack
from metafab.cell.rcwa.transverse import TransverseBasis, transverse_basis
from metafab.cell.response import PillarCell
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError

Orders = tuple[int, int]


@dataclass(frozen=True)
class ZeroOrder:
    """Jones matrices at one truncation.

    Attributes:
        t: shape (2, 2), [out, in] of the transverse field in the basis (x, y), at the planes of the conventions.
        r: shape (2, 2), the same for reflection.
        transmitted_power: shape (2,), power in all transmitted orders for incident x and y, over the incident power.
        reflected_power: shape (2,), the same for reflection.
        coefficients: unknowns of the largest symmetry class.
        inconsistency: by how much rounding broke the layer's reciprocity (:mod:`metafab.cell.rcwa.doubling`), as an
            amplitude; 0 where the modes were used.
    """

    t: ComplexArray
    r: ComplexArray
    transmitted_power: FloatArray
    reflected_power: FloatArray
    coefficients: int
    inconsistency: float


@dataclass(frozen=True)
class SymmetryClass:
    """Fields of one symmetry, with the outer indices that their polarisation sees."""

    basis: TransverseBasis
    n_in: complex
    n_out: complex


@dataclass(frozen=True)
class Layer:
    """Matrices of the layer in one symmetry class, and the plane waves on either side."""

    p: Matrix
    q: Matrix
    thickness_k0: float
    incoming: PlaneWaves
    outgoing: PlaneWaves


@dataclass(frozen=True)
class ClassSolution:
    """What :func:`solve_class` found: modes of the layer, waves outside, and the field."""

    modes: LayerModes
    incoming: PlaneWaves
    outgoing: PlaneWaves
    field: LayerField


def axis_orders(cell: PillarCell, orders: int) -> Orders:
    """Cosines along x and y for ``orders`` cosines along the longer period; shorter periods need fewer."""
    longest = max(cell.period_nm)
    x, y = (max(2, math.ceil(orders * period / longest)) for period in cell.period_nm)
    return x, y


def zero_order(cell: PillarCell, orders: int, formulation: Formulation = "adaptive") -> ZeroOrder:
    """Jones matrices of ``cell`` with ``orders`` cosines beside the constant along the longer period.

    One BLAS thread is used: on matrices of this size more threads cost time.

    Raises:
        InputError: light at an angle meets a substrate whose index depends on polarisation, or comes out of an
            absorbing medium.
    """
    t, r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    power = np.zeros((2, 2))
    largest, inconsistency = 0, 0.0
    with one_thread():
        for case in symmetry_classes(cell, axis_orders(cell, orders), formulation):
            layer, incident = _layer(cell, case), case.basis.zero_order()
            faces = through_case(cell, case, layer, incident)
            t, r = t + incident.T @ faces.transmitted, r + incident.T @ faces.reflected
            power = power + _powers(layer, faces, incident)
            largest = max(largest, case.basis.size)
            inconsistency = max(inconsistency, faces.inconsistency)
            if _polarisations_swap(cell):
                t, r, power = t + t[::-1, ::-1], r + r[::-1, ::-1], power + power[:, ::-1]
                break
    return ZeroOrder(t, r, power[0], power[1], largest, inconsistency)


def symmetry_classes(cell: PillarCell, orders: Orders, formulation: Formulation) -> Iterator[SymmetryClass]:
    """The symmetry classes that incident light of either polarisation excites."""
    x = axis_basis(cell.period_nm[0], cell.width_nm, orders[0], formulation)
    y = axis_basis(cell.period_nm[1], cell.length_nm, orders[1], formulation)
    if cell.angle_deg == 0.0:
        for i, even_first in enumerate((True, False)):
            basis = transverse_basis(*(symmetric_axis(axis, even_first=even_first) for axis in (x, y)))
            yield SymmetryClass(basis, cell.n_in[i], cell.n_out[i])
        return
    _check_oblique(cell)
    k_in = 2.0 * math.pi / cell.wavelength_nm * cell.n_in[0].real * math.sin(math.radians(cell.angle_deg))
    k_x, k_y = (k_in * part for part in _direction(cell.azimuth_deg))
    # With parity along one axis only, each of its two classes holds one polarisation.
    for u in _families(x, k_x):
        for v in _families(y, k_y):
            yield SymmetryClass(transverse_basis(u, v), cell.n_in[0], cell.n_out[0])


def through_case(cell: PillarCell, case: SymmetryClass, layer: Layer, incident: ComplexArray) -> Faces:
    """Field at the faces of the layer or stack, by whichever way is faster and can be trusted."""
    if cell.under or cell.over:
        return _through_slices(cell, case, layer, incident)
    largest_a = largest_eigenvalue(permittivity(cell.n_pillar), permittivity(cell.n_ambient))
    faces = through_by_doubling(
        layer.p, layer.q, layer.thickness_k0, layer.incoming, layer.outgoing, incident, largest_a
    )
    if faces is not None:
        return faces
    field = solve_class(cell, case, layer).field
    return Faces(field.transmitted, field.reflected, 0.0)


def solve_class(cell: PillarCell, case: SymmetryClass, layer: Layer | None = None) -> ClassSolution:
    """Modes and field of one symmetry class, for incident E_x = 1 and E_y = 1 (as far as the class holds them)."""
    layer = layer or _layer(cell, case)
    modes = layer_modes(layer.p, layer.q)
    field = through_layer(modes, layer.thickness_k0, layer.incoming, layer.outgoing, case.basis.zero_order())
    return ClassSolution(modes, layer.incoming, layer.outgoing, field)


def _through_slices(cell: PillarCell, case: SymmetryClass, layer: Layer, incident: ComplexArray) -> Faces:
    k0_per_nm = 2.0 * math.pi / cell.wavelength_nm
    pillar = StackLayer(layer_modes(layer.p, layer.q), layer.thickness_k0)
    under, over = (
        [
            StackLayer(
                layer_modes(*layer_matrices(case.basis, k0_per_nm, permittivity(s.n_inside), permittivity(s.n_around))),
                k0_per_nm * s.height_nm,
            )
            for s in slices
        ]
        for slices in (cell.under, cell.over)
    )
    upwards = [*under, pillar, *over]
    layers = upwards if cell.side == "substrate" else upwards[::-1]
    return through_stack(layers, layer.incoming, layer.outgoing, incident)


def _layer(cell: PillarCell, case: SymmetryClass) -> Layer:
    k0_per_nm = 2.0 * math.pi / cell.wavelength_nm
    p, q = layer_matrices(case.basis, k0_per_nm, permittivity(cell.n_pillar), permittivity(cell.n_ambient))
    incoming, outgoing = (plane_waves(case.basis, k0_per_nm, permittivity(n)) for n in (case.n_in, case.n_out))
    return Layer(p, q, k0_per_nm * cell.height_nm, incoming, outgoing)


def permittivity(n: complex) -> complex:
    """Square of the index; a real number where nothing is lost, so that real arithmetic follows."""
    return n * n if complex(n).imag else complex(n).real ** 2


def one_thread() -> AbstractContextManager[Any]:
    """One BLAS thread while it lasts."""
    return cast("AbstractContextManager[Any]", _blas().limit(limits=1))


def _powers(layer: Layer, faces: Faces, incident: ComplexArray) -> FloatArray:
    """Power in all transmitted and all reflected orders, a row each, over the incident power (0 where none comes)."""

    def across(waves: PlaneWaves, field: ComplexArray) -> FloatArray:
        admittance = waves.h / np.where(waves.e == 0.0, np.inf, waves.e)
        return np.asarray(admittance.real @ np.abs(field) ** 2)

    sent = across(layer.incoming, incident)
    gone = np.stack([across(layer.outgoing, faces.transmitted), across(layer.incoming, faces.reflected)])
    return np.asarray(np.where(sent > 0.0, gone / np.where(sent > 0.0, sent, 1.0), 0.0))


def _polarisations_swap(cell: PillarCell) -> bool:
    """Whether x and y light see the same cell, turned by 90 degrees."""
    same_sizes = cell.width_nm == cell.length_nm and cell.period_nm[0] == cell.period_nm[1]
    return same_sizes and cell.angle_deg == 0.0 and cell.n_substrate[0] == cell.n_substrate[1]


def _families(axis: AxisBasis, incident_per_nm: float) -> list[AxisParity]:
    if incident_per_nm == 0.0:
        return [symmetric_axis(axis, even_first=True), symmetric_axis(axis, even_first=False)]
    return [travelling_axis(axis, incident_per_nm)]


def _direction(azimuth_deg: float) -> tuple[float, float]:
    """Cosine and sine, exact at multiples of 90 degrees, so that mirror planes are recognised."""
    quarter, rest = divmod(azimuth_deg, 90.0)
    c, s = (1.0, 0.0) if rest == 0.0 else (math.cos(math.radians(rest)), math.sin(math.radians(rest)))
    return ((c, s), (-s, c), (-c, -s), (s, -c))[int(quarter) % 4]


def _check_oblique(cell: PillarCell) -> None:
    if cell.n_substrate[0] != cell.n_substrate[1]:
        raise InputError.single(
            "cell",
            "angle_deg",
            "0 where the substrate's index differs between x and y polarisation",
            f"{cell.angle_deg:g}",
            "give the substrate one index, or light along the axis",
        )
    if cell.n_in[0].imag != 0.0:
        raise InputError.single(
            "cell", "angle_deg", "0 where the light comes out of an absorbing medium", f"{cell.angle_deg:g}"
        )


@cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController()
