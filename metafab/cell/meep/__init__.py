"""Unit cells by FDTD: drives the real Meep, a separate program in an interpreter of its own.

- ``finding``        which interpreter has the FDTD Meep, proved by a probe; what to install
- ``protocol``       one worker process: jobs, time limits, a sure end
- ``pool``           long-lived workers, one a core
- ``kept``           finished runs on disk by content hash, so that nothing is run twice
- ``coordinates``    stretched axes that put every wall on nodes of the grid
- ``grid``           a cell on such axes -> the worker's job
- ``deembedding``    recorded fields -> t and r in the planes of the conventions
- ``extrapolation``  several resolutions -> limit and error
- ``solver``         all of it for one cell, or many
- ``supercell``      unlike pillars in one period, and each alone on the same grid

In: a :class:`metafab.cell.response.PillarCell` at normal incidence, or a :class:`metafab.cell.supercell.Supercell`.
Out: its CellResponse or SupercellResponse. The program itself is ``metafab/cell/meep_worker.py``, the only file that
imports meep.
"""

from metafab.cell.meep.finding import MeepCandidate, find
from metafab.cell.meep.pool import Pool
from metafab.cell.meep.solver import MeepSettings, solve, solve_many
from metafab.cell.meep.supercell import SupercellSettings, estimate, solve_supercell

__all__ = [
    "MeepCandidate",
    "MeepSettings",
    "Pool",
    "SupercellSettings",
    "estimate",
    "find",
    "solve",
    "solve_many",
    "solve_supercell",
]
