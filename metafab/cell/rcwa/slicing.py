"""How many steps a sloped pillar is cut into, and what that costs in accuracy.

With n steps, each as wide as the pillar is in its middle, the amplitudes tend to those of the smooth wall as n^-1 to
n^-2: second order as long as a step is thin against the field's decay length, less for its most evanescent part. The
difference between n and 2 n is then at least the error of 2 n, and half the error of n. It is taken at a low
truncation, which moves resonances a little but hardly changes what steps do to them, and counts ``_MARGIN`` fold.
"""

from __future__ import annotations

from dataclasses import dataclass

from metafab.cell.rcwa.jones import ZeroOrder, distance, zero_order
from metafab.cell.response import CellNumerics, PillarCell
from metafab.core.errors import InputError

#: Truncation at which the steps are counted.
_ORDERS = 5
#: Most steps that are tried.
MOST_STEPS = 64
#: What a difference counts, and the share of the target that is left to the steps.
_MARGIN, _SHARE = 1.5, 0.5


@dataclass(frozen=True)
class Slicing:
    """Steps of a sloped pillar.

    Attributes:
        steps: how many, of equal height.
        error: bound on what they change in any amplitude; 0 for upright walls.
    """

    steps: int
    error: float


def slicing(cell: PillarCell, numerics: CellNumerics) -> Slicing:
    """The steps that ``numerics`` gives, or as many as keep to their share of its target error, and their error.

    Where ``MOST_STEPS`` do not keep to it, the error says so.

    Raises:
        InputError: ``numerics.steps`` is below 1; or as :func:`metafab.cell.rcwa.jones.zero_order`.
    """
    if numerics.steps is not None and numerics.steps < 1:
        raise InputError.single("numerics", "steps", "at least 1, or none for as many as needed", f"{numerics.steps}")
    if not cell.is_sloped:
        return Slicing(1, 0.0)

    def cut(steps: int) -> ZeroOrder:
        return zero_order(cell, min(_ORDERS, numerics.max_orders), numerics.formulation, steps)

    if numerics.steps is not None:
        return Slicing(numerics.steps, 2.0 * _MARGIN * distance(cut(numerics.steps), cut(2 * numerics.steps)))
    steps, coarse, earlier = 2, cut(2), distance(cut(1), cut(2))
    while True:
        steps, fine = 2 * steps, cut(2 * steps)
        change = distance(coarse, fine)
        # Two solutions may agree by accident, so that the difference before counts as well, as if by second order.
        error = _MARGIN * max(change, 0.25 * earlier)
        if error <= _SHARE * numerics.target_error or 2 * steps > MOST_STEPS:
            return Slicing(steps, error)
        coarse, earlier = fine, change
