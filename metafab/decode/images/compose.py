"""Depths, segments and sharp images put together: the Image4D of a frame."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from metafab.camera.frames.frame import RawFrame
from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import kept_threads
from metafab.decode.image import Image4D, SegmentFigures
from metafab.decode.images.contrast import SegmentLight, pixel_contrast
from metafab.decode.images.deconvolution import LitTiles, Restorer, Sharp
from metafab.decode.matching.cost_volume import Volume
from metafab.decode.matching.depth import HALF_CONFIDENCE, PixelDepth
from metafab.decode.matching.pooling import window_means
from metafab.decode.registration.reduce import enlarged, place_within, repeated
from metafab.decode.registration.twins import TwinGrid
from metafab.decode.segmentation.distance import distance
from metafab.decode.segmentation.frame_statistics import WINDOW_PX, Seen
from metafab.decode.segmentation.regions import Regions
from metafab.decode.segmentation.segment import grown

#: Tilted segments are made sharp in bands of this share of the calibrated range: 0.006 dB less than in a quarter of it.
_BAND_SHARE = 1.0 / 12.0
#: How far around what is lit images are made sharp, compared pixels.
_LIT_ABOUT_PX = 2
#: Share of the twins' power that they do not have in common, noise taken off, from which the calibration is doubted:
#: without noise, and more for each share of noise in the power (which is known to some per cent where there is little
#: light). Frames of the camera that was calibrated have 0.005 at most.
_LARGEST_MISMATCH, _MORE_WITH_NOISE = 0.01, 0.25
#: Share of the segments' pixels whose twins agree best, by which a calibration is judged: a wrong one spoils all of
#: them, a clutter of small pieces before each other only many.
_JUDGED_SHARE = 0.25
#: Of its own standard errors, that a pixel may be away from its segment without a doubt.
_OWN_ERRORS = 2.0


def full_depth_m(pixels: PixelDepth, every: int, shape: tuple[int, int]) -> FloatArray:
    """Depth of each pixel by itself on the frame's pixels, NaN where none is claimed."""
    depth = 1.0 / np.maximum(pixels.vergence_per_m, 1e-12)
    depth_m = enlarged(depth, every, shape)
    np.copyto(depth_m, np.nan, where=~repeated(pixels.claimed, every, shape))
    return depth_m


def sharpened(seen: Seen, regions: Regions, restorer: Restorer, tiles: LitTiles, candidates_per_m: FloatArray) -> Sharp:
    """Both images, sharp at the depth of the nearest segment."""
    label, vergences = focus(seen, regions, candidates_per_m)
    return restorer(tiles, seen.levels, repeated(label, seen.reduction.every, seen.twins.grid.shape), vergences)


def focus(seen: Seen, regions: Regions, candidates_per_m: FloatArray) -> tuple[NDArray[np.int32], FloatArray]:
    """At which depth each compared pixel is made sharp, numbered from 1 (0: it is dark), and 1/depth of each number."""
    band_per_m = _BAND_SHARE * float(candidates_per_m[-1] - candidates_per_m[0])
    wide = grown(regions.label, float(sum(regions.label.shape))) if regions.depths else np.ones_like(regions.label)
    wide = np.where(lit_about(seen), wide, 0)
    if not regions.depths:
        return wide, np.array([float(np.median(candidates_per_m))])
    return regions.bands(wide, band_per_m)


def lit_about(seen: Seen) -> NDArray[np.bool_]:
    """What is lit and a little around it, where images are made sharp."""
    return np.asarray(distance(seen.lit) <= _LIT_ABOUT_PX)


