"""Decoder: RawFrame and PSF calibration -> Image4D."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np

from metafab.camera.frames.frame import RawFrame
from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.executor import kept_threads, one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.decode.evaluation import evaluated
from metafab.decode.image import Image4D
from metafab.decode.images.compose import PixelMaps, empty, focus_depths, full_depth_m, lit_pixels
from metafab.decode.images.contrast_outlines import moved_outlines
from metafab.decode.images.deconvolution import KEPT_BYTES, Deconvolver, SharpImages, TileSpectra
from metafab.decode.images.frame_outlines import outlines_by_frame
from metafab.decode.images.light_outlines import outlines_at_edges
from metafab.decode.images.own_depths import plain_pixels
from metafab.decode.images.shortest_outlines import shortest_outlines
from metafab.decode.images.surface_edges import surface_at_edges
from metafab.decode.images.unmixing import Unmixing
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.matching.filters import CrossFilters
from metafab.decode.registration.calibration import Calibration
from metafab.decode.registration.downsampling import repeated
from metafab.decode.registration.twins import TwinGrid
from metafab.decode.segmentation.assignment import SegmentationNumerics
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.objects.plain_behind import PlainPixels, plain_behind_doubted
from metafab.decode.segmentation.objects.plain_parts import plain_parts_judged
from metafab.decode.segmentation.outlines import ROUNDS
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.regions import find_regions, textured_pixel_depth
from metafab.decode.segmentation.segments import Regions
from metafab.optics.point_spread import Psf

#: Number of candidate depths. The peak of the correlation is interpolated between them: by a spline for segments, by a
#: parabola for pixels, where noise exceeds the error of the parabola.
_CANDIDATES = 13
#: Margin around the decoded window from which blur comes in, pixels.
MARGIN_PX = 36


@dataclass(frozen=True)
class DecoderNumerics:
    """Numerics of a decoder."""

    #: Relative L2 error of the low-rank basis of the matched filters; a larger one is faster.
    basis_error: float = 0.02
    compensate_space_variance: bool = True  #: Whether to correct the filters for the pair's change over the field.
    outline_rounds: int = ROUNDS  #: Most rounds of the refinement of outlines.
    #: Whether to separate layers by noise, leave outliers out of segments' depths, and move outlines to where the
    #: contrast changes; without, decoding is faster.
    refined: bool = True
    #: Whether, if ``refined``, a model of the frame with occlusion refines outlines of segments, small objects and bars
    #: are searched, and wide plain parts of segments have no depth where nothing shows it.
    modelled: bool = True
    kept_bytes: int = KEPT_BYTES  #: Most memory of the transfer functions that are kept for the next frame.
    #: Pixels from one compared pixel to the next; None for the largest step that keeps the information about depth
    #: (:func:`metafab.decode.matching.filters.coarsest_step`).
    step_px: int | None = None

    @property
    def segmentation(self) -> SegmentationNumerics:
        """Numerics of the segmentation."""
        return SegmentationNumerics(self.outline_rounds, self.refined)


#: Numerics of ``metafab decode --fast``.
FAST = DecoderNumerics(refined=False)


def decode(
    frame: RawFrame, psf: Psf, *, numerics: DecoderNumerics | None = None, progress: Progress = silent
) -> Image4D:
    """Decode depth, all-in-focus polarisation images and their contrast from one frame.

    A depth is claimed only where the twins correlate, at a depth inside the calibrated range, and to better than a few
    per cent; everywhere else it is NaN. No frame raises: one that cannot be decoded gives an empty image, with the
    reason in its ``figures``. Saturated and invalid pixels are left out.

    ``psf`` is the calibration over the depths that are to be measured, at least three. The image stands on the
    geometric image grid of the x polarisation. InputError for an array in place of a frame, whose pixels and place on
    the sensor it lacks.
    """
    started = time.perf_counter()
    if not isinstance(frame, RawFrame):
        expected = "a RawFrame, of `metafab.camera.load` or RawFrame(array, pixel_um, origin_um, read_noise_e)"
        raise InputError.single("decode", "frame", expected, f"{type(frame).__name__}")
    values = np.asarray(frame.frame)
    if values.ndim != 2 or values.dtype.kind not in "buif":
        return _empty((1, 1), frame, f"not a grey frame (shape {values.shape}, type {values.dtype})", started)
    if psf.depth_m.size < 3:
        return _empty(values.shape, frame, "the calibration holds fewer than three depths", started)
    if not np.isfinite([*frame.origin_um, frame.read_noise_e]).all() or not frame.holds_window:
        return _empty(values.shape, frame, "the frame's place, noise or window make no sense", started)
    if not abs(frame.pixel_um / psf.pixel_um - 1.0) <= 1e-6:
        reason = f"pixels of {frame.pixel_um:g} um, but a calibration for {psf.pixel_um:g} um"
        return _empty(values.shape, frame, reason, started)
    decoder = Decoder.of(psf, values.shape, frame.origin_um, frame.x_window, numerics)
    if decoder is None:
        return _empty(values.shape, frame, "the frame does not hold both images", started)
    return decoder(frame, progress=progress)


@dataclass(frozen=True)
class MatchedFrame:
    """A frame whose twins are compared over depth."""

    prepared: PreparedFrame  #: Registered twins.
    volume: CostVolume  #: Cost volume over the candidate depths.
    #: Returns the cost volume by filters that keep textures in their place; computed once, with the first continuous
    #: surface.
    volume_in_place: Callable[[], CostVolume]


@dataclass(frozen=True)
class DecodedFrame:
    """All results of which a frame's 4D image is made."""

    prepared: PreparedFrame  #: Registered twins.
    volume: CostVolume  #: Cost volume.
    pixels: PixelDepth  #: Depth of each pixel.
    regions: Regions  #: Segments.
    sharp: SharpImages  #: All-in-focus images.
    maps: PixelMaps  #: Arrays of the 4D image.
    plain: PlainPixels | None = None  #: Pixels whose sharp images show no texture; None where that is not asked.


