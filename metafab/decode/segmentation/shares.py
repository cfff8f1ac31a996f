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
from scipy.ndimage import gaussian_filter
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.spectra import convolved
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.distance import distance, nearest
from metafab.decode.segmentation.layer_light import LayerLight, LayerOptics
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.segments import SegmentDepth

#: Distance from an outline up to which it may be wrong, frame pixels.
_BAND_PX = 20
#: Distance over which a layer's share falls by e beyond its outline at first, frame pixels.
_FIRST_FALL_PX = 6.0
#: Distance up to which a segment is grown over lit pixels without one, frame pixels.
_GROWN_PX = 60
#: Rounds of expectation and maximisation, and steps of conjugate gradients in each: more move outlines by a pixel.
_ROUNDS, _STEPS = 2, 8
#: Rms contrast of the texture, and error of the calibration as a share of the light.
_TEXTURE, _MODEL_ERROR = 0.3, 0.01
#: A farther layer is expected in full from an open share of the aperture of 1 / 1.7: 1/2 at a straight outline, a
#: little more after pooling over both sides.
_OPEN = 1.7
#: Least variance of a pixel, over that of a typical one.
_LEAST_VARIANCE = 0.05
#: Energy of whitened light that counts as none, over that of the prior.
_LEAST_ENERGY = 0.05
#: Standard deviation of the Gaussian over which energy is pooled, frame pixels.
_POOLED_PX = 4.0
#: Side of the window whose mean light scales a texture, frame pixels.
_LIGHT_PX = 21
#: Distance over which light from beyond the window is mixed in, frame pixels.
_BLUR_PX = 12
#: Relative difference of vergence from which a layer is nearer than another.
_NEARER = 2e-3
#: Most segments, and most memory of their blur: pieces of a shattered segmentation are no layers.
_MOST_LAYERS, _MOST_BYTES = 40, 1 << 30

Pictures = list[NDArray[np.float32]]


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
        Shape (n_y, n_x), number of each pixel's segment, 0 for none. None where the model says nothing: no two segments
        touch, a segment has no lit pixel, or there are more than 40 segments or 1 GB of their blur.
    """
    if not 2 <= len(depths) <= _MOST_LAYERS:
        return None
    model = _FrameModel.of(prepared, depths, label, interior, optics)
    if model is None:
        return None
    share = model.fitted()[:, *prepared.downsampling.inner]
    return _without_specks(share, model.label[prepared.downsampling.inner])


def _without_specks(share: NDArray[np.float32], label: NDArray[np.int32]) -> NDArray[np.int32]:
    """The layer of the largest share, except in pieces that nothing connects with that layer's own pixels."""
    owner = np.where(label > 0, share.argmax(axis=0) + 1, 0).astype(np.int32)
    for number in range(1, len(share) + 1):
        component, count = connected_components(owner == number)
        touched = np.zeros(count + 1, dtype=bool)
        touched[component[(owner == number) & (label == number)]] = True
        loose = (component > 0) & ~touched[component]
        owner[loose] = label[loose]
    return owner


