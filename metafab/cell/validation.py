"""Validation of cells and numerics: every fault at once."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import get_args

from metafab.cell.pillar import PillarCell, Shape, SizesAt, Slice
from metafab.cell.response import CellNumerics
from metafab.core.conventions import Side
from metafab.core.errors import Fault, InputError

#: Smallest wall angle, degrees: a flatter wall needs more layers than the solver tries.
_FLATTEST_WALL_DEG = 60.0
#: Largest ratio of two indices: its square, 1e12, times the double precision of 1e-16 is the error of an amplitude.
_WIDEST_RANGE = 1e6
#: Largest square root of a cell's area, in wavelengths: 280 000 orders then propagate in vacuum.
_WIDEST_CELL = 300.0
#: Smallest number of cosines that allows a comparison of two truncations.
_FEWEST_ORDERS = 3


def check(cell: PillarCell) -> None:
    """Refuse an unphysical cell; InputError with every fault of the cell."""
    faults = _faults_of_choices(
        ("side", cell.side, get_args(Side)),
        ("sizes_at", cell.sizes_at, get_args(SizesAt)),
        ("shape", cell.shape, get_args(Shape)),
    )
    faults += [*_faults_of_lengths(cell), *_faults_of_corners(cell)]
    overhanging = 180.0 - _FLATTEST_WALL_DEG
    if not _FLATTEST_WALL_DEG <= cell.sidewall_angle_deg <= overhanging:
        got = f"{cell.sidewall_angle_deg:g}"
        faults.append(Fault("sidewall_angle_deg", f"{_FLATTEST_WALL_DEG:g} to {overhanging:g}", got))
    if not 0.0 <= cell.angle_deg < 90.0:
        faults.append(Fault("angle_deg", "0 to below 90", f"{cell.angle_deg:g}"))
    if not math.isfinite(cell.azimuth_deg):
        faults.append(Fault("azimuth_deg", "a finite angle", f"{cell.azimuth_deg:g}"))
    for name, n in _indices(cell):
        if not (0.0 <= n.imag < math.inf and 0.0 < n.real < math.inf):
            faults.append(Fault(name, "a finite index with real part > 0 and imaginary part >= 0", f"{n}"))
    faults = faults or list(_faults_of_combinations(cell))
    if faults:
        raise InputError("cell", faults)


def check_numerics(numerics: CellNumerics) -> None:
    """Refuse numerics that are out of range; InputError with every fault of the numerics."""
    faults = _faults_of_choices(
        ("solver", numerics.solver, ("rcwa", "elements", "meep")),
        ("formulation", numerics.formulation, ("adaptive", "fourier")),
    )
    if (numerics.solver, numerics.formulation) == ("elements", "fourier"):
        faults.append(Fault("formulation", "adaptive for the solver elements", "fourier", "or solve with rcwa"))
    if not 0.0 < numerics.target_error < 1.0:
        faults.append(Fault("target_error", "above 0 and below 1", f"{numerics.target_error:g}"))
    if not numerics.max_orders >= _FEWEST_ORDERS:
        faults.append(Fault("max_orders", f"{_FEWEST_ORDERS} or more", f"{numerics.max_orders}"))
    if faults:
        raise InputError("numerics", faults)


def _faults_of_choices(*choices: tuple[str, str, tuple[str, ...]]) -> list[Fault]:
    """Faults of the choices (field, value, allowed values) with a value that is not allowed."""
    return [Fault(name, " or ".join(known), repr(got)) for name, got, known in choices if got not in known]


def _slices(cell: PillarCell) -> list[tuple[str, Slice]]:
    """(prefix of the field names, layer) of every layer under and over the pillar."""
    sides = (("under", cell.under), ("over", cell.over))
    return [(f"{side}[{i}].", layer) for side, layers in sides for i, layer in enumerate(layers)]


def _faults_of_lengths(cell: PillarCell) -> Iterator[Fault]:
    for axis, period in zip("xy", cell.period_nm, strict=True):
        if not 0.0 < period < math.inf:
            yield Fault("period_nm", "positive lengths", f"{period:g} nm along {axis}")
    if not 0.0 < cell.wavelength_nm < math.inf:
        yield Fault("wavelength_nm", "a positive length", f"{cell.wavelength_nm:g}")
    parts: list[tuple[str, PillarCell | Slice]] = [("", cell), *_slices(cell)]
    for prefix, part in parts:
        if not 0.0 <= part.height_nm < math.inf:
            yield Fault(f"{prefix}height_nm", "a length from 0", f"{part.height_nm:g}")
        sizes = (("width_nm", part.width_nm), ("length_nm", part.length_nm))
        for (name, size), period in zip(sizes, cell.period_nm, strict=True):
            if 0.0 < period < math.inf and size is not None and not 0.0 <= size <= period:
                yield Fault(f"{prefix}{name}", f"0 to the period of {period:g} nm", f"{size:g} nm")


def _faults_of_corners(cell: PillarCell) -> Iterator[Fault]:
    """Corners that cannot be rounded, crosses that do not fit into the cell, and rings without wall or hole."""
    radius, got = cell.corner_radius_nm, f"{cell.corner_radius_nm:g} nm"
    shorter, longer = sorted((cell.width_nm, cell.length_nm))
    if not 0.0 <= radius < math.inf:
        yield Fault("corner_radius_nm", "a length from 0", got)
    elif radius and 0.0 < shorter < 2.0 * radius:
        yield Fault("corner_radius_nm", f"at most half the shorter side, {0.5 * shorter:g} nm", got)
    elif radius and cell.shape != "rectangle":
        yield Fault("corner_radius_nm", f"0 for the shape {cell.shape}", got)
    if cell.shape == "cross" and longer > min(cell.period_nm):
        yield Fault("width_nm, length_nm", f"a cross within {min(cell.period_nm):g} nm", f"{longer:g} nm")
    if cell.shape == "ring" and longer > 0.0 and not (shorter == longer and 0.0 < cell.hole_nm < longer):
        got = f"{cell.width_nm:g} x {cell.length_nm:g} nm with a hole of {cell.hole_nm:g} nm"
        yield Fault("width_nm, length_nm", "both a ring's outer diameter, larger than its hole above 0", got)
    elif cell.shape != "ring" and cell.hole_nm:
        yield Fault("hole_nm", f"0 for the shape {cell.shape}", f"{cell.hole_nm:g} nm")


def _indices(cell: PillarCell) -> list[tuple[str, complex]]:
    """Every complex index of the cell with the name of its field."""
    named = [(f"{prefix}n", n) for prefix, layer in _slices(cell) for n in (layer.n_inside, layer.n_around)]
    named += [("n_pillar", cell.n_pillar), ("n_ambient", cell.n_ambient)]
    named += [("n_substrate", n) for n in cell.n_substrate]
    if cell.n_substrate_z is not None:
        named.append(("n_substrate_z", cell.n_substrate_z))
    return [(name, complex(n)) for name, n in named]


def _faults_of_combinations(cell: PillarCell) -> Iterator[Fault]:
    """Faults of several fields together: ends of a sloped pillar, ratio of the indices, size of the cell."""
    ends = (("bottom", 0.0), ("top", 1.0)) if cell.is_sloped else ()
    for end, share in ends:
        for name, size, period in zip(("width_nm", "length_nm"), cell.sizes_nm(share), cell.period_nm, strict=True):
            if not 0.0 <= size <= period:
                yield Fault(
                    name,
                    f"sizes of 0 to the period of {period:g} nm from the pillar's bottom to its top",
                    f"{size:g} nm at the {end} with a sidewall_angle_deg of {cell.sidewall_angle_deg:g}",
                    "sweep sizes further from 0 and from the period, or steepen the wall",
                )
    sizes = [abs(n) for _, n in _indices(cell)]
    if max(sizes) > _WIDEST_RANGE * min(sizes):
        expected = "indices whose ratio is at most a million to one"
        yield Fault("n_pillar, n_substrate, n_ambient", expected, f"{min(sizes):g} to {max(sizes):g}")
    x_nm, y_nm = cell.period_nm
    if x_nm * y_nm > (_WIDEST_CELL * cell.wavelength_nm) ** 2:
        expected = f"a cell of at most {_WIDEST_CELL:g} by {_WIDEST_CELL:g} wavelengths"
        yield Fault("period_nm", expected, f"{x_nm:g} by {y_nm:g} nm at a wavelength of {cell.wavelength_nm:g} nm")
