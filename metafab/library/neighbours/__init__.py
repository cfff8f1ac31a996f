"""Effect of unlike neighbours on the field of each pillar: chains of coupled modes, trained on solved rows of pillars.

- ``line``        a chain of coupled modes and its parameters
- ``solve``       field of closed chains, and its derivatives by the parameters
- ``rows``        training rows, and their solution
- ``doubt``       stated error of a row, from what is known of it without a solver
- ``training``    a library in, its :class:`Neighbours` out
- ``model``       :class:`Neighbours`: the chains of all directions and polarisations, with their errors
- ``mask``        field of the pillars of a mask, and sizes chosen for it
- ``blocks``      joint effect of rows and columns: solved, or by chains that are coupled across their lines
- ``evaluation``  :func:`solve_supercell`: transmitted orders of rows and blocks
- ``storage``     chains in the file of a library
"""

from metafab.core.figures import LineStatistics
from metafab.library.neighbours.blocks.joint import has_joint_effect
from metafab.library.neighbours.evaluation import joint_share, require_neighbours, solve_supercell
from metafab.library.neighbours.model import Neighbours, TrainedLine

__all__ = [
    "LineStatistics",
    "Neighbours",
    "TrainedLine",
    "has_joint_effect",
    "joint_share",
    "require_neighbours",
    "solve_supercell",
]
