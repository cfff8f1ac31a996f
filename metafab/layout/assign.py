"""Target phases + library + rules -> pillars, tile by tile."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray, power_transmittance
from metafab.core.parallel.executor import default_workers, in_order
from metafab.core.parallel.progress import Progress, silent
from metafab.layout.aperture import Aperture
from metafab.layout.figures import TileFigures
from metafab.layout.geometry import tile_sites
from metafab.layout.mapping import Mapping
from metafab.layout.neighbours import JointSizes
from metafab.layout.outlines import Outline
from metafab.layout.pillars import Lattice, PillarMap, PillarTile
from metafab.library import Library, SizeTable, build_size_table, global_offsets
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design

#: Lattices up to this many sites are kept (2 bytes a site); larger ones are mapped again on each reading.
KEPT_SITES = 1 << 27

# Rows and columns that are sampled to choose the constant phases.
_SAMPLED_LINES = 1000


@dataclass(frozen=True)
class Assignment:
    """The pillars of a lens and how well they follow the target.

    Attributes:
        pillars: the map.
        figures: ``pillars``, ``distinct_sizes``, ``min_gap_nm`` (None of a single pillar), ``phase_rms_error_rad``
            (both polarisations, after the constant phases ``offsets_rad``), ``mean_transmittance`` (power),
            ``field_overlap`` = |<target, t>|^2 / (<target, target> <t, t>), ``efficiency`` (transmittance times
            overlap: power in the wanted wave), means of both polarisations, and each with suffix _x, _y;
            ``offsets_rad``.
    """

    pillars: PillarMap
    figures: dict[str, Any]


def assign(
    profile: PhaseProfile,
    library: Library,
    design: Design,
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Assignment:
    """Choose the size of every pillar.

    Each site inside the aperture (:mod:`metafab.layout.aperture`) gets the size whose field overlaps best with
    its two target phases. With ``rules.gap_rule`` "each", widths and lengths are limited to the period less the
    smallest gap, so that no pair of neighbours can come closer; with "pairs", sizes are chosen jointly
    (:mod:`metafab.layout.neighbours`), and the figures hold those of "each" as ``gap_rule_each``.

    Args:
        profile: target phases.
        library: response of every size.
        design: lattice, aperture, rules, mask grid.
        executor: runs tiles; threads of this process unless given. It must stay open while the map of a lens of more
            than :data:`KEPT_SITES` sites is read.
        progress: told about tiles.

    Raises:
        InputError: the library has no size that the rules allow, or lengths do not fit the database unit.
    """
    mapping = mapping_of(profile, library, design)
    table, lattice = mapping.table, mapping.aperture.lattice
    kept = lattice.shape[0] * lattice.shape[1] <= KEPT_SITES
    whole = np.zeros(lattice.shape if kept else (0, 0), dtype=np.uint16)
    total: list[TileFigures] = []
    places = mapping.places()
    with ThreadPoolExecutor(default_workers()) as threads:
        for done, (tile, figures) in enumerate(in_order(executor or threads, mapping, places), start=1):
            if kept:
                n_y, n_x = tile.size_index.shape
                whole[tile.row : tile.row + n_y, tile.column : tile.column + n_x] = tile.size_index
            total = [reduce(add, [*total, figures])]
            progress("mapping", done, len(places))

    if kept:
        pillars = PillarMap.from_array(lattice, table.size_dbu, whole, mapping.tile_sites)
    else:

        def tiles() -> Iterator[PillarTile]:
            with ThreadPoolExecutor(default_workers()) as threads:
                for tile, _ in in_order(executor or threads, mapping, places):
                    yield tile

        pillars = PillarMap(lattice, table.size_dbu, tiles, mapping.tile_sites)
    summary = _summary(total[0], library, table)
    if total[0].plain is not None:
        summary["gap_rule_each"] = _summary(total[0].plain, library, table)
    return Assignment(pillars, {**summary, "offsets_rad": mapping.offset_rad})


def mapping_of(profile: PhaseProfile, library: Library, design: Design) -> Mapping:
    """What maps a design's tiles, with the constant phases that suit the library best.

    Raises:
        InputError: as :func:`assign`.
    """
    table = allowed_sizes(library, design)
    aperture = Aperture.of(design)
    joint = _joint(library, design, table, aperture.lattice) if design.rules.gap_rule == "pairs" else None
    offsets = constant_phases(profile, table, aperture)
    sizes = table if joint is None else joint.table
    return Mapping(profile, sizes, aperture, offsets, tile_sites(design), joint, Outline.of(design))


def allowed_sizes(library: Library, design: Design) -> SizeTable:
    """The look-up table of the sizes that the design's rules allow at every site, whatever its neighbours."""
    p_x, p_y = design.unit_cell.cell.period_nm
    gap_nm = design.min_spacing_nm
    return build_size_table(
        library,
        database_unit_nm=design.mask.database_unit_nm,
        max_width_nm=p_x - gap_nm,
        max_length_nm=p_y - gap_nm,
        min_feature_nm=design.min_side_nm,
        cd_sigma_nm=design.rules.cd_sigma_nm,
        isotropic=design.rules.polarisation_independent,
    )


