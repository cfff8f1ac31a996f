"""Rigorous coupled-wave analysis (Fourier modal method): a PillarCell in, a CellResponse with a bound on its error out.

- ``basis``        one axis and one symmetry class in a truncated basis
- ``layers``       Maxwell's equations of a layer as matrices, by Li's factorisation rules
- ``scattering``   one incident wave through one layer or several
- ``symmetry``     symmetry classes of a cell, with their layers and outer waves
- ``jones``        Jones matrices at one truncation
- ``slicing``      a sloped pillar as the limit of thin steps
- ``convergence``  how a cell's errors fall with the number of cosines
- ``certificate``  adaptive truncation, and the bound on the error
- ``diffraction``  efficiencies of single orders
- ``derivatives``  derivatives by sizes, height and index
"""

from typing import TYPE_CHECKING

from metafab.cell.rcwa.certificate import RcwaDetails, solve
from metafab.cell.rcwa.diffraction import diffraction, diffracts, efficiencies, propagating_orders
from metafab.cell.rcwa.jones import zero_order
from metafab.core.further import further_names

__all__ = [
    "solve",
    "zero_order",
    "diffraction",
    "diffracts",
    "efficiencies",
    "propagating_orders",
    "RcwaDetails",
]

if not TYPE_CHECKING:
    __getattr__ = further_names(
        __name__,
        {
            "metafab.cell.rcwa.diffraction": "DiffractedOrder Diffraction",
            "metafab.cell.rcwa.jones": "ZeroOrder",
            "metafab.cell.rcwa.basis.coordinates": "Formulation",
        },
    )
