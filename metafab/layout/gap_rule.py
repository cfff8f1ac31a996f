"""The gap rule: the sizes that the rules of a design allow. It is applied here and nowhere else in the mapping.

``rules.min_gap_nm`` is the smallest gap between drawn pillars; with ``mask.bias_nm`` it becomes
``Design.min_spacing_nm``, the smallest gap between standing ones. ``rules.gap_rule`` chooses how it is kept:

- "each": by every pillar alone. :func:`allowed_sizes` limits width and length to :func:`largest_sides_nm`, so that any
  two pillars may be neighbours; turned pillars (:mod:`metafab.layout.turned`) keep their extent within it.
- "pairs": by each pair of neighbours. :func:`joint_sizes` admits larger pillars, and :mod:`metafab.layout.joint`
  chooses sizes that keep the gap.

Gaps are measured by :mod:`metafab.layout.gaps`, and :mod:`metafab.drc` checks the rule on the written file.
"""

from __future__ import annotations

import numpy as np

from metafab.core.errors import InputError
from metafab.layout.joint import JointSizes
from metafab.layout.outlines import Outline
from metafab.layout.pillars import Lattice
from metafab.library import Library, SizeTable, build_size_table
from metafab.library.neighbours.mask.choice import NeighbourChoice
from metafab.spec import Design


def largest_sides_nm(design: Design) -> tuple[float, float]:
    """Return the largest extent of a pillar along x and y that leaves the gap to an equal neighbour."""
    p_x, p_y = design.unit_cell.cell.period_nm
    return p_x - design.min_spacing_nm, p_y - design.min_spacing_nm


def allowed_sizes(library: Library, design: Design) -> SizeTable:
    """Return the look-up table of the sizes that are allowed at every site, whatever the neighbours.

    A library without such a size raises InputError.
    """
    return _sizes_up_to(largest_sides_nm(design), library, design)


def _sizes_up_to(largest_nm: tuple[float, float], library: Library, design: Design, cells: int = 512) -> SizeTable:
    """Look-up table of the sizes up to a width and a length."""
    return build_size_table(
        library,
        database_unit_nm=design.mask.database_unit_nm,
        max_width_nm=largest_nm[0],
        max_length_nm=largest_nm[1],
        min_feature_nm=design.min_side_nm,
        cells=cells,
        cd_sigma_nm=design.rules.cd_sigma_nm,
        isotropic=design.rules.polarisation_independent,
    )


def neighbour_choice(library: Library, design: Design, each: SizeTable) -> NeighbourChoice | None:
    """Return the choice of sizes for their light among neighbours, if ``rules.neighbours`` asks for it.

    ``each`` holds the sizes of :func:`allowed_sizes`. A library without a model of neighbours raises InputError.
    """
    if not design.rules.neighbours:
        return None
    if library.neighbours is None:
        expected, got = "a library with a model of neighbours", "pillars among equal ones only"
        remedy = "add [neighbours] to the unit cell, or leave it out"
        raise InputError.single(design.name, "rules.neighbours", expected, got, remedy)
    size_nm = np.multiply(each.size_dbu, each.database_unit_nm, dtype=np.float64)
    return NeighbourChoice.of(library.neighbours, size_nm, each.t)


def joint_sizes(library: Library, design: Design, each: SizeTable, lattice: Lattice) -> JointSizes | None:
    """Return the joint choice for ``gap_rule = "pairs"``; None if the rule is "each" or no size is larger.

    ``each`` holds the sizes of :func:`allowed_sizes`, which are allowed at every site of the lattice.
    """
    if design.rules.gap_rule != "pairs":
        return None
    p_x, p_y = design.unit_cell.cell.period_nm

    def largest_nm(period_nm: float) -> float:
        """Largest side that leaves the gap next to the smallest pillar and does not exceed the cell."""
        return min(period_nm, 2.0 * (period_nm - design.min_spacing_nm) - design.min_side_nm)

    wide = _sizes_up_to((largest_nm(p_x), largest_nm(p_y)), library, design, cells=2)
    if len(wide.size_dbu) == len(each.size_dbu):
        return None
    gap_dbu = design.min_spacing_nm / design.mask.database_unit_nm
    return JointSizes.of(wide, each, lattice, gap_dbu, Outline.of(design))
