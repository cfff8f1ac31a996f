"""Target phases + library + rules -> the pillars of the whole lens, tile by tile."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.figures import MappingFigures
from metafab.core.parallel.executor import default_workers, in_order
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import plain
from metafab.layout.aperture import Aperture
from metafab.layout.figures import TileSums
from metafab.layout.gap_rule import allowed_sizes, joint_sizes, neighbour_choice
from metafab.layout.geometry import tile_sites
from metafab.layout.mapping import TileMapping
from metafab.layout.outlines import Outline
from metafab.layout.pillars import PillarMap, PillarTile
from metafab.library import Library, SizeTable
from metafab.library.use.lookup import global_offsets
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design

#: Lattices up to this many sites are kept in memory (2 bytes a site); larger ones are mapped again on each reading.
KEPT_SITES = 1 << 27

# Rows and columns that are sampled to choose the constant phases.
_SAMPLED_LINES = 1000


@dataclass(frozen=True)
class Assignment:
    """The pillars of a lens and how well they follow the target phases."""

    pillars: PillarMap  #: The map.
    figures: MappingFigures  #: Phase error, overlap, transmittance, gap.
    offsets_rad: tuple[float, float]  #: Constants added to the target phases of x and y polarisation.
    #: The figures under ``gap_rule = "each"``, where sizes were chosen jointly; else None.
    gap_rule_each: MappingFigures | None = None

    def to_json(self) -> dict[str, Any]:
        """The figures as they stand in ``summary.json`` and ``layout.json``."""
        each = {} if self.gap_rule_each is None else {"gap_rule_each": self.gap_rule_each}
        table: dict[str, Any] = plain({**plain(self.figures), **each, "offsets_rad": self.offsets_rad})
        return table


def assign(
    profile: PhaseProfile,
    library: Library,
    design: Design,
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
    kept_sites: int = KEPT_SITES,
) -> Assignment:
    """Choose the size of every pillar.

    Each site inside the aperture gets the size whose field overlaps best with its two target phases, among those that
    the gap rule allows (:mod:`metafab.layout.gap_rule`).

    Args:
        library: response of every size.
        design: lattice, aperture, rules, mask grid.
        executor: runs tiles; threads of this process by default. It must stay open while the map of a lens of more than
            ``kept_sites`` sites is read.
        kept_sites: largest lattice that is kept in memory.

    Raises:
        InputError: the library has no size that the rules allow, or lengths do not fit the database unit.
    """
    mapping = mapping_of(profile, library, design)
    table, lattice, corners = mapping.table, mapping.aperture.lattice, mapping.corners()
    kept = math.prod(lattice.shape) <= kept_sites
    whole = np.zeros(lattice.shape if kept else (0, 0), dtype=np.uint16)
    total: TileSums | None = None
    for done, (tile, sums) in enumerate(_mapped(mapping, corners, executor), start=1):
        if kept:
            whole[tile.window] = tile.size_index
        total = sums if total is None else total + sums
        progress("mapping", done, len(corners))
    assert total is not None  # An aperture holds at least one site, and so one tile.

    def tiles() -> Iterator[PillarTile]:
        """Map all tiles again."""
        return (tile for tile, _ in _mapped(mapping, corners, executor))

    if kept:
        pillars = PillarMap.from_array(lattice, table.size_dbu, whole, mapping.tile_sites)
    else:
        pillars = PillarMap(lattice, table.size_dbu, tiles, mapping.tile_sites)
    each = None if total.each is None else total.each.figures(library, table)
    return Assignment(pillars, total.figures(library, table), mapping.offset_rad, each)


def _mapped(
    mapping: TileMapping, corners: list[tuple[int, int]], executor: Executor | None
) -> Iterator[tuple[PillarTile, TileSums]]:
    """Map the tiles in order, on threads of this process by default."""
    with ThreadPoolExecutor(default_workers()) as threads:
        yield from in_order(executor or threads, mapping, corners)


def mapping_of(profile: PhaseProfile, library: Library, design: Design) -> TileMapping:
    """Return the mapping of a design's tiles, with the constant phases that suit the library best.

    Errors as :func:`assign`.
    """
    each = allowed_sizes(library, design)
    aperture = Aperture.of(design)
    joint = joint_sizes(library, design, each, aperture.lattice)
    choice = neighbour_choice(library, design, each)
    offsets = constant_phases(profile, each, aperture)
    table = each if joint is None else joint.table
    return TileMapping(profile, table, aperture, offsets, tile_sites(design), joint, choice, Outline.of(design))


def constant_phases(profile: PhaseProfile, table: SizeTable, aperture: Aperture) -> tuple[float, float]:
    """Constant phases (x, y polarisation) that suit the library best, from a sample of at most a million sites."""
    lattice = aperture.lattice
    rows, columns = _sampled_lines(lattice.shape[0]), _sampled_lines(lattice.shape[1])
    x_um, y_um = lattice.x_um()[columns], lattice.y_um()
    histogram = np.zeros(table.size_index.shape, dtype=np.int64)
    for block in np.array_split(rows, max(1, rows.size // 64)):
        target = profile(x_um, y_um[block])
        inside = aperture.at(block, columns)
        histogram += table.histogram(target[0][inside], target[1][inside])
    return global_offsets(table, histogram)


def _sampled_lines(count: int) -> NDArray[np.int64]:
    """Up to :data:`_SAMPLED_LINES` of ``count`` lines, a golden-ratio sequence: even, without a period."""
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    return np.unique((np.arange(1, _SAMPLED_LINES + 1) * golden % 1.0 * count).astype(np.int64))
