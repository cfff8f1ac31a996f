"""A design's lengths as whole numbers of database units: the lattice, write fields and tiles.

Nothing is rounded on the way: a length that is not a whole number of units is a fault of the design.
"""

from __future__ import annotations

import math

from metafab.core.errors import InputError
from metafab.layout.pillars import Lattice
from metafab.spec import Design


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
            "choose a smaller unit, such as 0.5 nm, or a coarser size grid",
        )
    return count


def lattice_of(design: Design) -> Lattice:
    """The sites whose unit cells fit into the square that bounds the aperture, centred on the axis.

    Raises:
        InputError: the period is not a whole number of database units, or the aperture holds no cell.
    """
    unit_nm = design.mask.database_unit_nm
    periods = [whole_dbu(period, unit_nm, "cell.period_nm") for period in design.unit_cell.cell.period_nm]
    aperture = aperture_dbu(design)
    columns, rows = (aperture // period for period in periods)
    if not (rows and columns):
        raise InputError.single(
            design.name,
            "device.aperture_um",
            "at least one period",
            f"{design.device.aperture_um:g} um for periods of {design.unit_cell.cell.period_nm} nm",
        )
    return Lattice((periods[0], periods[1]), (rows, columns), unit_nm)


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

    Fields that cut through a cell would stitch inside a pillar, so a field is a whole number of periods.

    Raises:
        InputError: it is not.
    """
    field_nm = design.mask.write_field_um * 1e3
    sites = []
    for period_nm in design.unit_cell.cell.period_nm:
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
    return sites[0], sites[1]


def tile_sites(design: Design) -> int:
    """Sites a side of a tile: the divisor of the write field nearest (in ratio) to ``numerics.tile_sites``.

    Tiles then never straddle two write fields, and each becomes one cell of the mask file.
    """
    common = math.gcd(*field_sites(design))
    wanted = design.numerics.tile_sites
    divisors = [k for k in range(1, common + 1) if common % k == 0]
    return min(divisors, key=lambda k: (abs(math.log(k / wanted)), k))
