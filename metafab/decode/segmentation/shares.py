"""Outlines from an explicit model of the frame: the light of each layer, and the share of each pixel that is its own.

The frame is modelled as the sum of its layers' light, each blurred by the pair at its depth and in the ratio of its
polarisation contrast. Nearer layers hide farther ones by the geometry of each ray, as in
:mod:`metafab.camera.rendering.occlusion`: at an outline, half of the aperture still sees what lies behind. In a band
about each outline, the layers on both sides may hold the light. It is a Gaussian process: mean and texture (1/k
spectrum) in proportion to the layer's visible share. Expectation and maximisation alternate: the light given the
shares, by preconditioned conjugate gradients, and the shares given the light. A layer that is not there has no texture:
the energy of its whitened light is a fraction of that in the layer's interior (automatic relevance determination;
Tipping, J. Mach. Learn. Res. 1, 211, 2001).

Only tiles whose cores hold such a band are computed, each by itself; see
:mod:`metafab.decode.segmentation.tile_shares`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, find_objects, gaussian_filter
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance, nearest
from metafab.core.parallel.executor import kept_threads
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.layer_light import LayerOptics
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.segments import SegmentDepth
from metafab.decode.segmentation.tile_shares import TileLayers

#: Distance from an outline up to which it may be wrong, frame pixels.
_BAND_PX = 20
#: Distance beyond its outline over which a layer's initial share falls by a factor of e, frame pixels.
_FIRST_FALL_PX = 6.0
#: Distance up to which a segment is grown over lit pixels without one, frame pixels.
_GROWN_PX = 60
#: Rounds of expectation and maximisation.
_ROUNDS = 3
#: Error of the calibration as a share of the light.
_MODEL_ERROR = 0.01
#: Least variance of a pixel, over that of a typical one.
_LEAST_VARIANCE = 0.05
#: Standard deviation of the Gaussian over which energy is pooled, frame pixels.
_POOLED_PX = 4.0
#: Side of the window whose mean light scales a texture, frame pixels.
_LIGHT_PX = 21
#: Distance over which light from beyond the window is mixed in, frame pixels.
_BLUR_PX = 12
#: Distance from a tile's edge up to which its pixels do not count, frame pixels: light from beyond is mixed in. 9 px
#: give the same errors, 18 px a tenth more.
_GUARD_PX = 12
#: Least share of a layer's pixels that lie away from outlines, for these alone to give its typical energy. Small discs
#: before a plain wall with 26 to 50 % there lose and take pixels if all pixels give it; one with 23 % shrinks if these
#: alone do.
_TYPICAL_SHARE = 0.25
#: Standard deviation of the Gaussian that blurs hard outlines for a misfit, downsampled pixels: that of a pixel that an
#: outline may cross anywhere is 0.3; with 0.6 the misfit of true outlines is least against shifted ones.
_HARD_OUTLINE = 0.6
#: Distance from a narrow segment, or from moved pixels, up to which misfits count, frame pixels.
_ABOUT_PX = 24
#: Standard deviation of the Gaussian over which the gain of a move is pooled, frame pixels.
_JUDGED_PX = 8.0
#: Relative difference of vergence from which a layer is nearer than another.
_NEARER = 2e-3
#: Most segments, and most memory of their model: pieces of a shattered segmentation are no layers.
_MOST_LAYERS, _MOST_BYTES = 40, 1 << 30
#: Bytes that a pixel of a tile takes for each layer: transforms of the pair and of the light, shares, masks.
_BYTES_A_PIXEL = 40
#: Pairs of a tile and a layer that are computed at once: their data stay in a core's cache.
_PAIRS_AT_ONCE = 8


def outline_owners(
    prepared: PreparedFrame,
    depths: Sequence[SegmentDepth],
    label: NDArray[np.int32],
    interior: NDArray[np.int32],
    optics: LayerOptics,
) -> NDArray[np.int32] | None:
    """Assign the pixels along outlines to segments by the model of the frame.

    Args:
        prepared: the frame.
        depths: of its segments, from number 1.
        label: shape (n_y, n_x), number of each pixel's segment; 0 for none.
        interior: shape (n_y, n_x), number of the segment whose interior holds the pixel; 0 for none.
        optics: the pair on the frame's downsampled pixels.

    Returns:
        Shape (n_y, n_x), number of each pixel's segment, 0 for none. None where the model does not apply: no two
        segments touch, a segment has no lit pixel, or there are more than 40 segments or 1 GB of their model.
    """
    if not 2 <= len(depths) <= _MOST_LAYERS:
        return None
    layers = _Layers.of(prepared, depths, label, interior, optics)
    owner = None if layers is None else layers.owners()
    if layers is None or owner is None:
        return None
    inner = prepared.downsampling.inner
    return _without_specks(owner[inner], layers.label[inner])


def false_pieces(
    prepared: PreparedFrame,
    depths: Sequence[SegmentDepth],
    label: NDArray[np.int32],
    interior: NDArray[np.int32],
    optics: LayerOptics,
    narrow: Sequence[int],
) -> list[int]:
    """Narrow segments whose light the segments about them explain better, by the model of the frame.

    Between two outlines the blur of both surfaces may correlate at a depth that is neither's. Such a piece is false if
    the nearest other segments fit better both the light of its median pixel and the sum of all light about it; wrong
    outlines nearby spoil the sum alone.

    Args:
        prepared, depths, label, interior, optics: as for :func:`outline_owners`; labels have the shape (n_y, n_x).
        narrow: numbers of the segments that are judged.

    Returns:
        Numbers of the false ones.
    """
    if not 0 < len(narrow) < len(depths) <= _MOST_LAYERS:
        return []
    layers = _Layers.of(prepared, depths, label, interior, optics)
    if layers is None:
        return []
    others = np.where(np.isin(layers.label, narrow), 0, layers.label)
    _, row, column = nearest(others > 0)
    inner, step = prepared.downsampling.inner, prepared.downsampling.step
    pieces = [(number, layers.label[inner] == number) for number in narrow]
    about = [distance(mask) * step <= _ABOUT_PX for _, mask in pieces]
    without = np.where(layers.label > 0, others[row, column], 0).astype(np.int32)
    gain = layers.gain(without, np.any(about, axis=0))
    if gain is None:
        return []
    return [
        number
        for (number, mask), zone in zip(pieces, about, strict=True)
        if np.median(gain[mask]) > 0.0 and gain[zone].sum() > 0.0
    ]


def explained_moves(
    prepared: PreparedFrame,
    depths: Sequence[SegmentDepth],
    label: NDArray[np.int32],
    interior: NDArray[np.int32],
    optics: LayerOptics,
    moved: NDArray[np.int32],
) -> NDArray[np.bool_]:
    """Moves of pixels to other segments by which the light about them fits better, by the model of the frame.

    Args:
        prepared, depths, label, interior, optics: as for :func:`outline_owners`; labels have the shape (n_y, n_x).
        moved: shape (n_y, n_x), other segments of the pixels that move, ``label`` elsewhere.

    Returns:
        Shape (n_y, n_x); all moves where the model does not apply.
    """
    moves = np.asarray(moved != label)
    if not moves.any() or not 2 <= len(depths) <= _MOST_LAYERS:
        return moves
    step, margin = prepared.downsampling.step, prepared.downsampling.margin
    layers = _Layers.of(prepared, depths, label, interior, optics)
    if layers is None:
        return moves
    other = np.where((layers.label > 0) & np.pad(moves, margin), np.pad(moved, margin), layers.label)
    gain = layers.gain(other.astype(np.int32), distance(moves) * step <= _ABOUT_PX)
    return moves if gain is None else moves & (gaussian_filter(gain, _JUDGED_PX / step) > 0.0)


def _without_specks(owner: NDArray[np.int32], label: NDArray[np.int32]) -> NDArray[np.int32]:
    """The owners, except in pieces that nothing connects with pixels of their owner's own label."""
    kept = owner.copy()
    for index, box in enumerate(find_objects(owner)):
        if box is None:
            continue
        component, count = connected_components(owner[box] == index + 1)
        own = np.bincount(component[label[box] == index + 1], minlength=count + 1) > 0
        loose = (component > 0) & ~own[component]
        kept[box][loose] = label[box][loose]
    return kept


