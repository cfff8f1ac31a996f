"""Depth error against photons and time: the small design's scene, from its target phases to decoded depth.

``error`` is the NMAE of the segments' depths over all decoded pixels, ``seconds`` the decoding of a frame by a decoder
that is already set up, ``depth_map_seconds`` that of the depth map alone. The pair is that of Eq. 2 without
optimisation, propagated exactly; the full benchmark lets it vary over the field.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from metafab import camera, decode, optics, phase
from metafab.core.measure import measured
from metafab.layout.pillars import Lattice
from metafab.spec import Design, load_design
from metafab.spec.design import SpiralZones

DESIGN = Path(__file__).parents[1] / "layouts" / "helix_small.toml"
SEEDS = 4


def rows(quick: bool) -> list[dict[str, Any]]:
    """One row a number of photons; errors are means over several exposures."""
    design = load_design(DESIGN)
    table = []
    for name, psf in _pairs(design, quick):
        for photons in (3000.0,) if quick else (300.0, 3000.0, 30000.0):
            table.append(_row(f"{name}, {photons:g} e", design, psf, photons))
    return table


def _pairs(design: Design, quick: bool) -> list[tuple[str, optics.Psf]]:
    terms = tuple(dataclasses.replace(t, optimise="none") if isinstance(t, SpiralZones) else t for t in design.phase)
    design = dataclasses.replace(design, phase=terms)
    imaging = optics.Imaging.of(design)
    period_nm = np.broadcast_to(design.unit_cell.cell.period_nm, 2)
    unit_nm = design.mask.database_unit_nm
    sites = math.ceil(1e3 * design.device.aperture_um / min(period_nm)) | 1
    lattice = Lattice((round(period_nm[0] / unit_nm), round(period_nm[1] / unit_nm)), (sites, sites), unit_nm)
    source = optics.ideal_field(phase.profile_of(design), lattice, design.device)
    depths = [piece.depth_m for piece in design.scene.objects]
    depth_m = optics.depth_nodes(imaging, 0.96 * min(depths), 1.04 * max(depths), 1e-3)
    plain = optics.psf(source, imaging, depth_m)
    if quick:
        return [("one pair for all", plain)]
    tangents = optics.field_tangents(design, imaging)
    return [
        ("one pair for all", plain),
        ("over the field", optics.psf(source, imaging, depth_m, field_tangents=tangents)),
    ]


def _row(name: str, design: Design, psf: optics.Psf, photons: float) -> dict[str, Any]:
    scene = dataclasses.replace(design.scene, photons_per_pixel=photons)
    frames = [camera.capture(scene, psf, seed=seed) for seed in range(1, SEEDS + 1)]
    first = frames[0]
    decoder = decode.Decoder.of(psf, first.frame.shape, first.origin_um, first.x_window)
    if decoder is None:
        raise ValueError("the frame does not hold both images")
    decoder(first)
    with measured() as cost:
        images = [decoder(frame) for frame in frames]
    with measured() as map_cost:
        for frame in frames:
            decoder.depth_map(frame)
    mean = {key: float(np.mean([image.details[key] for image in images])) for key in ("nmae_pixel", "share_decoded")}
    error = float(np.mean([image.nmae if image.nmae is not None else math.nan for image in images]))
    seconds = cost.seconds / SEEDS
    return {
        "name": name,
        "error": error,
        "seconds": seconds,
        "peak_rss_mb": cost.peak_rss_mb,
        "photons": photons,
        "depth_map_seconds": map_cost.seconds / SEEDS,
        **mean,
    }
