"""Target phases and a library -> the size of every pillar, tile by tile.

In: a :class:`~metafab.phase.PhaseProfile`, a :class:`~metafab.library.Library` and a :class:`~metafab.spec.Design`.
Out: an :class:`Assignment`, which holds the :class:`PillarMap` and its figures.

- ``pillars``: lattice, tiles and map of the pillars, in whole database units
- ``geometry``: lattice, write fields and tiles of a design
- ``aperture``: the sites that carry a pillar
- ``outlines``: polygon of a pillar, and distance between two pillars
- ``gap_rule``: the sizes that ``rules.min_gap_nm`` allows; the gap rule is applied here
- ``joint``: sizes chosen jointly, so that each pair of neighbours keeps the gap
- ``gaps``: distances between neighbouring pillars
- ``figures``: phase error, field overlap and efficiency of the chosen sizes
- ``mapping``: the sizes of one tile
- ``assign``: the sizes of the whole lens
- ``turned``: size and angle of turned pillars, and their outlines
"""

from typing import TYPE_CHECKING

from metafab.core.further import further_names
from metafab.layout.aperture import Aperture
from metafab.layout.assign import Assignment, assign
from metafab.layout.gaps import smallest_gap
from metafab.layout.geometry import field_sites, lattice_of, sampling_lattice, tile_sites
from metafab.layout.outlines import Outline
from metafab.layout.pillars import Lattice, PillarMap, PillarTile

__all__ = [
    "assign",
    "Assignment",
    "PillarMap",
    "Lattice",
    "lattice_of",
    "Outline",
    "Aperture",
    "PillarTile",
    "smallest_gap",
    "sampling_lattice",
    "field_sites",
    "tile_sites",
]

if not TYPE_CHECKING:
    __getattr__ = further_names(__name__, {"metafab.layout.gaps": "Gaps", "metafab.layout.mapping": "LightTarget"})
