"""One unit cell under a plane wave: a PillarCell in, a CellResponse (Jones t and r, error) out.

- ``response``     what every solver is asked and answers
- ``problem``      from a unit-cell spec to cells, and the calls that solve one or many
- ``fresnel``      closed forms: interface and film, in the same planes and types
- ``halfspace``    plane waves of a birefringent substrate
- ``supercell``    unlike pillars in one period: what is asked, answered, and predicted from each alone
- ``rcwa``         the Fourier modal method, certified
- ``meep``         the real Meep (FDTD) as a separate program
"""

from metafab.cell.problem import is_square, pillar_cell, solve, solve_many
from metafab.cell.response import CellNumerics, CellResponse, CellSolver, PillarCell, Slice

__all__ = [
    "CellNumerics",
    "CellResponse",
    "CellSolver",
    "PillarCell",
    "Slice",
    "is_square",
    "pillar_cell",
    "solve",
    "solve_many",
]