@dataclass(frozen=True)
class _FrameModel:
    """Layers of a frame with what stays the same while their shares change; arrays on the images with margin."""

    images: NDArray[np.float32]  # (2, n_y, n_x), electrons
    weight: NDArray[np.float32]  # (2, n_y, n_x), inverse standard deviation of a pixel; 0 where it is not modelled
    label: NDArray[np.int32]  # (n_y, n_x), segment of each lit pixel
    allowed: NDArray[np.bool_]  # (n_layers, n_y, n_x), pixels that may belong to a layer
    first: NDArray[np.float32]  # (n_layers, n_y, n_x), shares to begin with
    layers: tuple[LayerLight, ...]
    vergence_per_m: FloatArray  # (n_layers, 2), least and largest over the layer's pixels
    gains: NDArray[np.float32]  # (n_layers, 2), light of each image over the mean of both
    light: tuple[NDArray[np.float32], ...]  # mean light of each layer's part, electrons
    shifts_px_m: FloatArray  # (n, 2), of the aperture
    pooled: float  # standard deviation of the pooling, downsampled pixels

    @classmethod
    def of(
        cls,
        prepared: PreparedFrame,
        depths: Sequence[SegmentDepth],
        segments: NDArray[np.int32],
        interior: NDArray[np.int32],
        optics: LayerOptics,
    ) -> _FrameModel | None:
        """The model of a frame; arguments as for :func:`outline_owners`. None where no two segments touch."""
        step, margin = prepared.downsampling.step, prepared.downsampling.margin
        lit = np.pad(prepared.lit, margin)
        away, row, column = nearest(segments > 0)
        whole = np.where(away * step <= _GROWN_PX, segments[row, column], 0)
        label = np.where(lit, np.pad(whole, margin), 0).astype(np.int32)
        numbers = range(1, len(depths) + 1)
        parts = [label == number for number in numbers]
        if not all(part.any() for part in parts):
            return None
        away_px = np.stack([distance(part) * np.float32(step) for part in parts])
        allowed = (away_px <= _BAND_PX) & lit
        for number, mine, own in zip(numbers, parts, allowed, strict=True):
            others = (label > 0) & ~mine
            deep = mine & np.pad(segments == number, margin)
            if others.any():
                deep &= distance(others) * step > _BAND_PX
            # A piece without pixels away from its outline has none from which its light could be measured: it stays.
            fixed = deep if deep.any() else mine
            allowed &= ~fixed
            own[:] = own & deep.any() | fixed
        if not (allowed.sum(axis=0) > 1).any():
            return None
        first = np.where(allowed, np.exp(-away_px / np.float32(_FIRST_FALL_PX)), np.float32(0.0))
        first /= np.maximum(first.sum(axis=0), np.float32(1e-9))
        inner, shape = prepared.downsampling.inner, prepared.downsampling.shape
        planes = [depth.plane.over(shape) for depth in depths]
        spanned = [plane[part[inner]] for part, plane in zip(parts, planes, strict=True)]
        vergence = np.array([(one.min(), one.max()) for one in spanned])
        shifts = optics.shifts_px_m()
        hidden_px = step * float(np.abs(shifts).max()) * (vergence.max() - vergence.min())
        layers: list[LayerLight] = []
        for plane, px in zip(planes, away_px, strict=True):
            layers.append(optics.layer(plane, (px <= _BAND_PX + hidden_px) & lit))
            if sum(layer.nbytes for layer in layers) > _MOST_BYTES:
                return None
        images = prepared.images
        mean = window_means(images, max(3, _LIGHT_PX // step | 1))
        # Dark pixels are not known better than a frame's usual noise allows, whatever read noise it states.
        floor_e2 = prepared.levels.read_noise_e**2 + _LEAST_VARIANCE * prepared.levels.noise_variance
        variance = np.maximum(mean, np.float32(0.0)) + np.float32(floor_e2)
        sigma = np.sqrt(variance / step**2 + (_MODEL_ERROR * mean) ** 2 + np.float32(1e-9))
        weight = (1.0 / sigma).astype(np.float32)
        # Light from beyond the window is not modelled.
        beyond = images.sum(axis=0) > np.pad(prepared.floor_e, margin, mode="edge")
        beyond[prepared.downsampling.inner] = False
        weight[:, distance(beyond) * step <= _BLUR_PX] = 0.0
        weight[:, *prepared.downsampling.inner][:, prepared.spoiled] = 0.0
        light = np.maximum(mean.mean(axis=0), np.float32(1e-3))
        return cls(
            images,
            weight,
            label,
            allowed,
            first.astype(np.float32),
            tuple(layers),
            vergence,
            _gains(images, np.pad(interior, margin), len(layers)),
            tuple(light[layer.at] for layer in layers),
            shifts,
            _POOLED_PX / step,
        )

    @cached_property
    def nearer(self) -> list[list[int]]:
        """Of each layer, the layers nearer than it throughout, whose light may hide it."""
        least, largest = self.vergence_per_m.T
        nearer = least[None, :] > (1.0 + _NEARER) * largest[:, None]
        return [
            [j for j in np.flatnonzero(row).tolist() if _overlap(self.layers[k].at, self.layers[j].at)]
            for k, row in enumerate(nearer)
        ]

    def fitted(self) -> NDArray[np.float32]:
        """Shares of the layers, shape (n_layers, n_y, n_x); their sum is 1 at pixels of a segment."""
        share, white = self.first, [np.zeros(layer.shape, dtype=np.float32) for layer in self.layers]
        deep = self.allowed.sum(axis=0) == 1
        for _ in range(_ROUNDS):
            extent, open_share = self._extended(share)
            white = self._light_given(share, extent * open_share, open_share, white)
            energy = np.zeros_like(share)
            for k, layer in enumerate(self.layers):
                pooled = gaussian_filter(white[k] * white[k], self.pooled) + np.float32(_LEAST_ENERGY)
                own = pooled[deep[layer.at] & (self.label[layer.at] == k + 1)]
                typical = float(np.median(own)) if own.size else float(pooled.mean())
                expected = np.minimum(np.float32(1.0), np.float32(_OPEN) * open_share[k][layer.at])
                energy[k][layer.at] = pooled / typical * expected * extent[k][layer.at]
            energy = np.where(self.allowed, energy + np.float32(1e-4), np.float32(0.0))
            share = energy / np.maximum(energy.sum(axis=0), np.float32(1e-9))
        return share

    def _extended(self, share: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Share of each pixel that a layer fills, seen or hidden, and share of the aperture that sees it there.

        A layer continues behind nearer ones; both of shape (n_layers, n_y, n_x).
        """
        open_share, extent, vergence = np.ones_like(share), share.copy(), self.vergence_per_m.mean(axis=1)
        for k, nearer in enumerate(self.nearer):
            support = np.zeros(share.shape[1:], dtype=bool)
            support[self.layers[k].at] = True
            for j in nearer:
                at = self.layers[j].at
                kernel = _aperture_kernel(self.shifts_px_m * (vergence[j] - vergence[k]))
                reach = len(kernel) // 2
                covered = convolved(share[j][at], kernel)[reach:-reach, reach:-reach]
                open_share[k][at] -= covered
                extent[k] += np.where(support, share[j], np.float32(0.0))
        open_share = np.clip(open_share, np.float32(0.0), np.float32(1.0))
        return np.minimum(extent, np.float32(1.0)), open_share

    def _light_given(
        self,
        share: NDArray[np.float32],
        seen: NDArray[np.float32],
        open_share: NDArray[np.float32],
        start: Sequence[NDArray[np.float32]],
    ) -> Pictures:
        """Whitened texture of each layer given the shares: preconditioned conjugate gradients from ``start``."""
        gains = self._balanced(share, seen, open_share)
        spread = [
            np.float32(_TEXTURE) * light * np.sqrt(seen[k][layer.at])
            for k, (layer, light) in enumerate(zip(self.layers, self.light, strict=True))
        ]
        mean = [light * seen[k][layer.at] for k, (layer, light) in enumerate(zip(self.layers, self.light, strict=True))]

        def forward(white: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
            textures = [
                one * layer.filtered(u, layer.texture) for layer, one, u in zip(self.layers, spread, white, strict=True)
            ]
            return self.weight * self._rendered(textures, gains)

        def gradient(residual: NDArray[np.float32], white: Sequence[NDArray[np.float32]]) -> Pictures:
            weighted = self.weight * residual
            return [
                layer.filtered(one * layer.adjoint(gain * weighted[:, *layer.at]), layer.texture) - u
                for layer, one, gain, u in zip(self.layers, spread, gains, white, strict=True)
            ]

        white = [one.copy() for one in start]
        residual = self.weight * (self.images - self._rendered(mean, gains)) - forward(white)
        descent = gradient(residual, white)
        scaled = self._preconditioned(descent)
        direction, norm = scaled, _dot(descent, scaled)
        for _ in range(_STEPS):
            change = forward(direction)
            length = np.float32(norm / max(float(np.vdot(change, change)) + _dot(direction, direction), 1e-30))
            white = [u + length * one for u, one in zip(white, direction, strict=True)]
            residual = residual - length * change
            descent = gradient(residual, white)
            scaled = self._preconditioned(descent)
            before, norm = norm, _dot(descent, scaled)
            ratio = np.float32(norm / max(before, 1e-30))
            direction = [one + ratio * last for one, last in zip(scaled, direction, strict=True)]
        return white

    def _rendered(
        self, light: Sequence[NDArray[np.float32]], gains: Sequence[NDArray[np.float32]]
    ) -> NDArray[np.float32]:
        """Both images of the layers' light, shape (2, n_y, n_x)."""
        images = np.zeros_like(self.images)
        for layer, gain, one in zip(self.layers, gains, light, strict=True):
            images[:, *layer.at] += gain * layer.blurred(one)
        return images

    def _balanced(
        self, share: NDArray[np.float32], seen: NDArray[np.float32], open_share: NDArray[np.float32]
    ) -> Pictures:
        """Gain of each layer at each pixel of both images: radiance does not change where layers hide each other."""
        hiding = {j for nearer in self.nearer for j in nearer}
        veils = {j: self.layers[j].blurred(np.minimum(share[j], seen[j])[self.layers[j].at]) for j in hiding}
        gains = []
        for k, layer in enumerate(self.layers):
            gain = np.broadcast_to(self.gains[k][:, None, None], (2, *layer.shape))
            if self.nearer[k]:
                veil = np.zeros_like(self.images)
                for j in self.nearer[k]:
                    veil[:, *self.layers[j].at] += veils[j]
                hidden = layer.blurred(np.float32(1.0) - open_share[k][layer.at])
                gain = gain * (np.float32(1.0) + hidden - veil[:, *layer.at])
            gains.append(gain)
        return gains

    def _preconditioned(self, pictures: Sequence[NDArray[np.float32]]) -> Pictures:
        """Pictures divided by the mean curvature of each frequency."""
        return [layer.filtered(one, by) for layer, one, by in zip(self.layers, pictures, self._inverse, strict=True)]

    @cached_property
    def _inverse(self) -> Pictures:
        """Inverse of the curvature of each frequency of each layer, for its typical light and noise."""
        inverse = []
        for k, (layer, light) in enumerate(zip(self.layers, self.light, strict=True)):
            ratio = _TEXTURE * float(np.median((light * self.weight.mean(axis=0)[layer.at])[self.allowed[k][layer.at]]))
            power = ratio**2 * layer.texture**2 * layer.power(self.gains[k].astype(np.float64))
            inverse.append((1.0 / (1.0 + power)).astype(np.float32))
        return inverse


def _gains(images: NDArray[np.float32], interior: NDArray[np.int32], count: int) -> NDArray[np.float32]:
    """Light of each image over the mean of both in the segments' interiors: shape (count, 2); 1 without light."""
    light = np.stack([np.bincount(interior.ravel(), one.ravel(), count + 1)[1:] for one in images], axis=1)
    total = light.sum(axis=1, keepdims=True)
    return np.where((light > 0.0).all(axis=1, keepdims=True), 2.0 * light / np.maximum(total, 1e-30), 1.0).astype(
        np.float32
    )


def _overlap(one: tuple[slice, slice], other: tuple[slice, slice]) -> bool:
    return all(a.start < b.stop and b.start < a.stop for a, b in zip(one, other, strict=True))


def _aperture_kernel(shifts_px: FloatArray) -> NDArray[np.float32]:
    """Picture of shifts (n, 2), (columns, rows), of sum 1: each is split bilinearly between four pixels."""
    reach = int(np.ceil(np.abs(shifts_px).max())) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    # A convolution takes the value at minus the shift.
    x, y = (reach - shifts_px).T
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    right, down = x - column, y - row
    for i, share_y in ((0, 1.0 - down), (1, down)):
        for j, share_x in ((0, 1.0 - right), (1, right)):
            np.add.at(kernel, (np.minimum(row + i, 2 * reach), np.minimum(column + j, 2 * reach)), share_y * share_x)
    return (kernel / len(shifts_px)).astype(np.float32)


def _dot(ones: Sequence[NDArray[np.float32]], others: Sequence[NDArray[np.float32]]) -> float:
    return sum(float(np.vdot(a, b)) for a, b in zip(ones, others, strict=True))
