"""Zero-order Jones matrices of a pillar at one truncation, by the symmetry classes that the incidence allows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from typing import Any, Protocol, cast

import numpy as np
from threadpoolctl import ThreadpoolController

from metafab.cell.rcwa.basis.axis import (
    AxisBasis,
    AxisParity,
    Formulation,
    Matrix,
    symmetric_axis,
    travelling_axis,
)
from metafab.cell.rcwa.basis.shared_map import outline_bases
from metafab.cell.rcwa.basis.transverse import TransverseBasis, transverse_basis
from metafab.cell.rcwa.layers.cross_section import Rectangles, rectangles
from metafab.cell.rcwa.layers.factorisation import largest_eigenvalue, layer_matrices
from metafab.cell.rcwa.layers.nested import nested_matrices
from metafab.cell.rcwa.layers.staggered import staggered_matrices
from metafab.cell.rcwa.scattering.admittance import LayerField, through_layer
from metafab.cell.rcwa.scattering.birefringence import TensorWaves, magnetic, tensor_waves
from metafab.cell.rcwa.scattering.conditioning import NO_MODES, Conditioning, conditioning
from metafab.cell.rcwa.scattering.doubling import Faces, through_by_doubling
from metafab.cell.rcwa.scattering.eigenmodes import LayerModes, PlaneWaves, layer_modes, plane_waves
from metafab.cell.rcwa.scattering.stack import StackLayer, through_stack
from metafab.cell.response import PillarCell, Slice
from metafab.core.conventions import ComplexArray, FloatArray, Side
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
        inconsistency: by how much rounding broke reciprocity (:mod:`metafab.cell.rcwa.scattering.doubling`), as an
        amplitude; 0
            where the modes were used.
        conditioning: of the worst layer's modes; 0 where none were used.
    """

    t: ComplexArray
    r: ComplexArray
    transmitted_power: FloatArray
    reflected_power: FloatArray
    coefficients: int
    inconsistency: float
    conditioning: Conditioning


@dataclass(frozen=True)
class SymmetryClass:
    """Fields of one symmetry, with the outer indices that their polarisation sees.

    Attributes:
        bases: for each layer from the substrate on, those of its rectangles; they differ in their outline alone.
        layers: what they hold, each with its sizes.
        n_in: index of the half space that the light comes from.
        n_out: index of the half space behind.
    """

    bases: tuple[tuple[TransverseBasis, ...], ...]
    layers: tuple[Slice, ...]
    n_in: complex
    n_out: complex

    @property
    def basis(self) -> TransverseBasis:
        """What all layers share: coefficients and wave numbers (and the overlap of the first)."""
        return self.bases[0][0]


@dataclass(frozen=True)
class Outside:
    """Plane waves of the half space that the light comes from, and of the one behind."""

    incoming: PlaneWaves | TensorWaves
    outgoing: PlaneWaves | TensorWaves


@dataclass(frozen=True)
class ClassFaces:
    """One symmetry class and its field at the faces of the layer or stack.

    Attributes:
        case: the class.
        outside: waves of both half spaces.
        incident: shape (n, 2), the columns of incident E_x = 1 and E_y = 1; zero where the class does not hold them.
        faces: transmitted and reflected field of both.
    """

    case: SymmetryClass
    outside: Outside
    incident: ComplexArray
    faces: Faces


@dataclass(frozen=True)
class ClassSolution:
    """What :func:`solve_class` found: modes of the layer, waves outside, and the field."""

    modes: LayerModes
    incoming: PlaneWaves
    outgoing: PlaneWaves
    field: LayerField


def zero_order(cell: PillarCell, orders: int, formulation: Formulation = "adaptive", steps: int = 1) -> ZeroOrder:
    """Jones matrices of ``cell`` with ``orders`` cosines beside the constant along each axis.

    A short period gets as many as a long one: were it left behind, the truncation would rise without its error falling.

    A sloped pillar is cut into ``steps`` of equal height, each as wide as the pillar is in the middle of it; for the
    limit of many see :func:`metafab.cell.rcwa.slicing.smooth`. One BLAS thread is used: on matrices of this size more
    threads cost time.

    Raises:
        InputError: light at an angle meets a birefringent substrate of unknown index along z, or comes out of a biaxial
            or an absorbing one.
    """
    t, r = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    power = np.zeros((2, 2))
    largest, inconsistency, worst = 0, 0.0, NO_MODES
    with one_thread():
        for solved in solved_classes(cell, orders, formulation, steps):
            incident, faces = solved.incident, solved.faces
            t, r = t + incident.T @ faces.transmitted, r + incident.T @ faces.reflected
            power = power + np.stack([np.sum(each, axis=0) for each in shares_of_power(solved)])
            largest = max(largest, solved.case.basis.size)
            inconsistency, worst = max(inconsistency, faces.inconsistency), worst.worse(faces.conditioning)
            if polarisations_swap(cell):
                t, r, power = t + t[::-1, ::-1], r + r[::-1, ::-1], power + power[:, ::-1]
                break
    return ZeroOrder(t, r, power[0], power[1], largest, inconsistency, worst)


