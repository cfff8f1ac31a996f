"""Adaptive truncation: the number of cosines rises until a bound on the error is below the target.

The truncations form a ladder, and the target selects the rungs that are solved. The bounds were measured on 173 pillars
of four materials, resonances among them, against references of 13 and 14 orders. With d(M, k) the largest difference
of any amplitude between M and k orders, a claim is

    error(M) <= max( floor, share(k) d(M, k) ... ),

with a margin of 1.4 over the worst pillar; 195 random cells of the measured kind then raised the shares of 8 and 10
cosines, and let floors grow with k0 times the height. Differences include the special features of a pillar (a sharp
resonance that the truncation shifts); the floor covers truncations that agree by accident. A rung may have several
claims, a low floor with a large share or the other way round; each holds, so that the least is the bound. A last
difference so large that the ladder has not begun to converge counts in full.

The error of a sloped pillar's steps is added (:mod:`metafab.cell.rcwa.slicing`), and no bound is below the rounding of
ill-conditioned modes (:mod:`metafab.cell.rcwa.scattering.modes`).

Cells unlike the measured ones (:func:`is_measured`) take the largest error that the three rungs before imply,

    error(M) <= max( floor g, a d(M, k), c e_M / e_j d(M, j) ... ),

with k the rung before M, j < k, and e_M the typical error of M cosines. On random cells errors grew as the first power
of the height (exponents 0.8 to 1.1 at 3 to 10 cosines): a truncation shifts the effective indices of the modes, and the
shift turns t by k0 times the height. Floors therefore grow by g with the phase that the pillar adds, beyond the largest
one that was measured.

Cross-sections of several rectangles, pillars of a hexagonal lattice and metals converge as a power of the truncation,
and two neighbouring rungs then differ little: d(M, k) is the error at M times (M / k)^p - 1. The bound is also at least
three times the largest error that any earlier rung implies by this law.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.basis.coordinates import Formulation
from metafab.cell.rcwa.jones import ZeroOrder, distance
from metafab.cell.rcwa.slicing import slicing, smooth
from metafab.cell.response import CellNumerics, CellResponse, SolverDetails
from metafab.core.errors import SolverError


@dataclass(frozen=True)
class Claim:
    """A bound on the error at one truncation."""

    floor: float  #: Smallest bound of this claim.
    #: (earlier orders, factor from the difference to them to the bound); all must be solved.
    shares: tuple[tuple[int, float], ...]


#: Cosines along each axis -> claims on the error of that truncation.
_CLAIMS: dict[Formulation, dict[int, tuple[Claim, ...]]] = {
    "adaptive": {
        5: (Claim(6e-4, ((3, 1.5),)),),
        6: (
            Claim(3e-4, ((5, 3.0),)),
            Claim(4.5e-4, ((5, 0.9),)),
            Claim(3e-4, ((4, 0.28),)),
            Claim(4e-4, ((4, 0.18),)),
            Claim(9e-4, ((4, 0.06),)),
        ),
        7: (
            Claim(2e-4, ((6, 6.0),)),
            Claim(4e-4, ((6, 0.65),)),
            Claim(2e-4, ((4, 0.15),)),
            Claim(3e-4, ((4, 0.05),)),
        ),
        8: (Claim(3e-5, ((7, 5.0),)), Claim(3e-5, ((6, 1.15),))),
        9: (Claim(7e-5, ((8, 1.1),)), Claim(3e-5, ((6, 0.95),))),
        10: (Claim(9e-5, ((9, 0.7), (8, 0.7))),),
        12: (Claim(4e-5, ((10, 1.0), (9, 1.0))),),
        14: (Claim(2e-5, ((12, 1.5), (10, 1.0))),),
        16: (Claim(1.2e-5, ((14, 1.5), (12, 1.0))),),
    },
    # Plain harmonics converge algebraically: half the orders have at least twice the error.
    "fourier": {
        6: (Claim(5e-2, ((3, 1.5), (4, 1.5))),),
        8: (Claim(2e-2, ((4, 1.5), (6, 1.5))),),
        12: (Claim(1e-2, ((6, 1.5), (8, 1.5))),),
        16: (Claim(5e-3, ((8, 1.5), (12, 1.5))),),
        24: (Claim(2e-3, ((12, 1.5), (16, 1.5))),),
    },
}
#: (least target, rungs for it), chosen so that two rungs are likely to suffice.
_LADDERS: dict[Formulation, tuple[tuple[float, tuple[int, ...]], ...]] = {
    "adaptive": (
        (0.0, (6, 8, 9, 10, 12, 14, 16)),
        (5e-4, (4, 6, 7, 8, 9, 10, 12, 14, 16)),
        (4e-3, (3, 5, 6, 7, 8, 9, 10, 12, 14, 16)),
    ),
    "fourier": ((0.0, (3, 4, 6, 8, 12, 16, 24)),),
}
#: Rung that measured cells skip between 6 and 8: at targets from 5e-4, 7 cosines were enough for 5 of the 90 silicon
#: pillars that needed more than 6, at more than half the cost of 8.
_SKIPPED_RUNG = 7
#: First rungs between which cells unlike the measured ones take another: 3 and 5 cosines may agree by accident. On 91
#: random cells the least bound over the error at 5 cosines was 1.2 from 3 and 5, and 1.9 from 3, 4 and 5.
_ACCIDENTS = ((3, 5), (4, 6))
#: Last difference above which the ladder has not begun to converge.
_NOT_CONVERGING = 5e-2
#: Implied error, of an amplitude or an efficiency, above which it has not, and the multiple of it that is then stated,
#: at least 1: 6 cosines under light at an angle differed from 5 by 0.06 and 0.1, and were off by 0.25 and 0.35.
_FAR_FROM_CONVERGED, _FAR_MARGIN = 0.15, 2.0
#: Measured range: period in wavelengths inside the densest medium, height in vacuum wavelengths, ratio of the indices,
#: and extinction over index. In narrower and in taller cells 5 cosines may be worse than 3, and claims failed.
_NARROWEST, _WIDEST, _TALLEST, _STEEPEST, _DIMMEST = 1.2, 1.65, 1.35, 4.0, 0.05
#: Measured range: phase, rad, that the pillar adds to light over its height: 12.7 in the paper's cell, 14.8 in the
#: tallest silicon pillars.
_LARGEST_PHASE = 15.0
#: Phase, rad, of the vacuum wave over the height of the silicon pillars on which the floors were chosen; 4.71 in the
#: paper's cell.
_SILICON_PHASE = 4.75
#: Least error of 8 to 10 cosines for each radian that the pillar adds: neighbours among them agree better, as errors
#: fall slowly there. On 195 random cells of the measured kind they were up to 6e-6 (5.7e-5 at 13 rad), and 6.9e-6 in
#: two of 3334 of all kinds.
_SLOW_RUNGS, _LEAST_OF_A_RAD, _LEAST_UNMEASURED = (8, 9, 10), 7e-6, 1.5e-5
#: Measured range: ratio of the periods.
_LONGEST = 1.03
#: Measured range: size over period. Between silicon pillars that stand closer, claims failed at some heights.
_FULLEST = 0.7
#: Least cosines a wavelength of the period in the densest medium, and in a film or a cap, whose guided waves the
#: coordinates of the pillar stretch: under pillars of low index, 6 cosines in 3.5 wavelengths differed from 5 by 0.001
#: and were off by 0.03; under a cap of 4.2, 8 cosines in 3.7 wavelengths differed from 7 by 0.001 and were off by 0.08.
_RESOLVED, _RESOLVED_LAYER = 1.5, 2.5
#: Cosines a wavelength in the densest medium below which errors need not fall yet, and the least error there for each
#: radian that the pillar adds: 5 cosines were off by up to 6.7e-4 a radian on 28 random cells. In a pillar of 2.8 and a
#: period of 2.0 wavelengths, 3, 4 and 5 cosines agreed within 0.005, and 5 were off by 0.011.
_FALLING, _COARSE_OF_A_RAD = 2.5, 1e-3
#: Error over that of 3 cosines: median of 156 random rectangles, most of them unlike the measured ones. Plain harmonics
#: converge about as the power -2.5.
_TYPICAL: dict[Formulation, dict[int, float]] = {
    "adaptive": {
        3: 1.0, 4: 0.5, 5: 0.1, 6: 0.03, 7: 0.011, 8: 4.4e-3, 9: 2.4e-3, 10: 1.5e-3, 12: 6e-4, 14: 3e-4, 16: 2e-4,
    },
    "fourier": {3: 1.0, 4: 0.5, 6: 0.18, 8: 0.09, 12: 0.03, 16: 0.015, 24: 0.006},
}  # fmt: skip
#: Where nothing was measured: least cosines -> factors to the bound from the last difference and from the typical share
#: of an earlier one. Up to 6 cosines, errors that fall slowly were as large as 2.2 times the last difference (random
#: pillar of index 4.7). From 8 to 10, small last differences are accidents: 8 cosines in an absorbing pillar differed
#: from 7 by 1e-4, and were off by 2e-3, which is 8 times the typical share of the difference to 6.
_MARGINS = {12: (3.0, 15.0), 8: (3.0, 20.0), 7: (3.0, 15.0), 0: (5.0, 10.0)}
#: Factor from a single difference, and number of differences.
_LONE_MARGIN, _NEAREST = 12.0, 3


@dataclass(frozen=True)
class PowerLaw:
    """Algebraic convergence."""

    power: float  #: The error falls at least as the truncation to minus this power.
    from_orders: int  #: Smallest truncation to which the law applies.

    def bound(self, orders: int, earlier: dict[int, float]) -> float:
        """Bound on the error at ``orders`` from differences to ``earlier`` truncations; inf below ``from_orders``."""
        if orders < self.from_orders or not earlier:
            return float("inf")
        implied = (apart / (float(orders / count) ** self.power - 1.0) for count, apart in earlier.items())
        return float(_LAW_MARGIN * max(implied))


#: Curved outlines converge more slowly than corners between straight walls.
_CURVED, _STRAIGHT = PowerLaw(1.5, 7), PowerLaw(2.0, 6)
#: Margin over the largest implied error, and over the floors. Powers scatter: on 280 random cells the error was up to
#: 1.35 of the implied one, and 6 cosines in a cross of index 1.5 were off by 4.7e-4 and differed from 5 by 1e-4.
_LAW_MARGIN = 3.0
#: Margin over the floors of other cells unlike the measured ones: 5 cosines in a pillar of 2.5 were off by 3.2e-4.
_FLOOR_MARGIN = 1.2
#: Target whose ladder a power law uses at least: distant rungs determine the error best.
_FAR_TARGET = 4e-3


@dataclass(frozen=True)
class RcwaDetails(SolverDetails):
    """Figures of a solution by RCWA."""

    formulation: Formulation  #: "adaptive" or "fourier".
    orders_x: int  #: Cosines along x of the finest truncation.
    orders_y: int  #: Cosines along y, equal to ``orders_x``.
    coefficients: int  #: Unknowns of the largest symmetry class.
    truncations: int  #: Number of truncations that were solved.
    inconsistency: float  #: Violation of reciprocity by rounding, as an amplitude; 0 where modes were used.
    condition: float  #: Condition number of the worst layer's modes; 0 where none were used.
    transmitted_power_x: float  #: Power in all transmitted orders over the incident power, for incident x.
    transmitted_power_y: float  #: Power in all transmitted orders over the incident power, for incident y.
    reflected_power_x: float  #: Power in all reflected orders over the incident power, for incident x.
    reflected_power_y: float  #: Power in all reflected orders over the incident power, for incident y.


@dataclass(frozen=True)
class SlopedDetails(RcwaDetails):
    """Figures of a sloped pillar by RCWA."""

    steps: int  #: Number of steps in the finer of the two extrapolated cuts.
    slicing_error: float  #: Bound on the error of the steps.


def solve(
    cell: PillarCell,
    numerics: CellNumerics = CellNumerics(),  # noqa: B008 (frozen)
    known: dict[tuple[int, int], ZeroOrder] | None = None,
) -> CellResponse:
    """Solve ``cell`` for its Jones matrices, with a bound on their error that is at most the target if it converged.

    The truncation rises up to ``numerics.max_orders``. If the target is not met there, the finest solution is returned
    with ``converged`` false and the error that it has. ``known`` holds truncations of this cell by (cosines, steps),
    which are taken from there and added; for several targets. InputError as :func:`metafab.cell.rcwa.jones.zero_order`;
    SolverError if an amplitude is not a finite number.
    """
    started = time.perf_counter()
    cut = slicing(cell, numerics)
    measured, law, growth = is_measured(cell), power_law(cell), floor_growth(cell)
    solved: dict[int, ZeroOrder] = {}
    known = {} if known is None else known
    for orders in ladder(numerics, measured=measured, law=law):
        if (orders, cut.steps) not in known:
            known[orders, cut.steps] = smooth(cell, orders, numerics.formulation, cut.steps)
        solved[orders] = known[orders, cut.steps]
        error = bound(orders, solved, numerics.formulation, measured=measured, law=law, growth=growth) + cut.error
        of_a_rad = _LEAST_OF_A_RAD if measured else _LEAST_UNMEASURED
        tail = of_a_rad * growth * _added_phase_rad(cell) if law is None and orders in _SLOW_RUNGS else 0.0
        error = max(error, tail, solved[orders].conditioning.rounding, unresolved(cell, orders))
        if error <= numerics.target_error:
            break
    last = solved[orders]
    if not (np.isfinite(last.t).all() and np.isfinite(last.r).all()):
        raise SolverError(f"rcwa gave no finite amplitudes with {orders} orders for {cell}")
    details = RcwaDetails(
        formulation=numerics.formulation,
        orders_x=orders,
        orders_y=orders,
        coefficients=last.coefficients,
        truncations=len(solved),
        inconsistency=last.inconsistency,
        condition=last.conditioning.condition,
        transmitted_power_x=float(last.transmitted_power[0]),
        transmitted_power_y=float(last.transmitted_power[1]),
        reflected_power_x=float(last.reflected_power[0]),
        reflected_power_y=float(last.reflected_power[1]),
    )
    if cell.is_sloped:
        details = SlopedDetails(**vars(details), steps=cut.steps, slicing_error=cut.error)
    return CellResponse(
        cell=cell,
        numerics=numerics,
        t=last.t,
        r=last.r,
        error=float(error),
        converged=bool(error <= numerics.target_error),
        resolution=(2 * orders + 1) ** 2,
        seconds=time.perf_counter() - started,
        details=details,
    )


def ladder(numerics: CellNumerics, *, measured: bool = False, law: PowerLaw | None = None) -> tuple[int, ...]:
    """Truncations for the target, ascending up to ``numerics.max_orders``; at least two where that many are allowed.

    ``measured`` says whether the claims were measured on cells of this kind; ``law`` is the convergence of a cell that
    follows a power law.
    """
    if law is not None:
        numerics = replace(numerics, target_error=max(numerics.target_error, _FAR_TARGET))
    below: tuple[int, ...] = ()
    for least_target, all_rungs in reversed(_LADDERS[numerics.formulation]):
        rungs = tuple(orders for orders in all_rungs if orders <= numerics.max_orders)
        if len(rungs) >= 2 or not below:
            below = rungs
        if numerics.target_error >= least_target:
            break
    if not measured and law is None and below[:2] in _ACCIDENTS:
        return (below[0], below[0] + 1, *below[1:])
    if measured and 4 in below and max(below) > _SKIPPED_RUNG:
        return tuple(orders for orders in below if orders != _SKIPPED_RUNG)
    return below or _LADDERS[numerics.formulation][-1][1][:1]


def bound(
    orders: int,
    solved: dict[int, ZeroOrder],
    formulation: Formulation = "adaptive",
    *,
    measured: bool = True,
    law: PowerLaw | None = None,
    growth: float = 1.0,
) -> float:
    """Bound on the error of ``solved[orders]`` from the earlier solutions; infinite where they do not suffice.

    Args:
        orders: truncation whose error is bounded.
        solved: truncation -> solution.
        formulation: "adaptive" or "fourier".
        measured: whether the claims were measured on cells of this kind.
        law: convergence of a cell that follows a power law.
        growth: factor of the floors, from 1.
    """
    earlier = {count: distance(solved[orders], solution) for count, solution in solved.items() if count < orders}
    claims = [
        claim for claim in _CLAIMS[formulation].get(orders, ()) if all(count in earlier for count, _ in claim.shares)
    ]
    if not claims:
        return float("inf")
    if not measured:
        return stated(max(growth * claims[0].floor, implied_bound(orders, earlier, formulation, law)))
    nearest = earlier[max(earlier)]
    if nearest > _NOT_CONVERGING:
        return nearest
    return min(
        max(growth * claim.floor, *(share * earlier[count] for count, share in claim.shares)) for claim in claims
    )


def implied_bound(
    orders: int,
    earlier: dict[int, float],
    formulation: Formulation = "adaptive",
    law: PowerLaw | None = None,
) -> float:
    """Bound on the error of any figure at ``orders`` from its differences to ``earlier`` truncations, at least one.

    ``law`` is the convergence of a cell that follows a power law.
    """
    typical, (last, *before) = _TYPICAL[formulation], sorted(earlier, reverse=True)[:_NEAREST]
    of_last, of_typical = next(margins for least, margins in _MARGINS.items() if orders >= least)
    shares = [of_typical * typical[orders] / typical[count] * earlier[count] for count in before]
    implied = (of_last if before else _LONE_MARGIN) * earlier[last]
    return max(0.0 if law is None else law.bound(orders, earlier), implied, *shares)


def stated(implied: float) -> float:
    """Bound on an error from an implied one: at least 1 where that is too large for truncations that converge."""
    return max(_FAR_MARGIN * implied, 1.0) if implied > _FAR_FROM_CONVERGED else implied


def unresolved(cell: PillarCell, orders: int) -> float:
    """Least bound of a truncation: 1 where it has too few cosines for the waves in pillar, film or cap.

    Where it has enough, but too few for errors to fall, it grows with the phase that the pillar adds; else it is 0.

    Two such truncations may agree by accident: in a cell of 5.2 wavelengths within the pillar, 5 and 6 cosines differ
    by 0.03, and both are off by 0.16.
    """
    layers = [max(complex(n).real for n in (each.n_inside, each.n_around)) for each in (*cell.under, *cell.over)]
    least = max(_RESOLVED * _densest(cell), *(_RESOLVED_LAYER * n for n in layers), 0.0)
    per_wavelength = orders * cell.wavelength_nm / max(cell.period_nm)
    if per_wavelength < least:
        return 1.0
    is_coarse = power_law(cell) is None and per_wavelength < _FALLING * _densest(cell)
    return _COARSE_OF_A_RAD * _added_phase_rad(cell) if is_coarse else 0.0


def power_law(cell: PillarCell) -> PowerLaw | None:
    """Power law of a cell's convergence; None for a dielectric rectangle in a rectangular lattice."""
    if cell.shape == "ellipse":
        return _CURVED
    is_metal = (complex(cell.n_pillar) ** 2).real < 0.0
    return _STRAIGHT if cell.is_shaped or cell.is_staggered or is_metal else None


