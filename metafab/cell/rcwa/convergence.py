"""How the errors of a cell fall with the number of cosines: by its indices, sizes and height alone.

- A truncation that does not resolve the waves in the pillar, or those guided in a film or a cap, proves nothing.
- Where a truncation barely resolves them, errors need not fall yet.
- A truncation shifts the effective indices of the modes, and the shift turns t by k0 times the height: errors grow with
  the phase that the pillar adds to light.
- The field at the corners of several rectangles, of adjacent rows and of metals lets errors fall as a power only.
- Square cells like the paper's were measured, resonances among them (:mod:`metafab.cell.rcwa.certificate`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from metafab.cell.pillar import PillarCell

#: Least cosines for each wavelength in the period: of light in the densest medium, and of light in a film or a cap,
#: whose guided waves the pillar's coordinates stretch. With fewer, small differences hid large errors. In a pillar with
#: 5.2 wavelengths a period, 5 and 6 cosines differed by 0.03 and were off by 0.16. In a film with 3.5 under pillars of
#: low index, they differed by 0.001 and were off by 0.03. In a cap of index 4.2 with 3.7, 7 and 8 cosines differed by
#: 0.001 and were off by 0.08.
_RESOLVED, _RESOLVED_LAYER = 1.5, 2.5
#: Cosines a wavelength in the densest medium below which errors need not fall yet, and the least error there for each
#: radian that the pillar adds: 5 cosines were off by up to 6.7e-4 a radian on 28 random cells. In a pillar of 2.8 and a
#: period of 2.0 wavelengths, 3, 4 and 5 cosines agreed within 0.005, and 5 were off by 0.011.
_FALLING, _COARSE_OF_A_RAD = 2.5, 1e-3
#: Measured range: period in wavelengths inside the densest medium. In narrower and in taller cells 5 cosines may be
#: worse than 3, and claims failed.
_NARROWEST, _WIDEST = 1.2, 1.65
#: Measured range: largest height, vacuum wavelengths.
_TALLEST = 1.35
#: Measured range: largest ratio of the indices.
_STEEPEST = 4.0
#: Measured range: largest extinction over index.
_DIMMEST = 0.05
#: Measured range: ratio of the periods, and size over period.
_LONGEST, _FULLEST = 1.03, 0.72
#: Size over period from which errors exceed the claims of sizes below, and the rise of the claims' margin with it. On
#: 300 random cells with a size of 0.70 to 0.72 the error was up to 1.7 times the claim of a target up to 1e-3 and up to
#: 2.4 times that of 1e-2, on 300 with smaller sizes 1.24 times, all from 0.67 on, and on 318 more 1.25 times at 0.657.
_FULL, _MARGIN_OF_FULL = 0.63, 16.0
#: Measured range: phase, rad, that the pillar adds to light over its height: 12.7 in the cell of Shen 2023, 14.8 in the
#: tallest silicon pillars.
_LARGEST_PHASE = 15.0
#: Phase, rad, of the vacuum wave over the height of the silicon pillars on which the floors were chosen; 4.71 in the
#: paper's cell.
_SILICON_PHASE = 4.75
#: Margins over the floors of cells unlike the measured ones, and over floors and implied errors of those that follow a
#: power law. Five cosines in a pillar of 2.5 were off by 3.2e-4. Powers scatter: on 280 random cells the error was up
#: to 1.35 of the implied one, and 6 cosines in a cross of index 1.5 were off by 4.7e-4 and differed from 5 by 1e-4.
_FLOOR_MARGIN, _LAW_MARGIN = 1.2, 3.0


@dataclass(frozen=True)
class PowerLaw:
    """Algebraic convergence."""

    power: float  #: The error falls at least as the truncation to minus this power.
    from_orders: int  #: Smallest truncation to which the law applies.

    def bound(self, orders: int, earlier: dict[int, float]) -> float:
        """Bound on the error at ``orders`` from differences to ``earlier`` truncations; inf below ``from_orders``.

        A difference to k orders is the error times (orders / k)^power - 1.
        """
        if orders < self.from_orders or not earlier:
            return math.inf
        implied = (d / (float(orders / count) ** self.power - 1.0) for count, d in earlier.items())
        return float(_LAW_MARGIN * max(implied))


#: Curved outlines converge more slowly than corners between straight walls.
_CURVED, _STRAIGHT = PowerLaw(1.5, 7), PowerLaw(2.0, 6)


@dataclass(frozen=True)
class Convergence:
    """What is known of a cell's errors before it is solved."""

    is_measured: bool  #: Whether claims were measured on cells of this kind.
    law: PowerLaw | None  #: Law that the errors follow; None for a dielectric rectangle in a rectangular lattice.
    added_phase_rad: float  #: Phase that the pillar adds to light over its height, rad.
    #: Factor of the floors, at least 1. In the measured range: phase of the vacuum wave over the height, over that of
    #: the silicon pillars. Elsewhere: the added phase over the largest measured one, with a margin.
    floor_growth: float
    claims_margin: float  #: Factor of the claims of measured cells, above 1 where pillars stand close.
    resolving: float  #: Cosines from which every wave in pillar, film and cap is resolved.
    falling: float  #: Cosines from which errors fall.

    def least_error(self, orders: int) -> float:
        """Least bound of a truncation: 1 where it does not resolve the waves, and 0 where errors fall."""
        if orders < self.resolving:
            return 1.0
        return _COARSE_OF_A_RAD * self.added_phase_rad if orders < self.falling else 0.0


