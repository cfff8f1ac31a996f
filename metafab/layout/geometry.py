"""A design's lengths as whole numbers of database units: the lattice, write fields and tiles.

Nothing is rounded on the way: a length that is not a whole number of units is a fault of the design.
"""

from __future__ import annotations

import math

from metafab.core.errors import InputError
from metafab.layout.pillars import Lattice
from metafab.spec import Design

#: Coordinates of GDSII, and of most readers, are whole numbers of 32 bits; the centre of the lens is 0.
MAX_APERTURE_DBU = 2**31
#: Units along a unit cell: beyond, the tables of sizes would not fit the memory, and no writer has so fine a grid.
MAX_CELL_DBU = 2**15


def whole_dbu(length_nm: float, database_unit_nm: float, field: str, *, even: bool = False) -> int:
    """``length_nm`` in database units.

    Args:
        length_nm: the length.
        database_unit_nm: size of one unit.
        field: what the length is called in messages.
        even: whether half the length must be a whole number of units, too.

    Raises:
        InputError: it is not a whole (or even) number of units.
    """
    units = length_nm / database_unit_nm
    count = round(units)
    if abs(units - count) > 1e-6 or (even and count % 2):
        raise InputError.single(
            "mask.database_unit_nm",
            field,
            f"{'an even' if even else 'a whole'} number of database units of {database_unit_nm:g} nm",
            f"{length_nm:g} nm, {units:g} units",
            _remedy(length_nm, database_unit_nm, 2 if even else 1),
        )
    return count


def _remedy(length_nm: float, unit_nm: float, step: int) -> str:
    """The lengths to either side that would do, and the largest of some finer units if one does."""
    below = math.floor(length_nm / unit_nm / step) * step * unit_nm
    lengths = f"use {below:g} or {below + step * unit_nm:g} nm"
    for part in (2, 4, 5, 8, 10, 20, 50, 100):
        steps = length_nm * part / unit_nm / step
        if abs(steps - round(steps)) < 1e-6:
            return f"{lengths}, or a unit of {unit_nm / part:g} nm"
    return lengths


def lattice_of(design: Design) -> Lattice:
    """The sites whose unit cells fit into the square that bounds the aperture, centred on the axis.

    Raises:
        InputError: the period is not a whole number of database units, the aperture holds no cell, or the unit is so
            small that the file's or the tables' numbers would not do.
    """
    unit_nm, hexagonal = design.mask.database_unit_nm, design.unit_cell.cell.is_hexagonal
    whole_x, whole_y = (
        whole_dbu(period, unit_nm, "cell.period_nm", even=hexagonal and axis == 0)
        for axis, period in enumerate(design.unit_cell.cell.period_nm)
    )
    p_x, p_y = whole_x // 2 if hexagonal else whole_x, whole_y
    aperture = aperture_dbu(design)
    columns, rows = aperture // p_x, aperture // p_y
    if aperture < max(whole_x, whole_y):
        raise InputError.single(
            design.name,
            "device.aperture_um",
            "at least one period",
            f"{design.device.aperture_um:g} um for periods of {design.unit_cell.cell.period_nm} nm",
        )
    _refuse_tiny_unit(design, max(whole_x, whole_y), aperture)
    if hexagonal:  # Odd numbers: the lattice is its own mirror image in both axes.
        columns, rows = columns // 2 * 2 + 1, (rows - 1) // 2 * 2 + 1
    return Lattice((p_x, p_y), (rows, columns), unit_nm, hexagonal)


def _refuse_tiny_unit(design: Design, cell_dbu: int, aperture: int) -> None:
    """Refuse units of which an aperture or a unit cell holds too many."""
    unit_nm = design.mask.database_unit_nm
    for name, units, most in (("unit cell", cell_dbu, MAX_CELL_DBU), ("aperture", aperture, MAX_APERTURE_DBU)):
        if units > most:
            expected, got = f"at most {most} units across the {name}", f"{units} units of {unit_nm:g} nm"
            remedy = f"choose one of at least {unit_nm * units / most:.3g} nm"
            raise InputError.single(design.name, "mask.database_unit_nm", expected, got, remedy)


def aperture_dbu(design: Design) -> int:
    """Diameter or side of the aperture in database units, rounded down."""
    return floor_dbu(design.device.aperture_um, design)


def floor_dbu(length_um: float, design: Design) -> int:
    """A length in database units, rounded down but for a millionth of a unit."""
    return math.floor(length_um * 1e3 / design.mask.database_unit_nm + 1e-6)


def nearest_dbu(length_um: float, design: Design) -> int:
    """A length in database units, rounded to the nearest."""
    return round(length_um * 1e3 / design.mask.database_unit_nm)


def field_sites(design: Design) -> tuple[int, int]:
    """Sites along (x, y) of one write field.

    Fields that cut through a cell would stitch inside a pillar, so a field is a whole number of periods. Periods of a
    hexagonal lattice have no common multiple of that size: a field is then as wide as asked and as many whole tiles
    high as fit, and its sides follow the zigzag of the rows, half a period deep.

    Raises:
        InputError: it is not.
    """
    field_nm = design.mask.write_field_um * 1e3
    cell = design.unit_cell.cell
    hexagonal = cell.is_hexagonal
    sites = []
    for period_nm in cell.period_nm[:1] if hexagonal else cell.period_nm:
        count = round(field_nm / period_nm)
        if count < 1 or abs(count * period_nm - field_nm) > 1e-3:
            below = max(1, math.floor(field_nm / period_nm))
            raise InputError.single(
                design.name,
                "mask.write_field_um",
                f"a whole number of periods of {period_nm:g} nm",
                f"{design.mask.write_field_um:g} um, {field_nm / period_nm:.6g} periods",
                f"use {below * period_nm * 1e-3:.6g} or {(below + 1) * period_nm * 1e-3:.6g} um",
            )
        sites.append(count)
    if not hexagonal:
        return sites[0], sites[1]
    columns, rows = 2 * sites[0], math.floor(field_nm / cell.period_nm[1] + 1e-9)
    tile = _nearest_divisor(columns, min(design.numerics.tile_sites, rows))
    return columns, max(1, rows // tile) * tile


def tile_sites(design: Design) -> int:
    """Sites a side of a tile: the divisor of the write field nearest (in ratio) to ``numerics.tile_sites``.

    Tiles then never straddle two write fields, and each becomes one cell of the mask file.
    """
    return _nearest_divisor(math.gcd(*field_sites(design)), design.numerics.tile_sites)


def _nearest_divisor(number: int, wanted: int) -> int:
    divisors = (k for k in range(1, number + 1) if number % k == 0)
    return min(divisors, key=lambda k: (abs(math.log(k / wanted)), k))