def floor_growth(cell: PillarCell) -> float:
    """Factor of the floors, from 1: the phase that the pillar adds over the largest one that was measured.

    It is threefold where errors fall as a power of the truncation, and 1.2 times that phase in other cells unlike the
    measured ones. Within the measured kind it is the phase of the vacuum wave over that in silicon pillars.
    """
    if is_measured(cell):
        return max(1.0, cell.k0_per_nm * cell.height_nm / _SILICON_PHASE)
    return (_FLOOR_MARGIN if power_law(cell) is None else _LAW_MARGIN) * max(
        1.0, _added_phase_rad(cell) / _LARGEST_PHASE
    )


def _added_phase_rad(cell: PillarCell) -> float:
    return cell.k0_per_nm * cell.height_nm * abs(complex(cell.n_pillar) - complex(cell.n_ambient))


def _densest(cell: PillarCell) -> float:
    """Largest refractive index among pillar, ambient and substrate."""
    return max(n.real for n in map(complex, (cell.n_pillar, cell.n_ambient, *cell.n_substrate)))


def is_measured(cell: PillarCell) -> bool:
    """Whether the claims were measured on cells like ``cell``.

    They were not for holes, light at an angle, birefringent substrates, sloped walls, layers, cross-sections of several
    rectangles, hexagonal lattices, tall pillars, narrow, wide or oblong cells, sizes near the period, steep or strongly
    absorbing indices, and metals, where the field at the corners has no limit that Fourier methods approach steadily.
    """
    pillar, around = complex(cell.n_pillar), complex(cell.n_ambient)
    sizes = (cell.width_nm, cell.length_nm)
    return (
        cell.angle_deg == 0.0
        and not cell.is_birefringent
        and not (cell.under or cell.over or cell.is_sloped or cell.is_shaped or cell.is_staggered)
        and around.real <= pillar.real <= _STEEPEST * around.real
        and max(pillar.imag / pillar.real, around.imag / around.real) <= _DIMMEST
        and max(cell.period_nm) <= _LONGEST * min(cell.period_nm)
        and all(size <= _FULLEST * period for size, period in zip(sizes, cell.period_nm, strict=True))
        and _NARROWEST * cell.wavelength_nm <= max(cell.period_nm) * _densest(cell) <= _WIDEST * cell.wavelength_nm
        and cell.height_nm <= _TALLEST * cell.wavelength_nm
        and _added_phase_rad(cell) <= _LARGEST_PHASE
    )
