"""Depths, segments and sharp images put together: the Image4D of a frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from metafab.camera.frame import RawFrame
from metafab.core.conventions import FloatArray
from metafab.core.executor import kept_threads
from metafab.decode.contrast import SegmentLight, pixel_contrast
from metafab.decode.depth import HALF_CONFIDENCE, PixelDepth
from metafab.decode.distance import distance
from metafab.decode.image import Image4D
from metafab.decode.pooling import window_means
from metafab.decode.reduce import enlarged, repeated
from metafab.decode.regions import LAYER_SHARE, Regions
from metafab.decode.restore import LitTiles, Restorer, Sharp
from metafab.decode.seen import WINDOW_PX, Seen
from metafab.decode.segment import grown
from metafab.decode.twins import TwinGrid
from metafab.decode.volume import Volume

#: Share of the twins' power that they do not have in common, noise taken off, from which the calibration is doubted.
_LARGEST_MISMATCH = 0.05


def full_depth_m(pixels: PixelDepth, every: int, shape: tuple[int, int]) -> FloatArray:
    """Depth of each pixel by itself on the frame's pixels, NaN where none is claimed."""
    depth = 1.0 / np.maximum(pixels.vergence_per_m, 1e-12)
    depth_m = enlarged(depth, every, shape)
    np.copyto(depth_m, np.nan, where=~repeated(pixels.claimed, every, shape))
    return depth_m


def sharpened(
    seen: Seen,
    regions: Regions,
    restorer: Restorer,
    tiles: LitTiles,
    candidates_per_m: FloatArray,
    changed: NDArray[np.bool_] | None,
    last: Sharp | None,
) -> Sharp:
    """Both images, sharp at the depth of the nearest segment; with ``last``, that is kept where nothing ``changed``."""
    every, shape = seen.reduction.every, seen.twins.grid.shape
    middle_per_m = float(np.median(candidates_per_m))
    band_per_m = LAYER_SHARE * float(candidates_per_m[-1] - candidates_per_m[0])
    wide = grown(regions.label, float(sum(regions.label.shape))) if regions.depths else np.ones_like(regions.label)
    wide = np.where(lit_about(seen), wide, 0)
    vergences = np.array([middle_per_m])
    if regions.depths:
        wide, vergences = regions.bands(wide, band_per_m)
    if last is None or changed is None:
        return restorer(tiles, seen.levels, repeated(wide, every, shape), vergences)
    sharp = restorer(tiles, seen.levels, repeated(np.where(changed, wide, 0), every, shape), vergences)
    unchanged = ~repeated(changed, every, shape)
    np.copyto(sharp.images, last.images, where=unchanged)
    np.copyto(sharp.noise_gain, last.noise_gain, where=unchanged)
    return sharp


def lit_about(seen: Seen) -> NDArray[np.bool_]:
    """What is lit and two pixels around it, where images are made sharp."""
    return np.asarray(binary_dilation(seen.lit, iterations=2))


def composed(
    frame: RawFrame,
    seen: Seen,
    volume: Volume,
    pixels: PixelDepth,
    regions: Regions,
    sharp: Sharp,
    basis_images: int,
) -> Image4D:
    """All that is known about a frame, on its own pixels."""
    images = sharp.images
    every, shape = seen.reduction.every, seen.twins.grid.shape
    with kept_threads() as beside:
        maps = beside.submit(_maps, pixels, regions, every, shape)
        doubts = beside.submit(_doubts, volume, seen, regions)
        lit = _lit(images, seen.floor_e) & ~seen.twins.bad
        contrast, contrast_error = pixel_contrast(sharp, seen.levels.read_noise_e, lit)
    dark = ~lit
    segment, depth_m, confidence, pixel_m = maps.result()
    for part, unknown in ((segment, 0), (depth_m, np.nan), (confidence, 0.0), (pixel_m, np.nan)):
        np.copyto(part, unknown, where=dark)
    light = SegmentLight.of(images, segment, repeated(regions.inner, every, shape), len(regions.depths))
    rows = _rows(regions, light, every, seen.levels.read_noise_e)
    details: dict[str, float | str] = {
        "layers": float(regions.layers),
        "basis_images": float(basis_images),
        "step_px": float(every),
        "pixels": float(lit.size),
        "pixels_without_signal": float(dark.sum()),
        "pixels_without_texture": float((lit & np.isnan(depth_m)).sum()),
        "pixels_broken": float(seen.twins.bad.sum()),
        "contrast_standard_error": _typical(contrast_error[::8, ::8], contrast[::8, ::8]),
        **doubts.result(),
    }
    return Image4D(
        images[0].astype(np.float64),
        images[1].astype(np.float64),
        contrast,
        depth_m,
        confidence,
        segment,
        seen.twins.grid.origin_um,
        frame.pixel_um,
        rows,
        pixel_m,
        contrast_error,
        details=details,
    )


