"""Composition of the Image4D of a frame from its pixel depths, segments and sharp images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from metafab.camera.frames.frame import RawFrame
from metafab.core.conventions import FloatArray
from metafab.core.figures import DecodingFigures, SegmentFigures
from metafab.core.parallel.executor import kept_threads
from metafab.decode.broken_light import BrokenLight
from metafab.decode.confidence import LEAST_RIGHT, RIGHT_WITHIN, SEGMENTS_SCATTER, confidence, same_side
from metafab.decode.image import Image4D
from metafab.decode.images.contrast import SegmentLight, pixel_contrast
from metafab.decode.images.deconvolution import SharpImages
from metafab.decode.images.own_depths import seen_elsewhere
from metafab.decode.images.pixel_outlines import on_pixels
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.matching.pooling import window_means
from metafab.decode.registration.downsampling import enlarged, relative_slices, repeated
from metafab.decode.registration.twins import TwinGrid
from metafab.decode.segmentation.layers import grown
from metafab.decode.segmentation.objects.plain_behind import PlainPixels
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Width of the bands of one depth in which tilted segments are deconvolved, as a share of the calibrated range: images
#: are 0.006 dB worse than in bands of a quarter of it.
_BAND_SHARE = 1.0 / 12.0
#: Mismatch of the twins from which the calibration is doubted, and its increase per share of noise in their power,
#: which is known to some per cent where there is little light. Frames of the calibrated camera have 0.005 at most.
_LARGEST_MISMATCH, _MISMATCH_PER_NOISE = 0.01, 0.25
#: Share of the segments' pixels by which a calibration is judged, those whose twins agree best: a wrong calibration
#: spoils all pixels; small objects that hide each other spoil many, but not all.
_JUDGED_SHARE = 0.25
#: Side of the squares in which a doubted calibration is judged again, frame pixels: as wide as the windows that measure
#: depths.
_PIECE_PX = 28

Patch = tuple[tuple[slice, slice], "PixelMaps", tuple[slice, slice]]


def full_depth_m(pixels: PixelDepth, step: int, shape: tuple[int, int]) -> FloatArray:
    """Depth of each frame pixel from the window around it, m: shape ``shape``; NaN where none is claimed."""
    depth_m = enlarged(1.0 / np.maximum(pixels.vergence_per_m, 1e-12), step, shape)
    np.copyto(depth_m, np.nan, where=~repeated(pixels.claimed, step, shape))
    return depth_m


def focus_depths(
    prepared: PreparedFrame, regions: Regions, candidates_per_m: FloatArray
) -> tuple[NDArray[np.int32], FloatArray]:
    """Depths at which a frame is deconvolved: each pixel at that of the nearest segment.

    Args:
        candidates_per_m: shape (n_candidates,), vergences of the cost volume.

    Returns:
        Number of each downsampled pixel's depth from 1 (0 in the dark), shape (n_y, n_x), and 1/depth of each number,
        shape (n_depths,).
    """
    near = prepared.near_light
    if not regions.depths:
        return near.astype(np.int32), np.array([float(np.median(candidates_per_m))])
    everywhere = grown(regions.label)
    band_per_m = _BAND_SHARE * float(candidates_per_m[-1] - candidates_per_m[0])
    return regions.bands(np.where(near, everywhere, 0).astype(np.int32), band_per_m)


@dataclass(frozen=True)
class PixelMaps:
    """The arrays of an :class:`Image4D`, documented there, all of shape (n_y, n_x)."""

    intensity_x: FloatArray  #: Shape (n_y, n_x).
    intensity_y: FloatArray  #: Shape (n_y, n_x).
    contrast: FloatArray  #: Shape (n_y, n_x).
    contrast_error: FloatArray  #: Shape (n_y, n_x).
    depth_m: FloatArray  #: Shape (n_y, n_x).
    confidence: FloatArray  #: Shape (n_y, n_x).
    segment: NDArray[np.int32]  #: Shape (n_y, n_x).
    depth_pixel_m: FloatArray  #: Shape (n_y, n_x).
    lit: NDArray[np.bool_]  #: Shape (n_y, n_x), whether a pixel has light.

    @classmethod
    def of(
        cls,
        prepared: PreparedFrame,
        pixels: PixelDepth,
        regions: Regions,
        sharp: SharpImages,
        lit: NDArray[np.bool_],
        plain_of: Callable[[], PlainPixels],
    ) -> PixelMaps:
        """The maps of a frame, or of a part of it.

        ``lit``, shape (n_y, n_x), are its :func:`lit_pixels`; ``plain_of`` returns its plain pixels.
        """
        step, shape = prepared.downsampling.step, prepared.twins.grid.shape
        with kept_threads() as pool:
            depths = pool.submit(depth_maps, pixels, regions, step, shape, plain_of)
            contrast, contrast_error = pixel_contrast(sharp, prepared.levels.read_noise_e, lit)
        maps = depths.result()
        for array, in_the_dark in (
            (maps.depth_m, np.nan),
            (maps.confidence, 0.0),
            (maps.segment, 0),
            (maps.depth_pixel_m, np.nan),
        ):
            np.copyto(array, in_the_dark, where=~lit)
        return cls(
            sharp.images[0].astype(np.float64),
            sharp.images[1].astype(np.float64),
            contrast,
            contrast_error,
            maps.depth_m,
            maps.confidence,
            maps.segment,
            maps.depth_pixel_m,
            lit,
        )

    def with_segments(self, regions: Regions, prepared: PreparedFrame) -> PixelMaps:
        """The maps with other segments at the same depths."""
        segment = on_pixels(regions.grown, prepared.downsampling.step, self.lit.shape, regions.beyond_px)(regions.grown)
        return replace(self, segment=np.where(self.lit, segment, 0).astype(np.int32))

    def overwrite(self, renumbered: NDArray[np.int32], patches: Sequence[Patch]) -> None:
        """Write parts of other maps into these.

        Args:
            renumbered: shape (n_segments + 1,), new number of each segment by the old one, from 0 for none.
            patches: for each part, its slices, maps of its surroundings, and the slices of these surroundings.
        """
        if not np.array_equal(renumbered, np.arange(renumbered.size)):
            self.segment[...] = renumbered[self.segment]
        for part, maps, surroundings in patches:
            inside = relative_slices(part, surroundings)
            for item in fields(self):
                getattr(self, item.name)[part] = getattr(maps, item.name)[inside]

    def image(self, prepared: PreparedFrame, volume: CostVolume, regions: Regions, sharp: SharpImages) -> Image4D:
        """The 4D image, with figures of each segment and of the decoding."""
        step = prepared.downsampling.step
        with kept_threads() as pool:
            doubts = pool.submit(_mismatch_figures, volume, prepared, regions)
            broken = BrokenLight.of(prepared, regions)
            inner = repeated(regions.interior, step, self.lit.shape)
            light = SegmentLight.of(sharp.images, self.segment, inner, len(regions.depths))
        maps = {name: array for name, array in vars(self).items() if name != "lit"}
        if broken.refused.any():
            shown = ~broken.refused[self.segment]
            for name, value in (("depth_m", np.nan), ("depth_pixel_m", np.nan), ("confidence", 0.0)):
                maps[name] = np.where(shown, maps[name], value)
        some = (slice(None, None, 8), slice(None, None, 8))
        figures = doubts.result()
        figures = replace(
            figures,
            warning=broken.warning or figures.warning,
            layers=regions.layers,
            step_px=step,
            pixels=self.lit.size,
            pixels_without_signal=self.lit.size - int(np.count_nonzero(self.lit)),
            pixels_without_texture=int(np.count_nonzero(self.lit & np.isnan(maps["depth_m"]))),
            pixels_broken=int(np.count_nonzero(prepared.twins.bad)),
            contrast_standard_error=_median_relative(self.contrast_error[some], self.contrast[some]),
        )
        return Image4D(
            **maps,
            origin_um=prepared.twins.grid.origin_um,
            pixel_um=prepared.twins.grid.pixel_um,
            segments=_segment_figures(regions, light, broken, step, prepared.levels.read_noise_e),
            figures=figures,
        )


def lit_pixels(prepared: PreparedFrame, sharp: SharpImages) -> NDArray[np.bool_]:
    """Pixels that have light in the sharp images of a frame, or of a part of it: shape (n_y, n_x)."""
    light = window_means(sharp.images[0] + sharp.images[1], 3)
    floor_e = repeated(prepared.sharp_floor_e, prepared.downsampling.step, light.shape)
    return np.asarray(light > floor_e) & ~prepared.twins.bad


@dataclass(frozen=True)
class DepthMaps:
    """Segments and depths on the frame's pixels, as if all of them were lit."""

    segment: NDArray[np.int32]  #: Shape (n_y, n_x), number of the segment; 0 for none.
    depth_m: FloatArray  #: Shape (n_y, n_x), depth of the segment; NaN where none is claimed.
    confidence: FloatArray  #: Shape (n_y, n_x), 0 to 1.
    depth_pixel_m: FloatArray  #: Shape (n_y, n_x), depth from the window about the pixel; NaN where none is claimed.


