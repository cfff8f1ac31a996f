"""Adaptive truncation: the number of cosines rises until a bound on the error is below the target.

The truncations form a ladder, and the target selects the rungs that are solved. With d(M, k) the largest difference of
any amplitude between M and k cosines, the bound on the error of M is the largest of these:

====================  ===========================  ==================================================================
rule                  of                           bound
====================  ===========================  ==================================================================
claims                cells like measured pillars  least of several max(g floor, share(k) d(M, k) ...), with a margin
                                                   where pillars stand close;
                                                   d(M, k) of the rung k before, where that is above 0.05
near field            cells like measured pillars  c(M) times the squared field of all other orders at the faces:
                                                   truncations that agree by accident beside a resonance
floor                 other cells                  g floor(M): truncations that agree by accident
slow convergence      other cells                  a d(M, k), k the rung before: errors as large as the last change
typical convergence   other cells                  c e_M / e_j d(M, j), j < k, e the typical error: a small last change
power law             crosses, hexagons, metals    3 d(M, k) / ((M / k)^p - 1) over all rungs
far from convergence  other cells                  1.5 times the largest of the three above and at least 1, where it is
                                                   above 0.15: no convergence yet
shifted indices       8 to 10 cosines, rectangles  1.5 10^-5 for each radian that the pillar adds (7 10^-6 within the
                                                   measured kind): neighbours agree better than they err
coarse                under 2.5 cosines a          10^-3 for each radian: errors need not fall yet
                      wavelength, rectangles
unresolved            under 1.5 a wavelength, 2.5  1
                      in a film or a cap
====================  ===========================  ==================================================================

Claims were measured on 173 pillars of four materials, resonances among them, against references of 13 and 14 cosines,
with a margin of 1.4 over the worst pillar; 195 random cells of the measured kind then raised the shares of 8 and 10
cosines, and let floors grow with k0 times the height. On 625 more, 6 cosines agreed with 5, or 9 with 8, by accident,
and erred up to 6.9 times the claim: these claims also take a share of the difference to 3 or to 6. A rung may have
several claims, a low floor with a large share or the other way round; each holds, so that the least is the bound. The
factors of other cells were chosen on 3334 random ones of all kinds (``metafab benchmark certificates``). What a cell's
errors depend on before it is solved, g among it, is in :mod:`metafab.cell.rcwa.convergence`.

The error of a sloped pillar's steps is added (:mod:`metafab.cell.rcwa.slicing`), and no bound is below the rounding of
ill-conditioned modes (:mod:`metafab.cell.rcwa.scattering.modes`).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from metafab.cell.pillar import PillarCell
from metafab.cell.rcwa.basis.coordinates import Formulation
from metafab.cell.rcwa.convergence import Convergence, convergence
from metafab.cell.rcwa.derivatives import size_slopes
from metafab.cell.rcwa.jones import ZeroOrder, distance
from metafab.cell.rcwa.slicing import slicing, smooth
from metafab.cell.response import CellNumerics, CellResponse, SolverDetails
from metafab.core.errors import SolverError


@dataclass(frozen=True)
class Claim:
    """A bound on the error at one truncation, for cells of the measured kind."""

    floor: float  #: Smallest bound of this claim.
    #: (earlier orders, bound over the difference to them); all of these orders must be solved.
    shares: tuple[tuple[int, float], ...]


@dataclass(frozen=True)
class Rung:
    """Rules of one truncation for all other cells."""

    typical: float  #: Typical error, over that of 3 cosines.
    floor: float = math.inf  #: Smallest bound.
    of_last: float = 0.0  #: Factor from the last difference to the bound.
    of_typical: float = 0.0  #: Factor from the typical share of an earlier difference to the bound.
    #: Least bound for each radian that a dielectric rectangle adds to the phase of light, times the growth of floors.
    of_a_rad: float = 0.0


#: Typical errors are the median of 156 random rectangles; plain harmonics converge about as the power -2.5. Up to 6
#: cosines, errors that fall slowly were as large as 2.2 times the last difference (random pillar of index 4.7). From 8
#: to 10, small last differences are accidents: 8 cosines in an absorbing pillar differed from 7 by 1e-4, and were off
#: by 2e-3, which is 8 times the typical share of the difference to 6. Errors fall slowly there: 9 cosines were off by
#: 6.0e-6 and 6.9e-6 a radian in two of 3334 random cells.
_RUNGS: dict[Formulation, dict[int, Rung]] = {
    "adaptive": {
        3: Rung(1.0),
        4: Rung(0.5),
        5: Rung(0.1, 6e-4, 5.0, 10.0),
        6: Rung(0.03, 3e-4, 5.0, 10.0),
        7: Rung(0.011, 2e-4, 3.0, 15.0),
        8: Rung(4.4e-3, 3e-5, 3.0, 20.0, 1.25e-5),
        9: Rung(2.4e-3, 7e-5, 3.0, 20.0, 1.25e-5),
        10: Rung(1.5e-3, 9e-5, 3.0, 20.0, 1.25e-5),
        12: Rung(6e-4, 4e-5, 3.0, 15.0),
        14: Rung(3e-4, 2e-5, 3.0, 15.0),
        16: Rung(2e-4, 1.2e-5, 3.0, 15.0),
    },
    "fourier": {
        3: Rung(1.0),
        4: Rung(0.5),
        6: Rung(0.18, 5e-2, 5.0, 10.0),
        8: Rung(0.09, 2e-2, 3.0, 15.0),
        12: Rung(0.03, 1e-2, 3.0, 15.0),
        16: Rung(0.015, 5e-3, 3.0, 15.0),
        24: Rung(6e-3, 2e-3, 3.0, 15.0),
    },
}
#: Least cosines for which a single difference bounds amplitudes: 4 and 5 may agree by accident.
_LONE_FROM = 6
#: Factor from a single difference to the bound, from ``_LONE_FROM`` cosines on and below. In 273 random cells the error
#: of 8 cosines was at most 2.7 times the difference to 6.
_LONE_MARGIN, _COARSE_LONE_MARGIN = 7.0, 12.0
#: Number of differences that are compared.
_NEAREST = 3
#: Implied error, of an amplitude or an efficiency, above which the ladder has not begun to converge, and the multiple
#: of it that is then stated, at least 1: 6 cosines under light at an angle differed from 5 by 0.06 and 0.1, and were
#: off by 0.25 and 0.35.
_FAR_FROM_CONVERGED, _FAR_MARGIN = 0.15, 1.5
#: Cosines along each axis -> claims on the error of that truncation.
_CLAIMS: dict[Formulation, dict[int, tuple[Claim, ...]]] = {
    "adaptive": {
        5: (Claim(6e-4, ((3, 1.5),)),),
        6: (
            Claim(4.5e-4, ((5, 0.9), (3, 0.05))),
            Claim(3e-4, ((4, 0.28),)),
            Claim(4e-4, ((4, 0.18),)),
            Claim(9e-4, ((4, 0.09),)),
        ),
        7: (
            Claim(2e-4, ((6, 6.0),)),
            Claim(4e-4, ((6, 0.65),)),
            Claim(2e-4, ((4, 0.15),)),
            Claim(3e-4, ((4, 0.05),)),
        ),
        8: (Claim(3e-5, ((6, 1.15),)),),
        9: (Claim(7e-5, ((8, 1.1), (6, 0.1))), Claim(3e-5, ((6, 0.95),))),
        10: (Claim(9e-5, ((9, 0.7), (8, 0.7))),),
        12: (Claim(5e-5, ((10, 1.0), (9, 1.0))),),
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
#: Cosines along each axis -> least error of the measured kind over the near field
#: (:meth:`metafab.cell.rcwa.jones.SolvedClass.near_field`). A truncation changes the layer a little, and t turns with
#: it as the product of the fields lit from either side, both of which a resonance raises. Over the near field the
#: errors of pillars that broke the claims of 6 cosines were 3.3e-5 to 5.2e-5 (index 3.5) and 8.5e-5 to 9.7e-5 (2.37);
#: of 24 resonant pillars of index 3.5 all but one stayed below 2.5e-5 at 7 cosines, 7.7e-6 at 9 and 3.6e-6 at 10, and
#: at 12 and 14 below 1.3e-6 where the near field is above 10. The factors are 1.2 to 1.4 times these. No resonance
#: broke the claims of 5 and of 8 cosines.
OF_NEAR_FIELD: dict[Formulation, dict[int, float]] = {
    "adaptive": {6: 1.2e-4, 7: 3.5e-5, 9: 1e-5, 10: 4.5e-6, 12: 1.6e-6, 14: 1.6e-6},
    "fourier": {},
}
#: Last difference above which a ladder of the measured kind has not begun to converge.
_NOT_CONVERGING = 5e-2
#: Cosines of the measured kind whose neighbours agree better than they err, and their least error for each radian that
#: the pillar adds: on 195 random cells errors were up to 6e-6 (5.7e-5 at 13 rad).
_SLOW_RUNGS, _LEAST_OF_A_RAD = (8, 9, 10), 7e-6
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
#: pillars that needed more than 6, at more than half the cost of 8. They were enough for 144 of 165 random cells whose
#: pillars stand close.
_SKIPPED_RUNG = 7
#: First rungs between which cells unlike the measured ones take another: 3 and 5 cosines may agree by accident. On 91
#: random cells the least bound over the error at 5 cosines was 1.2 from 3 and 5, and 1.9 from 3, 4 and 5; 3, 5 and 6
#: of a cross under light at an angle agreed within 2.8e-4, while 6 were off by 7.6e-4 and differed from 4 by 1.1e-3.
_ACCIDENTS = ((3, 5), (4, 6))
#: A power law uses at least the ladder of this target: distant rungs determine the error best.
_FAR_TARGET = 4e-3
#: Margin of the claims above which pillars count as close, and the target whose ladder is then used for larger ones:
#: 4 and 6 cosines, since 3 and 5 agreed by accident in a cell of 0.703 of the period, where 6 were off by 6e-3.
_CLOSE, _CLOSE_TARGET = 1.5, 5e-4


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
    with ``converged`` false and the error that it has. ``known`` is a cache of this cell's truncations, (cosines,
    steps) -> solution, read and extended: for calls of several targets. InputError as in
    :func:`metafab.cell.rcwa.jones.zero_order`; SolverError if an amplitude is not a finite number.
    """
    started = time.perf_counter()
    cut, rate = slicing(cell, numerics), convergence(cell)
    solved: dict[int, ZeroOrder] = {}
    known = {} if known is None else known
    for orders in ladder(numerics, rate):
        if (orders, cut.steps) not in known:
            known[orders, cut.steps] = smooth(cell, orders, numerics.formulation, cut.steps, keep=numerics.slopes)
        last = known[orders, cut.steps]
        earlier = {count: distance(last, coarser) for count, coarser in solved.items()}
        error = bound(orders, earlier, rate, numerics.formulation, last.near_field) + cut.error
        error = max(error, last.conditioning.rounding)
        known[orders, cut.steps] = solved[orders] = replace(last, kept=())
        if error <= numerics.target_error:
            break
    if not (np.isfinite(last.t).all() and np.isfinite(last.r).all()):
        raise SolverError(f"rcwa gave no finite amplitudes with {orders} orders for {cell}")
    slopes = size_slopes(cell, last, orders, numerics.formulation) if last.kept else None
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
        slopes=slopes,
    )