@dataclass(frozen=True)
class Pictures:
    """What is known of each pixel of a frame, all of shape (n_y, n_x): see :class:`Image4D`.

    Attributes:
        lit: where there is light.
    """

    intensity_x: FloatArray
    intensity_y: FloatArray
    contrast: FloatArray
    contrast_error: FloatArray
    depth_m: FloatArray
    confidence: FloatArray
    segment: NDArray[np.int32]
    depth_pixel_m: FloatArray
    lit: NDArray[np.bool_]

    @classmethod
    def of(cls, seen: Seen, pixels: PixelDepth, regions: Regions, sharp: Sharp) -> Pictures:
        """All that is seen, or a part of it."""
        every, shape, images = seen.reduction.every, seen.twins.grid.shape, sharp.images
        with kept_threads() as beside:
            maps = beside.submit(_maps, pixels, regions, every, shape)
            lit = _lit(images, seen.floor_e) & ~seen.twins.bad
            contrast, contrast_error = pixel_contrast(sharp, seen.levels.read_noise_e, lit)
        segment, depth_m, confidence, pixel_m = maps.result()
        for part, unknown in ((segment, 0), (depth_m, np.nan), (confidence, 0.0), (pixel_m, np.nan)):
            np.copyto(part, unknown, where=~lit)
        intensity_x, intensity_y = images.astype(np.float64)
        return cls(intensity_x, intensity_y, contrast, contrast_error, depth_m, confidence, segment, pixel_m, lit)

    def copy(self) -> Pictures:
        """The same in memory of its own."""
        return Pictures(**{item.name: getattr(self, item.name).copy() for item in fields(self)})

    def renumbered(self, number: NDArray[np.int32]) -> Pictures:
        """With other numbers for the segments from 0 (none) on."""
        same = np.array_equal(number, np.arange(number.size))
        return self if same else replace(self, segment=number[self.segment])

    def paste(self, there: Pictures, part: tuple[slice, slice], about: tuple[slice, slice]) -> None:
        """Take a part from the pictures of what lies ``about`` it; both are pixels of these."""
        inside = place_within(part, about)
        for item in fields(self):
            getattr(self, item.name)[part] = getattr(there, item.name)[inside]

    def image(
        self, frame: RawFrame, seen: Seen, volume: Volume, regions: Regions, sharp: Sharp, basis_images: int
    ) -> Image4D:
        """All that is known about a frame, on its own pixels."""
        every = seen.reduction.every
        with kept_threads() as beside:
            doubts = beside.submit(_doubts, volume, seen, regions)
            inner = repeated(regions.inner, every, self.lit.shape)
            light = SegmentLight.of(sharp.images, self.segment, inner, len(regions.depths))
        some = (slice(None, None, 8), slice(None, None, 8))
        details: dict[str, float | str] = {
            "layers": float(regions.layers),
            "basis_images": float(basis_images),
            "step_px": float(every),
            "pixels": float(self.lit.size),
            "pixels_without_signal": float((~self.lit).sum()),
            "pixels_without_texture": float((self.lit & np.isnan(self.depth_m)).sum()),
            "pixels_broken": float(seen.twins.bad.sum()),
            "contrast_standard_error": _typical(self.contrast_error[some], self.contrast[some]),
            **doubts.result(),
        }
        return Image4D(
            self.intensity_x,
            self.intensity_y,
            self.contrast,
            self.depth_m,
            self.confidence,
            self.segment,
            seen.twins.grid.origin_um,
            frame.pixel_um,
            _segment_figures(regions, light, every, seen.levels.read_noise_e),
            self.depth_pixel_m,
            self.contrast_error,
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
    vergence = regions.vergence_per_m(regions.near)
    # A pixel that says another depth than its segment, by more than its own error, doubts the segment's.
    away = np.abs(pixels.vergence_per_m / vergence - 1.0) - _OWN_ERRORS * pixels.relative_error
    error = np.hypot(error, np.where(claimed, np.maximum(away, 0.0), 0.0))
    trust = np.where(known, 1.0 / (1.0 + (error / HALF_CONFIDENCE) ** 2), 0.0)
    depth_m = np.where(known, 1.0 / vergence, np.nan)
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


def _segment_figures(
    regions: Regions, light: SegmentLight, every: int, read_noise_e: float
) -> tuple[SegmentFigures, ...]:
    """Figures of each segment; its contrast is that of its interior, where deconvolution keeps the light."""
    contrast, error = light.contrast(read_noise_e)
    return tuple(
        SegmentFigures(
            number=index + 1,
            pixels=int(light.pixels[index]),
            depth_m=1.0 / depth.vergence_per_m,
            slope_x_per_m=depth.plane.slope_per_m[1] / every,
            slope_y_per_m=depth.plane.slope_per_m[0] / every,
            error_m=depth.relative_error / depth.vergence_per_m,
            contrast=float(contrast[index]),
            contrast_error=float(error[index]),
            correlation=depth.correlation,
        )
        for index, depth in enumerate(regions.depths)
    )


def _doubts(volume: Volume, seen: Seen, regions: Regions) -> dict[str, float | str]:
    """What the twins do not have in common, and a warning where the calibration does not seem to be the camera's."""
    found = _mismatch(volume, seen, regions)
    if found is None:
        return {"warning": "the twins agree at no depth: no texture, or another camera's calibration"}
    mismatch, noise = found
    if mismatch <= _LARGEST_MISMATCH + _MORE_WITH_NOISE * noise:
        return {"twin_mismatch": mismatch}
    warning = f"the twins differ by {mismatch:.0%} of their power: is this the camera's calibration?"
    return {"twin_mismatch": mismatch, "warning": warning}


def _mismatch(volume: Volume, seen: Seen, regions: Regions) -> tuple[float, float] | None:
    """Share of the twins' power that is neither common to both nor noise, where they agree best; None without any.

    Beside it, the noise's power over that of the rest.
    """
    if not regions.depths:
        return None
    count = len(regions.depths)
    number = regions.label.ravel()
    pixels = np.bincount(number, minlength=count + 1)[1:]
    sums = [np.bincount(number, np.maximum(image, np.float32(0.0)).ravel(), count + 1)[1:] for image in seen.inner]
    light = np.stack(sums) / np.maximum(pixels, 1)
    whole = np.array([depth.power for depth in regions.depths])
    power = _power_without_noise(whole, light, volume.noise_gain * (light + seen.levels.read_noise_e**2))
    common = np.array([depth.correlation for depth in regions.depths]) * whole
    apart = np.where(power > 0.0, 1.0 - common / np.maximum(power, 1e-30), 1.0)
    best = np.argsort(apart)
    judged = best[np.searchsorted(np.cumsum(pixels[best]), _JUDGED_SHARE * pixels.sum())]
    return max(0.0, float(apart[judged])), float((whole[judged] - power[judged]) / max(float(power[judged]), 1e-30))


def _power_without_noise(power: FloatArray, light: FloatArray, noise: FloatArray) -> FloatArray:
    """Geometric mean of the twins' powers without that of their noise, for textures in proportion to their light.

    Of powers r^2 S + n_x and S + n_y, with r = I_x / I_y, the product is known.

    Args:
        power: shape (n,), geometric mean with noise.
        light: shape (2, n), mean brightness of both.
        noise: the same shape, power of it.
    """
    ratio = np.maximum(light[0], 1e-12) / np.maximum(light[1], 1e-12)
    linear = ratio**2 * noise[1] + noise[0]
    left = power**2 - noise[0] * noise[1]
    root = np.sqrt(np.maximum(linear**2 + 4.0 * ratio**2 * left, 0.0))
    return np.where(left > 0.0, (root - linear) / (2.0 * ratio), 0.0)
