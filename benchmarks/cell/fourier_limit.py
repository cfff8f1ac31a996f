"""Jones matrices in the limit of infinitely many plain harmonics: a check that is independent of stretched coordinates.

Without stretching, Li's rules converge algebraically: kinks of the field at the walls and its singularities at the
corners leave an error of about M^-p. Over silicon pillars, resonances among them, p was 2.2 to 3.2 between 8 and 16
cosines. Single truncations scatter about that law as the harmonics fall on one or the other side of the walls. So a
weighted fit takes several truncations: the limit is that of p = 3, and its error the change to p = 2 plus the largest
residual of the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from metafab.cell import PillarCell
from metafab.cell.rcwa import zero_order
from metafab.cell.rcwa.basis.coordinates import Formulation
from metafab.cell.rcwa.jones import ZeroOrder
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError

#: The power of the fitted law, and the power whose limit gives the error.
_POWER, _SLOWEST = 3.0, 2.0
#: Weight of a truncation M is M to this power, the inverse of an error that falls as M^-1.5.
_WEIGHT = 1.5


@dataclass(frozen=True)
class FourierLimit:
    """Jones matrices in the limit of infinitely many plain harmonics."""

    t: ComplexArray  #: Shape (2, 2), transmission as in :class:`metafab.cell.rcwa.jones.ZeroOrder`.
    r: ComplexArray  #: Shape (2, 2), reflection.
    error: float  #: Estimate of the largest error of any amplitude.
    correction: float  #: Largest change of any amplitude from the finest truncation to the limit.


def fourier_limit(
    cell: PillarCell,
    orders: Sequence[int] = (8, 9, 10, 11, 12),
    solver: Callable[[PillarCell, int, Formulation], ZeroOrder] = zero_order,
) -> FourierLimit:
    """Jones matrices of ``cell`` by Li's rules on plain harmonics, extrapolated from several truncations.

    Args:
        cell: a plain rectangle with upright walls.
        orders: cosines along each axis, three or more different numbers. From 8 on the error held on all pillars
            tested; fewer harmonics may not follow the law.
        solver: solver of one truncation.

    Raises:
        InputError: fewer than three truncations, or another kind of pillar; or as
            :func:`metafab.cell.rcwa.jones.zero_order`.
    """
    numbers = sorted(set(orders))
    if len(numbers) < 3 or numbers[0] < 2:
        raise InputError.single("fourier_limit", "orders", "three or more different numbers from 2", f"{orders}")
    treated = ("angle_deg", "under, over", "n_substrate_z", "is_staggered")
    if faults := cell.untreated("an extrapolation", treated):
        raise InputError("cell", faults)
    solved = [solver(cell, count, "fourier") for count in numbers]
    values = np.array([np.stack([each.t, each.r]) for each in solved]).reshape(len(solved), -1)
    count = np.array(numbers, dtype=np.float64)
    limit, scatter = _fit(count, values, _POWER)
    slower, _ = _fit(count, values, _SLOWEST)
    t, r = limit.reshape(2, 2, 2)
    return FourierLimit(t, r, float(np.abs(limit - slower).max()) + scatter, float(np.abs(limit - values[-1]).max()))


def _fit(count: FloatArray, values: ComplexArray, power: float) -> tuple[ComplexArray, float]:
    """Limit of values = limit + c count^-power by weighted least squares, and the largest residual."""
    law = np.stack([np.ones_like(count), count**-power], axis=1)
    weight = count[:, None] ** _WEIGHT
    coefficients = np.linalg.lstsq(weight * law, weight * values, rcond=None)[0]
    return coefficients[0], float(np.abs(law @ coefficients - values).max())
