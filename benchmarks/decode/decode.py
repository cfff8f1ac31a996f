"""Depth error of the decoder against photons and time: frames of the small design's scene, from its target phases.

- ``error`` is the NMAE of the segments' depths over all decoded pixels, a mean over several exposures.
- ``seconds`` is the time of decoding a frame with a decoder that is already set up, ``depth_map_seconds`` that of the
  pixels' depths alone.
- ``bound`` is the smallest NMAE of any unbiased decoder: Cramer-Rao, whole objects, unknown textures of the scene's
  spectrum, the pair at each place of the field. ``bound_known_texture`` is that for known textures.

The pair is that of Eq. 2 without optimisation, propagated exactly; in the full benchmark it varies over the field. In
the rows of windows of one plane, ``error`` is the rms of their relative errors, and ``ratio_to_bound`` the rms of each
window's error over its own bound.

The full benchmark has two rows of the paper's lens in the light of a 10 nm filter. In one, the frames are those of the
exact camera, whose pairs are computed at the scene's own depths and refined over its field, so that the calibration
shares none of them. In the other, they are made with the calibration itself. The difference is the error of the
calibration's interpolation.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab import camera, decode, optics, phase
from metafab.core.conventions import FloatArray
from metafab.core.parallel.measure import measured
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.planes import Cells
from metafab.information import Texture
from metafab.layout import Lattice, sampling_lattice
from metafab.spec import Design, Scene, SceneObject, load_design
from metafab.spec.terms import SpiralZones

LAYOUTS = Path(__file__).parents[2] / "layouts"
DESIGN, PAPER_DESIGN = LAYOUTS / "helix_small.toml", LAYOUTS / "helix_2mm.toml"
OUTDOOR_DESIGN, FAR_DESIGN = LAYOUTS / "helix_outdoor.toml", LAYOUTS / "helix_5cm.toml"
SEEDS = 4
FILTER_FWHM_NM = 10.0
#: Side of the windows of one plane.
WINDOW_PX = 60


def rows(quick: bool) -> list[dict[str, Any]]:
    """One row per number of photons; errors are means over several exposures."""
    design = load_design(DESIGN)
    table = []
    for name, psf in _pairs(design, quick):
        for photons in (3000.0,) if quick else (300.0, 3000.0, 30000.0):
            table.append(_row(f"{name}, {photons:g} e", design, psf, psf, photons))
    if quick:
        return table
    windows = [
        _window_row("2 mm lens", PAPER_DESIGN, SceneObject(depth_m=0.29, size=(0.2, 0.1))),
        _window_row("5 cm lens", FAR_DESIGN, SceneObject(depth_m=200.0, size=(0.02, 0.01))),
    ]
    return table + _realism_rows() + [*windows, _video_row()]


def _pairs(design: Design, quick: bool) -> list[tuple[str, optics.Psf]]:
    source, imaging, depth_m = optics_of(design)
    plain = optics.psf(source, imaging, depth_m)
    if quick:
        return [("one pair for all", plain)]
    tangents = optics.field_tangents(design, imaging)
    return [
        ("one pair for all", plain),
        ("over the field", optics.psf(source, imaging, depth_m, field_tangents=tangents)),
    ]


def optics_of(design: Design) -> tuple[optics.Source, optics.Imaging, FloatArray]:
    """The target phases of a design without optimisation, their geometry, and depths to calibrate at."""
    terms = tuple(dataclasses.replace(t, optimise="none") if isinstance(t, SpiralZones) else t for t in design.phase)
    design = dataclasses.replace(design, phase=terms)
    imaging = optics.Imaging.of(design)
    period_nm = np.broadcast_to(design.unit_cell.cell.period_nm, 2)
    unit_nm = design.mask.database_unit_nm
    sites = math.ceil(1e3 * design.device.aperture_um / min(period_nm)) | 1
    lattice = Lattice(
        period_dbu=(round(period_nm[0] / unit_nm), round(period_nm[1] / unit_nm)),
        shape=(sites, sites),
        database_unit_nm=unit_nm,
    )
    profile = phase.profile_of(design)
    lattice = lattice if design.has_mask else sampling_lattice(profile, design)
    source = optics.ideal_field(profile, lattice, design.device)
    depths = [piece.depth_m for piece in design.scene.objects]
    return source, imaging, optics.depth_nodes(imaging, 0.96 * min(depths), 1.04 * max(depths), 1e-3)


def _realism_rows() -> list[dict[str, Any]]:
    """The paper's lens over its field in a filter's light: frames of the calibration, and of the exact camera."""
    design = load_design(PAPER_DESIGN)
    source, imaging, depth_m = optics_of(design)
    tangents = optics.field_tangents(design, imaging)
    calibration = optics.psf(
        source, imaging, depth_m, optics.PsfNumerics(filter_fwhm_nm=FILTER_FWHM_NM), field_tangents=tangents
    )
    exact = camera.exact_psf(
        design.scene,
        source,
        imaging,
        optics.PsfNumerics(window_px=96, target_error=1e-2, filter_fwhm_nm=FILTER_FWHM_NM),
    )
    photons = design.scene.photons_per_pixel
    light = f"{FILTER_FWHM_NM:g} nm, {photons:g} e"
    return [
        _row(f"2 mm lens, own frames, {light}", design, calibration, calibration, photons),
        _row(f"2 mm lens, exact camera, {light}", design, exact, calibration, photons),
    ]


def _row(name: str, design: Design, shown: optics.Psf, psf: optics.Psf, photons: float) -> dict[str, Any]:
    """Row of frames that are made with ``shown`` and decoded with ``psf``."""
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
    mean = {key: float(np.mean([getattr(image.figures, key) for image in images])) for key in keys}
    error = float(np.mean([image.nmae if image.nmae is not None else math.nan for image in images]))
    bound, bound_known = smallest_nmae(scene, decoder, first)
    # Decoding alone, without the comparison with the truth.
    seconds = float(np.mean([image.figures.seconds for image in images]))
    return {
        "name": name,
        "series": name.rsplit(", ", 1)[0],
        "error": error,
        "seconds": seconds,
        "peak_rss_mb": cost.peak_rss_mb,
        "photons": photons,
        "bound": bound,
        "bound_known_texture": bound_known,
        "depth_map_seconds": map_cost.seconds / SEEDS,
        **mean,
    }


def _video_row() -> dict[str, Any]:
    """Row of the outdoor design's film, 480 x 960 pixels, from the second frame on: a car passes a wall and a post.

    ``worst_object_error`` is the largest error of all objects in all frames, ``worst_object_error_alone`` that of
    frames that are each decoded anew. ``seconds_unchanged`` is the time of a frame without motion.
    """
    design = load_design(OUTDOOR_DESIGN)
    source, imaging, depth_m = optics_of(design)
    psf = optics.psf(source, imaging, depth_m, field_tangents=optics.field_tangents(design, imaging))
    frames = list(camera.film(design.scene, psf))
    first = decode.Decoder.of(psf, frames[0].frame.shape, frames[0].origin_um, frames[0].x_window)
    if first is None:
        raise ValueError("the frame does not hold both images")
    rehearsal, decoder = decode.VideoDecoder(first), decode.VideoDecoder(first)
    for frame in frames[:2]:  # the second frame compiles the loops for a part of the window
        rehearsal(frame)
    decoder(frames[0])
    with measured() as cost:
        images = [decoder(frame) for frame in frames[1:]]
    same = decoder(frames[-1])
    alone = [first(frame) for frame in frames[1:]]
    return {
        "name": f"2 mm lens, film of a moving car, {len(images)} frames",
        "series": "2 mm lens, film",
        "error": float(np.mean([image.nmae if image.nmae is not None else math.nan for image in images])),
        "seconds": float(np.mean([image.figures.seconds for image in images])),
        "peak_rss_mb": cost.peak_rss_mb,
        "photons": design.scene.photons_per_pixel,
        "changed_share": float(np.mean([image.figures.changed_share for image in images])),
        "nmae_pixel": float(np.mean([image.figures.nmae_pixel for image in images])),
        "worst_object_error": max(float(image.figures.worst_object_error) for image in images),
        "worst_object_error_alone": max(float(image.figures.worst_object_error) for image in alone),
        "seconds_alone": float(np.mean([image.figures.seconds for image in alone])),
        "seconds_unchanged": float(same.figures.seconds),
    }


def _window_row(lens: str, path: Path, plane: SceneObject) -> dict[str, Any]:
    """Row of windows of one plane all over a lens' field, at one wavelength, each measured separately."""
    design = load_design(path)
    source, imaging, depth_m = optics_of(design)
    psf = optics.psf(source, imaging, depth_m, field_tangents=optics.field_tangents(design, imaging))
    scene = dataclasses.replace(design.scene, objects=(plane,))
    frames = [camera.capture(scene, psf, seed=seed) for seed in range(1, SEEDS + 1)]
    decoder = decode.Decoder.of(psf, frames[0].frame.shape, frames[0].origin_um, frames[0].x_window)
    if decoder is None:
        raise ValueError("the frame does not hold both images")
    bound = decode.DepthBound.of(decoder.calibration, plane.depth_m, texture_of(scene, plane), sides_px(plane, psf))
    with measured() as cost:
        error, least = window_errors(decoder, frames, bound, WINDOW_PX)
    known = window_bounds(bound, decoder, WINDOW_PX, known=True)
    return {
        "name": f"{lens}, windows of {WINDOW_PX} pixels of one plane, {scene.photons_per_pixel:g} e",
        "series": f"{lens}, windows of one plane",
        "error": math.sqrt(float(np.mean(error**2))),
        "seconds": cost.seconds / SEEDS,
        "peak_rss_mb": cost.peak_rss_mb,
        "photons": scene.photons_per_pixel,
        "bound": math.sqrt(float(np.mean(least**2))),
        "bound_known_texture": math.sqrt(float(np.mean(known**2))),
        "ratio_to_bound": math.sqrt(float(np.mean((error / least) ** 2))),
    }