def depth_maps(
    pixels: PixelDepth,
    regions: Regions,
    step: int,
    shape: tuple[int, int],
    plain_of: Callable[[], PlainPixels] | None = None,
) -> DepthMaps:
    """Segments, depths and confidence on the frame's pixels, shape (n_y, n_x), ``step`` to a downsampled one.

    ``plain_of`` returns the plain pixels, whose own depths do not count; without, those of all pixels do.
    """
    claimed = pixels.claimed & (regions.grown > 0)
    known = regions.grown > 0 if regions.continuous else regions.shown(claimed, WINDOW_PX / step)
    segment_error = np.array([np.inf, *(depth.relative_error for depth in regions.depths)])[regions.grown]
    if not regions.continuous:  # Otherwise the probability of the right depth counts the noise.
        segment_error *= SEGMENTS_SCATTER
    vergence = regions.vergence_per_m(regions.grown)
    right = np.ones(vergence.shape) if regions.right is None else regions.right
    known &= right >= LEAST_RIGHT
    right = right * same_side(vergence, step)
    if not regions.continuous:
        right = np.minimum(right, 1.0 - seen_elsewhere(pixels, regions.grown, vergence, step, plain_of))
    # A window around a pixel of a small object holds mostly light of the object's surroundings.
    agrees = claimed & (np.abs(pixels.vergence_per_m - vergence) < RIGHT_WITHIN * vergence)
    pixel_error = np.where(agrees, pixels.relative_error, np.inf)
    trust = np.where(known, confidence(pixel_error, segment_error, right), 0.0)
    depth_m = np.where(known, 1.0 / vergence, np.nan)
    own = full_depth_m(replace(pixels, claimed=claimed), step, shape)
    brought = on_pixels(regions.grown, step, shape, regions.beyond_px)
    return DepthMaps(brought(regions.grown), brought(depth_m), brought(trust), own)