def ladder(numerics: CellNumerics, rate: Convergence) -> tuple[int, ...]:
    """Truncations for the target, ascending up to ``numerics.max_orders``; at least two where that many are allowed."""
    target = numerics.target_error
    if rate.law is not None:
        target = max(target, _FAR_TARGET)
    elif rate.is_measured and rate.claims_margin > _CLOSE and target >= _FAR_TARGET:
        target = _CLOSE_TARGET
    below: tuple[int, ...] = ()
    for least_target, all_rungs in reversed(_LADDERS[numerics.formulation]):
        rungs = tuple(orders for orders in all_rungs if orders <= numerics.max_orders)
        if len(rungs) >= 2 or not below:
            below = rungs
        if target >= least_target:
            break
    if not rate.is_measured and below[:2] in _ACCIDENTS:
        return (below[0], below[0] + 1, *below[1:])
    if rate.is_measured and rate.claims_margin <= _CLOSE and 4 in below and max(below) > _SKIPPED_RUNG:
        return tuple(orders for orders in below if orders != _SKIPPED_RUNG)
    return below or _LADDERS[numerics.formulation][-1][1][:1]


def bound(
    orders: int,
    earlier: dict[int, float],
    rate: Convergence,
    formulation: Formulation = "adaptive",
    near_field: float = 0.0,
) -> float:
    """Bound on the error of amplitudes of a truncation; infinite where the earlier ones do not suffice.

    Args:
        orders: truncation whose error is bounded.
        earlier: earlier truncation -> largest difference of any amplitude.
        rate: rate of convergence of the cell.
        formulation: "adaptive" or "fourier".
        near_field: :attr:`metafab.cell.rcwa.jones.ZeroOrder.near_field` of the truncation.
    """
    rung, growth = _RUNGS[formulation][orders], rate.floor_growth
    if rate.is_measured:
        claims = _CLAIMS[formulation].get(orders, ())
        bounds = [
            max(growth * claim.floor, *(share * earlier[count] for count, share in claim.shares))
            for claim in claims
            if all(count in earlier for count, _ in claim.shares)
        ]
        if bounds and earlier[max(earlier)] > _NOT_CONVERGING:
            bounds = [earlier[max(earlier)]]
        of_a_rad = _LEAST_OF_A_RAD if orders in _SLOW_RUNGS else 0.0
        of_near_field = OF_NEAR_FIELD[formulation].get(orders, 0.0) * near_field
        least = max(rate.claims_margin * min(bounds, default=math.inf), of_near_field)
    else:
        suffice = len(earlier) > 1 or (len(earlier) == 1 and orders >= _LONE_FROM)
        least = max(growth * rung.floor, implied_bound(orders, earlier, rate, formulation)) if suffice else math.inf
        of_a_rad = rung.of_a_rad if rate.law is None else 0.0
    return max(least, of_a_rad * growth * rate.added_phase_rad, rate.least_error(orders))


def implied_bound(
    orders: int, earlier: dict[int, float], rate: Convergence, formulation: Formulation = "adaptive"
) -> float:
    """Bound on the error of any figure at ``orders`` from its differences to ``earlier`` truncations, at least one."""
    rungs, (last, *before) = _RUNGS[formulation], sorted(earlier, reverse=True)[:_NEAREST]
    rung = rungs[orders]
    shares = [rung.of_typical * rung.typical / rungs[count].typical * earlier[count] for count in before]
    of_law = 0.0 if rate.law is None else rate.law.bound(orders, earlier)
    lone = _LONE_MARGIN if orders >= _LONE_FROM else _COARSE_LONE_MARGIN
    implied = max((rung.of_last if before else lone) * earlier[last], of_law, *shares)
    return max(_FAR_MARGIN * implied, 1.0) if implied > _FAR_FROM_CONVERGED else implied
