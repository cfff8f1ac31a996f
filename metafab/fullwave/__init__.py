"""Full-wave solutions of pieces of the written mask, compared with the library's local-period approximation.

- ``blocks``    supercells of a file by the model of neighbours, RCWA, Meep or the local-period approximation
- ``record``    file of solved blocks that a stopped solution leaves
- ``repeats``   orders of a mask whose pattern repeats
- ``written``   pillars of a mask around a place -> Supercell
- ``coupling``  rows of one local period by RCWA and Meep: error of the approximation; ``coupling.json``
- ``patch``     a square patch by Meep: its field compared with the library's; ``patch.h5``

In: a :class:`~metafab.layout.pillars.PillarMap` read back from a mask, and its
:class:`~metafab.library.library.Library`. Out: a :class:`Coupling` for the error budget, or a :class:`Patch` for the
report.
"""

from typing import TYPE_CHECKING

from metafab.core.further import further_names
from metafab.fullwave.coupling import Coupling, CouplingNumerics, load_coupling, measure_coupling, save_coupling
from metafab.fullwave.patch import Patch, load_patch, plan_patch, save_patch, solve_patch
from metafab.fullwave.written import supercell_at

__all__ = [
    "measure_coupling",
    "Coupling",
    "CouplingNumerics",
    "plan_patch",
    "solve_patch",
    "Patch",
    "supercell_at",
    "load_coupling",
    "save_coupling",
    "load_patch",
    "save_patch",
]

if not TYPE_CHECKING:
    __getattr__ = further_names(
        __name__,
        {
            "metafab.fullwave.coupling": "CouplingRow",
            "metafab.fullwave.patch": "PATCH_DECAY PatchPlan",
            "metafab.fullwave.written": "line_at local_period_sites",
        },
    )
