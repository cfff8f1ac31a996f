"""Raw frame and PSF calibration -> Image4D."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, uniform_filter

from metafab.camera.frame import RawFrame
from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.progress import Progress, silent
from metafab.decode import segment as segments
from metafab.decode.align import Aligner
from metafab.decode.calibration import Calibration, Transfer
from metafab.decode.depth import HALF_CONFIDENCE, PixelDepth, pixel_depth
from metafab.decode.image import Image4D
from metafab.decode.judge import judged
from metafab.decode.levels import Levels
from metafab.decode.restore import composed, sharpened
from metafab.decode.twins import TwinGrid, Twins, extract
from metafab.optics.point_spread import Psf

_CANDIDATES = 25
_WINDOW_PX = 25
#: How far around a window light is let in: the reach of the pair's main parts, and as much again to fade out.
_MARGIN_PX = 40
_WHITENING_PIXELS = 0.75  # windows reach across outlines
_WHITENING_SEGMENTS = 0.25  # segments keep away from them


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
        depth) and what was skipped.
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
        calibration: transfer functions of the pair on the grid of the x image.
    """

    calibration: Calibration

    @classmethod
    def of(
        cls,
        psf: Psf,
        frame_shape: tuple[int, int],
        origin_um: tuple[float, float],
        x_window: tuple[int, int, int, int] | None = None,
    ) -> Decoder | None:
        """A decoder, or None if no part of such frames holds both images.

        Args:
            psf: calibration.
            frame_shape: (n_y, n_x) of the frames.
            origin_um: (x, y) on the sensor of pixel [0, 0].
            x_window: (row, column, rows, columns) of the x image; without it, all that has its twin in the frame.
        """
        kernels, image_map = PairKernels(psf), ImageMap.from_psf(psf)
        place = (image_map, frame_shape, origin_um, psf.pixel_um, _MARGIN_PX)
        grid = TwinGrid.find(*place) if x_window is None else TwinGrid.at(*place, x_window)
        return None if grid is None else cls(Calibration.of(kernels, grid, image_map))

    @cached_property
    def vergences_per_m(self) -> FloatArray:
        """Candidate depths, equally spaced in vergence over the calibrated range."""
        depth_m = self.calibration.kernels.psf.depth_m
        return np.linspace(1.0 / depth_m.max(), 1.0 / depth_m.min(), _CANDIDATES)

    def __call__(self, frame: RawFrame, *, progress: Progress = silent) -> Image4D:
        """Decode one frame."""
        started = time.perf_counter()
        twins = extract(frame, self.calibration.grid)
        levels = Levels.of(twins.image, frame.read_noise_e)
        if levels.signal <= 0.0 or twins.bad.all():
            reason = "all pixels are saturated or invalid" if twins.bad.all() else "there is no light in the frame"
            return _empty(self.calibration.grid.shape, frame, reason, started, self.calibration.grid)
        tiling = self.calibration.tiling
        spectra = np.stack([scipy.fft.rfft2(tiling.cut(image)) for image in twins.image])
        pixels = self._pixels(twins, spectra, levels, progress)
        return self._finish(frame, twins, spectra, levels, pixels, started)

    def _pixels(self, twins: Twins, spectra: Transfer, levels: Levels, progress: Progress) -> PixelDepth:
        aligner = Aligner.of(spectra, self.calibration, levels, _WHITENING_PIXELS)
        inner = (slice(None), *twins.grid.inner)
        mean = np.stack([uniform_filter(image, _WINDOW_PX) for image in twins.image])[inner]
        variance = np.maximum(mean, 0.0) + levels.read_noise_e**2 + 1e-9 * levels.noise_variance
        pixels = pixel_depth(aligner, self.vergences_per_m, _WINDOW_PX, variance, progress)
        return PixelDepth(pixels.vergence_per_m, pixels.relative_error, pixels.claimed & ~twins.bad)

    def _finish(
        self, frame: RawFrame, twins: Twins, spectra: Transfer, levels: Levels, pixels: PixelDepth, started: float
    ) -> Image4D:
        candidates = self.vergences_per_m
        step = float(candidates[1] - candidates[0])
        layers = segments.depth_layers(pixels, step)
        usable = layers if layers.size else np.array([float(np.median(candidates))])
        aligner = Aligner.of(spectra, self.calibration, levels, _WHITENING_PIXELS)
        layer = segments.assign(aligner, usable, pixels, step)
        sharp = {i + 1: sharpened(spectra, self.calibration, levels, float(v)) for i, v in enumerate(usable)}
        images = composed(sharp, layer)
        lit = _lit(images, levels) & ~twins.bad
        segment = np.zeros(layer.shape, dtype=np.int32)
        if layers.size:
            segment = segments.grown(segments.split(layer, lit), lit, _WINDOW_PX)
        aligner = Aligner.of(spectra, self.calibration, levels, _WHITENING_SEGMENTS)
        limits = float(candidates[0]), float(candidates[-1])
        depth_m, rows = np.full(layer.shape, np.nan), []
        confidence = 1.0 / (1.0 + (pixels.relative_error / HALF_CONFIDENCE) ** 2)
        textured = distance_transform_edt(~pixels.claimed) <= _WINDOW_PX if pixels.claimed.any() else pixels.claimed
        for number in range(1, int(segment.max(initial=0)) + 1):
            mask = segment == number
            start = float(usable[np.bincount(layer[mask]).argmax() - 1])
            found = segments.segment_depth(aligner, mask, start, step, limits)
            if not found.relative_error < 4.0 * HALF_CONFIDENCE or found.correlation <= 0.0:
                segment[mask] = 0
                continue
            depth_m[mask & textured] = 1.0 / found.vergence_per_m
            confidence[mask] = np.maximum(
                confidence[mask], 1.0 / (1.0 + (found.relative_error / HALF_CONFIDENCE) ** 2) * textured[mask]
            )
            layer_image = sharpened(spectra, self.calibration, levels, found.vergence_per_m)
            np.copyto(images, np.maximum(layer_image, 0.0), where=mask)
            inner = segments.interior(mask)
            rows.append(
                {
                    "number": float(number),
                    "pixels": float(mask.sum()),
                    "depth_m": 1.0 / found.vergence_per_m,
                    "error_m": found.relative_error / found.vergence_per_m,
                    "contrast": float(images[0][inner].sum() / max(images[1][inner].sum(), 1e-30)),
                    "correlation": found.correlation,
                }
            )
        pixel_m = np.where(pixels.claimed & lit, 1.0 / np.maximum(pixels.vergence_per_m, 1e-12), np.nan)
        contrast = np.full(layer.shape, np.nan)
        np.divide(images[0], images[1], out=contrast, where=lit & (images[1] > 0.0))
        claimed = np.isfinite(depth_m)
        image = Image4D(
            images[0],
            images[1],
            contrast,
            depth_m,
            np.where(claimed, confidence, 0.0),
            segment,
            twins.grid.origin_um,
            frame.pixel_um,
            tuple(rows),
            pixel_m,
            details={
                "layers": float(layers.size),
                "tiles": float(len(self.calibration.tiling.starts)),
                "pixels": float(layer.size),
                "pixels_without_signal": float((~lit).sum()),
                "pixels_without_texture": float((lit & ~claimed).sum()),
                "pixels_broken": float(twins.bad.sum()),
            },
        )
        return judged(image, frame, seconds=time.perf_counter() - started)


def _lit(images: FloatArray, levels: Levels) -> NDArray[np.bool_]:
    """Pixels with light of either polarisation."""
    total = uniform_filter(images.sum(axis=0), 3, mode="nearest")
    return np.asarray(total > max(0.35 * levels.signal, 6.0 * levels.read_noise_e))


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