def solved_classes(cell: PillarCell, orders: int, formulation: Formulation, steps: int = 1) -> Iterator[ClassFaces]:
    """The symmetry classes of ``cell``, each solved when it is asked for; arguments as of :func:`zero_order`."""
    for case in symmetry_classes(cell, (orders, orders), formulation, steps):
        outside, incident = _outside(cell, case), case.basis.zero_order()
        yield ClassFaces(case, outside, incident, through_case(cell, case, outside, incident))


def shares_of_power(solved: ClassFaces) -> tuple[FloatArray, FloatArray]:
    """Power that each coefficient carries off, over the incident power (0 where none comes).

    Returns:
        Transmitted and reflected, each of shape (n, 2) for incident x and y. The two waves of one wave vector must be
        taken together.
    """

    def across(waves: PlaneWaves | TensorWaves, field: ComplexArray) -> FloatArray:
        return np.asarray((np.conj(field) * magnetic(waves, field)).real)

    outside = solved.outside
    sent = np.sum(across(outside.incoming, solved.incident), axis=0)
    over_sent = np.where(sent > 0.0, 1.0 / np.where(sent > 0.0, sent, 1.0), 0.0)
    gone = across(outside.outgoing, solved.faces.transmitted), across(outside.incoming, solved.faces.reflected)
    return gone[0] * over_sent, gone[1] * over_sent


class Amplitudes(Protocol):
    """Whatever has Jones matrices."""

    @property
    def t(self) -> ComplexArray:
        """Shape (2, 2), of transmission."""

    @property
    def r(self) -> ComplexArray:
        """Shape (2, 2), of reflection."""


def distance(one: Amplitudes, other: Amplitudes) -> float:
    """Largest absolute difference of any amplitude."""
    return float(max(np.abs(one.t - other.t).max(), np.abs(one.r - other.r).max()))


def layers_of(cell: PillarCell, steps: int = 1) -> tuple[Slice, ...]:
    """The cell's layers from the substrate on, each with its sizes; a sloped pillar in ``steps``."""
    count = steps if cell.is_sloped else 1
    pillar = [
        Slice(cell.height_nm / count, cell.n_pillar, cell.n_ambient, *cell.sizes_nm((i + 0.5) / count))
        for i in range(count)
    ]
    under, over = (
        [
            replace(
                each,
                width_nm=width if each.width_nm is None else each.width_nm,
                length_nm=length if each.length_nm is None else each.length_nm,
            )
            for each in slices
        ]
        for slices, (width, length) in ((cell.under, cell.sizes_nm(0.0)), (cell.over, cell.sizes_nm(1.0)))
    )
    return (*under, *pillar, *over)


def symmetry_classes(
    cell: PillarCell, orders: Orders, formulation: Formulation, steps: int = 1
) -> Iterator[SymmetryClass]:
    """The symmetry classes that incident light of either polarisation excites."""
    layers = layers_of(cell, steps)
    if cell.is_staggered:
        yield from _staggered_classes(cell, layers, orders, formulation)
        return
    outlines = [_outline(cell, each, max(orders)) for each in layers]
    sizes = [size for outline in outlines for size in outline]
    # A sloped pillar's ends, whatever the steps, so that more of them change the steps and not the coordinates.
    ends = [cell.sizes_nm(0.0), cell.sizes_nm(1.0)] if cell.is_sloped else []
    x, y = (
        outline_bases(cell.period_nm[axis], tuple(size[axis] for size in sizes + ends), orders[axis], formulation)
        for axis in (0, 1)
    )
    x, y = x[: len(sizes)], y[: len(sizes)]
    counts = tuple(map(len, outlines))
    if cell.angle_deg == 0.0:
        for i, even_first in enumerate((True, False)):
            both = ([symmetric_axis(each, even_first=even_first) for each in axis] for axis in (x, y))
            yield SymmetryClass(_over_outlines(*both, counts=counts), layers, cell.n_in[i], cell.n_out[i])
        return
    _check_oblique(cell)
    k_x, k_y = in_plane_per_nm(cell)
    # With parity along one axis only, each of its two classes holds one polarisation.
    for u in zip(*(_families(each, k_x) for each in x), strict=True):
        for v in zip(*(_families(each, k_y) for each in y), strict=True):
            yield SymmetryClass(_over_outlines(u, v, counts=counts), layers, cell.n_in[0], cell.n_out[0])


