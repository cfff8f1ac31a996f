"""Goodness of fit by place: residual of the twins where a segment's depth should make them equal.

At the right depth the filtered twins a and b of a texture are equal up to the contrast, and their residual is noise.
Its square over the noise's variance, the null energy, is 1 in the mean. At a wrong depth, or where the blur of two
depths mixes, it is larger. The noise is known, so that no other scale is needed but the calibration's own error, a
share of the texture's energy that the segments' interiors show.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.distance import distance, nearest
from metafab.core.parallel.executor import spread
from metafab.decode.confidence import RIGHT_WITHIN
from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.prepared_frame import WINDOW_PX, PreparedFrame
from metafab.decode.segmentation.segments import Regions

#: Side of the window over which the null energy is averaged, frame pixels.
_WINDOW_PX = 13
#: Least error of a calibration, as a share of the texture's energy: that of filters mixed from a basis within 2 %.
LEAST_MODEL_ERROR = 1e-3
#: Misfit, and share of the texture's energy, from which light of another depth is mixed in. Inside of surfaces noise
#: leaves less than 2.5 in 99 of 100 pixels, and sharp edges in photographs a share of less than 0.04 in most.
_FOREIGN, _FOREIGN_SHARE = 3.0, 0.06

#: Distance from an outline beyond which light that does not fit is not that of the other side, frame pixels.
OUTLINE_LIGHT_PX = 20
#: Side of the window of the misfit that surfaces are found by, frame pixels, and its least value: less is chance.
_SURFACE_WINDOW_PX, _LEAST_MISFIT = 15, 0.2
#: Energy of the texture, in variances of the noise of one image, at which a pixel of a continuous surface counts by
#: half, and below which it shows nothing by itself: noise alone tells no depths. Where all pixels count alike, a plain
#: part of a frame of 500 electrons takes the farthest depth (6.1 in place of 2.8 % off).
FAINT = 1.0
#: Difference of two depths of a pixel, in its standard errors, above which they are not the same.
_CHANGED_ERRORS = 2.5


@dataclass(frozen=True)
class TwinEnergies:
    """Mean products of the filtered twins over the variance of their noise."""

    products: NDArray[np.float32]  #: Shape (3, ...): a b, a^2 and b^2.

    @classmethod
    def of(cls, products: NDArray[np.float32], prepared: PreparedFrame, noise_gain: float) -> TwinEnergies:
        """Products of a cost volume of ``noise_gain``, shape (3, ..., n_y, n_x), divided by their noise."""
        noise = (noise_gain * prepared.variance).astype(np.float32)
        return cls(
            np.stack([products[0] / np.sqrt(noise[0] * noise[1]), products[1] / noise[0], products[2] / noise[1]])
        )

    @cached_property
    def energy(self) -> NDArray[np.float32]:
        """Energy of the texture, 0 for noise alone: shape (...)."""
        return np.asarray(np.maximum(self.products[1] + self.products[2] - np.float32(2.0), np.float32(0.0)))

    @cached_property
    def null_energy(self) -> NDArray[np.float32]:
        """Residual of the twins at their own contrast, shape (...): total least squares of a against b.

        The contrast may be negative: an object brighter than what it hides in one image, and darker in the other.
        """
        product, square_x, square_y = self.products
        half = np.float32(0.5) * (square_x + square_y)
        root = np.hypot(np.float32(0.5) * (square_x - square_y), product)
        return np.asarray(np.maximum(half - root, np.float32(0.0)))

    def over_noise(self, model_error: float = LEAST_MODEL_ERROR) -> NDArray[np.float32]:
        """Null energy over what noise and an error of the calibration, a share of the texture, explain: shape (...)."""
        return np.asarray(self.null_energy / (np.float32(1.0) + np.float32(model_error) * self.energy))

    @property
    def is_foreign(self) -> NDArray[np.bool_]:
        """Shape (...), whether light of another depth is mixed in: noise and a calibration's least error leave less."""
        return np.asarray((self.over_noise() > _FOREIGN) & (self.null_energy > _FOREIGN_SHARE * self.energy))


