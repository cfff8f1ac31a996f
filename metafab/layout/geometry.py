"""Lattice, write fields and tiles of a design, in whole database units.

Nothing is rounded on the way: a length that is not a whole number of units is a fault of the design.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metafab.core.errors import InputError
from metafab.layout.pillars import Lattice
from metafab.phase import PhaseProfile
from metafab.spec import Design

#: GDSII and most readers hold coordinates as 32-bit integers; the centre of the lens is 0.
MAX_APERTURE_DBU = 2**31
#: Most units along a unit cell: with more, a table of sizes would exceed the memory. No writer's grid is so fine.
MAX_CELL_DBU = 2**15

#: Places per side at which the phase slope is sampled.
_SLOPE_PLACES = 181
#: Fewest sites across the aperture, so that its rim is sampled as well.
_FEWEST_SITES = 1000
#: Share of the places that may be steeper than the limit: zone boundaries are steps, not slopes.
_STEP_SHARE = 0.02
#: Largest phase step between samples as a share of pi, the Nyquist limit.
_SHARE_OF_NYQUIST = 0.9


def whole_dbu(length_nm: float, database_unit_nm: float, field: str, *, even: bool = False) -> int:
    """Convert ``length_nm``, known to messages as ``field``, to database units.

    InputError unless it is a whole number of units, or, if ``even``, its half is one.
    """
    units = length_nm / database_unit_nm
    count = round(units)
    if abs(units - count) > 1e-6 or (even and count % 2):
        expected = f"{'an even' if even else 'a whole'} number of database units of {database_unit_nm:g} nm"
        remedy = _remedy(length_nm, database_unit_nm, 2 if even else 1)
        got = f"{length_nm:.12g} nm, {units:.12g} units"
        raise InputError.single("mask.database_unit_nm", field, expected, got, remedy)
    return count


def _remedy(length_nm: float, unit_nm: float, step: int) -> str:
    """Suggest the nearest valid lengths and, if there is one, the coarsest finer unit that fits."""
    below = math.floor(length_nm / unit_nm / step) * step * unit_nm
    lengths = f"use {below:.12g} or {below + step * unit_nm:.12g} nm"
    for part in (2, 4, 5, 8, 10, 20, 50, 100):
        steps = length_nm * part / unit_nm / step
        if abs(steps - round(steps)) < 1e-6:
            return f"{lengths}, or a unit of {unit_nm / part:g} nm"
    return lengths


def lattice_of(design: Design) -> Lattice:
    """Lattice of the sites whose unit cells fit into the square that bounds the aperture, centred on the axis.

    InputError if the period is not a whole number of database units, the aperture holds no cell, or the database unit
    is too small for the integers of the file or for the tables of sizes.
    """
    unit_nm, hexagonal = design.mask.database_unit_nm, design.unit_cell.cell.is_hexagonal
    period_x_nm, period_y_nm = design.unit_cell.cell.period_nm
    whole_x = whole_dbu(period_x_nm, unit_nm, "cell.period_nm", even=hexagonal)
    whole_y = whole_dbu(period_y_nm, unit_nm, "cell.period_nm")
    p_x, p_y = whole_x // 2 if hexagonal else whole_x, whole_y
    aperture = aperture_dbu(design)
    columns, rows = aperture // p_x, aperture // p_y
    if aperture < max(whole_x, whole_y):
        got = f"{design.device.aperture_um:g} um for periods of {design.unit_cell.cell.period_nm} nm"
        raise InputError.single(design.name, "device.aperture_um", "at least one period", got)
    for name, units, most in (
        ("unit cell", max(whole_x, whole_y), MAX_CELL_DBU),
        ("aperture", aperture, MAX_APERTURE_DBU),
    ):
        if units > most:
            expected, got = f"at most {most} units across the {name}", f"{units} units of {unit_nm:g} nm"
            remedy = f"choose one of at least {unit_nm * units / most:.3g} nm"
            raise InputError.single(design.name, "mask.database_unit_nm", expected, got, remedy)
    if hexagonal:  # Odd numbers make the lattice symmetric about both axes.
        columns, rows = columns // 2 * 2 + 1, (rows - 1) // 2 * 2 + 1
    return Lattice(period_dbu=(p_x, p_y), shape=(rows, columns), database_unit_nm=unit_nm, hexagonal=hexagonal)


def aperture_dbu(design: Design) -> int:
    """Diameter or side of the aperture in database units, rounded down."""
    return floor_dbu(design.device.aperture_um, design)


def floor_dbu(length_um: float, design: Design) -> int:
    """Convert a length to database units, rounded down after adding a millionth of a unit."""
    return math.floor(length_um * 1e3 / design.mask.database_unit_nm + 1e-6)


def nearest_dbu(length_um: float, design: Design) -> int:
    """Convert a length to database units, rounded to the nearest."""
    return round(length_um * 1e3 / design.mask.database_unit_nm)


def field_sites(design: Design) -> tuple[int, int]:
    """Sites along (x, y) of one write field.

    A field is a whole number of periods (else InputError), so that no pillar is stitched from two fields. The periods
    of a hexagonal lattice have no common multiple of that size: there, a field is ``write_field_um`` wide and as many
    whole tiles high as fit, and its sides follow the zigzag of the rows, half a period deep.
    """
    field_nm = design.mask.write_field_um * 1e3
    cell = design.unit_cell.cell
    hexagonal = cell.is_hexagonal
    sites = []
    periods_nm = cell.period_nm[:1] if hexagonal else cell.period_nm
    for period_nm in periods_nm:
        count = round(field_nm / period_nm)
        if count < 1 or abs(count * period_nm - field_nm) > 1e-3:
            common_nm = _common_nm(periods_nm, design.mask.database_unit_nm)
            below = max(1, math.floor(field_nm / common_nm))
            expected = f"a whole number of periods of {' and of '.join(f'{p:g}' for p in dict.fromkeys(periods_nm))} nm"
            got = f"{design.mask.write_field_um:.10g} um, {field_nm / period_nm:.6g} periods of {period_nm:g} nm"
            remedy = f"use {below * common_nm * 1e-3:.10g} or {(below + 1) * common_nm * 1e-3:.10g} um"
            raise InputError.single(design.name, "mask.write_field_um", expected, got, remedy)
        sites.append(count)
    if not hexagonal:
        return sites[0], sites[1]
    columns, rows = 2 * sites[0], math.floor(field_nm / cell.period_nm[1] + 1e-9)
    tile = _nearest_divisor(columns, min(design.numerics.tile_sites, rows))
    return columns, max(1, rows // tile) * tile


def _common_nm(periods_nm: Sequence[float], unit_nm: float) -> float:
    """Smallest common multiple of periods that are whole numbers of database units."""
    return math.lcm(*(max(1, round(period_nm / unit_nm)) for period_nm in periods_nm)) * unit_nm


def tile_sites(design: Design) -> int:
    """Sites per side of a tile: the divisor of the write field nearest (in ratio) to ``numerics.tile_sites``.

    A tile therefore lies in one write field. Each tile becomes one cell of the mask file.
    """
    return _nearest_divisor(math.gcd(*field_sites(design)), design.numerics.tile_sites)


def _nearest_divisor(number: int, wanted: int) -> int:
    divisors = (k for k in range(1, number + 1) if number % k == 0)
    return min(divisors, key=lambda k: (abs(math.log(k / wanted)), k))


def sampling_lattice(profile: PhaseProfile, design: Design) -> Lattice:
    """Coarsest square lattice that samples the target phases below the Nyquist limit; for designs without a mask.

    The pitch is an even number of periods. It follows from the steepest slope, apart from the steps at zone boundaries:
    the phase, lens and split included, turns by less than pi from site to site, so that no alias of the image falls
    into the window. Where no coarser lattice will do, the lattice of the pillars is returned. Errors as in
    :func:`lattice_of`.
    """
    fine = lattice_of(design)
    period, aperture = max(fine.cell_dbu), aperture_dbu(design)
    turn_rad = _steepest_turn_rad(profile, design, period * fine.database_unit_nm * 1e-3)
    periods = min(math.floor(_SHARE_OF_NYQUIST * math.pi / max(turn_rad, 1e-9)), aperture // (_FEWEST_SITES * period))
    if periods < 2:
        return fine
    pitch = periods // 2 * 2 * period  # Even, so that the sites next to the axis are whole numbers.
    count = aperture // pitch
    return Lattice(period_dbu=(pitch, pitch), shape=(count, count), database_unit_nm=fine.database_unit_nm)


def _steepest_turn_rad(profile: PhaseProfile, design: Design, step_um: float) -> float:
    """Quantile ``1 - _STEP_SHARE`` of the phase change per step along x or y, over both polarisations."""
    half_um = 0.5 * design.device.aperture_um - step_um
    places_um = np.linspace(-half_um, half_um, _SLOPE_PLACES)
    pairs_um = np.stack([places_um, places_um + step_um], axis=1).ravel()
    inside = design.device.encloses(places_um, places_um)
    along_x = np.diff(profile(pairs_um, places_um).reshape(2, _SLOPE_PLACES, _SLOPE_PLACES, 2), axis=3)[..., 0]
    along_y = np.diff(profile(places_um, pairs_um).reshape(2, _SLOPE_PLACES, 2, _SLOPE_PLACES), axis=2)[:, :, 0]
    turns_rad = np.abs(np.angle(np.exp(1j * np.stack([along_x, along_y]))))[..., inside]
    return float(np.quantile(turns_rad, 1.0 - _STEP_SHARE))
