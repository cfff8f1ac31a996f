"""Transmitted orders of a supercell by doubling of half the layer and one system for both faces, with an error bound.

Rows keep the mirror about their axis, so that each polarisation has half of the functions, and a quarter if the row is
its own mirror image along x. Blocks solve both polarisations at once, with half of the functions if
a half turn maps the block to itself. The resolution rises until the bound on the error
is below the target. The bound is a share of the change from one resolution to the next, and never below a floor that
falls with the resolution.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metafab.cell.curved.supercell import count_functions, curved_layer
from metafab.cell.elements.assembly import Grams, Layer, Waves, gradient_of, incident
from metafab.cell.elements.basis import Resolution, basis_of, elements_of
from metafab.cell.problem import solve
from metafab.cell.rcwa.basis.coordinates import IntArray, Matrix
from metafab.cell.rcwa.layers.factorisation import largest_eigenvalue
from metafab.cell.rcwa.scattering.doubling import Doubling, doubled
from metafab.cell.rcwa.symmetry import permittivity
from metafab.cell.response import CellNumerics
from metafab.cell.supercell import Supercell, SupercellOrders, SupercellResponse
from metafab.core.conventions import POLARISATIONS, ComplexArray, Polarisation
from metafab.core.errors import InputError, SolverError
from metafab.core.parallel.executor import one_blas_thread

#: Bound on the error of a light's amplitudes: a share of their last change, and at least this floor over the
#: square of the resolution (two resolutions may agree by accident). Measured on rows and single cells.
_SHARE, _FLOOR = 0.5, 0.075
#: Shares for circles and ellipses: at fine resolutions, and at coarse ones. On 20 random rows the error of order 4 was
#: up to 2.4 of the change from order 3, that of order 5 up to 0.53 of a change above 1e-3.
_SHARE_CURVED, _SHARE_COARSE = 2.0, 5.0
#: Resolution from which circles and ellipses are finely resolved: an order of 5.
_CURVED_FROM = 4.0
#: Most functions of a layer: ten complex matrices of this size fill 4 GB.
_MOST_FUNCTIONS = 5000
#: Target error of each pillar in its own periodic cell.
_SINGLE_CELL_ERROR = 1e-3


@dataclass(frozen=True)
class ElementNumerics:
    """Numerics of a supercell by spectral elements."""

    target_error: float = 5e-3  #: Largest accepted relative error of the amplitudes.
    #: Ascending polynomial orders of an element far smaller than the wavelength, two or more. Coarser ones are tried
    #: where the layer has too many functions.
    resolutions: tuple[float, ...] = (3.0, 4.0, 5.0)


def supercell_orders(supercell: Supercell, numerics: ElementNumerics = ElementNumerics()) -> SupercellOrders:
    """Transmitted orders of a row along x or along y, or of a block, for both incident polarisations.

    If the finest resolution misses the target, ``error`` exceeds it. InputError for pillars that touch, or a block of
    too many functions; SolverError if the amplitudes are not finite.
    """
    start = time.perf_counter()
    t, error = _converged(supercell, POLARISATIONS, numerics)
    return SupercellOrders(supercell, supercell.propagating_orders("x"), t, error, time.perf_counter() - start)


def require_treated(supercell: Supercell, numerics: ElementNumerics = ElementNumerics()) -> None:
    """Raise, before anything is solved, the InputError that :func:`supercell_orders` would raise for a supercell."""
    _require_one_index(supercell)
    _feasible(supercell, numerics.resolutions)


def solve_supercell(
    supercell: Supercell, polarisation: Polarisation, numerics: ElementNumerics = ElementNumerics()
) -> SupercellResponse:
    """Transmitted orders for one incident polarisation, and each pillar in its own periodic cell.

    Errors as :func:`supercell_orders`.
    """
    start = time.perf_counter()
    axis, cells = POLARISATIONS.index(polarisation), supercell.periodic_cells()
    t, error = _converged(supercell, (polarisation,), numerics)
    alone = {
        size: solve(cell, CellNumerics(target_error=_SINGLE_CELL_ERROR)).t[axis, axis] for size, cell in cells.items()
    }
    sizes = supercell.size_nm.reshape(-1, 2)
    return SupercellResponse(
        supercell=supercell,
        polarisation=polarisation,
        order=supercell.propagating_orders(polarisation),
        amplitude=t[:, :, 0],
        responses=np.array([alone[float(w), float(length)] for w, length in sizes]).reshape(supercell.shape),
        error=error * float(np.linalg.norm(t)),
        seconds=time.perf_counter() - start,
    )


def orders_at(supercell: Supercell, lights: Sequence[Polarisation], resolution: Resolution) -> ComplexArray:
    """E_x and E_y of each transmitted order at one resolution, shape (n_orders, 2, len(lights)).

    ``resolution``: see :data:`metafab.cell.elements.basis.Resolution`, a number for circles and ellipses. ``lights``:
    the incident polarisations. Errors as :func:`supercell_orders`.
    """
    if supercell.shape[1] == 1 < supercell.shape[0]:
        turned = orders_at(supercell.exchanged(), [other_light(light) for light in lights], resolution)
        return np.asarray(turned[exchanged_places(supercell, lights[0]), ::-1])
    order = supercell.propagating_orders(lights[0])
    with one_blas_thread():
        together = [tuple(lights)] if supercell.shape[0] > 1 else [(light,) for light in lights]
        found = []
        for some in together:
            layer = _layer(supercell, some, resolution, order)
            system = face_system(layer, supercell, some)
            found.append(layer.orders @ system.solve(2.0 * system.source, np.zeros_like(system.source))[1])
    return np.concatenate(found, axis=2)


def scattered_by_row(supercell: Supercell, light: Polarisation, resolution: float) -> ComplexArray:
    """Reflected and transmitted orders of a row along x, with the polarisation of the light, at one resolution.

    Shape (2, n_orders), amplitudes over the incident E: of the orders that return into the substrate, then of those
    that leave behind the pillars. Both are the orders that propagate behind the pillars. Errors as
    :func:`supercell_orders`.
    """
    order, axis = supercell.propagating_orders(light), POLARISATIONS.index(light)
    with one_blas_thread():
        layer = _layer(supercell, (light,), resolution, order)
        system = face_system(layer, supercell, (light,))
        fields = system.solve(2.0 * system.source, np.zeros_like(system.source))[..., 0]
    scattered = fields @ layer.orders[:, axis].T
    scattered[0] -= np.all(order == 0, axis=1)
    return np.asarray(scattered)


def _layer(supercell: Supercell, lights: Sequence[Polarisation], resolution: Resolution, order: IntArray) -> Layer:
    if supercell.cell.is_shaped:
        if isinstance(resolution, tuple):
            raise ValueError("`resolution`: expected a number for curved outlines, got orders of pillars and gaps")
        return curved_layer(supercell, lights, resolution, order)
    basis = basis_of(supercell, lights[0], resolution, folded=_is_symmetric(supercell))
    elements = elements_of(basis)
    grams = Grams.of(elements, gradient_of(basis))
    return Waves(basis, order).overlaps(elements, *grams.p_and_q(supercell.cell.layer, supercell.cell.k0_per_nm))


def _is_symmetric(supercell: Supercell) -> bool:
    """Whether a row along x is its own mirror image about its middle, or a block its own image under a half turn."""
    return np.array_equal(supercell.size_nm, supercell.size_nm[::-1, ::-1])


def other_light(light: Polarisation) -> Polarisation:
    """The polarisation that ``light`` becomes when x and y are exchanged."""
    return "y" if light == "x" else "x"


def exchanged_places(supercell: Supercell, light: Polarisation) -> IntArray:
    """Index of each order of ``supercell`` among those of the exchanged supercell, shape (n_orders,)."""
    turned = supercell.exchanged().propagating_orders(other_light(light))
    return np.lexsort((turned[:, 1], turned[:, 0]))


def _converged(
    supercell: Supercell, lights: Sequence[Polarisation], numerics: ElementNumerics
) -> tuple[ComplexArray, float]:
    """Amplitudes as from :func:`orders_at`, and the bound on their relative error."""
    _require_one_index(supercell)
    last: ComplexArray | None = None
    error = np.inf
    for resolution in _feasible(supercell, numerics.resolutions):
        t = orders_at(supercell, lights, resolution)
        if not np.isfinite(t).all():
            raise SolverError(f"the amplitudes of a supercell are not finite at resolution {resolution:g}")
        if last is not None:
            share = _SHARE
            if supercell.cell.is_shaped:
                share = _SHARE_CURVED if resolution >= _CURVED_FROM else _SHARE_COARSE
            change = share * float(np.linalg.norm(t - last))
            floor = _FLOOR / resolution**2 * math.sqrt(len(lights))
            error = max(change, floor) / float(np.linalg.norm(t))
            if error <= numerics.target_error:
                break
        last = t
    return t, error


def _feasible(supercell: Supercell, resolutions: tuple[float, ...]) -> list[float]:
    """The resolutions whose layers have few enough functions, or two coarser ones; InputError if even they do not."""

    def count(resolution: float) -> int:
        turned = supercell.exchanged() if supercell.shape[1] == 1 else supercell
        if supercell.cell.is_shaped:
            return count_functions(turned, resolution)
        return basis_of(turned, "x", resolution, folded=_is_symmetric(turned)).sizes[0]

    is_curved = supercell.cell.is_shaped
    for shift in (0.0, 0.5, 1.0):
        # Curved elements have whole orders: two resolutions of one order would agree whatever the error.
        tried = sorted({math.floor(each - shift) if is_curved else each - shift for each in resolutions})
        feasible = [each for each in tried if count(each) <= _MOST_FUNCTIONS]
        if len(feasible) >= 2:
            return feasible
    got = f"{supercell.shape[1]} x {supercell.shape[0]} pillars"
    most = "4 x 4 pillars, or a row of 22" if is_curved else "5 x 5 pillars, or a row of 60"
    expected = f"a supercell of at most {_MOST_FUNCTIONS} functions ({most})"
    raise InputError.single("supercell", "size_nm", expected, got, "use meep, or the library's model")


def _require_one_index(supercell: Supercell) -> None:
    n_x, n_y = supercell.cell.n_substrate
    if n_x != n_y and min(supercell.shape) > 1:
        expected = "equal indices of the substrate for a block, which couples both polarisations"
        raise InputError.single("supercell", "n_substrate", expected, f"{n_x} and {n_y}", "solve rows")


@dataclass(frozen=True)
class FaceSystem:
    """Equations of the fields at both faces of a layer of N functions.

    With F of half the layer, X = P^-1 F and Z = F^-T Q, the fields obey h(0) - h(d) = -i Z (e(0) + e(d)) and
    h(0) + h(d) = i X (e(0) - e(d)) (:mod:`metafab.cell.rcwa.scattering.doubling`).
    """

    half: Doubling  #: F of half the layer, shape (N, N).
    x: Matrix  #: Shape (N, N), symmetric.
    z: Matrix  #: Shape (N, N), symmetric.
    matrix: ComplexArray  #: Shape (2 N, 2 N), symmetric, for (e(0), e(d)).
    source: ComplexArray  #: Shape (N, n_lights), twice the h of the incident waves.

    def solve(self, near: ComplexArray, far: ComplexArray) -> ComplexArray:
        """(e(0), e(d)) for the right-hand sides of both faces, each of shape (N, k); shape (2, N, k)."""
        return np.asarray(np.linalg.solve(self.matrix, np.concatenate([near, far])).reshape(2, *near.shape))


def face_system(
    layer: Layer, supercell: Supercell, lights: Sequence[Polarisation], *, keep: bool = False
) -> FaceSystem:
    """Equations of a layer between its half spaces, one index of each for all lights; SolverError if it is singular.

    The steps of the doubling are kept for derivatives in reverse mode if ``keep`` is true.
    """
    cell = supercell.cell
    axis = POLARISATIONS.index(lights[0])
    near, far = (layer.admittance(complex(permittivity(n[axis])), cell.k0_per_nm) for n in (cell.n_in, cell.n_out))
    source = np.stack([incident(layer, light, cell.n_in[axis]) for light in lights], axis=1)
    with np.errstate(all="ignore"):  # non-finite values are refused by the caller
        largest = largest_eigenvalue(permittivity(cell.n_ambient), permittivity(cell.n_pillar))
        half = doubled(layer.p, layer.q, cell.k0_per_nm * cell.height_nm, largest, omitted=1, keep=keep)
    if half is None:
        raise SolverError("the layer of a supercell is singular")
    x, z = np.linalg.solve(layer.p, half.f), np.linalg.solve(half.f.T, layer.q)
    n = len(x)
    matrix = np.empty((2 * n, 2 * n), dtype=np.complex128)
    matrix[:n, :n], matrix[n:, n:] = 2.0 * near + 1j * (x - z), 2.0 * far + 1j * (x - z)
    matrix[:n, n:] = matrix[n:, :n] = -1j * (x + z)
    return FaceSystem(half, x, z, matrix, source)
