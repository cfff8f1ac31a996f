"""Segments of a frame: the depth of each, and its pixels.

All pictures are on the downsampled pixels of the cost volume.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.distance import distance, nearest
from metafab.core.parallel.executor import spread
from metafab.decode.segmentation.planes import Plane


@dataclass(frozen=True)
class SegmentDepth:
    """The depth of one segment."""

    vergence_per_m: float  #: 1/depth; at the centre of the plane for a tilted segment.
    relative_error: float  #: Standard error of depth over depth; inf if the twins agree at no depth.
    correlation: float  #: Correlation of the twins at that depth.
    power: float  #: Mean square of the filtered twins there, geometric mean of both, electrons squared.
    plane: Plane  #: Depth over the picture.
    pixels: float = 0.0  #: Downsampled pixels that the depth is measured on.
    error_factor: float = 1.0  #: Factor in ``relative_error`` for structure along one straight line.
    of_outline: bool = False  #: Whether the depth is that of a plain surface's outline, which all of its pixels take.


@dataclass(frozen=True)
class Regions:
    """The segments of a frame, on the downsampled pixels."""

    layers: int  #: Number of depths at which many pixels lie.
    depths: tuple[SegmentDepth, ...]  #: Depth of each segment, in the order of their numbers.
    label: NDArray[np.int32]  #: Shape (n_y, n_x), number of each pixel's segment from 1; 0 for none.
    interior: NDArray[np.int32]  #: Shape (n_y, n_x), ``label`` where the segment's depth is measured; 0 elsewhere.
    grown: NDArray[np.int32]  #: Shape (n_y, n_x), ``label`` grown over the pixels along the outlines.
    #: Shape (n_y, n_x), probability that a pixel of ``grown`` is in the right segment; None for certainty.
    right: FloatArray | None = None
    #: Shape (n_y, n_x), 1/depth of each pixel of ``grown`` where segments are pieces of continuous surfaces, which no
    #: few planes explain; None where the depth of a pixel is that of its segment.
    surface_per_m: FloatArray | None = None
    #: Shape (n_y, n_x), frame pixels by which the segment of a pixel reaches beyond its pixels at the nearest outline;
    #: negative where the segment across does. None where outlines stand at the pixels' edges.
    beyond_px: NDArray[np.float32] | None = None

    @property
    def continuous(self) -> bool:
        """Whether segments are pieces of continuous surfaces."""
        return self.surface_per_m is not None

    @property
    def of_outline(self) -> NDArray[np.bool_]:
        """Whether each segment is a plain surface at the depth of its outline, by number: shape (n_segments + 1,)."""
        return np.array([False, *(depth.of_outline for depth in self.depths)])

    def shown(self, claimed: NDArray[np.bool_], window: float) -> NDArray[np.bool_]:
        """Pixels of segments that show depth: ``claimed`` ones, others within a window, and all of plain objects.

        Mask and result have the shape (n_y, n_x), ``window`` is in downsampled pixels.
        """
        inside = self.grown > 0
        return inside & ((distance(claimed & inside) <= window) | self.of_outline[self.grown])

    def within(self, rows: slice, columns: slice) -> Regions:
        """The segments in a part of the window, with the same numbers."""
        depths = tuple(
            replace(one, plane=one.plane.moved(-rows.start, -columns.start)) if one.plane.tilted else one
            for one in self.depths
        )
        part = (rows, columns)
        label, inside, grown_label = (one[part] for one in (self.label, self.interior, self.grown))
        right, surface = (None if one is None else one[part] for one in (self.right, self.surface_per_m))
        beyond = None if self.beyond_px is None else self.beyond_px[part]
        return Regions(self.layers, depths, label, inside, grown_label, right, surface, beyond)

    def with_owners(self, owner: NDArray[np.int32]) -> Regions:
        """The same depths with new outlines: ``owner`` is each pixel's segment or none, shape (n_y, n_x).

        Plain objects keep the outline of their light.
        """
        owner = np.where(self.of_outline[owner] | self.of_outline[self.grown], self.grown, owner)
        grown_label = np.where(self.grown > 0, owner, 0).astype(np.int32)
        kept = (self.label > 0) | (grown_label != self.grown)
        return replace(
            self,
            label=np.where(kept, grown_label, 0).astype(np.int32),
            interior=np.where(grown_label == self.interior, self.interior, 0).astype(np.int32),
            grown=grown_label,
            surface_per_m=self.surface_of(grown_label),
        )

    def surface_of(self, owner: NDArray[np.int32]) -> FloatArray | None:
        """``surface_per_m`` where pixels belong to the segments ``owner``, shape (n_y, n_x).

        Pixels that change their segment take the plane of their new one.
        """
        if self.surface_per_m is None:
            return None
        return np.where(owner == self.grown, self.surface_per_m, self._planes_per_m(owner))

    def without(self, numbers: Sequence[int]) -> Regions:
        """The other segments, numbered anew; pixels of those left out go to the nearest other segment."""
        if not numbers:
            return self
        out = np.isin(self.grown, numbers)
        _, row, column = nearest((self.grown > 0) & ~out)
        grown_label = np.where(out, self.grown[row, column], self.grown)
        stays = ~np.isin(np.arange(len(self.depths) + 1), numbers)
        number = np.where(stays, np.cumsum(stays) - 1, 0).astype(np.int32)
        return replace(
            self,
            depths=tuple(depth for depth, stay in zip(self.depths, stays[1:].tolist(), strict=True) if stay),
            label=number[np.where(np.isin(self.label, numbers), grown_label, self.label)],
            interior=number[self.interior],
            surface_per_m=self.surface_of(grown_label),
            grown=number[grown_label],
        )

    def merged(self, target: NDArray[np.int32], *, interiors: bool) -> tuple[Regions, NDArray[np.int32]]:
        """Segments merged into others, numbered anew, and each one's new number, shape (n_segments + 1,).

        Args:
            target: shape (n_segments + 1,), segment that each becomes part of; its own number where it stays.
            interiors: whether interiors are merged as well; else those of segments that do not stay are left out.
        """
        stays = target == np.arange(target.size)
        number = (np.cumsum(stays) - 1).astype(np.int32)[target]
        return replace(
            self,
            depths=tuple(depth for depth, stay in zip(self.depths, stays[1:].tolist(), strict=True) if stay),
            label=number[self.label],
            interior=(number if interiors else np.where(stays, number, 0).astype(np.int32))[self.interior],
            grown=number[self.grown],
        ), number

    def refused(self, where: NDArray[np.bool_]) -> Regions:
        """The same segments, of which the pixels ``where``, shape (n_y, n_x), have no depth."""
        if not where.any():
            return self
        right = np.ones(where.shape) if self.right is None else self.right
        return replace(self, right=np.where(where, 0.0, right))

    def vergence_per_m(self, label: NDArray[np.int32]) -> FloatArray:
        """1/depth of each pixel in the segments ``label``, shape (n_y, n_x): the same shape; NaN for none."""
        surface = self.surface_of(label)
        return self._planes_per_m(label) if surface is None else np.where(label > 0, surface, np.nan)

    def _planes_per_m(self, label: NDArray[np.int32]) -> FloatArray:
        vergence = np.array([np.nan, *(depth.vergence_per_m for depth in self.depths)])
        if not any(depth.plane.tilted for depth in self.depths):
            return vergence[label]
        surfaces = np.zeros((vergence.size, 8))
        surfaces[:, 0] = vergence
        for number, plane in enumerate((depth.plane for depth in self.depths), start=1):
            if plane.tilted:
                surfaces[number] = plane.vergence_per_m, *plane.slope_per_m, *plane.centre, *plane.curvature_per_m
        out = np.empty(label.shape)
        spread(_write_surfaces, label.shape[0], np.ascontiguousarray(label, dtype=np.int32), surfaces, out)
        return out

    def bands(self, label: NDArray[np.int32], step_per_m: float) -> tuple[NDArray[np.int32], FloatArray]:
        """Cut tilted segments into bands of one depth, ``step_per_m`` of vergence apart; ``label`` counts from 1.

        Bands of continuous surfaces are those of all segments together. Returns the number of each pixel's band from 1,
        shape (n_y, n_x), and 1/depth of each band, (n_bands,).
        """
        if self.surface_per_m is not None:
            lit, bands = label > 0, np.zeros(label.shape, dtype=np.int32)
            # In a film, surfaces that come up in a part have no depth where no segment is.
            surface = np.where(np.isnan(self.surface_per_m), self._planes_per_m(label), self.surface_per_m)
            steps, place = np.unique(np.round(surface[lit] / step_per_m), return_inverse=True)
            bands[lit] = 1 + place
            return bands, steps * step_per_m
        if not any(depth.plane.tilted for depth in self.depths):
            return label, np.array([depth.vergence_per_m for depth in self.depths])
        vergence, bands = self.vergence_per_m(label), np.zeros(label.shape, dtype=np.int32)
        of_bands: list[float] = []
        for number, depth in enumerate(self.depths, start=1):
            mask = label == number
            step = np.round((vergence[mask] - depth.vergence_per_m) / step_per_m)
            steps, place = np.unique(step, return_inverse=True)
            bands[mask] = len(of_bands) + 1 + place
            of_bands += (depth.vergence_per_m + steps * step_per_m).tolist()
        return bands, np.array(of_bands)


@compiled
def _write_surfaces(first: int, stop: int, label: NDArray[np.int32], surfaces: FloatArray, out: FloatArray) -> None:
    """Write each pixel's :meth:`Plane.at`; a surface is its vergence, slopes, centre and curvature."""
    for i in range(first, stop):
        for j in range(label.shape[1]):
            at = surfaces[label[i, j]]
            y, x = i - at[3], j - at[4]
            rise = at[1] * y + at[2] * x + at[5] * (y * y) + at[6] * y * x + at[7] * (x * x)
            out[i, j] = max(at[0] + rise, 0.01 * at[0])
