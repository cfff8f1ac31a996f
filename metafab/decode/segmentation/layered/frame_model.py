"""Outlines from an explicit model of the frame: the light of each layer, and the share of each pixel that is its own.

The frame is modelled as the sum of its layers' light, each blurred by the pair at its depth and in the ratio of its
polarisation contrast. Nearer layers hide farther ones by the geometry of each ray, as in
:mod:`metafab.camera.rendering.occlusion`: at an outline, half of the aperture still sees what lies behind. In a band
about each outline, the layers on both sides may hold the light. It is a Gaussian process: mean and texture (1/k
spectrum) in proportion to the layer's visible share. Expectation and maximisation alternate: the light given the
shares, by preconditioned conjugate gradients, and the shares given the light. A layer that is not there has no texture:
the energy of its whitened light is a fraction of that in the layer's interior (automatic relevance determination;
Tipping, J. Mach. Learn. Res. 1, 211, 2001).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, gaussian_filter
from scipy.ndimage import label as connected_components

from metafab.core.numeric.distance import distance, nearest
from metafab.core.parallel.executor import kept_threads
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.layered.layer_tiles import FrameLayers, TileGroup
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Rounds of expectation and maximisation.
_ROUNDS = 3
#: Least share of a layer's pixels that lie away from outlines, for these alone to give its typical energy. Small discs
#: before a plain wall with 26 to 50 % there lose and take pixels if all pixels give it; one with 23 % shrinks if these
#: alone do.
_TYPICAL_SHARE = 0.25
#: Standard deviation of the Gaussian that blurs hard outlines for a misfit, downsampled pixels: that of a pixel that an
#: outline may cross anywhere is 0.3; with 0.6 the misfit of true outlines is least against shifted ones.
_HARD_OUTLINE = 0.6
#: Distance from a narrow segment up to which misfits count, frame pixels.
_ABOUT_PX = 24
#: Standard deviation of the Gaussian over which the gain of a move is pooled, frame pixels. Tiles that near to moves
#: are computed: those within three times as much are up to a third more, and make outlines no better.
_JUDGED_PX = 8.0
#: Standard deviation of the Gaussian over which misfits of displaced outlines are pooled, frame pixels: with 4, 6 and 9
#: a natural scene is 0.985, 0.991 and 1.003 % off.
_DISPLACED_PX = 4.0
#: Difference of the logarithms of I_x / I_y from which contrasts are unlike: the least by which
#: :mod:`metafab.decode.images.contrast_outlines` tells two segments apart.
_UNLIKE = 0.1
#: Least moves in a tile's core, downsampled pixels, for which it is computed: fewer stay where they are. That leaves
#: out 0.1 % of a frame's pixels and half of the tiles of its first moves, and outlines err no more. With 32, natural
#: frames have 2 to 3 % more wrong pixels.
_FEWEST_MOVES = 16
#: Most segments: pieces of a shattered segmentation are no layers.
_MOST_LAYERS = 40


@dataclass(frozen=True)
class FrameModel:
    """The model of a frame by the layers of its segments; it applies to 2 to 40 segments, each with a lit pixel."""

    prepared: PreparedFrame  #: The frame.
    regions: Regions  #: Its segments.
    optics: LayerOptics  #: The pair on the frame's downsampled pixels.

    def owners(self) -> NDArray[np.int32] | None:
        """Number of each pixel's segment by the largest share of its light, 0 for none: shape (n_y, n_x).

        None where the model does not apply, no two segments touch, or their tiles take too much memory.
        """
        layers = self._layers
        groups = [] if layers is None else layers.groups()
        if layers is None or not groups:
            return None
        with kept_threads() as pool:
            shares = pool.map(lambda group: group.first, groups)
            white: list[NDArray[np.complex64] | None] = [None] * len(groups)
            for _ in range(_ROUNDS):
                found = pool.map(lambda group, *last: group.model.expected(*last), groups, shares, white)
                typical = typical_energy(groups, [one.energy for one in found], len(self.regions.depths))
                shares = pool.map(
                    lambda group, one, typical=typical: group.model.share(one, typical[group.layer]), groups, found
                )
                white = [one.white for one in found]
        label = layers.label[self.prepared.downsampling.inner]
        owner = label.copy()
        for group, share in zip(groups, shares, strict=True):
            layers.write_cores(group, group.largest(share), owner)
        return _without_specks(np.where(label > 0, owner, 0), label)

    def false_pieces(self, narrow: Sequence[int]) -> list[int]:
        """Narrow segments, by their numbers, whose light the segments about them explain better.

        Between two outlines the blur of both surfaces may correlate at a depth that is neither's. Such a piece is false
        if the nearest other segments fit better both the light of its median pixel and the sum of all light about it;
        wrong outlines nearby spoil the sum alone. None are false where the model does not apply.
        """
        if not 0 < len(narrow) < len(self.regions.depths) or self._layers is None:
            return []
        label = self._layers.label[self.prepared.downsampling.inner]
        others = np.where(np.isin(label, narrow), 0, label)
        _, row, column = nearest(others > 0)
        pieces = [label == number for number in narrow]
        about = [distance(mask) * self.prepared.downsampling.step <= _ABOUT_PX for mask in pieces]
        misfits = self._misfits(np.where(label > 0, others[row, column], 0).astype(np.int32), np.any(about, axis=0))
        if misfits is None:
            return []
        gain = misfits[0] - misfits[1]
        return [
            number
            for number, mask, zone in zip(narrow, pieces, about, strict=True)
            if np.median(gain[mask]) > 0.0 and gain[zone].sum() > 0.0
        ]

    def explained_moves(self, moved: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Moves of pixels to other segments by which the light about them fits better: shape (n_y, n_x).

        ``moved`` is as for :meth:`gain_of_moves`. All moves between segments of unlike contrast, which tells them apart
        better, and all where the model does not apply.
        """
        own = self.regions.grown
        unlike = self.unlike[own, moved]
        gain = self.gain_of_moves(np.where(unlike, own, moved).astype(np.int32))
        return np.asarray((moved != own) & (True if gain is None else unlike | (gain > 0.0)))

    def gain_of_moves(self, moved: NDArray[np.int32]) -> NDArray[np.float32] | None:
        """Fall of the misfit of a pixel and the light about it if pixels move to other segments: shape (n_y, n_x).

        In variances of the pixel: those of noise, or of the residuals after the moves where these are larger; 0 where
        few pixels move.

        Args:
            moved: shape (n_y, n_x), other segments of the pixels that move, their own elsewhere.

        Returns:
            None without moves, or where the model does not apply.
        """
        moves, step = np.asarray(moved != self.regions.grown), self.prepared.downsampling.step
        if not moves.any() or self._layers is None:
            return None
        many = self.optics.tiling.in_many(moves, _FEWEST_MOVES)
        if not many.any():
            return np.zeros(moves.shape, dtype=np.float32)
        label = self._layers.label[self.prepared.downsampling.inner]
        misfits = self._misfits(np.where((label > 0) & moves, moved, label), distance(many) * step <= _JUDGED_PX)
        if misfits is None:
            return None
        before, after = gaussian_filter(misfits, (0.0, _JUDGED_PX / step, _JUDGED_PX / step))
        # A pixel has a value in each of both images.
        return np.asarray((before - after) / np.maximum(np.float32(1.0), np.float32(0.5) * after))

    @cached_property
    def unlike(self) -> NDArray[np.bool_]:
        """Whether the contrasts of two segments differ, by their numbers: shape (n_segments + 1, n_segments + 1).

        Those of segments without pixels away from their outlines are not known: their light is mixed with other light.
        None are unlike where the model does not apply.
        """
        if self._layers is None:
            return np.zeros((len(self.regions.depths) + 1,) * 2, dtype=bool)
        contrast = np.log(self._layers.gains[:, 0] / self._layers.gains[:, 1])
        known = np.append(np.nan, np.where(self._layers.grows, contrast, np.nan))
        return np.asarray(np.abs(known[:, None] - known) > _UNLIKE)

    def displaced_misfits(
        self, beyond_px: NDArray[np.float32], across: NDArray[np.int32], by_px: Sequence[float], near: NDArray[np.bool_]
    ) -> NDArray[np.float32] | None:
        """Misfits of pixels and the light about them if nearer segments reach farther out: (n_by, n_y, n_x).

        In variances of the frame's noise, or of what is left with the best displacement where that is larger, summed
        under a Gaussian of unit height. Of the small lens' frames 10 to 22 times the noise is left along outlines:
        differences of a few variances of the noise are chance there.

        Args:
            beyond_px: shape (n_y, n_x), distance of each pixel from the nearest outline, frame pixels, positive in the
                farther segment.
            across: shape (n_y, n_x), the segment across that outline; 0 without one.
            by_px: displacements of all outlines, ascending, 0 in their middle, frame pixels.
            near: shape (n_y, n_x), pixels whose tiles are computed; others are 0.

        Returns:
            None where the model does not apply, or if the tiles take too much memory.
        """
        layers, step, margin = self._layers, self.prepared.downsampling.step, self.prepared.downsampling.margin
        groups = [] if layers is None else layers.groups(near)
        if layers is None or not groups:
            return None
        own, is_near = self.regions.grown, beyond_px < 0.0
        pictures = np.where(is_near, own, across), np.where(is_near, across, own), beyond_px
        nearer, farther, beyond = (np.pad(one, margin, mode="edge") for one in pictures)

        def misfits(group: TileGroup) -> list[NDArray[np.float32]]:
            here = group.hard(nearer, self.optics.tiling), group.hard(farther, self.optics.tiling)
            away = group.of_pairs(beyond, self.optics.tiling)
            inner = [np.clip(np.float32(0.5) + (np.float32(by) - away) / np.float32(step), 0.0, 1.0) for by in by_px]
            return group.model.misfits([here[0] * one + here[1] * (np.float32(1.0) - one) for one in inner])

        found = np.zeros((len(by_px), *near.shape), dtype=np.float32)
        with kept_threads() as pool:
            for group, of_group in zip(groups, pool.map(misfits, groups), strict=True):
                for one, to in zip(of_group, found, strict=True):
                    layers.write_cores(group, one, to)
        deviation = _DISPLACED_PX / step
        mean = gaussian_filter(found, (0.0, deviation, deviation))
        # A pixel has a value in each of both images.
        left = np.maximum(np.float32(1.0), np.float32(0.5) * mean.min(axis=0))
        return np.asarray(mean / left * np.float32(2.0 * np.pi * deviation**2))

    @cached_property
    def _layers(self) -> FrameLayers | None:
        """The layers; None where the model does not apply."""
        if not 2 <= len(self.regions.depths) <= _MOST_LAYERS:
            return None
        return FrameLayers.of(self.prepared, self.regions, self.optics)

    def _misfits(self, label: NDArray[np.int32], near: NDArray[np.bool_]) -> NDArray[np.float32] | None:
        """Misfits of the layers' pixels by the segments' outlines and by other ones: shape (2, n_y, n_x).

        ``label``, shape (n_y, n_x), is the number of each pixel's layer by the other outlines. Tiles without pixels
        ``near`` those, shape (n_y, n_x), are 0. None without tiles, or if they take too much memory.
        """
        layers = self._layers
        groups = [] if layers is None else layers.groups(near)
        if layers is None or not groups:
            return None
        tiling, both = self.optics.tiling, (layers.label, np.pad(label, self.prepared.downsampling.margin))

        def misfit(group: TileGroup, one: NDArray[np.int32]) -> NDArray[np.float32]:
            hard = group.hard(one, tiling).astype(np.float32)
            return group.model.misfit(gaussian_filter(hard, (0.0, _HARD_OUTLINE, _HARD_OUTLINE)))

        misfits = np.zeros((2, *near.shape), dtype=np.float32)
        jobs = [(group, one) for group in groups for one in (0, 1)]
        with kept_threads() as pool:
            found = pool.map(lambda group, one: misfit(group, both[one]), *zip(*jobs, strict=True))
        for (group, one), of_group in zip(jobs, found, strict=True):
            layers.write_cores(group, of_group, misfits[one])
        return misfits


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


def typical_energy(
    groups: Sequence[TileGroup], energies: Sequence[NDArray[np.float32]], count: int
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
