"""Frames one after the other: what has not changed since it was decoded is not decoded again."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from metafab.camera.frame import RawFrame
from metafab.core.progress import silent
from metafab.decode.changes import Glance, Squares, parts_of
from metafab.decode.decoder import Decoded, Decoder
from metafab.decode.depth import PixelDepth, pixel_depth
from metafab.decode.image import Image4D
from metafab.decode.judge import judged
from metafab.decode.regions import near_texture
from metafab.decode.seen import Seen
from metafab.decode.twins import extract_part

#: A frame of which more changed is decoded anew, with levels of its own.
_MOST_CHANGED = 0.6
#: Compared pixels to which means over windows, halved thrice, keep.
_ALIGNED = 8

Part = tuple[slice, slice]


@dataclass
class VideoDecoder:
    """A decoder with a memory.

    Attributes:
        decoder: what decodes.
        changed_share: share of the last frame's pixels that were decoded anew.
    """

    decoder: Decoder
    changed_share: float = field(default=1.0, init=False)
    _last: tuple[Decoded, Glance, tuple[object, ...]] | None = field(default=None, init=False, repr=False)

    def __call__(self, frame: RawFrame) -> Image4D:
        """Decode the next frame: where nothing moved, agreement of the twins and brightness are the last frame's.

        ``details`` get ``changed_share``. A frame that cannot be decoded is forgotten at once.
        """
        started = time.perf_counter()
        camera = (np.shape(frame.frame), frame.pixel_um, frame.origin_um, frame.read_noise_e, frame.saturation_e)
        last = self._last
        self._last, self.changed_share = None, 1.0
        found: Decoded | None = None
        if last is not None and last[2] == camera:
            found, glance = self._updated(frame, last[0], last[1])
        if found is None:
            seen = self.decoder.look(frame)
            if not isinstance(seen, Seen):
                return self.decoder(frame)
            found, glance = self.decoder.finish(frame, seen, self.decoder.volume(seen)), self._squares.glance(frame)
        self._last = found, glance, camera
        image = judged(found.image, frame, seconds=time.perf_counter() - started)
        image.details["changed_share"] = self.changed_share
        return image

    @cached_property
    def _squares(self) -> Squares:
        return Squares.of(self.decoder.calibration.grid, self.decoder.filters.reduction)

    def _updated(self, frame: RawFrame, last: Decoded, before: Glance) -> tuple[Decoded | None, Glance]:
        """The last frame with what changed, if that is not too much, and what it looks like."""
        now = self._squares.glance(frame)
        reached = self._squares.reached(self._squares.moved(now, before, last.seen.levels))
        parts = parts_of(reached, self.decoder.filters.block)
        changed = np.zeros(reached.shape, dtype=bool)
        for part in parts:
            changed[part] = True
        share = float(changed.mean())
        if share > _MOST_CHANGED:
            return None, now
        self.changed_share = share
        if not parts:
            return last, before
        seen = self._looked(frame, last, parts)
        pixels = self._pixels(seen, last, parts)
        found = self.decoder.finish(frame, seen, last.volume, pixels, changed, last)
        margin = self._squares.margin
        return found, now.kept(before, np.pad(changed, margin))

    def _looked(self, frame: RawFrame, last: Decoded, parts: list[Part]) -> Seen:
        """The twins and their agreement, written over the last frame's in some parts."""
        grid, seen, every = self.decoder.calibration.grid, last.seen, self.decoder.filters.reduction.every
        m = self._squares.margin
        for rows, columns in parts:
            inside = tuple(
                slice(at.start * every, min(at.stop * every, n))
                for at, n in zip((rows, columns), grid.shape, strict=True)
            )
            image, bad = extract_part(frame, grid, *inside)
            wide = tuple(slice(at.start, at.stop + 2 * grid.margin) for at in inside)
            seen.twins.image[:, *wide], seen.twins.bad[inside] = image, bad
            filters = self.decoder.filters.within(rows, columns)
            spectra = filters.reduction.spectra(image)
            small = filters.reduction.images(spectra)[:, *filters.reduction.inner]
            seen.small[:, m + rows.start : m + rows.stop, m + columns.start : m + columns.stop] = small
            lit = small.sum(axis=0) > seen.floor_e
            volume = filters.volume(spectra, seen.levels, lit, silent)
            last.volume.parts[:, :, rows, columns] = volume.parts
        return replace(seen)

    def _pixels(self, seen: Seen, last: Decoded, parts: list[Part]) -> PixelDepth:
        """The depth of each pixel by itself, written over the last frame's where windows reach into some parts."""
        reach = -(-2 * seen.window // _ALIGNED) * _ALIGNED
        vergence, error = last.pixels.vergence_per_m, last.pixels.relative_error
        for part in parts:
            near, wide = (self._about(part, k * reach) for k in (1, 2))
            volume = replace(last.volume, parts=last.volume.parts[:, :, *wide])
            found = pixel_depth(volume, seen.window, seen.variance[:, *wide])
            inner = tuple(slice(a.start - b.start, a.stop - b.start) for a, b in zip(near, wide, strict=True))
            vergence[near], error[near] = found.vergence_per_m[inner], found.relative_error[inner]
        return PixelDepth(vergence, error, np.isfinite(error) & near_texture(seen))

    def _about(self, part: Part, reach: int) -> Part:
        """A part and what lies about it in the window."""
        rows, columns = (
            slice(
                max(0, (at.start - reach) // _ALIGNED * _ALIGNED), min(n, -(-(at.stop + reach) // _ALIGNED) * _ALIGNED)
            )
            for at, n in zip(part, self.decoder.filters.reduction.shape, strict=True)
        )
        return rows, columns
