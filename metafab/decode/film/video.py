"""Decoder of films: parts of a frame that have not changed since the last one are not decoded again.

Changes are detected in the raw frame. Rectangles that hold them, with the pixels that filters mix them into, are
decoded like small frames, together with their surroundings. Their segments are tracked from the last frame's. Where the
depths of the first frame are those of a continuous surface, its segments are replaced by ones on planes of that
surface, on which later parts continue.
"""

from __future__ import annotations

import time
from copy import deepcopy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.camera.frames.frame import RawFrame
from metafab.core.parallel.executor import kept_threads
from metafab.core.parallel.progress import silent
from metafab.decode.decoder import DecodedFrame, Decoder
from metafab.decode.evaluation import evaluated
from metafab.decode.film.changes import ChangeDetector, PatchMeans, changed_rectangles
from metafab.decode.film.surface_planes import continued_surface, with_planes_of_surface
from metafab.decode.film.tracking import (
    ChangedPart,
    Part,
    TrackedRegions,
    planes_around,
    remeasured,
    track,
    without_slivers,
)
from metafab.decode.image import Image4D
from metafab.decode.images.compose import PixelMaps, focus_depths, lit_pixels
from metafab.decode.images.contrast_outlines import moved_outlines
from metafab.decode.images.deconvolution import SharpImages, TileSpectra
from metafab.decode.images.own_depths import plain_pixels, seen_elsewhere
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.registration.downsampling import relative_slices, repeated
from metafab.decode.registration.pedestal import without_pedestal
from metafab.decode.registration.twins import extract_part
from metafab.decode.segmentation.assignment import SegmentationNumerics
from metafab.decode.segmentation.objects.plain_behind import PlainPixels, plain_behind_doubted
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.regions import find_regions, textured_pixel_depth
from metafab.decode.segmentation.segments import Regions
from metafab.decode.segmentation.surfaces import layer_separation_per_m

#: Share of changed pixels from which a whole frame is decoded anew, with levels of its own.
_MOST_CHANGED = 0.6
#: Numbers of the changed frames that are decoded anew for comparison, and interval of the later ones: the segmentation
#: with fewer segments is kept, so that a bad start, and fragments of segments, do not last. Continuous surfaces stay.
SECOND_LOOKS, _LOOK_AGAIN = (1, 3), 25
#: Width of the surroundings with which a part is decoded, frame pixels.
_SURROUNDINGS_PX = 12


@dataclass(frozen=True)
class FilmState:
    """The last frame of a film."""

    decoded: DecodedFrame  #: Its decoding.
    image: Image4D  #: Its 4D image, without errors against a truth.
    patches: PatchMeans  #: Its patches, for change detection.
    #: Shape of the frame, pixel, place, noise and saturation; frames of another camera do not continue it.
    camera: tuple[object, ...]


@dataclass(frozen=True)
class _Rectangle:
    """A changed rectangle of a frame, downsampled pixels."""

    part: Part
    around: Part  # with the pixels around it
    prepared: PreparedFrame  # the frame in ``around``

    @property
    def inside(self) -> Part:
        """The rectangle relative to its surroundings."""
        return relative_slices(self.part, self.around)


