"""Frames one after the other: what has not changed since it was decoded is not decoded again.

Changes are looked for in the raw frame. Rectangles that hold them and what they reach are decoded as if they were small
frames, with what lies around them: their segments are joined to the last frame's, their images written over its own.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.camera.frames.frame import RawFrame
from metafab.core.parallel.executor import kept_threads
from metafab.core.parallel.progress import silent
from metafab.decode.decoder import Decoded, Decoder
from metafab.decode.evaluation.metrics import judged
from metafab.decode.film.changes import Glance, Squares, parts_of
from metafab.decode.film.tracking import Part, joined, planes_around, refreshed
from metafab.decode.image import Image4D
from metafab.decode.images.compose import Pictures, focus, lit_about
from metafab.decode.images.deconvolution import LitTiles
from metafab.decode.matching.cost_volume import Volume
from metafab.decode.matching.depth import PixelDepth, pixel_depth
from metafab.decode.registration.reduce import place_within, repeated
from metafab.decode.registration.twins import extract_part
from metafab.decode.segmentation.frame_statistics import Seen
from metafab.decode.segmentation.regions import Regions, find_regions, layer_step_per_m, near_texture

#: A frame of which more changed is decoded anew, with levels of its own.
_MOST_CHANGED = 0.6
#: Frames with changes that are decoded anew for a second look, and after how many more there is another: the better one
#: stays, so that a bad beginning, and fragments of segments, do not last.
_SECOND_LOOKS, _LOOK_AGAIN = (1, 3), 25
#: What a part is seen with, pixels of the frame around it: what windows reach, and where its segments go on.
_AROUND_PX = 12


@dataclass
class VideoDecoder:
    """A decoder with a memory.

    Attributes:
        decoder: what decodes.
        changed_share: share of the last frame's pixels that were decoded anew.
    """

    decoder: Decoder
    changed_share: float = field(default=1.0, init=False)
    _changes: int = field(default=0, init=False, repr=False)
    _last: tuple[Decoded, Glance, tuple[object, ...]] | None = field(default=None, init=False, repr=False)

    def __call__(self, frame: RawFrame) -> Image4D:
        """Decode the next frame: where nothing moved, all that is known of it is the last frame's.

        The image's arrays are for reading only (a copy of one is not): later frames go on from them, and one in which
        nothing moved has the very same. ``details`` get ``changed_share``. A frame that cannot be decoded is forgotten
        at once; one that shows another scene, or the same in other light, is decoded anew.
        """
        started = time.perf_counter()
        camera = (np.shape(frame.frame), frame.pixel_um, frame.origin_um, frame.read_noise_e, frame.saturation_e)
        last = self._last
        self._last, self.changed_share = None, 1.0
        with kept_threads():
            found = None if last is None or last[2] != camera else self._followed(frame, last[0], last[1])
            if found is None:
                self._changes = 0
                found = self._anew(frame)
            if found is None:
                return self.decoder(frame)
        self._last = *found, camera
        image = judged(_for_reading(found[0].image), frame, seconds=time.perf_counter() - started)
        image.details["changed_share"] = self.changed_share
        return image

    def _anew(self, frame: RawFrame) -> tuple[Decoded, Glance] | None:
        """A frame decoded by itself, and what it looks like; None if there is nothing to be decoded."""
        seen = self.decoder.look(frame)
        if not isinstance(seen, Seen):
            return None
        return self.decoder.finish(frame, seen, self.decoder.volume(seen)), self._squares.glance(frame)

    @cached_property
    def _squares(self) -> Squares:
        return Squares.of(self.decoder.calibration.grid, self.decoder.filters.reduction)

    def _followed(self, frame: RawFrame, last: Decoded, before: Glance) -> tuple[Decoded, Glance] | None:
        """The last frame with what changed, and what it looks like; None if too much did."""
        now = self._squares.glance(frame)
        reached = self._squares.reached(self._squares.moved(now, before, last.seen.levels))
        parts = parts_of(reached, self.decoder.filters.block)
        anew = np.zeros(reached.shape, dtype=bool)
        for part in parts:
            anew[part] = True
        share = float(anew.mean())
        if share > _MOST_CHANGED:
            return None
        if parts:
            self._changes += 1
            if self._changes in _SECOND_LOOKS or self._changes % _LOOK_AGAIN == 0:
                again = self._anew(frame)
                # The same scene in fewer pieces is better understood.
                if again is not None and len(again[0].regions.depths) <= len(last.regions.depths):
                    return again
        self.changed_share = share
        if not parts:
            return last, before
        # What moved in the margin beside a part is known with it.
        taken = np.pad(anew, self._squares.margin, mode="edge")
        return self._renewed(frame, last, parts, reached), now.kept(before, taken)

    def _renewed(self, frame: RawFrame, last: Decoded, parts: list[Part], reached: NDArray[np.bool_]) -> Decoded:
        """The last frame with some parts of another. All of it but its image and segments is written over.

        Args:
            frame: that other.
            last: the frame before.
            parts: what is decoded anew, compared pixels.
            reached: shape (n_y, n_x), the pixels of those whose light is anew.
        """
        for part in parts:
            self._look(frame, last, part)
        seen = replace(last.seen)  # without what it knew of its pixels
        rows, columns = self.decoder.filters.reduction.shape
        everywhere = [(slice(0, rows), slice(0, columns))]
        with kept_threads() as beside:
            # Loops over all threads are left to this one: not every threading layer lets two start them at once.
            ready = beside.submit(lambda: (last.pictures.copy(), self._tiles(seen, parts, reached)))
            regions, number = self._segments(last, parts)
        copied, tiles = ready.result()
        refreshed_ones = refreshed(regions, last.volume, self.decoder.filters.reduction.every)
        self._sharpen(seen, last, refreshed_ones, parts, reached, tiles)
        pictures = copied.renumbered(number)
        for part in parts if refreshed_ones is regions else everywhere:
            self._draw(pictures, seen, last, refreshed_ones, part)
        return self.decoder.put_together(frame, seen, last.volume, last.pixels, refreshed_ones, last.sharp, pictures)

    def _about(self, part: Part) -> Part:
        """A part and what lies around it in the window."""
        reduction = self.decoder.filters.reduction
        reach = -(-_AROUND_PX // reduction.every)
        rows, columns = (
            slice(max(0, at.start - reach), min(n, at.stop + reach))
            for at, n in zip(part, reduction.shape, strict=True)
        )
        return rows, columns

    def _look(self, frame: RawFrame, last: Decoded, part: Part) -> None:
        """Write a part's twins and their agreement over the last frame's."""
        (rows, columns), seen, m = part, last.seen, self._squares.margin
        filters = self.decoder.filters.within(*part)
        inside = self.decoder.filters.reduction.of_part(*part)
        image, bad = extract_part(frame, self.decoder.calibration.grid, *inside)
        here = seen.twins.within(*inside)
        here.image[:], here.bad[:] = image, bad
        spectra = filters.reduction.spectra(image)
        small = filters.reduction.images(spectra)[:, *filters.reduction.inner]
        seen.small[:, m + rows.start : m + rows.stop, m + columns.start : m + columns.stop] = small
        lit = small.sum(axis=0) > seen.floor_e
        last.volume.parts[:, :, rows, columns] = filters.volume(spectra, seen.levels, lit, silent).parts

    def _pixels(self, seen: Seen, volume: Volume, last: PixelDepth, part: Part, about: Part) -> PixelDepth:
        """Write the depth of each of a part's pixels by itself over the last frame's; those about it.

        Args:
            seen: of what lies about the part, like ``volume``.
            volume: see ``seen``.
            last: of all of the window.
            part: what is written.
            about: that and what lies around it.
        """
        found = pixel_depth(volume, seen.window, seen.variance)
        found = PixelDepth(found.vergence_per_m, found.relative_error, found.claimed & near_texture(seen))
        rows, columns = place_within(part, about)
        inner, here = found.within(rows, columns), last.within(*part)
        here.vergence_per_m[:], here.relative_error[:] = inner.vergence_per_m, inner.relative_error
        here.claimed[:] = inner.claimed
        return last.within(*about)

    def _segments(self, last: Decoded, parts: list[Part]) -> tuple[Regions, NDArray[np.int32]]:
        """The last frame's segments with those of some parts, and the number that each of the former has now."""
        regions = last.regions
        number = np.arange(len(regions.depths) + 1, dtype=np.int32)
        for part in parts:
            about = self._about(part)
            seen, volume = last.seen.within(*about), last.volume.within(*about)
            pixels = self._pixels(seen, volume, last.pixels, part, about)
            step_per_m = layer_step_per_m(volume)
            found = find_regions(seen, volume, pixels, planes_around(regions, part, about, step_per_m))
            regions, changed = joined(regions, found, part, about, step_per_m)
            number = changed[number]
        return regions, number

    def _tiles(self, seen: Seen, parts: list[Part], reached: NDArray[np.bool_]) -> LitTiles:
        """The tiles that hold what is made sharp."""
        lit = np.zeros_like(reached)
        for part in parts:
            lit[part] = lit_about(seen.within(*part))
        every = self.decoder.filters.reduction.every
        label = repeated(lit & reached, every, self.decoder.calibration.grid.shape)
        return self.decoder.restorer.transformed(seen.twins.image, label)

    def _sharpen(
        self,
        seen: Seen,
        last: Decoded,
        regions: Regions,
        parts: list[Part],
        reached: NDArray[np.bool_],
        tiles: LitTiles,
    ) -> None:
        """Write what is reached over the last frame's sharp images."""
        reduction, shape = self.decoder.filters.reduction, self.decoder.calibration.grid.shape
        label, vergences = np.zeros(reached.shape, dtype=np.int32), np.zeros(0)
        for part in parts:
            about = self._about(part)
            depths, its_vergences = focus(seen.within(*about), regions.within(*about), last.volume.vergences_per_m)
            numbers = np.where(depths > 0, depths + vergences.size, 0)
            rows, columns = place_within(part, about)
            label[part] = np.where(reached[part], numbers[rows, columns], 0)
            vergences = np.append(vergences, its_vergences)
        wanted, dark = (repeated(of, reduction.every, shape) for of in (label, reached & (label == 0)))
        number = np.zeros(shape, dtype=np.int32)
        for part in parts:
            inside = reduction.of_part(*part)
            number[inside] = wanted[inside]
            here = last.sharp.within(*inside)
            for values in (here.images, here.noise_gain):
                np.copyto(values, 0.0, where=dark[inside])
        self.decoder.restorer.write(last.sharp, tiles, seen.levels, number, vergences)

    def _draw(self, pictures: Pictures, seen: Seen, last: Decoded, regions: Regions, part: Part) -> None:
        """Draw a part over the last frame's pictures."""
        about, of_part = self._about(part), self.decoder.filters.reduction.of_part
        known = last.pixels.within(*about), regions.within(*about), last.sharp.within(*of_part(*about))
        pictures.paste(Pictures.of(seen.within(*about), *known), of_part(*part), of_part(*about))


def _for_reading(image: Image4D) -> Image4D:
    """An image that shares its arrays, and by which nothing is written to them."""
    views: dict[str, Any] = {
        item.name: array.view() for item in fields(image) if isinstance(array := getattr(image, item.name), np.ndarray)
    }
    for view in views.values():
        view.flags.writeable = False
    return replace(image, **views)