def convergence(cell: PillarCell) -> Convergence:
    """Convergence of ``cell``."""
    measured, law, added_phase_rad = is_measured(cell), power_law(cell), _added_phase_rad(cell)
    layers = [max(complex(n).real for n in (each.n_inside, each.n_around)) for each in (*cell.under, *cell.over)]
    wavelengths = max(cell.period_nm) / cell.wavelength_nm
    if measured:
        growth = max(1.0, cell.k0_per_nm * cell.height_nm / _SILICON_PHASE)
    else:
        growth = (_FLOOR_MARGIN if law is None else _LAW_MARGIN) * max(1.0, added_phase_rad / _LARGEST_PHASE)
    return Convergence(
        is_measured=measured,
        law=law,
        added_phase_rad=added_phase_rad,
        floor_growth=growth,
        claims_margin=1.0 + _MARGIN_OF_FULL * max(0.0, _fill(cell) - _FULL),
        resolving=wavelengths * max(_RESOLVED * _densest(cell), _RESOLVED_LAYER * max(layers, default=0.0)),
        falling=wavelengths * _FALLING * _densest(cell) if law is None else 0.0,
    )


def power_law(cell: PillarCell) -> PowerLaw | None:
    """Power law of a cell's convergence; None for a dielectric rectangle in a rectangular lattice."""
    if cell.shape == "ellipse":
        return _CURVED
    is_metal = (complex(cell.n_pillar) ** 2).real < 0.0
    return _STRAIGHT if cell.is_shaped or cell.is_staggered or is_metal else None


def _added_phase_rad(cell: PillarCell) -> float:
    return cell.k0_per_nm * cell.height_nm * abs(complex(cell.n_pillar) - complex(cell.n_ambient))


def _fill(cell: PillarCell) -> float:
    """Larger size over the period."""
    return max(cell.width_nm / cell.period_nm[0], cell.length_nm / cell.period_nm[1])


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
    return (
        cell.angle_deg == 0.0
        and not cell.is_birefringent
        and not (cell.under or cell.over or cell.is_sloped or cell.is_shaped or cell.is_staggered)
        and around.real <= pillar.real <= _STEEPEST * around.real
        and max(pillar.imag / pillar.real, around.imag / around.real) <= _DIMMEST
        and max(cell.period_nm) <= _LONGEST * min(cell.period_nm)
        and _fill(cell) <= _FULLEST
        and _NARROWEST * cell.wavelength_nm <= max(cell.period_nm) * _densest(cell) <= _WIDEST * cell.wavelength_nm
        and cell.height_nm <= _TALLEST * cell.wavelength_nm
        and _added_phase_rad(cell) <= _LARGEST_PHASE
    )