@dataclass
class VideoDecoder:
    """A decoder that remembers the last frame."""

    decoder: Decoder  #: Decoder of single frames, without the model of the frame.
    second_looks: tuple[int, ...] = SECOND_LOOKS  #: Numbers of the changed frames that are decoded anew for comparison.
    changed_share: float = field(default=1.0, init=False)  #: Share of the last frame's pixels that were decoded again.
    #: The last frame; None before the first one, and after one that could not be decoded.
    state: FilmState | None = field(default=None, init=False, repr=False)
    _changes: int = field(default=0, init=False, repr=False)

    def __post_init__(self) -> None:
        """Leave out the model of the frame and small objects: both are slow, and parts are decoded without them."""
        self.decoder = replace(self.decoder, numerics=replace(self.decoder.numerics, modelled=False))

    def __call__(self, frame: RawFrame) -> Image4D:
        """Decode the next frame.

        Where nothing has changed, the results of the last frame are kept. The image's arrays are read-only, because
        the next frames share them. A frame of another scene, or in other light, is decoded anew.
        """
        started = time.perf_counter()
        camera = (np.shape(frame.frame), frame.pixel_um, frame.origin_um, frame.read_noise_e, frame.saturation_e)
        last = self.state
        self.state, self.changed_share = None, 1.0
        with kept_threads():
            state = self._continued(frame, last) if last is not None and last.camera == camera else None
            if state is None:
                self._changes = 0
                state = self._anew(frame, camera)
            if state is None:
                return self.decoder(frame)
        self.state = state
        image = evaluated(_read_only(state.image), frame, seconds=time.perf_counter() - started)
        return replace(image, figures=replace(image.figures, changed_share=self.changed_share))

    def _anew(self, frame: RawFrame, camera: tuple[object, ...], most_segments: int | None = None) -> FilmState | None:
        """A frame decoded by itself; None if it cannot be decoded, or has more than ``most_segments``."""
        prepared = self.decoder.prepare(frame)
        if isinstance(prepared, str):
            return None
        decoder, matched = self.decoder, self.decoder.match(prepared)
        if most_segments is None:
            decoded = decoder.complete(matched)
        else:
            # The first frame of this scene showed no continuous surface, and to search for one takes ten frames' time.
            pixels, regions = decoder.segment(matched, surfaces=False)
            if len(regions.depths) > most_segments:
                return None
            decoded = decoder.sharpen(matched, pixels, regions, decoder.tile_spectra(prepared))
        image, numerics = decoder.image(decoded), SegmentationNumerics(decoder.numerics.outline_rounds)
        regions = with_planes_of_surface(decoded.regions, prepared, matched.volume, decoded.pixels, numerics)
        if regions is not decoded.regions:
            decoded = replace(decoded, regions=regions, maps=decoded.maps.with_segments(regions, prepared))
        return FilmState(decoded, image, self._detector.patch_means(frame), camera)

    @cached_property
    def _detector(self) -> ChangeDetector:
        return ChangeDetector.of(self.decoder.calibration.grid, self.decoder.filters.downsampling)

    def _continued(self, frame: RawFrame, last: FilmState) -> FilmState | None:
        """The last frame updated where it changed; None if too much did."""
        patches = self._detector.patch_means(frame)
        changed = self._detector.changed(patches, last.patches, last.decoded.prepared.levels)
        affected = self._detector.affected(changed)
        parts = changed_rectangles(affected, self.decoder.filters.block)
        again = np.zeros(affected.shape, dtype=bool)
        for part in parts:
            again[part] = True
        share = float(again.mean())
        if share > _MOST_CHANGED:
            return None
        if not parts:
            self.changed_share = share
            return last
        self._changes += 1
        look_again = self._changes in self.second_looks or self._changes % _LOOK_AGAIN == 0
        # The pieces of a continuous surface tell nothing of its depths, and to search for one takes ten frames' time.
        if look_again and not last.decoded.regions.continuous:
            # Fewer segments of the same scene are the better segmentation.
            anew = self._anew(frame, last.camera, most_segments=len(last.decoded.regions.depths))
            if anew is not None:
                return anew
        self.changed_share = share
        m = self._detector.margin
        decoded = self._updated(frame, last.decoded, parts, affected, changed[m:-m, m:-m])
        # All other patches stay, so that a slow change adds up until it is seen.
        return FilmState(decoded, self.decoder.image(decoded), last.patches.replaced(patches, changed), last.camera)

    def _updated(
        self,
        frame: RawFrame,
        last: DecodedFrame,
        parts: list[Part],
        affected: NDArray[np.bool_],
        changed: NDArray[np.bool_],
    ) -> DecodedFrame:
        """The last frame with parts of the next one: changed rectangles, downsampled pixels.

        ``affected``, shape (n_y, n_x), are the pixels in them that filters mix with changed light, ``changed`` those
        whose light changed: only there may another surface stand. The last frame's twins, cost volume and sharp images
        are overwritten; the maps belong to its image and are copied.
        """
        prepared, volume = self._matched(frame, last, parts)
        rectangles = [self._rectangle(prepared, part) for part in parts]
        step, shape = self.decoder.filters.downsampling.step, self.decoder.calibration.grid.shape
        near_light = np.zeros_like(affected)
        for one in rectangles:
            near_light[one.part] = one.prepared.near_light[one.inside]
        near_light = repeated(near_light & affected, step, shape)
        with kept_threads() as pool:
            copied = pool.submit(deepcopy, last.maps)
            tiles = pool.submit(self.decoder.deconvolver.tile_spectra, prepared.twins.image, near_light)
            pixels, tracked = self._segmented(volume, last, rectangles, changed)
        regions = remeasured(tracked.regions, volume, step)
        whole = slice(0, affected.shape[0]), slice(0, affected.shape[1])
        redrawn = rectangles if regions is tracked.regions else [self._rectangle(prepared, whole)]
        sharp = self._deconvolved(prepared, last, regions, rectangles, affected, tiles.result())
        lit = [self._lit(one, sharp) for one in rectangles]
        if self.decoder.numerics.refined:
            regions = self._moved(regions, sharp, rectangles, lit, changed)
        plain_of = partial(self._plain, prepared, last.plain, sharp, rectangles)
        regions, plain = plain_behind_doubted(prepared, regions, pixels, plain_of, changed)
        if regions.continuous:
            plain = plain_of() if plain is None else plain
            regions = regions.refused(plain.wide(step) & changed)
        if redrawn is not rectangles:
            lit = [self._lit(one, sharp) for one in redrawn]
        maps, patches = copied.result(), []
        for one, lit_here in zip(redrawn, lit, strict=True):
            frame_slices, around = self.decoder.filters.downsampling.frame_slices, one.around
            sharp_part = sharp.within(*frame_slices(*around))
            of_part = one.prepared, pixels.within(*around), regions.within(*around), sharp_part
            local = partial(plain_pixels, one.prepared, sharp_part)
            of_part_maps = PixelMaps.of(*of_part, lit_here, local if plain is None else partial(plain.within, *around))
            patches.append((frame_slices(*one.part), of_part_maps, frame_slices(*around)))
        maps.overwrite(tracked.number, patches)
        return DecodedFrame(prepared, volume, pixels, regions, sharp, maps, plain)

    def _moved(
        self,
        regions: Regions,
        sharp: SharpImages,
        rectangles: list[_Rectangle],
        lit: list[NDArray[np.bool_]],
        changed: NDArray[np.bool_],
    ) -> Regions:
        """Segments whose outlines in the parts stand where the contrast changes; ``regions`` if they all do."""
        downsampling = self.decoder.filters.downsampling
        for one, lit_here in zip(rectangles, lit, strict=True):
            # What is new in the part of a continuous surface lies on planes, whose outlines move as those of others.
            local = replace(regions.within(*one.around), surface_per_m=None)
            sharp_part = sharp.within(*downsampling.frame_slices(*one.around))
            moved = moved_outlines(local, sharp_part, downsampling.step, lit_here, changed[one.around])
            if moved is not local:
                arrays = {name: getattr(regions, name).copy() for name in ("label", "interior", "grown", "right")}
                for name, array in arrays.items():
                    array[one.around] = getattr(moved, name)
                surface = None
                if regions.surface_per_m is not None:
                    surface = regions.surface_per_m.copy()
                    surface[one.around] = continued_surface(surface[one.around], local.grown, moved.grown)
                regions = replace(regions, **arrays, surface_per_m=surface)
        return regions

    def _plain(
        self, prepared: PreparedFrame, last: PlainPixels | None, sharp: SharpImages, rectangles: list[_Rectangle]
    ) -> PlainPixels:
        """The last frame's plain pixels with those of the rectangles; without any, those of the whole frame."""
        if last is None:
            return plain_pixels(prepared, sharp)
        frame_slices = self.decoder.filters.downsampling.frame_slices
        for one in rectangles:
            local = plain_pixels(one.prepared, sharp.within(*frame_slices(*one.around)))
            last = last.updated(one.part, local, one.inside)
        return last

    def _lit(self, one: _Rectangle, sharp: SharpImages) -> NDArray[np.bool_]:
        """Pixels around a rectangle that have light in the sharp images."""
        return lit_pixels(one.prepared, sharp.within(*self.decoder.filters.downsampling.frame_slices(*one.around)))

    def _rectangle(self, prepared: PreparedFrame, part: Part) -> _Rectangle:
        around = self._surroundings(part)
        return _Rectangle(part, around, prepared.within(*around))

    def _surroundings(self, part: Part) -> Part:
        """A part with the pixels around it, inside the window."""
        downsampling = self.decoder.filters.downsampling
        reach = -(-_SURROUNDINGS_PX // downsampling.step)
        rows, columns = (
            slice(max(0, at.start - reach), min(n, at.stop + reach))
            for at, n in zip(part, downsampling.shape, strict=True)
        )
        return rows, columns

    def _matched(self, frame: RawFrame, last: DecodedFrame, parts: list[Part]) -> tuple[PreparedFrame, CostVolume]:
        """The last frame's twins and cost volume, overwritten in the changed parts."""
        before, grid, volume = last.prepared, self.decoder.calibration.grid, last.volume
        frame = without_pedestal(frame, before.levels.pedestal_e)
        for part in parts:
            filters = self.decoder.filters.within(*part)
            rows, columns = self.decoder.filters.downsampling.frame_slices(*part)
            twins = extract_part(frame, grid, rows, columns)
            wide = slice(rows.start, rows.stop + 2 * grid.margin), slice(columns.start, columns.stop + 2 * grid.margin)
            before.twins.image[:, *wide], before.twins.broken[:, *wide] = twins
            spectra = filters.downsampling.spectra(twins[0])
            small = filters.downsampling.images(spectra)[:, *filters.downsampling.inner]
            m = filters.downsampling.margin
            before.images[:, part[0].start + m : part[0].stop + m, part[1].start + m : part[1].stop + m] = small
            lit = small.sum(axis=0) > before.dark_e
            volume.products[:, :, *part] = filters.volume(spectra, before.levels, lit, silent).products
        # New objects, without what the last frame's computed from these arrays.
        return replace(before, twins=replace(before.twins)), volume

    def _segmented(
        self,
        volume: CostVolume,
        last: DecodedFrame,
        rectangles: list[_Rectangle],
        changed: NDArray[np.bool_],
    ) -> tuple[PixelDepth, TrackedRegions]:
        """The last frame's pixel depths and segments with those of the changed pixels in the parts."""
        before, regions = last.pixels, last.regions
        number = np.arange(len(regions.depths) + 1, dtype=np.int32)
        pixels = PixelDepth(before.vergence_per_m.copy(), before.relative_error.copy(), before.claimed.copy())
        separation = layer_separation_per_m(volume)
        for one in rectangles:
            change, inside, local = ChangedPart(one.part, one.around, changed[one.part]), one.inside, one.prepared
            part, renewed = change.part, change.changed
            local_volume = volume.within(*change.around)
            depth = textured_pixel_depth(local, local_volume)
            pixels.vergence_per_m[part][renewed] = depth.vergence_per_m[inside][renewed]
            pixels.relative_error[part][renewed] = depth.relative_error[inside][renewed]
            pixels.claimed[part][renewed] = depth.claimed[inside][renewed]
            known = planes_around(regions, change, separation)
            here = pixels.within(*change.around)
            # Segments that continue keep their depth: outliers are left out of the others once. So do the planes of a
            # continuous surface, whose depths show their slopes better.
            numerics = replace(self.decoder.numerics.segmentation, slopes=not regions.continuous, robust_rounds=1)
            current = find_regions(local, local_volume, here, known, numerics)
            if regions.continuous and not current.continuous and current.right is not None:
                # The image of a surface leaves out that doubt, because its pixels have their own depths: these do not.
                vergence, step = current.vergence_per_m(current.grown), local.downsampling.step
                elsewhere = seen_elsewhere(here, current.grown, vergence, step)
                current = replace(current, right=np.minimum(current.right, 1.0 - elsewhere))
            tracked = track(regions, current, change, here, separation)
            tracked = without_slivers(tracked, change, here, local.downsampling.step)
            regions, number = tracked.regions, tracked.number[number]
        return pixels, TrackedRegions(regions, number)

    def _deconvolved(
        self,
        prepared: PreparedFrame,
        last: DecodedFrame,
        regions: Regions,
        rectangles: list[_Rectangle],
        affected: NDArray[np.bool_],
        tiles: TileSpectra,
    ) -> SharpImages:
        """The last frame's sharp images with those of the affected pixels."""
        downsampling, shape = self.decoder.filters.downsampling, self.decoder.calibration.grid.shape
        label, vergences = np.zeros(affected.shape, dtype=np.int32), np.zeros(0)
        for one in rectangles:
            depths, of_depths = focus_depths(one.prepared, regions.within(*one.around), last.volume.vergences_per_m)
            numbers = np.where(depths > 0, depths + vergences.size, 0)[one.inside]
            label[one.part] = np.where(affected[one.part], numbers, 0)
            vergences = np.append(vergences, of_depths)
        wanted = np.zeros(shape, dtype=np.int32)
        all_wanted, renewed = (repeated(values, downsampling.step, shape) for values in (label, affected))
        parts = [downsampling.frame_slices(*one.part) for one in rectangles]
        for part in parts:
            wanted[part] = all_wanted[part]
        sharp = self.decoder.deconvolver(tiles, prepared.levels, wanted, vergences, prepared.twins.broken)
        for part in parts:
            last.sharp.within(*part).overwrite(sharp.within(*part), renewed[part])
        return last.sharp


def _read_only(image: Image4D) -> Image4D:
    """The image with read-only views of its arrays."""
    views: dict[str, Any] = {
        item.name: array.view() for item in fields(image) if isinstance(array := getattr(image, item.name), np.ndarray)
    }
    for view in views.values():
        view.flags.writeable = False
    return replace(image, **views)
