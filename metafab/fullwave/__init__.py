"""Unlike neighbours: pieces of the written mask by full-wave solvers, against the library's local-period approximation.

- ``written``   pillars of a mask around a place -> Supercell
- ``coupling``  rows of one local period, by RCWA and by Meep: what the approximation misses; ``coupling.json``
- ``patch``     a square patch by Meep: its field behind the pillars beside the library's; ``patch.h5``

In: a :class:`~metafab.layout.pillars.PillarMap` read back from a mask, its :class:`~metafab.library.library.Library`.
Out: a :class:`Coupling`, which the error budget quotes, or a :class:`Patch`, which the report shows.
"""

from metafab.fullwave.coupling import Coupling, CouplingRow, load_coupling, measure_coupling, save_coupling
from metafab.fullwave.patch import PATCH_DECAY, Patch, PatchPlan, load_patch, plan_patch, save_patch, solve_patch
from metafab.fullwave.written import line_at, local_period_sites, supercell_at

__all__ = [
    "PATCH_DECAY",
    "Coupling",
    "CouplingRow",
    "Patch",
    "PatchPlan",
    "line_at",
    "load_coupling",
    "load_patch",
    "local_period_sites",
    "measure_coupling",
    "plan_patch",
    "save_coupling",
    "save_patch",
    "solve_patch",
    "supercell_at",
]
