"""Depth error against photons and time: the small design's scene, from its target phases to decoded depth.

``error`` is the NMAE of the segments' depths over all decoded pixels, ``seconds`` the decoding of a frame by a decoder
that is already set up, ``depth_map_seconds`` that of the depth map alone. ``bound`` is the least NMAE that any unbiased
decoder can have (Cramer-Rao, unknown textures of the scene's spectrum, whole objects on the axis). The pair is that of
Eq. 2 without optimisation, propagated exactly; the full benchmark lets it vary over the field.

The full benchmark ends with the paper's lens in the light of a 10 nm filter: frames of the exact camera, whose pairs
are computed at the scene's own depths and refined over its field, decoded with a calibration that shares none of them;
beside them frames that were made with the calibration itself, which tell what its gaps cost.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from metafab import camera, decode, optics, phase
from metafab.core.conventions import FloatArray
from metafab.core.measure import measured
from metafab.layout.pillars import Lattice
from metafab.optics.fisher import Texture, depth_crlb_m, twin_depth_information
from metafab.spec import Design, Scene, load_design
from metafab.spec.design import SpiralZones

LAYOUTS = Path(__file__).parents[1] / "layouts"
DESIGN, PAPER_DESIGN = LAYOUTS / "helix_small.toml", LAYOUTS / "helix_2mm.toml"
SEEDS = 4
FILTER_FWHM_NM = 10.0


def rows(quick: bool) -> list[dict[str, Any]]:
    """One row a number of photons; errors are means over several exposures."""
    design = load_design(DESIGN)
    table = []
    for name, psf in _pairs(design, quick):
        for photons in (3000.0,) if quick else (300.0, 3000.0, 30000.0):
            table.append(_row(f"{name}, {photons:g} e", design, psf, psf, photons))
    return table if quick else table + _realism_rows() + [_video_row()]


def _pairs(design: Design, quick: bool) -> list[tuple[str, optics.Psf]]:
    source, imaging, depth_m = _optics(design)
    plain = optics.psf(source, imaging, depth_m)
    if quick:
        return [("one pair for all", plain)]
    tangents = optics.field_tangents(design, imaging)
    return [
        ("one pair for all", plain),
        ("over the field", optics.psf(source, imaging, depth_m, field_tangents=tangents)),
    ]


def _optics(design: Design) -> tuple[optics.Source, optics.Imaging, FloatArray]:
    """The target phases of a design without optimisation, their geometry, and depths to calibrate at."""
    terms = tuple(dataclasses.replace(t, optimise="none") if isinstance(t, SpiralZones) else t for t in design.phase)
    design = dataclasses.replace(design, phase=terms)
    imaging = optics.Imaging.of(design)
    period_nm = np.broadcast_to(design.unit_cell.cell.period_nm, 2)
    unit_nm = design.mask.database_unit_nm
    sites = math.ceil(1e3 * design.device.aperture_um / min(period_nm)) | 1
    lattice = Lattice((round(period_nm[0] / unit_nm), round(period_nm[1] / unit_nm)), (sites, sites), unit_nm)
    source = optics.ideal_field(phase.profile_of(design), lattice, design.device)
    depths = [piece.depth_m for piece in design.scene.objects]
    return source, imaging, optics.depth_nodes(imaging, 0.96 * min(depths), 1.04 * max(depths), 1e-3)


def _realism_rows() -> list[dict[str, Any]]:
    """The paper's lens over its field in a filter's light: frames by the calibration, and by the exact camera."""
    design = load_design(PAPER_DESIGN)
    source, imaging, depth_m = _optics(design)
    tangents = optics.field_tangents(design, imaging)
    calibration = optics.psf(source, imaging, depth_m, field_tangents=tangents, filter_fwhm_nm=FILTER_FWHM_NM)
    exact = camera.exact_psf(design.scene, source, imaging, target_error=1e-2, filter_fwhm_nm=FILTER_FWHM_NM)
    photons = design.scene.photons_per_pixel
    light = f"{FILTER_FWHM_NM:g} nm, {photons:g} e"
    return [
        _row(f"2 mm lens, its calibration's own frames, {light}", design, calibration, calibration, photons),
        _row(f"2 mm lens, frames of the exact camera, {light}", design, exact, calibration, photons),
    ]


def _row(name: str, design: Design, shown: optics.Psf, psf: optics.Psf, photons: float) -> dict[str, Any]:
    """Frames that ``shown`` makes, decoded with ``psf``."""
    scene = dataclasses.replace(design.scene, photons_per_pixel=photons)
    frames = [camera.capture(scene, shown, seed=seed) for seed in range(1, SEEDS + 1)]
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
    keys = ("nmae_pixel", "share_decoded", "psnr_x_db", "ssim_x", "contrast_error")
    mean = {key: float(np.mean([image.details[key] for image in images])) for key in keys}
    error = float(np.mean([image.nmae if image.nmae is not None else math.nan for image in images]))
    # Of the decoding alone, without the judging against the truth.
    seconds = float(np.mean([image.details["seconds"] for image in images]))
    return {
        "name": name,
        "series": name.rsplit(", ", 1)[0],
        "error": error,
        "seconds": seconds,
        "peak_rss_mb": cost.peak_rss_mb,
        "photons": photons,
        "bound": smallest_nmae(scene, psf),
        "depth_map_seconds": map_cost.seconds / SEEDS,
        **mean,
    }


def _video_row() -> dict[str, Any]:
    """Frames of 480 x 960 pixels in which one object of the paper's indoor scene moves, from the second frame on."""
    design = load_design(PAPER_DESIGN)
    source, imaging, depth_m = _optics(design)
    psf = optics.psf(source, imaging, depth_m, field_tangents=optics.field_tangents(design, imaging))
    still, *others = sorted(design.scene.objects, key=lambda piece: -piece.size[0])
    small = dataclasses.replace(others[-1], velocity_m_per_s=(0.01, 0.0, 0.0))
    scene = dataclasses.replace(design.scene, objects=(still, *others[:-1], small), frames=6, frame_interval_s=0.04)
    frames = list(camera.film(scene, psf))
    first = decode.Decoder.of(psf, frames[0].frame.shape, frames[0].origin_um, frames[0].x_window)
    if first is None:
        raise ValueError("the frame does not hold both images")
    decoder = decode.VideoDecoder(first)
    with measured() as cost:
        images = [decoder(frame) for frame in frames]
    later = images[1:]
    return {
        "name": "2 mm lens, video at 25 frames a second, one object of three moves",
        "series": "2 mm lens, video",
        "error": float(np.mean([image.nmae if image.nmae is not None else math.nan for image in later])),
        "seconds": float(np.mean([image.details["seconds"] for image in later])),
        "peak_rss_mb": cost.peak_rss_mb,
        "photons": scene.photons_per_pixel,
        "changed_share": float(np.mean([image.details["changed_share"] for image in later])),
    }