def _outline(cell: PillarCell, layer: Slice, orders: int) -> Rectangles:
    """Rectangles of one layer; a closed film is as good as one."""
    width_nm, length_nm = layer.width_nm or 0.0, layer.length_nm or 0.0
    if layer.n_inside == layer.n_around:
        return ((width_nm, length_nm),)
    return rectangles(cell, width_nm, length_nm, orders)


def _staggered_classes(
    cell: PillarCell, layers: tuple[Slice, ...], orders: Orders, formulation: Formulation
) -> Iterator[SymmetryClass]:
    """Of a hexagonal lattice: outlines of the pillar, and of the gap at its ends, in the centred cell of two rows."""
    lengths = cell.period_nm[0], 2.0 * cell.period_nm[1]
    x, y = (
        outline_bases(length, (size, length - size), count, formulation)
        for length, size, count in zip(
            lengths, (cell.width_nm, cell.length_nm), (orders[0], 2 * orders[1]), strict=True
        )
    )
    for i, even_first in enumerate((True, False)):
        both = ([symmetric_axis(each, even_first=even_first) for each in axis] for axis in (x, y))
        yield SymmetryClass(_over_outlines(*both, counts=(2,)), layers, cell.n_in[i], cell.n_out[i])


def in_plane_per_nm(cell: PillarCell) -> tuple[float, float]:
    """Wave vector (k_x, k_y) of the incident light in the plane of the cell, rad/nm."""
    k_x, k_y = cell.in_plane
    return _k0_per_nm(cell) * k_x, _k0_per_nm(cell) * k_y


def _over_outlines(
    u: Sequence[AxisParity], v: Sequence[AxisParity], *, counts: tuple[int, ...]
) -> tuple[tuple[TransverseBasis, ...], ...]:
    """A basis for each outline along both axes, ``counts`` of them to each layer."""
    first = transverse_basis(u[0], v[0])
    bases = (first, *(replace(first, u=of_x, v=of_y) for of_x, of_y in zip(u[1:], v[1:], strict=True)))
    each = iter(bases)
    return tuple(tuple(islice(each, count)) for count in counts)


def through_case(cell: PillarCell, case: SymmetryClass, outside: Outside, incident: ComplexArray) -> Faces:
    """Field at the faces of the layer or stack, by whichever way is faster and can be trusted."""
    incoming, outgoing = outside.incoming, outside.outgoing
    if len(case.layers) > 1 or isinstance(incoming, TensorWaves) or isinstance(outgoing, TensorWaves):
        return _through_stack(cell, case, outside, incident)
    p, q = matrices(cell, case)
    largest_a = _largest_eigenvalue(case.layers[0])
    thickness_k0 = _thickness_k0(cell, case, 0)
    faces = through_by_doubling(p, q, thickness_k0, incoming, outgoing, incident, largest_a)
    if faces is not None:
        return faces
    solution = solve_class(cell, case, outside)
    return Faces(solution.field.transmitted, solution.field.reflected, 0.0, conditioning(solution.modes))


def solve_class(cell: PillarCell, case: SymmetryClass, outside: Outside | None = None) -> ClassSolution:
    """Modes and field of a class with one layer, for incident E_x = 1 and E_y = 1 (as far as the class holds them)."""
    outside = outside or _outside(cell, case)
    incoming, outgoing = outside.incoming, outside.outgoing
    if isinstance(incoming, TensorWaves) or isinstance(outgoing, TensorWaves):
        raise TypeError("`cell`: expected isotropic half spaces, got a birefringent one; use `through_case`")
    modes = layer_modes(*matrices(cell, case))
    field = through_layer(modes, _thickness_k0(cell, case, 0), incoming, outgoing, case.basis.zero_order())
    return ClassSolution(modes, incoming, outgoing, field)