def empty(shape: tuple[int, ...], frame: RawFrame, reason: str, grid: TwinGrid | None = None) -> Image4D:
    """An image of ``shape`` without any depth, and the reason."""
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
        figures=DecodingFigures(reason=reason),
    )


def _median_relative(error: FloatArray, values: FloatArray) -> float:
    """Median of errors over their values; NaN without any."""
    known = np.isfinite(error) & (values > 0.0)
    return float(np.median(error[known] / values[known])) if known.any() else float("nan")


def _segment_figures(
    regions: Regions, light: SegmentLight, broken: BrokenLight, step: int, read_noise_e: float
) -> tuple[SegmentFigures, ...]:
    """Figures of each segment; its contrast is that of its interior, where deconvolution keeps the light."""
    contrast, error = light.contrast(read_noise_e)
    error = np.hypot(error, contrast * broken.contrast_error)
    return tuple(
        SegmentFigures(
            number=index + 1,
            pixels=int(light.pixels[index]),
            depth_m=1.0 / depth.vergence_per_m,
            slope_x_per_m=depth.plane.slope_per_m[1] / step,
            slope_y_per_m=depth.plane.slope_per_m[0] / step,
            error_m=float(np.hypot(depth.relative_error, broken.depth_error[index])) / depth.vergence_per_m,
            contrast=float(contrast[index]),
            contrast_error=float(error[index]),
            correlation=depth.correlation,
        )
        for index, depth in enumerate(regions.depths)
    )


def _mismatch_figures(volume: CostVolume, prepared: PreparedFrame, regions: Regions) -> DecodingFigures:
    """Mismatch of the twins, and a warning where the calibration does not seem to be the camera's.

    The mismatch is the share of the twins' power that is neither common to both nor noise, where they agree best.
    """
    if not regions.depths:
        return DecodingFigures(warning="the twins agree at no depth: no texture, or another camera's calibration")
    power = np.array([depth.power for depth in regions.depths])
    common = np.array([depth.correlation for depth in regions.depths]) * power
    twins = _TwinPower.of(regions.label, len(power), power, common, volume, prepared)
    mismatches = np.where(twins.texture > 0.0, 1.0 - common / np.maximum(twins.texture, 1e-30), 1.0)
    best = np.argsort(mismatches)
    judged = best[np.searchsorted(np.cumsum(twins.pixels[best]), _JUDGED_SHARE * twins.pixels.sum())]
    mismatch = max(0.0, float(mismatches[judged]))
    if not twins.is_doubted(np.array([judged])) or not _pieces_are_doubted(volume, prepared, regions):
        return DecodingFigures(twin_mismatch=mismatch)
    warning = f"the twins differ by {100.0 * mismatch:.0f} % of their power: is this the camera's calibration?"
    return DecodingFigures(twin_mismatch=mismatch, warning=warning)


