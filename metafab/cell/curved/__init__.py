"""Ellipses, rings and rounded rectangles by spectral elements along their outlines: PillarCell in, CellResponse out.

- ``mesh``       a quarter of the cell as curved quadrilaterals, and the cells that have one
- ``functions``  the functions of the field, their numbers and their values
- ``layers``     Jones matrices at one polynomial order
- ``solve``      adaptive order, the bound on the error, and efficiencies of single orders
- ``supercell``  layers of unlike pillars in one period
"""

from metafab.cell.curved.layers import zero_order
from metafab.cell.curved.mesh import is_treated, untreated
from metafab.cell.curved.solve import CurvedDetails, solve

__all__ = ["CurvedDetails", "is_treated", "solve", "untreated", "zero_order"]