def window_errors(
    decoder: decode.Decoder, frames: Sequence[camera.RawFrame], bound: decode.DepthBound, side_px: int
) -> tuple[FloatArray, FloatArray]:
    """Relative errors of the depths of windows in frames of one plane, and their bounds: shapes (n,).

    Windows along the rim are left out: the plane continues beyond it.
    """
    errors = []
    for frame in frames:
        prepared = decoder.prepare(frame)
        if isinstance(prepared, str):
            raise ValueError(prepared)
        cells = _cells(decoder, decoder.match(prepared).volume, side_px)
        errors.append(_inside(cells.vergence_per_m[_whole(cells)], decoder, side_px) * bound.depth_m - 1.0)
    return np.concatenate(errors), np.tile(window_bounds(bound, decoder, side_px), len(errors))


def window_bounds(
    bound: decode.DepthBound, decoder: decode.Decoder, side_px: int, *, known: bool = False
) -> FloatArray:
    """Smallest relative error of each window, in the order of :func:`window_errors`: shape (n,)."""
    step = decoder.filters.downsampling.step
    rows, columns = _counts(decoder, side_px)
    span = step * (side_px // step)
    least = [
        bound.relative_error((slice(i * span, (i + 1) * span), slice(j * span, (j + 1) * span)), known=known)
        for i in range(rows)
        for j in range(columns)
    ]
    return _inside(np.array(least), decoder, side_px)


def _counts(decoder: decode.Decoder, side_px: int) -> tuple[int, int]:
    """Whole windows along y and x."""
    downsampling = decoder.filters.downsampling
    rows, columns = (n // (side_px // downsampling.step) for n in downsampling.shape)
    return rows, columns


def _inside(values: FloatArray, decoder: decode.Decoder, side_px: int) -> FloatArray:
    """Values of the whole windows that have neighbours on all sides."""
    return values.reshape(_counts(decoder, side_px))[1:-1, 1:-1].ravel()


def _cells(decoder: decode.Decoder, volume: CostVolume, side_px: int) -> Cells:
    return Cells.of(volume, np.ones(volume.shape, dtype=bool), decoder.filters.downsampling.step, side_px)


def _whole(cells: Cells) -> NDArray[np.bool_]:
    return np.asarray(cells.pixels == cells.pixels.max())


def smallest_nmae(scene: Scene, decoder: decode.Decoder, frame: camera.RawFrame) -> tuple[float, float]:
    """Mean of |error| / depth over a scene's pixels at the Cramer-Rao bound, for Gaussian errors.

    Each object is one segment of its visible pixels, and is taken as unpolarised.

    Args:
        scene: the photographed scene.
        decoder: a decoder of the frame.
        frame: with its truth.

    Returns:
        The mean with unknown textures, and with known ones.
    """
    if frame.truth is None:
        raise ValueError("the frame's truth is not known")
    errors, areas = [], []
    for number, piece in enumerate(scene.objects, start=1):
        mask = frame.truth.label == number
        if not mask.any():
            continue
        extent = sides_px(piece, decoder.calibration.kernels.psf)
        bound = decode.DepthBound.of(decoder.calibration, piece.depth_m, texture_of(scene, piece), extent)
        errors.append([bound.relative_error(mask, known=known) for known in (False, True)])
        areas.append(int(mask.sum()))
    unknown, known = math.sqrt(2.0 / math.pi) * np.average(errors, axis=0, weights=areas)
    return float(unknown), float(known)


def texture_of(scene: Scene, piece: SceneObject) -> Texture:
    """Texture of an object in the light of a scene."""
    electrons = scene.photons_per_pixel * scene.quantum_efficiency * piece.brightness
    return Texture(electrons=electrons, contrast=piece.texture_contrast, read_noise_e=scene.read_noise_e)


def sides_px(piece: SceneObject, psf: optics.Psf) -> tuple[int, int]:
    """(n_y, n_x) pixels of an object."""
    rows, columns = (max(2, round(side * psf.sensor_distance_um / psf.pixel_um)) for side in reversed(piece.size))
    return rows, columns