def _maps(
    pixels: PixelDepth, regions: Regions, every: int, shape: tuple[int, int]
) -> tuple[NDArray[np.int32], FloatArray, FloatArray, FloatArray]:
    """Segment, its depth in m, confidence and own depth of each pixel of the frame, if all of them were lit."""
    claimed = pixels.claimed & (regions.near > 0)
    known = (regions.near > 0) & (distance(claimed) <= WINDOW_PX / every)
    errors = np.array([np.inf, *(depth.relative_error for depth in regions.depths)])
    error = np.minimum(np.where(claimed, pixels.relative_error, np.inf), errors[regions.near])
    trust = np.where(known, 1.0 / (1.0 + (error / HALF_CONFIDENCE) ** 2), 0.0)
    depth_m = np.where(known, 1.0 / regions.vergence_per_m(regions.near), np.nan)
    segment, depth_m, confidence = (repeated(part, every, shape) for part in (regions.near, depth_m, trust))
    own_m = full_depth_m(PixelDepth(pixels.vergence_per_m, pixels.relative_error, claimed), every, shape)
    return segment, depth_m, confidence, own_m


def _typical(error: FloatArray, values: FloatArray) -> float:
    """Median of the errors' shares of their values; NaN where nothing is known."""
    known = np.isfinite(error) & (values > 0.0)
    return float(np.median(error[known] / values[known])) if known.any() else float("nan")


def empty(shape: tuple[int, ...], frame: RawFrame, reason: str, grid: TwinGrid | None = None) -> Image4D:
    """No depth anywhere, and why."""
    dark, unknown = np.zeros(shape), np.full(shape, np.nan)
    return Image4D(
        dark,
        dark.copy(),
        unknown,
        unknown.copy(),
        dark.copy(),
        np.zeros(shape, dtype=np.int32),
        frame.origin_um if grid is None else grid.origin_um,
        frame.pixel_um,
        depth_pixel_m=unknown.copy(),
        contrast_error=unknown.copy(),
        details={"reason": reason},
    )


def _lit(images: NDArray[np.float32], floor_e: float) -> NDArray[np.bool_]:
    """Pixels with light of either polarisation."""
    return np.asarray(window_means(images[0] + images[1], 3) > floor_e)


def _rows(regions: Regions, light: SegmentLight, every: int, read_noise_e: float) -> tuple[dict[str, float], ...]:
    """What is known of each segment: its contrast from its inside, over which blur and sharpening keep the light."""
    contrast, error = light.contrast(read_noise_e)
    return tuple(
        {
            "number": float(index + 1),
            "pixels": float(light.pixels[index]),
            "depth_m": 1.0 / depth.vergence_per_m,
            "slope_x_per_m": depth.plane.slope_per_m[1] / every,
            "slope_y_per_m": depth.plane.slope_per_m[0] / every,
            "error_m": depth.relative_error / depth.vergence_per_m,
            "contrast": float(contrast[index]),
            "contrast_error": float(error[index]),
            "correlation": depth.correlation,
        }
        for index, depth in enumerate(regions.depths)
    )


def _doubts(volume: Volume, seen: Seen, regions: Regions) -> dict[str, float | str]:
    """What the twins do not have in common, and a warning where the calibration does not seem to be the camera's."""
    mismatch = _mismatch(volume, seen, regions)
    if mismatch is None:
        return {"warning": "the twins agree at no depth: no texture, or another camera's calibration"}
    if mismatch <= _LARGEST_MISMATCH:
        return {"twin_mismatch": mismatch}
    warning = f"the twins differ by {mismatch:.0%} of their power: is this the camera's calibration?"
    return {"twin_mismatch": mismatch, "warning": warning}


def _mismatch(volume: Volume, seen: Seen, regions: Regions) -> float | None:
    """Share of the twins' power that is neither common to both nor noise, over all segments; None without any."""
    if not regions.depths:
        return None
    inside = regions.label > 0
    mean = np.maximum(seen.inner[:, inside], 0.0).mean(axis=1) + seen.levels.read_noise_e**2
    noise = volume.noise_gain * float(np.sqrt(mean[0] * mean[1]))
    weights = np.bincount(regions.label[inside], minlength=len(regions.depths) + 1)[1:]
    common = float(np.average([depth.correlation * depth.power for depth in regions.depths], weights=weights))
    power = float(np.average([depth.power for depth in regions.depths], weights=weights))
    return max(0.0, 1.0 - common / max(power - noise, 1e-30)) if power > noise else 1.0