def smallest_nmae(scene: Scene, psf: optics.Psf) -> float:
    """Mean of |error| / depth over a scene's pixels at the Cramer-Rao bound, if all errors are Gaussian.

    Each object is one piece of its size with the texture's spectrum over that size; one that fills less of its
    bounding box, polarises or stands beside the axis is taken as one that does not.
    """
    unit = psf.psf / (psf.psf[:, psf.depth_m.size // 2].sum(axis=(-2, -1)).mean() * psf.pixel_um**2)
    errors, areas = [], []
    for piece in scene.objects:
        sides = [round(side * psf.sensor_distance_um / psf.pixel_um) for side in reversed(piece.size)]
        grown = [max(0, side - n) for side, n in zip(sides, unit.shape[-2:], strict=True)]
        padded = np.pad(unit, [(0, 0), (0, 0), *((extra - extra // 2, extra // 2) for extra in grown)])
        texture = Texture(scene.photons_per_pixel, piece.texture_contrast, read_noise_e=scene.read_noise_e)
        information = twin_depth_information(padded, psf.depth_m, psf.pixel_um, texture)
        share = math.prod(sides) / math.prod(padded.shape[-2:])
        error_m = depth_crlb_m(np.interp(piece.depth_m, psf.depth_m, information) * share)
        errors.append(math.sqrt(2.0 / math.pi) * float(error_m) / piece.depth_m)
        areas.append(math.prod(sides))
    return float(np.average(errors, weights=areas))
