"""Cost of a layout, from a sample of its tiles: seconds, bytes, core-hours."""

from __future__ import annotations

import io
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

from metafab.core.parallel.executor import default_workers
from metafab.layout import Aperture, Outline, PillarMap, PillarTile, lattice_of
from metafab.layout.assign import KEPT_SITES, mapping_of
from metafab.layout.mapping import LightTarget
from metafab.library import Library
from metafab.mask.drawing.cell_writer import MaskWriter
from metafab.mask.drawing.stamps import Stamps, shapes_per_pillar
from metafab.mask.gdsii.writer import BOUNDARY_WORDS, REFERENCE_WORDS
from metafab.mask.write import WRITERS, biased, drawing_of
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design

#: GDSII has no limit of its own, but many readers count bytes in 32 bits.
GDSII_COMFORT_BYTES = 2**31

#: Tiles that are mapped for the estimate of a whole mask.
_SAMPLED_TILES = 16


@dataclass(frozen=True)
class LayoutPlan:
    """Expected cost of a layout."""

    pillars: int  #: Number of pillars.
    tiles: int  #: Number of tiles.
    sampled_tiles: int  #: Number of tiles that were mapped and encoded for the estimate.
    mappings: int  #: Number of times that every tile is mapped.
    seconds: dict[str, float]  #: Time on ``workers`` cores, by step: "preparing", "mapping" and each format.
    core_hours: float  #: Sum over the steps that the cores share.
    bytes: dict[str, int]  #: Size of each file, by format.
    workers: int  #: Number of cores.
    advice: list[str]  #: Sentences for the user.


def plan(
    profile: PhaseProfile,
    library: Library,
    design: Design,
    workers: int | None = None,
    *,
    lights: Sequence[LightTarget] = (),
    kept_sites: int = KEPT_SITES,
) -> LayoutPlan:
    """Map and encode a sample of tiles, and extrapolate to the whole lens, of any size.

    Args:
        workers: cores that share the work, each as fast as one of this machine; None for the cores of this machine.
        lights: as for :func:`metafab.layout.assign`.
        kept_sites: largest lattice that :func:`metafab.layout.assign` keeps in memory.
    """
    workers, mappings = workers or default_workers(), _mappings(design, kept_sites)
    start = time.perf_counter()
    mapping = mapping_of(profile, library, design, lights)
    table, aperture = mapping.table, mapping.aperture
    corners = mapping.corners()
    # Evenly through the list: rim and centre, all rows of tiles alike. The first is mapped twice, to warm up.
    count = min(_SAMPLED_TILES, len(corners))
    sampled = [corners[(2 * k + 1) * len(corners) // (2 * count)] for k in range(count)]
    mapping(sampled[0])
    prepared = time.perf_counter() - start

    mapping_start = time.perf_counter()
    tiles = [mapping(corner) for corner in sampled]
    mapping_seconds = time.perf_counter() - mapping_start
    share = sum(sums.pillars for _, sums in tiles) / aperture.count
    seconds = {"preparing": prepared, "mapping": mappings * mapping_seconds / share / workers}
    sizes: dict[str, int] = {}
    sample = PillarMap(aperture.lattice, table.size_dbu, lambda: (tile for tile, _ in tiles), mapping.tile_sites)
    stamps = Stamps(biased(sample, design.mask.bias_nm), design)
    for suffix in design.mask.formats:
        writer = WRITERS[suffix](io.BytesIO(), drawing_of(aperture.lattice, design, stamps.copies))
        _encoded_bytes(writer, stamps, tiles[0][0])
        encoding_start = time.perf_counter()
        encoded = sum(_encoded_bytes(writer, stamps, tile) for tile, _ in tiles)
        seconds[suffix] = (time.perf_counter() - encoding_start) / share / workers
        sizes[suffix] = round(encoded / share)
    return LayoutPlan(
        pillars=aperture.count,
        tiles=len(corners),
        sampled_tiles=count,
        mappings=mappings,
        seconds=seconds,
        core_hours=(sum(seconds.values()) - prepared) * workers / 3600.0,
        bytes=sizes,
        workers=workers,
        advice=_advice(sizes),
    )


def _mappings(design: Design, kept_sites: int) -> int:
    """Number of mappings of a tile: a lens that is not kept is mapped for its figures and again for each reading."""
    if math.prod(lattice_of(design).shape) <= kept_sites:
        return 1
    dose = design.mask.dose
    return 3 if dose is not None and dose.by in {"size", "density"} else 2


def _encoded_bytes(writer: MaskWriter, stamps: Stamps, tile: PillarTile) -> int:
    """Bytes of all shapes on the sites of a tile."""
    return sum(piece.size for cell in writer.encoder(stamps.of(tile)) for piece in cell.content)


def announcement(design: Design) -> list[str]:
    """Warn before a mask is written whose GDSII file would be larger than most readers take.

    Nothing is mapped for it: every pillar is a BOUNDARY of 64 bytes (shapes other than rectangles: a reference of 40),
    once for each bias of ``mask.copies`` (in a flat mask for each copy), and an inverted field adds four per pillar.
    """
    if "gds" not in design.mask.formats:
        return []
    words = BOUNDARY_WORDS if Outline.of(design).is_rectangle else REFERENCE_WORDS
    return _advice({"gds": Aperture.of(design).count * shapes_per_pillar(design) * words * 4})


def _advice(sizes: dict[str, int]) -> list[str]:
    if sizes.get("gds", 0) <= GDSII_COMFORT_BYTES:
        return []
    text = f"layout.gds would have {sizes['gds'] / 1e9:.1f} GB, more than many GDSII readers take (2.1 GB)"
    return [f"{text}; write 'oas' (set mask.formats = [\"oas\"])"]
