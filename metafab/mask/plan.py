"""What a layout will cost, from a sample of its tiles: seconds, bytes, core-hours."""

from __future__ import annotations

import io
import math
import time
from typing import Any

from metafab.core.parallel.executor import default_workers
from metafab.layout import Aperture, Outline, PillarMap, PillarTile, lattice_of
from metafab.layout.assign import KEPT_SITES, mapping_of
from metafab.library import Library
from metafab.mask.drawing.cell_writer import MaskWriter
from metafab.mask.drawing.stamps import Stamps, shapes_per_pillar
from metafab.mask.gdsii.writer import BOUNDARY_WORDS, REFERENCE_WORDS
from metafab.mask.write import WRITERS, biased, drawing_of
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design

#: GDSII has no limit of its own, but many readers count bytes in 32 bits.
GDSII_COMFORT_BYTES = 2**31

_SAMPLED_TILES = 16


def plan(profile: PhaseProfile, library: Library, design: Design, workers: int | None = None) -> dict[str, Any]:
    """Map and encode a sample of tiles and extrapolate to the whole lens, of any size.

    Args:
        profile: target phases.
        library: response of every size.
        design: the lens.
        workers: cores that share the work, each as fast as one of this machine; its own unless given.

    Returns:
        ``pillars``, ``tiles``, ``sampled_tiles``, ``mappings`` (how often every tile is mapped), ``seconds`` (on
        ``workers`` cores, by step), ``core_hours``, ``bytes`` by format, ``workers``, and ``advice``, a list of
        sentences.
    """
    workers, mappings = workers or default_workers(), _mappings(design)
    start = time.perf_counter()
    mapping = mapping_of(profile, library, design)
    table, aperture = mapping.table, mapping.aperture
    places = mapping.corners()
    # Evenly through the list: rim and centre, all rows of tiles alike. The first is mapped twice, to warm up.
    count = min(_SAMPLED_TILES, len(places))
    chosen = [places[(2 * k + 1) * len(places) // (2 * count)] for k in range(count)]
    mapping(chosen[0])
    prepared = time.perf_counter() - start

    tiles, mapping_seconds = [], -time.perf_counter()
    for place in chosen:
        tiles.append(mapping(place))
    mapping_seconds += time.perf_counter()
    share = sum(figures.pillars for _, figures in tiles) / aperture.count
    seconds = {"preparing": prepared, "mapping": mappings * mapping_seconds / share / workers}
    sizes: dict[str, int] = {}
    sample = PillarMap(aperture.lattice, table.size_dbu, lambda: (tile for tile, _ in tiles), mapping.tile_sites)
    stamps = Stamps(biased(sample, design.mask.bias_nm), design)
    for suffix in design.mask.formats:
        writer = WRITERS[suffix](io.BytesIO(), drawing_of(aperture.lattice, design))
        _encoded_bytes(writer, stamps, tiles[0][0])
        encoding = time.perf_counter()
        encoded = sum(_encoded_bytes(writer, stamps, tile) for tile, _ in tiles)
        seconds[suffix] = (time.perf_counter() - encoding) / share / workers
        sizes[suffix] = round(encoded / share)
    return {
        "pillars": aperture.count,
        "tiles": len(places),
        "sampled_tiles": count,
        "mappings": mappings,
        "seconds": seconds,
        "core_hours": (sum(seconds.values()) - prepared) * workers / 3600.0,
        "bytes": sizes,
        "workers": workers,
        "advice": _advice(sizes),
    }


def _mappings(design: Design) -> int:
    """How often a tile is mapped: a lens too large to be kept is mapped for its figures and again for each reading."""
    if math.prod(lattice_of(design).shape) <= KEPT_SITES:
        return 1
    dose = design.mask.dose
    return 3 if dose is not None and dose.by == "density" else 2


def _encoded_bytes(writer: MaskWriter, stamps: Stamps, tile: PillarTile) -> int:
    """Bytes of all that is drawn on the sites of a tile."""
    return sum(piece.size for part in stamps.of(tile) for piece in writer.encoder(*part).content)


def announcement(design: Design) -> list[str]:
    """What is to be said before a mask is written: that its GDSII would be larger than many readers take.

    Every pillar is a BOUNDARY of 64 bytes (other than rectangles, a reference of 40), once for each bias of
    ``mask.copies`` (for each copy, if ``mask.flat``), beside four in the field around it where that is inverted, so
    that nothing needs to be mapped to know it.
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
