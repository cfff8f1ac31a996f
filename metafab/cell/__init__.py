"""One unit cell under a plane wave: a PillarCell in, a CellResponse (Jones matrices t and r, and their error) out.

- ``pillar``       the cell: pillar, layers, half spaces, light
- ``fresnel``      closed forms of interfaces, films and birefringent half spaces
- ``response``     numerics and result that all solvers share
- ``validation``   faults of cells and numerics
- ``problem``      unit-cell spec -> cells; solves one cell or many
- ``open_orders``  orders that leave a cell besides the zero order, and their share of the light
- ``starting``     a unit cell to start from, by rules of thumb and a search for the height
- ``supercell``    unlike pillars in one period, and the prediction of the local-period approximation
- ``rcwa``         the Fourier modal method with a bound on its error
- ``elements``     supercells by spectral elements and plane waves
- ``curved``       ellipses, rings and rounded rectangles by spectral elements
- ``meep``         FDTD by Meep, a separate program
- ``meep_worker``  the program that runs Meep
"""

from metafab.cell.pillar import PillarCell, Slice
from metafab.cell.problem import is_square, pillar_cell, solve, solve_many
from metafab.cell.response import CellNumerics, CellResponse, CellSolver

__all__ = [
    "solve",
    "pillar_cell",
    "PillarCell",
    "CellNumerics",
    "CellResponse",
    "solve_many",
    "is_square",
    "Slice",
    "CellSolver",
]
