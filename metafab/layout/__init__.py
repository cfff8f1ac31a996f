"""Target phases + Library + rules -> PillarMap, tile by tile.

- ``pillars``   Lattice, PillarTile, PillarMap: pillars as integers
- ``geometry``  a design's lattice, write fields and tiles in whole database units
- ``sampling``  sites for target phases alone, without a mask
- ``aperture``  which sites carry a pillar
- ``outlines``  what a pillar of a size is drawn as
- ``gaps``      distances between neighbours, diagonals included
- ``candidates``, ``neighbours``  sizes chosen jointly, where pairs of neighbours must keep the gap
- ``figures``   how well chosen sizes follow their targets
- ``mapping``   one tile: the best sizes
- ``assign``    the whole lens

In: a PhaseProfile, a Library and a Design. Out: an Assignment, the PillarMap and its figures.
"""

from metafab.layout.aperture import Aperture
from metafab.layout.assign import Assignment, assign
from metafab.layout.gaps import Gaps, smallest_gap
from metafab.layout.geometry import field_sites, lattice_of, tile_sites
from metafab.layout.outlines import Outline
from metafab.layout.pillars import Lattice, PillarMap, PillarTile
from metafab.layout.sampling import sampling_lattice

__all__ = [
    "Aperture",
    "Assignment",
    "Gaps",
    "Lattice",
    "Outline",
    "PillarMap",
    "PillarTile",
    "assign",
    "field_sites",
    "lattice_of",
    "sampling_lattice",
    "smallest_gap",
    "tile_sites",
]
