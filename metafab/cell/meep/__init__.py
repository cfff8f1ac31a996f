"""FDTD of unit cells and supercells by Meep, a separate program in an interpreter of its own.

- ``finding``         interpreters with the FDTD Meep, each proved by a probe
- ``protocol``        jobs, and one worker process that runs them
- ``pool``            long-lived workers, and finished runs on disk
- ``stretched_axes``  stretched axes with every wall on nodes of the grid
- ``grid``            cell -> job on such axes or on plain ones; recorded fields -> t and r
- ``shaped``          curved outlines, crosses, sloped walls, films and caps on plain axes
- ``solver``          one cell: PillarCell in, CellResponse out; the limit of vanishing pixels, and its error
- ``supercell``       unlike pillars in one period: Supercell in, SupercellResponse out

The worker program is ``metafab/cell/meep_worker.py``, the only file that imports meep.
"""

from typing import TYPE_CHECKING

from metafab.cell.meep.finding import MeepCandidate, find
from metafab.cell.meep.pool import Pool
from metafab.cell.meep.solver import MeepDetails, MeepSettings, solve
from metafab.cell.meep.supercell import SupercellSettings, estimate, solve_supercell
from metafab.core.further import further_names

__all__ = [
    "solve",
    "MeepSettings",
    "MeepDetails",
    "solve_supercell",
    "SupercellSettings",
    "estimate",
    "Pool",
    "find",
    "MeepCandidate",
]

if not TYPE_CHECKING:
    __getattr__ = further_names(__name__, {"metafab.cell.problem": "solve_many"})