@dataclass(frozen=True)
class _TwinPower:
    """Powers of the filtered twins in groups of pixels, arrays of shape (n,); electrons squared."""

    pixels: FloatArray  #: Number of pixels.
    power: FloatArray  #: Geometric mean of both twins.
    common: FloatArray  #: Covariance of the twins.
    texture: FloatArray  #: ``power`` without its noise; 0 where noise explains it.

    @classmethod
    def of(
        cls,
        label: NDArray[np.int32],
        count: int,
        power: FloatArray,
        common: FloatArray,
        volume: CostVolume,
        prepared: PreparedFrame,
    ) -> _TwinPower:
        """Powers of the groups that ``label``, shape (n_y, n_x), numbers from 1 to ``count``; 0 for none."""
        number = label.ravel()
        pixels = np.bincount(number, minlength=count + 1)[1:].astype(np.float64)
        images = np.maximum(prepared.inner, np.float32(0.0))
        sums = np.array([np.bincount(number, image.ravel(), count + 1)[1:] for image in images])
        light: FloatArray = sums / np.maximum(pixels, 1.0)
        noise: FloatArray = volume.noise_gain * (light + prepared.levels.read_noise_e**2)
        return cls(pixels, power, common, power_without_noise(power, light, noise))

    def is_doubted(self, groups: NDArray[np.intp]) -> bool:
        """Whether the twins of some groups together differ by more than a calibration's errors and noise explain."""
        texture, power, common = (
            float((self.pixels * values)[groups].sum()) for values in (self.texture, self.power, self.common)
        )
        return texture > 0.0 and texture - common > _LARGEST_MISMATCH * texture + _MISMATCH_PER_NOISE * (
            power - texture
        )


def _pieces_are_doubted(volume: CostVolume, prepared: PreparedFrame, regions: Regions) -> bool:
    """Whether the twins differ in pieces of segments, too, each pixel at its own depth.

    A segment may hold a curved surface, outlines and unlike contrasts, most of all in a small picture. These spoil its
    correlation behind the right calibration, but not that of all squares of :data:`_PIECE_PX`.
    """
    side = max(1, round(_PIECE_PX / prepared.downsampling.step))
    row, column = (np.arange(n) // side for n in regions.label.shape)
    square = row[:, None] * (column[-1] + 1) + column
    own = np.where(regions.label > 0, regions.label * (square.max() + 1) + square, 0)
    names, piece = np.unique(own, return_inverse=True)
    piece = piece.reshape(own.shape).astype(np.int32) + (names[0] > 0)
    count = int(piece.max())
    vergence = regions.vergence_per_m(regions.label)
    products = volume.at(np.where(np.isfinite(vergence), vergence, volume.vergences_per_m[0])[None])[:, 0]
    sums = [np.bincount(piece.ravel(), one.ravel(), count + 1)[1:] for one in products]
    pixels = np.bincount(piece.ravel(), minlength=count + 1)[1:]
    power = np.sqrt(np.maximum(sums[1], 0.0) * np.maximum(sums[2], 0.0)) / pixels
    twins = _TwinPower.of(piece, count, power, sums[0] / pixels, volume, prepared)
    texture = np.maximum(twins.texture, 1e-30)
    excess = (texture - twins.common - _MISMATCH_PER_NOISE * (power - texture)) / texture
    best = np.argsort(np.where(twins.texture > 0.0, excess, np.inf))
    return twins.is_doubted(best[: np.searchsorted(np.cumsum(pixels[best]), _JUDGED_SHARE * pixels.sum()) + 1])


def power_without_noise(power: FloatArray, light: FloatArray, noise: FloatArray) -> FloatArray:
    """Geometric mean of the twins' powers without their noise, shape (n,), for textures in proportion to their light.

    With r = I_x / I_y the powers are r^2 S + n_x and S + n_y; their product is known and is solved for r S. ``power``,
    shape (n,), is the geometric mean with noise. Mean brightness and power of noise of both images have the shape (2,
    n).
    """
    ratio = np.maximum(light[0], 1e-12) / np.maximum(light[1], 1e-12)
    linear = ratio**2 * noise[1] + noise[0]
    rest = power**2 - noise[0] * noise[1]
    root = np.sqrt(np.maximum(linear**2 + 4.0 * ratio**2 * rest, 0.0))
    return np.where(rest > 0.0, (root - linear) / (2.0 * ratio), 0.0)
