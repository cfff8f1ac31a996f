"""Layers of a frame in tiles: where each may hold the light, what hides what, the frame's noise.

:mod:`metafab.decode.segmentation.layered.frame_model` fits them. Only tiles whose cores hold outlines are computed,
each by itself; see :mod:`metafab.decode.segmentation.layered.tile_shares`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance, nearest
from metafab.core.parallel.executor import kept_threads
from metafab.decode.registration.tiles import Tiling, Value
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.layered.tile_shares import TileLayers
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Distance from an outline up to which it may be wrong, frame pixels.
_BAND_PX = 20
#: Distance beyond its outline over which a layer's initial share falls by a factor of e, frame pixels.
_FIRST_FALL_PX = 6.0
#: Distance up to which a segment is grown over lit pixels without one, frame pixels.
_GROWN_PX = 60
#: Standard deviation of the Gaussian over which energy is pooled, frame pixels.
_POOLED_PX = 4.0
#: Distance from a tile's edge up to which its pixels do not count, frame pixels: light from beyond is mixed in. 9 px
#: give the same errors, 18 px a tenth more.
_GUARD_PX = 12
#: Relative difference of vergence from which a layer is nearer than another.
_NEARER = 2e-3
#: Bytes that a pixel of a tile takes for each layer: transforms of the pair and of the light, shares, masks. 94 to 130
#: measured with 48 to 58 pairs of a tile and a layer (peak of tracemalloc in the frame model's methods, less what was
#: held before; frames of 300 x 170 px, on one and two cores), of which 23 to 27 last from round to round. With 8 to 27
#: pairs the peak is up to 170, because the threads' arrays count for more.
BYTES_A_PIXEL = 130
#: Pairs of a tile and a layer that are computed at once: more leave the cache, fewer take more calls. 4 take a tenth
#: longer.
_PAIRS_AT_ONCE = 12
#: Most memory of the tiles, bytes: 2.5 GiB are some 3000 pairs of a tile and a layer, a frame of 12 million pixels with
#: outlines in most tiles.
_MOST_BYTES = 5 << 29


@dataclass(frozen=True)
class FrameLayers:
    """The layers of a frame; pictures over its downsampled images with margin."""

    prepared: PreparedFrame
    optics: LayerOptics
    label: NDArray[np.int32]  #: (n_y, n_x), segment of each lit pixel
    lit: NDArray[np.bool_]  #: (n_y, n_x)
    alone: NDArray[np.int32]  #: (n_y, n_x), segment of the pixels that can belong to no other; 0 elsewhere
    away_px: NDArray[np.float32]  #: (n_layers, n_y, n_x), distance from each layer's pixels; inf beyond hidden_px
    grows: NDArray[np.bool_]  #: (n_layers,), whether a layer may grow: its light is known away from its outlines
    vergence_per_m: FloatArray  #: (n_layers, 2), least and largest over the layer's pixels
    middle_per_m: FloatArray  #: (n_layers, n_tiles), at the middles of tiles
    gains: NDArray[np.float32]  #: (n_layers, 2), light of each image over the mean of both
    hidden_px: float  #: distance from its own pixels up to which a layer is modelled behind others
    _apertures: dict[tuple[int, int], NDArray[np.complex64]] = field(default_factory=dict)

    @classmethod
    def of(cls, prepared: PreparedFrame, regions: Regions, optics: LayerOptics) -> FrameLayers | None:
        """The layers of a frame, one for each segment; None if one has no lit pixel."""
        count, segments = len(regions.depths), regions.grown
        step, margin = prepared.downsampling.step, prepared.downsampling.margin
        away, row, column = nearest(segments > 0)
        label = np.where(prepared.enclosed & (away * step <= _GROWN_PX), segments[row, column], 0).astype(np.int32)
        if not np.bincount(label.ravel(), minlength=count + 1)[1:].all():
            return None
        vergence, middles = np.empty((count, 2)), np.empty((count, optics.tiling.n_tiles))
        for index, plane in enumerate(depth.plane for depth in regions.depths):
            own = plane.over(label.shape)[label == index + 1]
            vergence[index] = own.min(), own.max()
            middles[index] = np.clip(plane.at(*optics.tiling.middles.T.astype(np.float64)), own.min(), own.max())
        hidden_px = _BAND_PX + step * float(np.abs(optics.shifts_px_m).max()) * (vergence.max() - vergence.min())
        wide, lit = np.pad(label, margin), np.pad(prepared.enclosed, margin)
        away_px = _distances(wide, count, hidden_px / step) * np.float32(step)
        near = ((away_px <= _BAND_PX) & lit).sum(axis=0, dtype=np.uint8)
        # A piece without pixels away from its outline has none from which its light could be measured: it stays.
        deep = np.where((wide == np.pad(segments, margin)) & (near == 1), wide, 0)
        grows = np.bincount(deep.ravel(), minlength=count + 1)[1:] > 0
        alone = np.where(np.append(False, grows)[wide], deep, wide)
        gains = _gains(prepared.inner, regions.interior, count)
        return cls(prepared, optics, wide, lit, alone, away_px, grows, vergence, middles, gains, hidden_px)

    def _aperture(self, nearer: int, behind: int) -> NDArray[np.complex64]:
        """Transfer function of the share of the aperture that one layer covers in front of another."""
        if (nearer, behind) not in self._apertures:
            vergence = self.vergence_per_m.mean(axis=1)
            self._apertures[nearer, behind] = self.optics.aperture(float(vergence[nearer] - vergence[behind]))
        return self._apertures[nearer, behind]

    def _is_nearer(self, one: NDArray[np.intp], other: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Whether layers are nearer than others throughout, so that their light may hide them; indices broadcast."""
        least, largest = self.vergence_per_m.T
        return np.asarray(least[one] > (1.0 + _NEARER) * largest[other])

    def groups(self, near: NDArray[np.bool_] | None = None) -> list[TileGroup]:
        """Tiles with outlines in their cores, in groups that are computed at once.

        Only those with pixels ``near``, shape (n_y, n_x) without margin, if given. An empty list if they take too much
        memory.
        """
        tiles, (n_y, n_x) = self._tiles(near), self.optics.tiling.size
        ends = np.cumsum([len(layers) for _, layers in tiles])
        if not tiles or int(ends[-1]) * n_y * n_x * BYTES_A_PIXEL > _MOST_BYTES:
            return []
        parts = pairwise([0, *(np.flatnonzero(np.diff(ends // _PAIRS_AT_ONCE)) + 1).tolist(), len(tiles)])
        with kept_threads() as pool:
            return pool.map(lambda part: self._group(tiles[slice(*part)]), parts)

    def write_cores(self, group: TileGroup, pictures: NDArray[Value], to: NDArray[Value]) -> None:
        """Write the cores of the tiles' pictures, shape (n_tiles, n_y, n_x), to their places in the window."""
        for tile, core in zip(group.tiles, pictures[:, *self._core], strict=True):
            place = to[self.optics.tiling.place(tile)]
            place[...] = core[: place.shape[0], : place.shape[1]]

    def _tiles(self, near: NDArray[np.bool_] | None) -> list[tuple[int, list[int]]]:
        """Tiles with outlines, and with pixels ``near``, in their cores; the layers near the pixels that count."""
        tiling, layers, tiles = self.optics.tiling, range(len(self.gains)), []
        open_pixels = ((self.label > 0) & (self.alone == 0))[self.prepared.downsampling.inner]
        asked = range(tiling.n_tiles) if near is None else tiling.tiles_with(near)
        for tile in np.intersect1d(tiling.tiles_with(open_pixels), asked).tolist():
            lit = tiling.window(self.lit, tile)[self._counted]
            about = [k for k in layers if (tiling.window(self.away_px[k], tile)[self._counted][lit] <= _BAND_PX).any()]
            if len(about) > 1:
                tiles.append((tile, about))
        return tiles

    def _group(self, tiles: list[tuple[int, list[int]]]) -> TileGroup:
        """Cut tiles, with the indices of the layers in each, out of the frame's pictures."""
        prepared, tiling, step = self.prepared, self.optics.tiling, self.prepared.downsampling.step
        numbers, counts = [tile for tile, _ in tiles], [len(layers) for _, layers in tiles]
        layer = np.array([k for _, layers in tiles for k in layers])
        of_tile = np.repeat(np.arange(len(tiles)), counts)
        at = np.array(numbers)[of_tile]
        optics = self.optics.light(at, of_tile, self.middle_per_m[layer, at], self.gains[layer])
        away = np.stack([tiling.window(self.away_px[k], tile) for k, tile in zip(layer, at.tolist(), strict=True)])
        alone, label = (
            np.stack([tiling.window(one, tile) for tile in numbers])[of_tile] for one in (self.alone, self.label)
        )
        lit = np.stack([tiling.window(self.lit, tile) for tile in numbers])[of_tile]
        number = (layer + 1)[:, None, None]
        near = (away <= _BAND_PX) & lit & self.grows[layer][:, None, None]
        allowed = np.where(alone > 0, alone == number, near)
        core, counted = np.zeros((2, *tiling.size), dtype=bool)
        core[self._core] = True
        counted[self._counted] = True
        images, weights, lights = (
            np.stack([tiling.window(one, tile) for tile in numbers])
            for one in (prepared.images, prepared.weight, prepared.light_around)
        )
        nearer = self._is_nearer(layer, layer[:, None]) & (of_tile[:, None] == of_tile)
        hiding = [
            (pair, one, self._aperture(int(layer[one]), int(layer[pair]))) for pair, one in np.argwhere(nearer).tolist()
        ]
        model = TileLayers(
            optics,
            self.gains[layer],
            hiding,
            images,
            weights * counted,
            np.maximum(lights, prepared.light_around.min()),
            allowed,
            away <= self.hidden_px,
            _POOLED_PX / step,
        )
        return TileGroup(numbers, layer, model, away, allowed & (label == number) & core)

    @property
    def _core(self) -> tuple[slice, ...]:
        """The core of a tile."""
        tiling = self.optics.tiling
        return tuple(slice(tiling.margin, tiling.margin + n) for n in tiling.core)

    @property
    def _counted(self) -> tuple[slice, ...]:
        """The part of a tile whose pixels count."""
        guard = _GUARD_PX // self.prepared.downsampling.step
        return tuple(slice(guard, n - guard) for n in self.optics.tiling.size)


@dataclass(frozen=True)
class TileGroup:
    """Tiles that are computed at once; pairs of a tile and a layer in it, sorted by tile."""

    tiles: list[int]  #: their numbers
    layer: NDArray[np.intp]  #: (n_pairs,), index of the layer
    model: TileLayers
    away_px: NDArray[np.float32]  #: (n_pairs, n_y, n_x), distance from the layer's pixels
    labelled: NDArray[np.bool_]  #: (n_pairs, n_y, n_x), pixels of the layer at first

    @property
    def first(self) -> NDArray[np.float32]:
        """Shares to begin with: shape (n_pairs, n_y, n_x)."""
        optics, fall = self.model.optics, np.exp(self.away_px / np.float32(-_FIRST_FALL_PX))
        share = np.where(self.model.allowed, fall, np.float32(0.0))
        share /= np.maximum(np.add.reduceat(share, optics.starts, axis=0), np.float32(1e-9))[optics.of_tile]
        return share

    @cached_property
    def alone(self) -> NDArray[np.bool_]:
        """Pixels of the layer at first that no other layer may take: shape (n_pairs, n_y, n_x)."""
        optics = self.model.optics
        layers = np.add.reduceat(self.model.allowed, optics.starts, axis=0, dtype=np.int8)
        return np.asarray(self.labelled & (layers == 1)[optics.of_tile])

    def largest(self, share: NDArray[np.float32]) -> NDArray[np.int32]:
        """Number, from 1, of the layer of the largest share (n_pairs, n_y, n_x): shape (n_tiles, n_y, n_x)."""
        ends = [*self.model.optics.starts.tolist(), len(share)]
        return np.stack(
            [1 + self.layer[first:stop][share[first:stop].argmax(axis=0)] for first, stop in pairwise(ends)]
        ).astype(np.int32)

    def hard(self, label: NDArray[np.int32], tiling: Tiling) -> NDArray[np.bool_]:
        """Whether pixels belong to the layer of each pair, shape (n_pairs, n_y, n_x), by their layers' numbers.

        ``label`` covers the images with margin.
        """
        return np.asarray(self.of_pairs(label, tiling) == (self.layer + 1)[:, None, None])

    def of_pairs(self, picture: NDArray[Value], tiling: Tiling) -> NDArray[Value]:
        """A picture of the images with margin in the tile of each pair: shape (n_pairs, n_y, n_x)."""
        tiles = np.stack([tiling.window(picture, tile) for tile in self.tiles])
        return np.asarray(tiles[self.model.optics.of_tile])


def _distances(label: NDArray[np.int32], count: int, reach: float) -> NDArray[np.float32]:
    """Distance of each pixel from the pixels of each number, inf beyond the reach: shape (count, n_y, n_x)."""
    distances = np.full((count, *label.shape), np.inf, dtype=np.float32)
    boxes = find_objects(label, count)

    def write(index: int) -> None:
        part = tuple(slice(max(0, at.start - int(reach) - 1), at.stop + int(reach) + 1) for at in boxes[index])
        distances[index][part] = distance(label[part] == index + 1)

    with kept_threads() as pool:
        pool.map(write, range(count))
    return distances


def _gains(images: NDArray[np.float32], interior: NDArray[np.int32], count: int) -> NDArray[np.float32]:
    """Light of each image over the mean of both in the segments' interiors: shape (count, 2); 1 without light."""
    light = np.stack([np.bincount(interior.ravel(), one.ravel(), count + 1)[1:] for one in images], axis=1)
    total = light.sum(axis=1, keepdims=True)
    return np.where((light > 0.0).all(axis=1, keepdims=True), 2.0 * light / np.maximum(total, 1e-30), 1.0).astype(
        np.float32
    )