def _through_stack(cell: PillarCell, case: SymmetryClass, outside: Outside, incident: ComplexArray) -> Faces:
    upwards = [
        StackLayer(*matrices(cell, case, i), _thickness_k0(cell, case, i), _largest_eigenvalue(case.layers[i]))
        for i in range(len(case.layers))
    ]
    layers = upwards if cell.side == "substrate" else upwards[::-1]
    return through_stack(layers, outside.incoming, outside.outgoing, incident)


def _largest_eigenvalue(layer: Slice) -> float:
    return largest_eigenvalue(permittivity(layer.n_inside), permittivity(layer.n_around))


def _outside(cell: PillarCell, case: SymmetryClass) -> Outside:
    far: Side = "ambient" if cell.side == "substrate" else "substrate"
    near_waves, far_waves = (
        plane_waves(case.basis, _k0_per_nm(cell), permittivity(n))
        if tensor is None
        else tensor_waves(case.basis, _k0_per_nm(cell), tensor)
        for tensor, n in ((cell.tensor(cell.side), case.n_in), (cell.tensor(far), case.n_out))
    )
    return Outside(near_waves, far_waves)


def matrices(cell: PillarCell, case: SymmetryClass, index: int = 0) -> tuple[Matrix, Matrix]:
    """P and Q of one layer of a class, in (TM, TE)."""
    layer = case.layers[index]
    media = permittivity(layer.n_inside), permittivity(layer.n_around)
    bases = case.bases[index]
    if cell.is_staggered:
        return staggered_matrices(bases[0], bases[1], _k0_per_nm(cell), *media)
    if len(bases) > 1:
        return nested_matrices(bases, _k0_per_nm(cell), *media)
    return layer_matrices(bases[0], _k0_per_nm(cell), *media)


def _thickness_k0(cell: PillarCell, case: SymmetryClass, index: int) -> float:
    return _k0_per_nm(cell) * case.layers[index].height_nm


def _k0_per_nm(cell: PillarCell) -> float:
    return 2.0 * math.pi / cell.wavelength_nm


def permittivity(n: complex) -> complex:
    """Square of the index; a real number where nothing is lost, so that real arithmetic follows."""
    return n * n if complex(n).imag else complex(n).real ** 2


def one_thread() -> AbstractContextManager[Any]:
    """One BLAS thread while it lasts."""
    return cast("AbstractContextManager[Any]", _blas().limit(limits=1))


def polarisations_swap(cell: PillarCell) -> bool:
    """Whether x and y light see the same cell, turned by 90 degrees."""
    same_sizes = cell.shape == "cross" or all(each.width_nm == each.length_nm for each in layers_of(cell))
    same_sizes = same_sizes and cell.period_nm[0] == cell.period_nm[1] and not cell.is_staggered
    return same_sizes and cell.angle_deg == 0.0 and cell.n_substrate[0] == cell.n_substrate[1]


def _families(axis: AxisBasis, incident_per_nm: float) -> list[AxisParity]:
    if incident_per_nm == 0.0:
        return [symmetric_axis(axis, even_first=True), symmetric_axis(axis, even_first=False)]
    return [travelling_axis(axis, incident_per_nm)]


def _check_oblique(cell: PillarCell) -> None:
    n_x, n_y = cell.n_substrate
    if n_x != n_y and cell.n_substrate_z is None:
        raise InputError.single(
            "cell",
            "angle_deg",
            "0 where the substrate's index differs between x and y polarisation and that along z is not given",
            f"{cell.angle_deg:g}",
            "give the substrate's `n_z` too (sapphire with its axis in the surface: the ordinary index)",
        )
    if cell.side == "substrate" and n_x != n_y and cell.n_substrate_z not in (n_x, n_y):
        raise InputError.single(
            "cell",
            "angle_deg",
            "0 from within a biaxial substrate, where no wave is ordinary",
            f"{cell.angle_deg:g}",
            'light it from `side = "ambient"`',
        )
    if complex(cell.n_of_angle).imag != 0.0:
        raise InputError.single(
            "cell",
            "angle_deg",
            "0 where the light comes out of an absorbing medium",
            f"{cell.angle_deg:g}",
            "no plane wave of one angle has a steady amplitude along the surface there; drop its k",
        )


@cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController()