@dataclass(frozen=True)
class _Layers:
    """The layers of a frame; pictures over its downsampled images with margin."""

    prepared: PreparedFrame
    optics: LayerOptics
    label: NDArray[np.int32]  # (n_y, n_x), segment of each lit pixel
    lit: NDArray[np.bool_]  # (n_y, n_x)
    alone: NDArray[np.int32]  # (n_y, n_x), segment of the pixels that can belong to no other; 0 elsewhere
    away_px: NDArray[np.float32]  # (n_layers, n_y, n_x), distance from each layer's pixels; inf beyond hidden_px
    grows: NDArray[np.bool_]  # (n_layers,), whether a layer may grow: its light is known away from its outlines
    vergence_per_m: FloatArray  # (n_layers, 2), least and largest over the layer's pixels
    middle_per_m: FloatArray  # (n_layers, n_tiles), at the middles of tiles
    gains: NDArray[np.float32]  # (n_layers, 2), light of each image over the mean of both
    hidden_px: float  # distance from its own pixels up to which a layer is modelled behind others
    _apertures: dict[tuple[int, int], NDArray[np.complex64]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        prepared: PreparedFrame,
        depths: Sequence[SegmentDepth],
        segments: NDArray[np.int32],
        interior: NDArray[np.int32],
        optics: LayerOptics,
    ) -> _Layers | None:
        """The layers of a frame; arguments as for :func:`outline_owners`. None if one has no lit pixel."""
        count, step, margin = len(depths), prepared.downsampling.step, prepared.downsampling.margin
        away, row, column = nearest(segments > 0)
        # Dark parts that light encloses send some, too: without it, no outline nearby fits.
        lit = binary_fill_holes(prepared.lit)
        label = np.where(lit & (away * step <= _GROWN_PX), segments[row, column], 0).astype(np.int32)
        if not np.bincount(label.ravel(), minlength=count + 1)[1:].all():
            return None
        vergence, middles = np.empty((count, 2)), np.empty((count, optics.tiling.n_tiles))
        for index, plane in enumerate(depth.plane for depth in depths):
            own = plane.over(label.shape)[label == index + 1]
            vergence[index] = own.min(), own.max()
            middles[index] = np.clip(plane.at(*optics.tiling.middles.T.astype(np.float64)), own.min(), own.max())
        hidden_px = _BAND_PX + step * float(np.abs(optics.shifts_px_m).max()) * (vergence.max() - vergence.min())
        wide, lit = np.pad(label, margin), np.pad(lit, margin)
        away_px = _distances(wide, count, hidden_px / step) * np.float32(step)
        near = ((away_px <= _BAND_PX) & lit).sum(axis=0, dtype=np.uint8)
        # A piece without pixels away from its outline has none from which its light could be measured: it stays.
        deep = np.where((wide == np.pad(segments, margin)) & (near == 1), wide, 0)
        grows = np.bincount(deep.ravel(), minlength=count + 1)[1:] > 0
        alone = np.where(np.append(False, grows)[wide], deep, wide)
        gains = _gains(prepared.inner, interior, count)
        return cls(prepared, optics, wide, lit, alone, away_px, grows, vergence, middles, gains, hidden_px)

    def aperture(self, nearer: int, behind: int) -> NDArray[np.complex64]:
        """Transfer function of the share of the aperture that one layer covers in front of another."""
        if (nearer, behind) not in self._apertures:
            vergence = self.vergence_per_m.mean(axis=1)
            self._apertures[nearer, behind] = self.optics.aperture(float(vergence[nearer] - vergence[behind]))
        return self._apertures[nearer, behind]

    def is_nearer(self, one: NDArray[np.intp], other: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Whether layers are nearer than others throughout, so that their light may hide them; indices broadcast."""
        least, largest = self.vergence_per_m.T
        return np.asarray(least[one] > (1.0 + _NEARER) * largest[other])

    def owners(self) -> NDArray[np.int32] | None:
        """The layer of the largest share of each pixel, from 1; None where no two touch, or for too much memory."""
        tiles = self.tiles
        if self.is_too_large(tiles):
            return None
        groups = self.groups(tiles)
        with kept_threads() as pool:
            shares = [group.first for group in groups]
            white: list[NDArray[np.complex64] | None] = [None] * len(groups)
            for _ in range(_ROUNDS):
                found = list(pool.map(lambda group, *last: group.model.expected(*last), groups, shares, white))
                typical = _typical_energy(groups, [one.energy for one in found], len(self.gains))
                shares = [
                    group.model.share(one, typical[group.layer]) for group, one in zip(groups, found, strict=True)
                ]
                white = [one.white for one in found]
        owner = self.label.copy()
        for group, share in zip(groups, shares, strict=True):
            self._write(group, share, owner[self.prepared.downsampling.inner])
        return owner

    def is_too_large(self, tiles: list[tuple[int, list[int]]]) -> bool:
        """Whether there is no tile, or too many for the memory of their model."""
        n_y, n_x = self.optics.tiling.size
        return not tiles or sum(len(layers) for _, layers in tiles) * n_y * n_x * _BYTES_A_PIXEL > _MOST_BYTES

    def groups(self, tiles: list[tuple[int, list[int]]]) -> list[_Group]:
        """Tiles with the indices of the layers in each, in groups that are computed at once."""
        ends = np.flatnonzero(np.diff(np.cumsum([len(layers) for _, layers in tiles]) // _PAIRS_AT_ONCE)) + 1
        mean = window_means(self.prepared.images, max(3, _LIGHT_PX // self.prepared.downsampling.step | 1))
        pictures = self._weight(mean), np.maximum(mean.mean(axis=0), np.float32(1e-3))
        parts = pairwise([0, *ends.tolist(), len(tiles)])
        with kept_threads() as pool:
            return list(pool.map(lambda part: self._group(tiles[slice(*part)], *pictures), parts))

    def gain(self, label: NDArray[np.int32], near: NDArray[np.bool_]) -> NDArray[np.float32] | None:
        """Misfit of the layers' pixels less that with other outlines, by pixel of the window: shape (n_y, n_x).

        ``label`` is the number of each pixel's layer with the other outlines, of the shape of the images with margin.
        Tiles without pixels ``near`` where it differs, shape (n_y, n_x), are 0. None without tiles, or for too much
        memory.
        """
        judged = set(self.optics.tiling.tiles_with(near).tolist())
        tiles = [one for one in self.tiles if one[0] in judged]
        if self.is_too_large(tiles):
            return None
        tiling, gain = self.optics.tiling, np.zeros(near.shape, dtype=np.float32)

        def of(group: _Group) -> NDArray[np.float32]:
            number = (group.layer + 1)[:, None, None]
            own, other = (
                np.stack([tiling.window(one, tile) for tile in group.tiles])[group.model.optics.of_tile] == number
                for one in (self.label, label)
            )
            before, after = (
                group.model.misfit(gaussian_filter(one.astype(np.float32), (0.0, _HARD_OUTLINE, _HARD_OUTLINE)))
                for one in (own, other)
            )
            return before - after

        groups = self.groups(tiles)
        with kept_threads() as pool:
            for group, found in zip(groups, pool.map(of, groups), strict=True):
                for tile, core in zip(group.tiles, found[:, *self._core], strict=True):
                    to = gain[tiling.place(tile)]
                    to[...] = core[: to.shape[0], : to.shape[1]]
        return gain

    def _write(self, group: _Group, share: NDArray[np.float32], owner: NDArray[np.int32]) -> None:
        """Write the layer of the largest share into the tiles' cores of the owners, at pixels of a segment."""
        tiling, starts = self.optics.tiling, group.model.optics.starts.tolist()
        for tile, first, stop in zip(group.tiles, starts, [*starts[1:], len(share)], strict=True):
            best = group.layer[first:stop][share[first:stop, *self._core].argmax(axis=0)] + 1
            to = owner[tiling.place(tile)]
            np.copyto(to, best[: to.shape[0], : to.shape[1]], where=to > 0, casting="same_kind")

    @property
    def tiles(self) -> list[tuple[int, list[int]]]:
        """Tiles with outlines in their cores, and the layers near the pixels of each that count."""
        tiling, layers, tiles = self.optics.tiling, range(len(self.gains)), []
        open_pixels = ((self.label > 0) & (self.alone == 0))[self.prepared.downsampling.inner]
        for tile in tiling.tiles_with(open_pixels).tolist():
            lit = tiling.window(self.lit, tile)[self._counted]
            near = [k for k in layers if (tiling.window(self.away_px[k], tile)[self._counted][lit] <= _BAND_PX).any()]
            if len(near) > 1:
                tiles.append((tile, near))
        return tiles

    def _group(
        self, tiles: list[tuple[int, list[int]]], weight: NDArray[np.float32], light: NDArray[np.float32]
    ) -> _Group:
        """Cut tiles, with the indices of the layers in each, out of the frame's pictures.

        ``weight`` is the inverse standard deviation of each pixel, ``light`` the mean light around it, electrons,
        positive.
        """
        tiling, step = self.optics.tiling, self.prepared.downsampling.step
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
        share = np.where(allowed, np.exp(-away / np.float32(_FIRST_FALL_PX)), np.float32(0.0))
        share /= np.maximum(np.add.reduceat(share, optics.starts, axis=0), np.float32(1e-9))[of_tile]
        single = np.add.reduceat(allowed, optics.starts, axis=0, dtype=np.int8)[of_tile] == 1
        core, counted = np.zeros((2, *tiling.size), dtype=bool)
        core[self._core] = True
        counted[self._counted] = True
        images, weights, lights = (
            np.stack([tiling.window(one, tile) for tile in numbers]) for one in (self.prepared.images, weight, light)
        )
        nearer = self.is_nearer(layer, layer[:, None]) & (of_tile[:, None] == of_tile)
        hiding = [
            (pair, one, self.aperture(int(layer[one]), int(layer[pair]))) for pair, one in np.argwhere(nearer).tolist()
        ]
        model = TileLayers(
            optics,
            self.gains[layer],
            hiding,
            images,
            weights * counted,
            np.maximum(lights, light.min()),
            allowed,
            away <= self.hidden_px,
            _POOLED_PX / step,
        )
        labelled = allowed & (label == number) & core
        return _Group(numbers, layer, model, share, labelled, labelled & single)

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

    def _weight(self, mean: NDArray[np.float32]) -> NDArray[np.float32]:
        """Inverse standard deviation of each pixel of the images, 0 where it is not modelled: their shape.

        ``mean``: light about each pixel, the shape of the images.
        """
        prepared = self.prepared
        step, margin = prepared.downsampling.step, prepared.downsampling.margin
        # Dark pixels are not known better than a frame's usual noise allows, whatever read noise it states.
        floor_e2 = prepared.levels.read_noise_e**2 + _LEAST_VARIANCE * prepared.levels.noise_variance
        variance = np.maximum(mean, np.float32(0.0)) + np.float32(floor_e2)
        sigma = np.sqrt(variance / step**2 + (_MODEL_ERROR * mean) ** 2 + np.float32(1e-9))
        weight = (1.0 / sigma).astype(np.float32)
        # Light from beyond the window is not modelled.
        beyond = prepared.images.sum(axis=0) > np.pad(prepared.floor_e, margin, mode="edge")
        beyond[prepared.downsampling.inner] = False
        weight[:, distance(beyond) * step <= _BLUR_PX] = 0.0
        weight[:, *prepared.downsampling.inner][:, prepared.spoiled] = 0.0
        return weight


@dataclass(frozen=True)
class _Group:
    """Tiles that are computed at once; pairs of a tile and a layer in it, sorted by tile."""

    tiles: list[int]  # their numbers
    layer: NDArray[np.intp]  # (n_pairs,), index of the layer
    model: TileLayers
    first: NDArray[np.float32]  # (n_pairs, n_y, n_x), shares to begin with
    labelled: NDArray[np.bool_]  # (n_pairs, n_y, n_x), pixels of the layer at first
    alone: NDArray[np.bool_]  # (n_pairs, n_y, n_x), those that no other layer may take


def _typical_energy(
    groups: Sequence[_Group], energies: Sequence[NDArray[np.float32]], count: int
) -> NDArray[np.float32]:
    """Median energy of each layer's whitened light at its pixels away from outlines: shape (count,).

    At all its pixels if fewer than a quarter are away from outlines: a layer that loses pixels explains its light by
    the others, and energy that rose with each loss would make it lose more. The mean over its tiles for a layer whose
    pixels lie in other tiles.
    """
    energy = np.concatenate(energies)
    layer, labelled, alone = (
        np.concatenate(parts) for parts in zip(*((g.layer, g.labelled, g.alone) for g in groups), strict=True)
    )
    typical = np.ones(count, dtype=np.float32)
    for index in np.unique(layer).tolist():
        at = layer == index
        known = alone[at] if alone[at].sum() >= _TYPICAL_SHARE * labelled[at].sum() else labelled[at]
        typical[index] = np.median(energy[at][known]) if known.any() else energy[at].mean()
    return typical


def _distances(label: NDArray[np.int32], count: int, reach: float) -> NDArray[np.float32]:
    """Distance of each pixel from the pixels of each number, inf beyond the reach: shape (count, n_y, n_x)."""
    distances = np.full((count, *label.shape), np.inf, dtype=np.float32)
    boxes = find_objects(label, count)

    def write(index: int) -> None:
        part = tuple(slice(max(0, at.start - int(reach) - 1), at.stop + int(reach) + 1) for at in boxes[index])
        distances[index][part] = distance(label[part] == index + 1)

    with kept_threads() as pool:
        for _ in pool.map(write, range(count)):
            pass
    return distances


def _gains(images: NDArray[np.float32], interior: NDArray[np.int32], count: int) -> NDArray[np.float32]:
    """Light of each image over the mean of both in the segments' interiors: shape (count, 2); 1 without light."""
    light = np.stack([np.bincount(interior.ravel(), one.ravel(), count + 1)[1:] for one in images], axis=1)
    total = light.sum(axis=1, keepdims=True)
    return np.where((light > 0.0).all(axis=1, keepdims=True), 2.0 * light / np.maximum(total, 1e-30), 1.0).astype(
        np.float32
    )