def _joint(library: Library, design: Design, plain: SizeTable, lattice: Lattice) -> JointSizes | None:
    """The joint choice; None where the library has no size that needs it."""
    gap_nm = design.min_spacing_nm
    wide = build_size_table(
        library,
        database_unit_nm=design.mask.database_unit_nm,
        # Beside the smallest pillar there is room for one this large, which must not leave its cell.
        **{
            name: min(period_nm, 2.0 * (period_nm - gap_nm) - design.min_side_nm)
            for name, period_nm in zip(("max_width_nm", "max_length_nm"), design.unit_cell.cell.period_nm, strict=True)
        },
        min_feature_nm=design.min_side_nm,
        cells=2,
        cd_sigma_nm=design.rules.cd_sigma_nm,
        isotropic=design.rules.polarisation_independent,
    )
    if len(wide.size_dbu) == len(plain.size_dbu):
        return None
    return JointSizes.of(wide, plain, lattice, gap_nm / design.mask.database_unit_nm, Outline.of(design))


def constant_phases(profile: PhaseProfile, table: SizeTable, aperture: Aperture) -> tuple[float, float]:
    """The constant phases (x, y polarisation) that suit the library best, from a sample of at most a million sites."""
    lattice = aperture.lattice
    rows, columns = (_spread(count) for count in lattice.shape)
    x_um, y_um = lattice.x_um()[columns], lattice.y_um()
    histogram = np.zeros(table.size_index.shape, dtype=np.int64)
    for block in np.array_split(rows, max(1, rows.size // 64)):
        target = profile(x_um, y_um[block])
        inside = aperture.at(block, columns)
        histogram += table.histogram(target[0][inside], target[1][inside])
    return global_offsets(table, histogram)


def _spread(count: int) -> NDArray[np.int64]:
    """Up to :data:`_SAMPLED_LINES` of ``count`` lines, by the golden ratio: even, and in step with no grating."""
    golden = (np.sqrt(5.0) - 1.0) / 2.0
    return np.unique((np.arange(1, _SAMPLED_LINES + 1) * golden % 1.0 * count).astype(np.int64))


def _summary(sums: TileFigures, library: Library, table: SizeTable) -> dict[str, Any]:
    from metafab.cell import pillar_cell

    cell = pillar_cell(library.unit_cell, 0.0, 0.0)
    overlap = np.abs(sums.overlap) ** 2 / (sums.pillars * sums.power)
    transmittance = np.array(
        [
            power_transmittance(np.sqrt(power / sums.pillars), n_in, n_out)
            for power, n_in, n_out in zip(sums.power, cell.n_in, cell.n_out, strict=True)
        ]
    )
    return {
        "pillars": sums.pillars,
        "distinct_sizes": int(np.count_nonzero(sums.used[1:])),
        "min_gap_nm": sums.smallest_gap_dbu * table.database_unit_nm if np.isfinite(sums.smallest_gap_dbu) else None,
        "phase_rms_error_rad": float(np.sqrt(sums.square_error.sum() / (2 * sums.pillars))),
        **_both("mean_transmittance", transmittance),
        **_both("field_overlap", overlap),
        **_both("efficiency", transmittance * overlap),
    }


def _both(name: str, values: FloatArray) -> dict[str, float]:
    """The mean of both polarisations and each of them."""
    return {name: float(values.mean()), f"{name}_x": float(values[0]), f"{name}_y": float(values[1])}
