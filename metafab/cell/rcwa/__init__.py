"""Rigorous coupled-wave analysis of a pillar: a PillarCell in, a certified CellResponse out.

From one axis to the answer:

- ``coordinates``    the map x(u) that gathers resolution at the walls, integrals in closed form
- ``basis``          one axis in a truncated basis: wave numbers and overlaps with the pillar; parity
- ``transverse``     coefficients of a symmetry class, paired and turned to TM and TE
- ``factorisation``  Maxwell's equations of the layer as two matrices, by Li's rules
- ``staggered``      the same for a hexagonal lattice
- ``cross_section``  crosses, ellipses and rounded corners as nested rectangles
- ``nested``         the same for nested rectangles
- ``eigenmodes``     modes of the layer, plane waves of the half spaces
- ``birefringence``  plane waves of a birefringent half space
- ``doubling``       one incident wave through the layer by doubling thickness: the fast way, tested as it goes
- ``admittance``     the same by modes, stable for any height
- ``conditioning``   how ill-conditioned the modes are
- ``outlines``       one axis for layers of unlike outlines
- ``stack``          the same through several layers, by doubled slabs or by modes
- ``slicing``        a sloped pillar as the limit of thin steps, and its error
- ``jones``          Jones matrices at one truncation
- ``certificate``    truncation raised until the error is what was asked
- ``extrapolation``  the limit of plain harmonics: an independent check
- ``diffraction``    efficiencies of single orders
- ``row``            a row of unlike pillars, by one map over all their walls
- ``cost``           seconds that an answer takes here, by a measured curve
- ``derivatives``    dt, dr by sizes, height and index, by reciprocity
"""

from metafab.cell.rcwa.basis.axis import Formulation
from metafab.cell.rcwa.certificate import solve
from metafab.cell.rcwa.cost import seconds_estimate
from metafab.cell.rcwa.derivatives import PillarDerivatives, derivatives
from metafab.cell.rcwa.diffraction import (
    DiffractedOrder,
    Diffraction,
    diffraction,
    diffracts,
    efficiencies,
    propagating_orders,
)
from metafab.cell.rcwa.extrapolation import FourierLimit, fourier_limit
from metafab.cell.rcwa.jones import ZeroOrder, zero_order

__all__ = [
    "DiffractedOrder",
    "Diffraction",
    "Formulation",
    "FourierLimit",
    "PillarDerivatives",
    "ZeroOrder",
    "derivatives",
    "diffraction",
    "diffracts",
    "efficiencies",
    "fourier_limit",
    "propagating_orders",
    "seconds_estimate",
    "solve",
    "zero_order",
]
