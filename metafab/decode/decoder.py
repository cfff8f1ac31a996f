"""Raw frame and PSF calibration -> Image4D."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from metafab.camera.frames.frame import RawFrame
from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import kept_threads
from metafab.core.parallel.progress import Progress, silent
from metafab.decode.evaluation.metrics import judged
from metafab.decode.image import Image4D
from metafab.decode.images.compose import Pictures, empty, full_depth_m, lit_about, sharpened
from metafab.decode.images.deconvolution import Restorer, Sharp
from metafab.decode.matching.cost_volume import Volume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.matching.filters import BASIS_ERROR, CrossFilters
from metafab.decode.matching.levels import Levels
from metafab.decode.registration.calibration import Calibration
from metafab.decode.registration.reduce import repeated
from metafab.decode.registration.twins import TwinGrid
from metafab.decode.segmentation.frame_statistics import Seen
from metafab.decode.segmentation.regions import Regions, find_regions, textured_pixels
from metafab.optics.point_spread import Psf

#: Between so few candidates the agreement is smooth enough for its peak to be found: by a spline for segments, and by a
#: parabola for pixels, whose noise is larger than what that is off.
_CANDIDATES = 13
#: How far around a pixel light is let in.
MARGIN_PX = 36


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
        return _nothing((1, 1), frame, f"not a grey frame (shape {values.shape}, type {values.dtype})", started)
    if psf.depth_m.size < 3:
        return _nothing(values.shape, frame, "the calibration holds fewer than three depths", started)
    if not np.isfinite([*frame.origin_um, frame.read_noise_e]).all() or not frame.holds_window:
        return _nothing(values.shape, frame, "the frame's place, noise or window make no sense", started)
    if not abs(frame.pixel_um / psf.pixel_um - 1.0) <= 1e-6:
        reason = f"pixels of {frame.pixel_um:g} um, but a calibration for {psf.pixel_um:g} um"
        return _nothing(values.shape, frame, reason, started)
    decoder = Decoder.of(psf, values.shape, frame.origin_um, frame.x_window)
    if decoder is None:
        return _nothing(values.shape, frame, "the frame does not hold both images", started)
    return decoder(frame, progress=progress)


@dataclass(frozen=True)
class Decoder:
    """A decoder for frames of one shape: what depends on the calibration alone is computed once.

    For one Python thread at a time: Numba's ``workqueue`` layer ends a process in which two start parallel loops at
    once, and what is kept between frames is not locked.

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
        with kept_threads():
            seen = self.look(frame)
            if isinstance(seen, str):
                return np.full(self.calibration.grid.shape, np.nan)
            pixels = textured_pixels(seen, self.volume(seen, progress=progress))
        return full_depth_m(pixels, self.filters.reduction.every, self.calibration.grid.shape)

    def __call__(self, frame: RawFrame, *, progress: Progress = silent) -> Image4D:
        """Decode one frame."""
        started = time.perf_counter()
        with kept_threads():
            seen = self.look(frame)
            if isinstance(seen, str):
                return _nothing(self.calibration.grid.shape, frame, seen, started, self.calibration.grid)
            found = self.finish(frame, seen, self.volume(seen, progress=progress))
        return judged(found.image, frame, seconds=time.perf_counter() - started)

    def look(self, frame: RawFrame, levels: Levels | None = None) -> Seen | str:
        """The twins and what is to be seen of them at once, or why there is nothing.

        Args:
            frame: of the decoder's shape.
            levels: of an earlier frame in the same light; measured by default.
        """
        grid, values = self.calibration.grid, np.asarray(frame.frame)
        pitch_um = self.calibration.kernels.psf.pixel_um
        if not abs(frame.pixel_um / pitch_um - 1.0) <= 1e-6:
            return f"pixels of {frame.pixel_um:g} um, but a decoder for {pitch_um:g} um"
        away_um = np.subtract(frame.origin_um, self._frame_origin_um)
        if not np.abs(away_um).max() <= 1e-3 * pitch_um:
            return (
                f"the frame starts at {frame.origin_um} um on the sensor, the decoder is for {self._frame_origin_um} um"
            )
        if values.shape != grid.frame_shape or values.dtype.kind not in "buif":
            return f"expected a grey frame of {grid.frame_shape}, got one of {values.shape}, {values.dtype}"
        return Seen.of(frame, grid, self.filters.reduction, levels)

    @property
    def _frame_origin_um(self) -> tuple[float, float]:
        """(x, y) on the sensor of pixel [0, 0] of the frames that it is made for."""
        grid, pitch_um = self.calibration.grid, self.calibration.kernels.psf.pixel_um
        (x, y), m = grid.origin_um, grid.margin
        return x - pitch_um * (grid.column + m), y - pitch_um * (grid.row + m)

    def volume(self, seen: Seen, progress: Progress = silent) -> Volume:
        """Agreement of the twins over depth."""
        return self.filters.volume(seen.spectra, seen.levels, seen.lit, progress)

    def finish(self, frame: RawFrame, seen: Seen, volume: Volume) -> Decoded:
        """Depth, segments and sharp images."""
        every, shape = self.filters.reduction.every, self.calibration.grid.shape
        with kept_threads() as beside:
            # Loops over all threads are left to this one: not every threading layer lets two start them at once.
            tiles = beside.submit(self.restorer.transformed, seen.twins.image, repeated(lit_about(seen), every, shape))
            pixels = textured_pixels(seen, volume)
            regions = find_regions(seen, volume, pixels)
        sharp = sharpened(seen, regions, self.restorer, tiles.result(), volume.vergences_per_m)
        return self.put_together(frame, seen, volume, pixels, regions, sharp, Pictures.of(seen, pixels, regions, sharp))

    def put_together(
        self,
        frame: RawFrame,
        seen: Seen,
        volume: Volume,
        pixels: PixelDepth,
        regions: Regions,
        sharp: Sharp,
        pictures: Pictures,
    ) -> Decoded:
        """A frame of which all is known."""
        image = pictures.image(frame, seen, volume, regions, sharp, self.filters.kernels.shape[1])
        return Decoded(seen, volume, pixels, regions, sharp, pictures, image)


@dataclass(frozen=True)
class Decoded:
    """A frame, and all that was found on the way to its image."""

    seen: Seen
    volume: Volume
    pixels: PixelDepth
    regions: Regions
    sharp: Sharp
    pictures: Pictures
    image: Image4D


def _nothing(
    shape: tuple[int, ...], frame: RawFrame, reason: str, started: float, grid: TwinGrid | None = None
) -> Image4D:
    """No depth anywhere, and why."""
    return judged(empty(shape, frame, reason, grid), frame, seconds=time.perf_counter() - started)
