"""Raw frame and PSF calibration -> Image4D."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, uniform_filter

from metafab.camera.frame import RawFrame
from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.progress import Progress, silent
from metafab.decode import segment as segments
from metafab.decode.calibration import Calibration
from metafab.decode.depth import HALF_CONFIDENCE, PixelDepth, pixel_depth
from metafab.decode.filters import BASIS_ERROR, CrossFilters
from metafab.decode.image import Image4D
from metafab.decode.judge import judged
from metafab.decode.levels import Levels
from metafab.decode.reduce import enlarged, repeated
from metafab.decode.restore import Restorer
from metafab.decode.twins import TwinGrid, Twins, extract
from metafab.decode.volume import Volume
from metafab.optics.point_spread import Psf

#: Between so few candidates the agreement is smooth enough for a parabola to find its peak.
_CANDIDATES = 13
#: Layers of the scene are told apart from this share of the calibrated range of vergence.
_LAYER_SHARE = 1.0 / 24.0
#: Side of the narrowest window that says a depth, and how far around a pixel light is let in.
_WINDOW_PX = 28
MARGIN_PX = 36
#: How far from an outline a window, through the pair's main parts, still sees it.
_OUTLINE_REACH_PX = 40
#: Share of the twins' power that they do not have in common, noise taken off, from which the calibration is doubted.
_LARGEST_MISMATCH = 0.05


def decode(frame: RawFrame, psf: Psf, *, progress: Progress = silent) -> Image4D:
    """Depth, all-in-focus polarisation images and their contrast from one frame.

    Depth is claimed only where the twins agree, at a depth inside the calibrated range, and to better than a
    few per cent; everywhere else it is NaN. No frame raises: what cannot be decoded comes back empty, with the
    reason in ``details``.

    Args:
        frame: electrons or counts; saturated and invalid pixels are left out.
        psf: calibration over the depths that are to be found, at least three.
        progress: called after each candidate depth.

    Returns:
        The image on the geometric image grid of the x polarisation. ``nmae`` is the mean of |z - z_true| /
        z_true over pixels with a decoded and a true depth, with the segments' depths. ``details`` has
        ``seconds``, ``nmae_pixel`` (each pixel's own depth), ``share_decoded`` (of the pixels with a true
        depth), ``twin_mismatch`` (share of the twins' power that neither noise nor depth explains), what was
        skipped, and a ``warning`` where the calibration does not seem to be the camera's.
    """
    started = time.perf_counter()
    values = np.asarray(frame.frame)
    if values.ndim != 2 or values.dtype.kind not in "buif":
        return _empty((1, 1), frame, f"not a grey frame (shape {values.shape}, type {values.dtype})", started)
    if psf.depth_m.size < 3:
        return _empty(values.shape, frame, "the calibration holds fewer than three depths", started)
    if abs(frame.pixel_um / psf.pixel_um - 1.0) > 1e-6:
        reason = f"pixels of {frame.pixel_um:g} um, but a calibration for {psf.pixel_um:g} um"
        return _empty(values.shape, frame, reason, started)
    decoder = Decoder.of(psf, values.shape, frame.origin_um, frame.x_window)
    if decoder is None:
        return _empty(values.shape, frame, "the frame does not hold both images", started)
    return decoder(frame, progress=progress)


@dataclass(frozen=True)
class Decoder:
    """A decoder for frames of one shape: what depends on the calibration alone is computed once.

    Attributes:
        calibration: the pair on the grid of the x image.
        filters: what makes the twins equal at each candidate depth.
        restorer: what makes them sharp.
    """

    calibration: Calibration
    filters: CrossFilters
    restorer: Restorer

    @classmethod
    def of(
        cls,
        psf: Psf,
        frame_shape: tuple[int, int],
        origin_um: tuple[float, float],
        x_window: tuple[int, int, int, int] | None = None,
        basis_error: float = BASIS_ERROR,
    ) -> Decoder | None:
        """A decoder, or None if no part of such frames holds both images.

        Args:
            psf: calibration.
            frame_shape: (n_y, n_x) of the frames.
            origin_um: (x, y) on the sensor of pixel [0, 0].
            x_window: (row, column, rows, columns) of the x image; without it, all that has its twin in the frame.
            basis_error: what the mixtures of filters may leave out (relative L2): more is faster, and less exact.
        """
        kernels, image_map = PairKernels(psf), ImageMap.from_psf(psf)
        place = (image_map, frame_shape, origin_um, psf.pixel_um, MARGIN_PX)
        grid = TwinGrid.find(*place) if x_window is None else TwinGrid.at(*place, x_window)
        if grid is None:
            return None
        calibration = Calibration(kernels, grid, image_map)
        vergences = np.linspace(1.0 / psf.depth_m.max(), 1.0 / psf.depth_m.min(), _CANDIDATES)
        return cls(calibration, CrossFilters.of(calibration, vergences, basis_error), Restorer.of(calibration))

    @property
    def nbytes(self) -> int:
        """Memory of what is computed once."""
        grid = self.calibration.grid
        maps = grid.tangent_x.nbytes * 5 + grid.resampler.nbytes
        return self.calibration.stack.nbytes + self.filters.nbytes + self.restorer.nbytes + maps

    def depth_map(self, frame: RawFrame, *, progress: Progress = silent) -> FloatArray:
        """The depth of each pixel by itself, m, and nothing else: NaN where none is claimed."""
        seen = self.look(frame)
        if isinstance(seen, str):
            return np.full(self.calibration.grid.shape, np.nan)
        pixels = self._pixels(seen, self.volume(seen, progress=progress))
        return self._full_depth_m(pixels)

    def __call__(self, frame: RawFrame, *, progress: Progress = silent) -> Image4D:
        """Decode one frame."""
        started = time.perf_counter()
        seen = self.look(frame)
        if isinstance(seen, str):
            return _empty(self.calibration.grid.shape, frame, seen, started, self.calibration.grid)
        return self.finish(frame, seen, self.volume(seen, progress=progress), started=started)

    def look(self, frame: RawFrame, levels: Levels | None = None) -> Seen | str:
        """The twins and what is to be seen of them at once, or why there is nothing.

        Args:
            frame: of the decoder's shape.
            levels: of an earlier frame in the same light; measured by default.
        """
        twins = extract(frame, self.calibration.grid)
        if twins.bad.all():
            return "all pixels are saturated or invalid"
        reduction = self.filters.reduction
        spectra = reduction.spectra(twins.image)
        small = reduction.images(spectra)
        levels = Levels.of(small, frame.read_noise_e) if levels is None else levels
        if levels.signal <= 0.0:
            return "there is no light in the frame"
        inner = small[:, *reduction.inner]
        return Seen(twins, levels, spectra, small, inner, inner.sum(axis=0) > _floor(levels))

    def _pixels(self, seen: Seen, volume: Volume) -> PixelDepth:
        window = round(_WINDOW_PX / self.filters.reduction.every) | 1
        mean = np.stack([uniform_filter(image, window) for image in seen.inner])
        variance = np.maximum(mean, 0.0) + seen.levels.read_noise_e**2 + 1e-9 * seen.levels.noise_variance
        pixels = pixel_depth(volume, window, variance)
        reach = _OUTLINE_REACH_PX // self.filters.reduction.every
        # The outline of a uniform object has no texture either: what lies behind it would be mixed in.
        kept = segments.textured_parts(seen.lit, self._uneven(seen), reach)
        near = distance_transform_edt(~kept) <= window // 2 if kept.any() else kept
        return PixelDepth(pixels.vergence_per_m, pixels.relative_error, pixels.claimed & near)

    def _uneven(self, seen: Seen) -> NDArray[np.bool_]:
        """Where the brightness of either image varies over a window by more than its noise."""
        window = round(_WINDOW_PX / self.filters.reduction.every) | 1
        mean, square = (uniform_filter(part, (0, window, window)) for part in (seen.inner, seen.inner**2))
        noise = self.filters.reduction.variance_left * (np.maximum(mean, 0.0) + seen.levels.read_noise_e**2)
        # The mean square of n nearly independent deviations is 1 +- sqrt(2 / n) of their variance.
        return np.asarray((square - mean**2 > noise * (1.0 + 6.0 * np.sqrt(2.0) / window)).any(axis=0))

    def _full_depth_m(self, pixels: PixelDepth) -> FloatArray:
        """Depth on the frame's pixels, NaN where none is claimed."""
        shape, every = self.calibration.grid.shape, self.filters.reduction.every
        vergence = enlarged(pixels.vergence_per_m.astype(np.float32), every, shape)
        depth_m = 1.0 / np.maximum(vergence, 1e-12).astype(np.float64)
        depth_m[~repeated(pixels.claimed, every, shape)] = np.nan
        return depth_m

    def volume(
        self,
        seen: Seen,
        changed: NDArray[np.bool_] | None = None,
        last: Volume | None = None,
        progress: Progress = silent,
    ) -> Volume:
        """Agreement of the twins over depth; with ``last``, that is kept in tiles where nothing ``changed``."""
        where = seen.lit if last is None or changed is None else changed
        return self.filters.volume(seen.spectra, seen.levels, where, progress, last)

    def finish(
        self,
        frame: RawFrame,
        seen: Seen,
        volume: Volume,
        changed: NDArray[np.bool_] | None = None,
        last: Image4D | None = None,
        *,
        started: float | None = None,
    ) -> Image4D:
        """Depth, segments and sharp images; with ``last``, its brightness is kept where nothing ``changed``."""
        started = time.perf_counter() if started is None else started
        pixels = self._pixels(seen, volume)
        every, shape = self.filters.reduction.every, self.calibration.grid.shape
        layers, found, small, near = self._segments(seen, volume, pixels)
        segment = repeated(near, every, shape)
        wide = segments.grown(small, float(sum(small.shape))) if found else np.ones_like(small)
        wide = np.where(binary_dilation(seen.lit, iterations=2), wide, 0)
        vergences = np.array([depth.vergence_per_m for depth in found] or [float(np.median(volume.vergences_per_m))])
        label = repeated(wide, every, shape)
        if last is not None and changed is not None:
            anew = repeated(changed, every, shape)
            images = self.restorer(seen.twins.image, seen.levels, np.where(anew, label, 0), vergences)
            for sharp, before in zip(images, (last.intensity_x, last.intensity_y), strict=True):
                np.copyto(sharp, before, where=~anew, casting="same_kind")
        else:
            images = self.restorer(seen.twins.image, seen.levels, label, vergences)
        lit = _lit(images, seen.levels) & ~seen.twins.bad
        segment = np.where(lit, segment, 0).astype(np.int32)
        claimed = pixels.claimed & (near > 0)
        about = distance_transform_edt(~claimed) <= _WINDOW_PX / every if claimed.any() else claimed
        known = (segment > 0) & repeated(about, every, shape)
        by_segment = np.array([np.nan, *(1.0 / vergences if found else [])])
        depth_m = np.where(known, by_segment[segment], np.nan)
        error = repeated(np.where(claimed, pixels.relative_error, np.inf), every, shape)
        if found:
            error = np.minimum(error, np.array([np.inf, *(depth.relative_error for depth in found)])[segment])
        confidence = np.where(known, 1.0 / (1.0 + (error / HALF_CONFIDENCE) ** 2), 0.0)
        pixel_m = self._full_depth_m(PixelDepth(pixels.vergence_per_m, pixels.relative_error, claimed))
        pixel_m[~lit] = np.nan
        contrast = np.full(shape, np.nan)
        np.divide(images[0], images[1], out=contrast, where=lit & (images[1] > 0.0))
        mismatch = _mismatch(volume, seen, small, found)
        details: dict[str, float | str] = {
            "layers": float(layers),
            "basis_images": float(self.filters.basis.shape[1]),
            "step_px": float(every),
            "pixels": float(lit.size),
            "pixels_without_signal": float((~lit).sum()),
            "pixels_without_texture": float((lit & ~known).sum()),
            "pixels_broken": float(seen.twins.bad.sum()),
        }
        if mismatch is None:
            details["warning"] = "the twins agree at no depth: no texture, or another camera's calibration"
        else:
            details["twin_mismatch"] = mismatch
            if mismatch > _LARGEST_MISMATCH:
                details["warning"] = (
                    f"the twins differ by {mismatch:.0%} of their power: is this the camera's calibration?"
                )
        image = Image4D(
            images[0].astype(np.float64),
            images[1].astype(np.float64),
            contrast,
            depth_m,
            confidence,
            segment,
            seen.twins.grid.origin_um,
            frame.pixel_um,
            tuple(_row(number, depth, segment, small, images, every) for number, depth in enumerate(found, start=1)),
            pixel_m,
            details=details,
        )
        return judged(image, frame, seconds=time.perf_counter() - started)

    def _segments(
        self, seen: Seen, volume: Volume, pixels: PixelDepth
    ) -> tuple[int, list[segments.SegmentDepth], NDArray[np.int32], NDArray[np.int32]]:
        """Number of layers, depth of each segment, the segments, and those grown over their outlines' pixels."""
        every = self.filters.reduction.every
        candidates = volume.vergences_per_m
        separation = float(candidates[-1] - candidates[0]) * _LAYER_SHARE
        layers = segments.depth_layers(pixels, separation)
        found: list[segments.SegmentDepth] = []
        small = np.zeros(volume.parts.shape[-2:], dtype=np.int32)
        unseen = np.zeros(small.shape, dtype=bool)
        if layers.size:
            layer = segments.assign(volume, layers, pixels, separation, every)
            parts = segments.split(layer, seen.lit, _WINDOW_PX, every)
            uneven = self._uneven(seen)
            for number in range(1, int(parts.max(initial=0)) + 1):
                mask = parts == number
                depth = segments.segment_depth(volume, segments.interior(parts, number, every))
                textured = segments.textured(mask, uneven, _OUTLINE_REACH_PX // every)
                if textured and depth.relative_error < 4.0 * HALF_CONFIDENCE and depth.correlation > 0.0:
                    found.append(depth)
                    small[mask] = len(found)
                elif not textured:
                    unseen |= mask
        near = segments.grown(small, _WINDOW_PX / every)
        if unseen.any():
            away = distance_transform_edt(~unseen)
            near[(away <= _WINDOW_PX / every) & (small == 0)] = 0
        return layers.size, found, small, near


@dataclass(frozen=True)
class Seen:
    """A frame at first sight.

    Attributes:
        twins: both images.
        levels: their noise and texture.
        spectra: transforms of every few pixels of them.
        small: those pixels, with margin.
        inner: the same without margin.
        lit: where there is light, shape of ``inner``.
    """

    twins: Twins
    levels: Levels
    spectra: NDArray[np.complex64]
    small: NDArray[np.float32]
    inner: NDArray[np.float32]
    lit: NDArray[np.bool_]


def _row(
    number: int,
    depth: segments.SegmentDepth,
    segment: NDArray[np.int32],
    small: NDArray[np.int32],
    images: NDArray[np.float32],
    every: int,
) -> dict[str, float]:
    inner = repeated(segments.interior(small, number, every), every, segment.shape) & (segment == number)
    return {
        "number": float(number),
        "pixels": float((segment == number).sum()),
        "depth_m": 1.0 / depth.vergence_per_m,
        "error_m": depth.relative_error / depth.vergence_per_m,
        "contrast": float(images[0][inner].sum() / max(float(images[1][inner].sum()), 1e-30)),
        "correlation": depth.correlation,
    }


def _mismatch(volume: Volume, seen: Seen, small: NDArray[np.int32], found: list[segments.SegmentDepth]) -> float | None:
    """Share of the twins' power that is neither common to both nor noise, over all segments; None without any."""
    if not found:
        return None
    inside = small > 0
    mean = np.maximum(seen.inner[:, inside], 0.0).mean(axis=1) + seen.levels.read_noise_e**2
    noise = volume.noise_gain * float(np.sqrt(mean[0] * mean[1]))
    weights = np.array([float((small == number).sum()) for number in range(1, len(found) + 1)])
    common = float(np.average([depth.correlation * depth.power for depth in found], weights=weights))
    power = float(np.average([depth.power for depth in found], weights=weights))
    return max(0.0, 1.0 - common / max(power - noise, 1e-30)) if power > noise else 1.0


def _floor(levels: Levels) -> float:
    """Light of both polarisations below which a pixel is dark, electrons."""
    return max(0.35 * levels.signal, 6.0 * levels.read_noise_e)


def _lit(images: NDArray[np.float32], levels: Levels) -> NDArray[np.bool_]:
    """Pixels with light of either polarisation."""
    total = uniform_filter(images.sum(axis=0), 3, mode="nearest")
    return np.asarray(total > _floor(levels))


def _empty(
    shape: tuple[int, ...], frame: RawFrame, reason: str, started: float, grid: TwinGrid | None = None
) -> Image4D:
    """No depth anywhere, and why."""
    dark, unknown = np.zeros(shape), np.full(shape, np.nan)
    image = Image4D(
        dark,
        dark.copy(),
        unknown,
        unknown.copy(),
        dark.copy(),
        np.zeros(shape, dtype=np.int32),
        frame.origin_um if grid is None else grid.origin_um,
        frame.pixel_um,
        depth_pixel_m=unknown.copy(),
        details={"reason": reason},
    )
    return judged(image, frame, seconds=time.perf_counter() - started)