@dataclass(frozen=True)
class Decoder:
    """A decoder for frames of one shape; everything that depends on the calibration alone is computed once.

    For one Python thread at a time: the transforms that are kept between frames are not locked.
    """

    calibration: Calibration  #: The pair on the grid of the x image.
    filters: CrossFilters  #: Matched filters of each candidate depth.
    deconvolver: Deconvolver  #: Wiener filters.
    numerics: DecoderNumerics = DecoderNumerics()  #: Numerics.

    @classmethod
    @one_blas_thread()
    def of(
        cls,
        psf: Psf,
        frame_shape: tuple[int, int],
        origin_um: tuple[float, float],
        x_window: tuple[int, int, int, int] | None = None,
        numerics: DecoderNumerics | None = None,
    ) -> Decoder | None:
        """A decoder, or None if no part of frames of the shape ``frame_shape`` holds both images.

        ``origin_um`` is (x, y) on the sensor of pixel [0, 0]; ``x_window`` is (row, column, rows, columns) of the x
        image, by default all pixels whose twins are in the frame.
        """
        numerics = numerics or DecoderNumerics()
        kernels, image_map = PairKernels.of_unpolarised(psf), ImageMap.from_psf(psf)
        place = (image_map, frame_shape, origin_um, psf.pixel_um, MARGIN_PX)
        grid = TwinGrid.find(*place) if x_window is None else TwinGrid.at(*place, x_window)
        if grid is None:
            return None
        calibration = Calibration(kernels, grid, image_map)
        vergences = np.linspace(1.0 / psf.depth_m.max(), 1.0 / psf.depth_m.min(), _CANDIDATES)
        filters = CrossFilters.of(
            calibration,
            vergences,
            numerics.basis_error,
            compensate=numerics.compensate_space_variance,
            step=numerics.step_px,
        )
        unmixing = Unmixing.of(psf, grid)
        return cls(calibration, filters, Deconvolver.of(calibration, numerics.kept_bytes, unmixing), numerics)

    @property
    def nbytes(self) -> int:
        """Memory of everything that is kept between frames."""
        grid = self.calibration.grid
        maps = grid.tangent_x.nbytes * 5 + grid.resampler.nbytes
        optics = self.layer_optics.nbytes if "layer_optics" in vars(self) else 0
        filters = self.filters.nbytes + (self.filters_in_place.nbytes if "filters_in_place" in vars(self) else 0)
        return self.calibration.stack.nbytes + filters + self.deconvolver.nbytes + optics + maps

    def depth_map(self, frame: RawFrame) -> FloatArray:
        """Depth of each pixel from the window around it, without segments: shape (n_y, n_x), m; NaN for none."""
        with kept_threads():
            prepared = self.prepare(frame)
            if isinstance(prepared, str):
                return np.full(self.calibration.grid.shape, np.nan)
            pixels = textured_pixel_depth(prepared, self.match(prepared).volume)
        return full_depth_m(pixels, self.filters.downsampling.step, self.calibration.grid.shape)

    def __call__(self, frame: RawFrame, *, progress: Progress = silent) -> Image4D:
        """Decode one frame; see :func:`decode`."""
        started = time.perf_counter()
        with kept_threads():
            prepared = self.prepare(frame)
            if isinstance(prepared, str):
                return _empty(self.calibration.grid.shape, frame, prepared, started, self.calibration.grid)
            image = self.image(self.complete(self.match(prepared, progress)))
        return evaluated(image, frame, seconds=time.perf_counter() - started)

    def prepare(self, frame: RawFrame) -> PreparedFrame | str:
        """Register and downsample a frame of the decoder's shape, or return the reason why it cannot be decoded."""
        grid, values = self.calibration.grid, np.asarray(frame.frame)
        if not abs(frame.pixel_um / grid.pixel_um - 1.0) <= 1e-6:
            return f"pixels of {frame.pixel_um:g} um, but a decoder for {grid.pixel_um:g} um"
        origin_um = (
            grid.origin_um[0] - grid.pixel_um * (grid.column + grid.margin),
            grid.origin_um[1] - grid.pixel_um * (grid.row + grid.margin),
        )
        if not np.abs(np.subtract(frame.origin_um, origin_um)).max() <= 1e-3 * grid.pixel_um:
            return f"the frame starts at {frame.origin_um} um on the sensor, the decoder is for {origin_um} um"
        if values.shape != grid.frame_shape or values.dtype.kind not in "buif":
            return f"expected a grey frame of {grid.frame_shape}, got one of {values.shape}, {values.dtype}"
        return PreparedFrame.of(frame, grid, self.filters.downsampling, self.calibration.spill)

    def match(self, prepared: PreparedFrame, progress: Progress = silent) -> MatchedFrame:
        """Compare the twins over the candidate depths."""
        compared = prepared.spectra, prepared.levels, prepared.lit
        in_place = cache(lambda: self.filters_in_place.volume(*compared, silent))
        return MatchedFrame(prepared, self.filters.volume(*compared, progress), in_place)

    @cached_property
    def layer_optics(self) -> LayerOptics:
        """The pair on the downsampled pixels, for the model of the frame along outlines and for small objects."""
        return LayerOptics.of(self.calibration, self.filters.downsampling)

    @cached_property
    def filters_in_place(self) -> CrossFilters:
        """Filters that keep textures in their place, for continuous surfaces; computed with the first one."""
        numerics, vergences, step = self.numerics, self.filters.vergences_per_m, self.filters.downsampling.step
        compensate = numerics.compensate_space_variance
        with one_blas_thread():
            return CrossFilters.of(
                self.calibration, vergences, numerics.basis_error, compensate=compensate, step=step, in_place=True
            )

    def complete(self, matched: MatchedFrame) -> DecodedFrame:
        """Depths, segments and sharp images of a frame."""
        with kept_threads() as pool:
            tiles = pool.submit(self.tile_spectra, matched.prepared)
            pixels, regions = self.segment(matched)
        return self.sharpen(matched, pixels, regions, tiles.result())

    def tile_spectra(self, prepared: PreparedFrame) -> TileSpectra:
        """Transforms of the tiles of a frame that are deconvolved."""
        near_light = repeated(prepared.near_light, self.filters.downsampling.step, self.calibration.grid.shape)
        return self.deconvolver.tile_spectra(prepared.twins.image, near_light)

    def segment(self, matched: MatchedFrame, *, surfaces: bool = True) -> tuple[PixelDepth, Regions]:
        """Depth of each pixel, and segments; ``surfaces``: whether continuous surfaces are sought."""
        prepared, volume = matched.prepared, matched.volume
        pixels = textured_pixel_depth(prepared, volume)
        numerics = replace(self.numerics.segmentation, surfaces=surfaces)
        optics = self.layer_optics if numerics.refined and self.numerics.modelled else None
        filters = None if optics is None else self.filters
        regions = find_regions(
            prepared,
            volume,
            pixels,
            numerics=numerics,
            optics=optics,
            filters=filters,
            volume_in_place=matched.volume_in_place,
        )
        return pixels, regions

    def sharpen(self, matched: MatchedFrame, pixels: PixelDepth, regions: Regions, tiles: TileSpectra) -> DecodedFrame:
        """Sharp images of a segmented frame, and outlines that follow them."""
        prepared, volume = matched.prepared, matched.volume
        step, shape = self.filters.downsampling.step, self.calibration.grid.shape
        label, vergences = focus_depths(prepared, regions, volume.vergences_per_m)
        depths = repeated(label, step, shape), vergences
        sharp = self.deconvolver(tiles, prepared.levels, *depths, prepared.twins.broken)
        # Moved outlines leave the sharp images: deconvolved again at the new depths, they would be 0.3 dB worse.
        lit = lit_pixels(prepared, sharp)
        if regions.continuous:
            regions = surface_at_edges(regions, prepared, matched.volume_in_place(), sharp)
        if self.numerics.refined:
            regions = moved_outlines(regions, sharp, step, lit)
        if self.numerics.refined and self.numerics.modelled:
            regions = outlines_at_edges(regions, prepared, sharp, self.layer_optics, step)
            regions = shortest_outlines(regions, sharp, step)
            regions = outlines_by_frame(regions, prepared, self.layer_optics, step)
            regions = plain_parts_judged(prepared, volume, regions, pixels)
        plain_of = cache(partial(plain_pixels, prepared, sharp))
        plain = plain_of() if regions.continuous else None
        if plain is None:
            regions, plain = plain_behind_doubted(prepared, regions, pixels, plain_of)
        else:  # What has no texture of its own continues what stands nearby, up to any distance.
            regions = regions.refused(plain.wide(step))
        maps = PixelMaps.of(prepared, pixels, regions, sharp, lit, plain_of)
        return DecodedFrame(prepared, volume, pixels, regions, sharp, maps, plain)

    def image(self, decoded: DecodedFrame) -> Image4D:
        """The 4D image of a decoded frame."""
        image = decoded.maps.image(decoded.prepared, decoded.volume, decoded.regions, decoded.sharp)
        figures = replace(image.figures, basis_images=self.filters.basis.count)
        unmixing = self.deconvolver.unmixing
        if figures.warning is None and unmixing is not None and not unmixing.is_possible:
            figures = replace(figures, warning=unmixing.WARNING)
        return replace(image, figures=figures)


def _empty(
    shape: tuple[int, ...], frame: RawFrame, reason: str, started: float, grid: TwinGrid | None = None
) -> Image4D:
    """An image without any depth, and the reason."""
    return evaluated(empty(shape, frame, reason, grid), frame, seconds=time.perf_counter() - started)
