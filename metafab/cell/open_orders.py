"""Orders besides the zero order that leave a unit cell and take light from it: their number and share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.cell import curved
from metafab.cell.pillar import PillarCell
from metafab.cell.problem import pillar_cell
from metafab.cell.rcwa.diffraction import diffraction, propagating_orders
from metafab.cell.response import CellNumerics
from metafab.core.conventions import FloatArray, Side
from metafab.spec import UnitCell

#: Sizes, as shares of the range of the sweep, whose orders are solved, and the error of their efficiencies.
_SIZES, _ERROR = (0.25, 0.5, 0.75), 2e-2


@dataclass(frozen=True)
class OpenOrders:
    """Orders that propagate in one half space."""

    side: Side  #: "substrate" or "ambient".
    count: int  #: Their number, without the zero order.
    largest_period_nm: float  #: Period below which none propagates, at the angle of incidence.
    #: Share of the incident light in them, mean of three sizes of the sweep, x polarisation; likewise y.
    share_x: float
    share_y: float
    error: float  #: Largest error of a share.

    def sentence(self) -> str:
        """Return the orders, their share and the remedy as one sentence."""
        accuracy = "" if self.error <= _ERROR else f" (to {self.error:.1g})"
        return (
            f"{self.count} diffraction orders besides the zero order open in the {self.side} and take "
            f"{100.0 * self.share_x:.1f} % of x and {100.0 * self.share_y:.1f} % of y polarised light{accuracy}, "
            f"mean of three sizes; with periods below {self.largest_period_nm:.0f} nm there are none"
        )


def open_orders(unit_cell: UnitCell, *, angle_deg: float = 0.0, azimuth_deg: float = 0.0) -> tuple[OpenOrders, ...]:
    """Return the orders that open on either side of a unit cell; solves three sizes if there are any.

    Angles and errors as :func:`metafab.cell.pillar_cell`.
    """
    sides: tuple[Side, Side] = ("substrate", "ambient")
    cells = [
        pillar_cell(unit_cell, *_size_nm(unit_cell, share), angle_deg=angle_deg, azimuth_deg=azimuth_deg)
        for share in _SIZES
    ]
    index = _index(cells[0], unit_cell)
    counts = {side: len(propagating_orders(cells[0], index[side])) - 1 for side in sides}
    if not any(counts.values()):
        return ()
    solved = [_shares(cell) for cell in cells]
    error = max(one[2] for one in solved)
    found = []
    for side in sides:
        if not counts[side]:
            continue
        is_back = side == unit_cell.illumination.side
        shares = np.mean([back if is_back else passed for passed, back, _ in solved], axis=0)
        densest = max(complex(n).real for n in index[side])
        # The first orders of a hexagonal lattice belong to its row distance, sqrt(3) / 2 of the period.
        factor = 2.0 / np.sqrt(3.0) if unit_cell.cell.is_hexagonal else 1.0
        largest_nm = float(factor * cells[0].wavelength_nm / (densest + np.hypot(*cells[0].in_plane)))
        found.append(OpenOrders(side, counts[side], largest_nm, float(shares[0]), float(shares[1]), error))
    return tuple(found)


def _shares(cell: PillarCell) -> tuple[FloatArray, FloatArray, float]:
    """Power in the other transmitted and reflected orders, shape (2,) each, for x and y light, and its error."""
    numerics = CellNumerics(target_error=_ERROR)
    if curved.is_treated(cell):
        answer = curved.solve(cell, numerics)
        whole = answer.details
        assert isinstance(whole, curved.CurvedDetails)
        passed = np.array([whole.transmitted_power_x, whole.transmitted_power_y]) - answer.transmittance
        back = np.array([whole.reflected_power_x, whole.reflected_power_y]) - np.abs(np.diag(answer.r)) ** 2
        return passed, back, 2.0 * answer.error
    found = diffraction(cell, numerics)
    transmitted, reflected = (
        np.array([sum(getattr(o, f"efficiency_{p}") for o in orders if any(o.order)) for p in "xy"])
        for orders in (found.transmitted, found.reflected)
    )
    return transmitted, reflected, found.error


def _index(cell: PillarCell, unit_cell: UnitCell) -> dict[Side, tuple[complex, complex]]:
    """Index of both half spaces for x and y polarisation."""
    from_substrate = unit_cell.illumination.side == "substrate"
    substrate, ambient = (cell.n_in, cell.n_out) if from_substrate else (cell.n_out, cell.n_in)
    return {"substrate": substrate, "ambient": ambient}


def _size_nm(unit_cell: UnitCell, share: float) -> tuple[float, float]:
    sweep = unit_cell.sweep
    width_nm, length_nm = (low + share * (high - low) for low, high in (sweep.width_nm, sweep.length_nm))
    return width_nm, length_nm
