"""Extremes of the RCWA solver: power balance, reciprocity, conditioning, and stated against true errors.

Each family varies one quantity of the paper's cell over all that can be asked for. Every cell is solved to 1e-3, and
once more by four cosines beyond the finest truncation of the answer. Columns of a family, each the worst of its cells:

- ``error``: distance of the answer to the finer one, where the answer states that it meets the target;
- ``power``: power of all orders minus 1 without absorption, and what exceeds 1 with absorption;
- ``reciprocity``: n_out t - n_in t' for light along z and from the other side, t' over the larger index;
- ``condition``: condition number of the modes, 0 where slabs are doubled instead;
- ``unmet``: answers that state an error above the target, by the finest truncation that is allowed;
- ``broken``: answers that are off by more than they state, unmet ones included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from metafab.cell import CellNumerics, PillarCell
from metafab.cell.rcwa import zero_order
from metafab.cell.rcwa.certificate import RcwaDetails, solve
from metafab.cell.rcwa.jones import distance
from metafab.core.parallel.measure import measured

BASE = PillarCell(
    period_nm=(350.0, 350.0),
    width_nm=150.0,
    length_nm=210.0,
    height_nm=600.0,
    n_pillar=3.6941,
    n_substrate=(1.7601, 1.7601),
    n_ambient=1.0,
    wavelength_nm=800.0,
)
TARGET, MOST_ORDERS, QUICK_ORDERS = 1e-3, 12, 7
#: Cosines of the reference beyond those of the answer.
_BEYOND = 4
#: Period at which the first orders graze in the substrate.
_GRAZING_NM = BASE.wavelength_nm / 1.7601


def _sized(width_nm: float, length_nm: float) -> PillarCell:
    return replace(BASE, width_nm=width_nm, length_nm=length_nm)


def _square(period_nm: float) -> PillarCell:
    share = period_nm / 350.0
    return replace(BASE, period_nm=(period_nm, period_nm), width_nm=share * 150.0, length_nm=share * 210.0)


#: Family -> its cells.
FAMILIES: dict[str, tuple[PillarCell, ...]] = {
    "widths of 0 to the period": tuple(_sized(w, 210.0) for w in (0.0, 1e-3, 1.0, 20.0, 100.0, 300.0, 349.0, 350.0)),
    "periods of 20 to 1200 nm": tuple(_square(p) for p in (20.0, 100.0, 250.0, 450.0, 700.0, 1200.0)),
    "heights of 1 pm to 20 um": tuple(replace(BASE, height_nm=h) for h in (1e-3, 1.0, 50.0, 300.0, 2e3, 2e4)),
    "extinction of 1e-9 to 30": tuple(
        replace(BASE, n_pillar=3.6941 + 1j * k) for k in (1e-9, 1e-4, 1e-2, 0.3, 3.0, 30.0)
    ),
    "angles of 1e-6 to 89.99 degrees": tuple(
        replace(BASE, side="ambient", angle_deg=a, azimuth_deg=30.0) for a in (1e-6, 20.0, 60.0, 85.0, 89.99)
    ),
    "orders that graze to 1e-12": tuple(
        _square(_GRAZING_NM * (1.0 + d)) for d in (-1e-2, -1e-5, -1e-12, 0.0, 1e-12, 1e-5, 1e-2)
    ),
    "tall and thin": tuple(
        replace(_sized(w, w), height_nm=h) for w, h in ((20.0, 1e3), (40.0, 3e3), (80.0, 1e4), (10.0, 1e4))
    ),
    "index contrasts of 1e-6 to 100": tuple(
        replace(BASE, n_pillar=n) for n in (1.0 + 1e-6, 1.0 + 1e-3, 1.5, 6.0, 20.0, 100.0)
    ),
    "metals": tuple(replace(BASE, n_pillar=n) for n in (0.04 + 5.6j, 0.15 + 4.9j, 2.7 + 8.4j, 1e-3 + 50j)),
    "epsilon near zero": tuple(replace(BASE, n_pillar=n) for n in (0.3 + 0.3j, 0.1 + 0.05j, 1e-2 + 1e-2j, 1e-3 + 0j)),
}


@dataclass(frozen=True)
class Checked:
    """One answer and what was found about it."""

    stated: float  #: Stated error.
    true: float  #: Distance to the finer truncation.
    power: float  #: Violation of the power balance.
    reciprocity: float  #: Violation of reciprocity.
    condition: float  #: Condition number of the modes.
    sound: bool  #: Whether all figures are finite.


def rows(quick: bool) -> list[dict[str, Any]]:
    """A row for each family.

    Args:
        quick: coarser truncations, and two cells of each family.
    """
    table = []
    for name, cells in FAMILIES.items():
        with measured() as cost:
            found = [check(cell, QUICK_ORDERS if quick else MOST_ORDERS) for cell in (cells[::4] if quick else cells)]
        met = [each for each in found if each.stated <= TARGET]
        table.append(
            {
                "name": name,
                "error": max((each.true for each in met), default=None),
                "seconds": cost.processor_seconds,
                "peak_rss_mb": cost.peak_rss_mb,
                "cells": len(found),
                "power": max(each.power for each in found),
                "reciprocity": max(each.reciprocity for each in found),
                "condition": max(each.condition for each in found),
                "unmet": len(found) - len(met),
                "broken": sum(not each.sound or each.true > each.stated for each in found),
            }
        )
    return table


def check(cell: PillarCell, most_orders: int) -> Checked:
    """Solve a cell to the target and once more beyond it."""
    answer = solve(cell, CellNumerics(target_error=TARGET, max_orders=most_orders))
    details = answer.details
    assert isinstance(details, RcwaDetails)  # the cells have upright walls
    finer = zero_order(cell, details.orders_x + _BEYOND)
    power = np.array(
        [
            details.transmitted_power_x + details.reflected_power_x - 1.0,
            details.transmitted_power_y + details.reflected_power_y - 1.0,
        ]
    )
    is_lossless = complex(cell.n_pillar).imag == 0.0
    figures = np.array([answer.error, distance(answer, finer), *power])
    return Checked(
        stated=answer.error,
        true=distance(answer, finer),
        power=float(np.abs(power).max() if is_lossless else max(0.0, power.max())),
        reciprocity=_reciprocity(cell, details.orders_x) if cell.angle_deg == 0.0 else 0.0,
        condition=details.condition,
        sound=bool(np.isfinite(figures).all()),
    )


def _reciprocity(cell: PillarCell, orders: int) -> float:
    """Violation of the Lorentz relation n_out t(in -> out) = n_in t(out -> in) of zero orders along z."""
    there, back = zero_order(cell, orders), zero_order(replace(cell, side=cell.far_side), orders)
    n_in, n_out = complex(cell.n_in[0]), complex(cell.n_out[0])
    return float(np.abs(n_out * there.t - n_in * back.t.T).max() / max(abs(n_in), abs(n_out)))