@dataclass(frozen=True)
class Misfit:
    """Residual of the twins at each pixel's depth, shape (n_y, n_x)."""

    over_noise: NDArray[np.float32]  #: Null energy over what noise and the calibration's error explain: 1 if it fits.
    of_texture: NDArray[np.float32]  #: Null energy over the texture's energy.
    model_error: float  #: The calibration's error as a share of the texture's energy.

    @property
    def is_foreign(self) -> NDArray[np.bool_]:
        """Shape (n_y, n_x), whether more is left than noise and a calibration's error leave: light of another depth."""
        return np.asarray((self.over_noise > _FOREIGN) & (self.of_texture > _FOREIGN_SHARE))


def surface_window(prepared: PreparedFrame) -> int:
    """Side of the window over which surfaces are judged, downsampled pixels; odd."""
    return max(3, _SURFACE_WINDOW_PX // prepared.downsampling.step | 1)


def texture_energy(prepared: PreparedFrame, volume: CostVolume) -> NDArray[np.float32]:
    """Energy of the texture about each pixel, in variances of the noise of one image: shape (n_y, n_x).

    That of the filtered twins, which hold no structure slower than some 20 px: a gradient of the light is no texture.
    """
    middle = window_means(volume.products[:, volume.vergences_per_m.size // 2], surface_window(prepared))
    return TwinEnergies.of(middle, prepared, volume.noise_gain).energy


def log_misfit(prepared: PreparedFrame, products: NDArray[np.float32], noise_gain: float) -> NDArray[np.float32]:
    """Logarithm of the twins' null energy over what noise explains, for depths that need not be those of segments.

    Args:
        prepared: the frame.
        products: shape (3, n_y, n_x), products of a cost volume at the depth of each pixel.
        noise_gain: of the cost volume.

    Returns:
        Shape (n_y, n_x).
    """
    energies = TwinEnergies.of(window_means(products, surface_window(prepared)), prepared, noise_gain)
    return np.asarray(np.log(np.maximum(energies.over_noise(), np.float32(_LEAST_MISFIT))))


def explains_better(
    regions: Regions, than: Regions, prepared: PreparedFrame, volume: CostVolume, pixels: PixelDepth
) -> bool:
    """Whether less of the twins is left at the depths of some segments than at those of others.

    If the first are as many as the others or more, only pixels are judged whose depths differ by more than their
    errors: elsewhere either would do, and what is left of the twins differs by chance and by outlines.
    """
    both = pixels.claimed & (regions.grown > 0) & (than.grown > 0)
    depths = [np.where(both, of.vergence_per_m(of.grown), volume.vergences_per_m[0]) for of in (regions, than)]
    judged = both
    if len(regions.depths) >= len(than.depths):
        judged = both & (np.abs(depths[0] / depths[1] - 1.0) > _CHANGED_ERRORS * pixels.relative_error)

    def left(vergence_per_m: FloatArray) -> float:
        products = volume.at(vergence_per_m[None])[:, 0]
        return float(log_misfit(prepared, products, volume.noise_gain)[judged].mean())

    return bool(judged.any()) and left(depths[0]) < left(depths[1])


def misfit_at(
    prepared: PreparedFrame,
    volume: CostVolume,
    vergence_per_m: FloatArray,
    interior: NDArray[np.int32],
    model_error: float | None = None,
) -> Misfit:
    """Goodness of fit at each pixel's depth.

    Args:
        vergence_per_m: shape (n_y, n_x), 1/depth of each pixel; any value where it has none.
        interior: shape (n_y, n_x), number of the segment whose interior holds the pixel, 0 for none.
        model_error: error of the calibration; by default it is measured in the interiors, where depths are right.
    """
    window = max(3, _WINDOW_PX // prepared.downsampling.step | 1)
    products = volume.at(np.nan_to_num(vergence_per_m, nan=float(volume.vergences_per_m[0]))[None])[:, 0]
    local = TwinEnergies.of(window_means(products, window), prepared, volume.noise_gain)
    null, energy = local.null_energy, local.energy
    inside = interior > 0
    # Medians: what does not belong to a segment must not excuse itself.
    share = LEAST_MODEL_ERROR if model_error is None else model_error
    if model_error is None and inside.any():
        excess, textured = float(np.median(null[inside])) - 1.0, float(np.median(energy[inside]))
        share = max(share, excess / max(textured, 1e-9))
    of_texture = null / np.maximum(energy, np.float32(1e-6))
    return Misfit(local.over_noise(share).astype(np.float32), of_texture.astype(np.float32), share)


def fitting_segments(
    label: NDArray[np.int32],
    spoiled: NDArray[np.bool_],
    own: Misfit,
    misfit_of: Callable[[int], Misfit],
    reach: float,
    explained: Callable[[NDArray[np.int32]], NDArray[np.bool_]] | None = None,
) -> tuple[NDArray[np.int32], Misfit]:
    """Give pixels that do not fit their segment to a segment nearby that they fit, where it is connected with them.

    Args:
        label: shape (n_y, n_x), number of each pixel's segment; 0 for none.
        spoiled: shape (n_y, n_x), pixels about saturated or invalid ones; they stay, as their misfit carries no
            information.
        own: misfit of each pixel at its segment's depth.
        misfit_of: returns the misfit of all pixels at the depth of a segment, by its number.
        reach: largest distance of the other segment, pixels.
        explained: returns where new segments of the pixels, shape (n_y, n_x), explain the frame better; all by default.

    Returns:
        The segments, and the misfit at their depths.
    """
    asked = own.is_foreign & (label > 0) & ~spoiled
    moved, over_noise, of_texture = np.zeros_like(label), own.over_noise.copy(), own.of_texture.copy()
    for number in range(1, int(label.max(initial=0)) + 1) if asked.any() else ():
        near = asked & (label != number) & (distance(label == number) <= reach)
        if not near.any():
            continue
        other = misfit_of(number)
        takes = near & ~other.is_foreign & (other.over_noise < over_noise)
        moved[takes] = number
        np.copyto(over_noise, other.over_noise, where=takes)
        np.copyto(of_texture, other.of_texture, where=takes)
    moved = connected_moves(label, moved)
    if explained is not None and moved.any():
        moved = connected_moves(label, np.where(explained(np.where(moved > 0, moved, label)), moved, 0))
    stays = moved == 0
    fits = replace(
        own,
        over_noise=np.where(stays, own.over_noise, over_noise),
        of_texture=np.where(stays, own.of_texture, of_texture),
    )
    return np.where(stays, label, moved), fits


def connected_moves(label: NDArray[np.int32], moved: NDArray[np.int32]) -> NDArray[np.int32]:
    """The moved pixels, shape (n_y, n_x), that are connected with the rest of the segment they move to; 0 elsewhere."""
    kept = np.zeros_like(moved)
    for number in np.unique(moved[moved > 0]).tolist():
        own = (label == number) & (moved == 0)
        component, _ = connected_components(own | (moved == number))
        touched = np.zeros(int(component.max()) + 1, dtype=bool)
        touched[component[own]] = True
        kept[touched[component] & (moved == number)] = number
    return kept


def foreign_light(regions: Regions, misfit: Misfit, step: int) -> NDArray[np.bool_]:
    """Pixels of wide segments, away from the outlines between them, that hold light of another depth.

    Args:
        regions: segments.
        misfit: of each pixel at its segment's depth.
        step: frame pixels from one downsampled pixel to the next.

    Returns:
        Shape (n_y, n_x).
    """
    wide = np.where(is_wide(regions, step)[regions.grown], regions.grown, 0).astype(np.int32)
    return misfit.is_foreign & away_from_outlines(wide, step)


def is_wide(regions: Regions, step: int) -> NDArray[np.bool_]:
    """Whether each segment is as wide as a window, and no plain object, by number: shape (n_segments + 1,)."""
    label, away = regions.grown, across_outlines(regions.grown)[1]
    widest = np.array([away[label == number].max(initial=0.0) for number in range(len(regions.depths) + 1)])
    return np.asarray((widest * step >= 0.5 * WINDOW_PX) & ~regions.of_outline & (np.arange(widest.size) > 0))


def away_from_outlines(label: NDArray[np.int32], step: int) -> NDArray[np.bool_]:
    """Pixels of segments so far from the outlines between them that their light is not that of the other side.

    Args:
        label: shape (n_y, n_x), number of each pixel's segment; 0 for none.
        step: frame pixels from one downsampled pixel to the next.

    Returns:
        Shape (n_y, n_x).
    """
    return np.asarray((label > 0) & (across_outlines(label)[1] * step > OUTLINE_LIGHT_PX))


def across_outlines(
    label: NDArray[np.int32], vergence_per_m: FloatArray | None = None
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The segment across the outline nearest to each pixel, and the distance of that outline.

    Args:
        label: shape (n_y, n_x), number of each pixel's segment; 0 for none.
        vergence_per_m: shape (n_y, n_x), 1/depth of each pixel's segment. Where it is given, outlines between depths
            that do not differ (:func:`metafab.decode.confidence.differs`) do not count: either depth is right there.

    Returns:
        Number of the other segment, 0 for none, and distance in pixels, inf without an outline: shapes (n_y, n_x).
    """
    label = np.ascontiguousarray(label)
    vergence = np.zeros((0, 0)) if vergence_per_m is None else vergence_per_m
    beside, across = np.zeros_like(label), np.empty_like(label)
    spread(_find_outlines, label.shape[0], label, vergence, beside)
    away, row, column = nearest(beside > 0)
    spread(_look_across, label.shape[0], label, vergence, beside, row, column, across)
    return across, away


@compiled
def _find_outlines(
    first: int, stop: int, label: NDArray[np.int32], vergence: FloatArray, beside: NDArray[np.int32]
) -> None:
    """Write the other segment beside each pixel on an outline: the one on its right, left, below or above."""
    n_y, n_x = label.shape
    for i in range(first, stop):
        for j in range(n_x):
            if label[i, j] == 0:
                continue
            for down, along in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                other, at = i + down, j + along
                if not (0 <= other < n_y and 0 <= at < n_x) or label[other, at] == 0:
                    continue
                # Of two neighbours, the lower or the right one's depth is that to which the difference is compared.
                after = down + along > 0
                if (after and _differ(label, vergence, other, at, i, j)) or (
                    not after and _differ(label, vergence, i, j, other, at)
                ):
                    beside[i, j] = label[other, at]
                    break


@compiled
def _look_across(
    first: int,
    stop: int,
    label: NDArray[np.int32],
    vergence: FloatArray,
    beside: NDArray[np.int32],
    row: NDArray[np.int32],
    column: NDArray[np.int32],
    across: NDArray[np.int32],
) -> None:
    """Write the segment across the outline at the nearest pixel along one."""
    for i in range(first, stop):
        for j in range(label.shape[1]):
            at = row[i, j], column[i, j]
            # The nearest pixel along an outline may lie beyond it: then it belongs to the other segment.
            across[i, j] = label[at] if _differ(label, vergence, *at, i, j) else beside[at]


@compiled
def _differ(label: NDArray[np.int32], vergence: FloatArray, row: int, column: int, i: int, j: int) -> bool:
    """Whether two pixels have unlike segments, and depths that differ if these are given."""
    if label[row, column] == label[i, j]:
        return False
    if not vergence.size:
        return True
    return bool(abs(vergence[row, column] - vergence[i, j]) > RIGHT_WITHIN * vergence[row, column])
