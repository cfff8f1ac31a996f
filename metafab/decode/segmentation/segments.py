"""Segments: layers of depth, connected pixels of one layer, and the depth of each segment.

All pictures are on the downsampled pixels of the cost volume.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt, find_objects, gaussian_filter1d
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.distance import box_about, distance, nearest
from metafab.core.parallel.executor import spread
from metafab.decode.matching.cost_volume import CostVolume, correlation, correlation_less
from metafab.decode.matching.depth import PixelDepth, parabolic_peak, spline_peaks, standard_error
from metafab.decode.matching.pooling import window_means
from metafab.decode.segmentation.outlines import ROUNDS, refined_outlines
from metafab.decode.segmentation.planes import Plane

#: Frame pixels of the smallest segment, half a window: less looks like the mixture of depths along an outline.
FEWEST_PX = 300
#: Share of the claimed pixels that a layer holds at least.
_SMALLEST_SHARE = 0.01
#: Distances from other segments, frame pixels, that keep their blur out: the first that leaves enough is taken.
_CLEAR_PX = (24, 20, 16, 12, 8, 4)
#: Window over which the correlation at each layer's depth is pooled for the first assignment, frame pixels.
_ASSIGNMENT_WINDOW_PX = 13
#: Window over which it is pooled to score outlines: a narrower one would be noise.
_OUTLINE_WINDOW_PX = 7
#: Window over which the refinement of outlines takes the layers' shares.
_SHARES_WINDOW_PX = 21
#: Weight of the correlation against those shares: with half as much, outlines would eat small objects.
_CORRELATION_WEIGHT = 2.0
#: Least share of a region's interior that shows texture; at 5 standard deviations, noise shows none.
_LEAST_TEXTURED = 0.05
#: Standard errors within which a fragment's depth is that of its neighbour, and their least ratio of sizes.
_SAME_DEPTH, _SIZE_RATIO = 2.5, 4
#: Width of a strip along the picture's rim (frame pixels), and relative difference within which it has its neighbour's
#: depth: in 4 of 12 frames a tilted wall had such a strip, 14 to 28 px wide and 1.4 to 2.7 % off, as windows there miss
#: what lies beyond the rim. Its stated error, 0.1 to 0.7 %, counts the noise alone.
_STRIP_PX, _STRIP_DIFFERENCE = 30, 0.04
#: Share of a strip's pixels that may be farther from the rim, and its least length along the rim over its mean width.
_STRIP_REST, _STRIP_RATIO = 0.1, 3.0

#: Ratio of the eigenvalues of the structure tensor below which structure lies along one straight line: outlines of
#: plain surfaces have 0.001 to 0.003, narrow segments of textured ones 0.16 to 0.7.
_STRAIGHT = 0.02


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


def depth_layers(pixels: PixelDepth, separation_per_m: float) -> FloatArray:
    """Vergences (1/m) of layers: peaks of the histogram of the pixels' depths, strongest first, shape (n_layers,).

    Peaks nearer to each other than 1.5 times ``separation_per_m`` are one layer.
    """
    claimed = pixels.claimed
    if not claimed.any():
        return np.zeros(0)
    vergence = pixels.vergence_per_m[claimed]
    weight = 1.0 / (1.0 + (pixels.relative_error[claimed] / 0.01) ** 2)
    low, high = float(vergence.min()) - 2.0 * separation_per_m, float(vergence.max()) + 2.0 * separation_per_m
    bins = max(8, int(np.ceil(4.0 * (high - low) / separation_per_m)))
    counts, edges = np.histogram(vergence, bins=bins, range=(low, high), weights=weight)
    smooth = gaussian_filter1d(counts, 2.0, mode="constant")
    middle = smooth[1:-1]
    peak = 1 + np.flatnonzero((middle >= smooth[:-2]) & (middle > smooth[2:]))
    bins_of_peak = 2.0 * np.sqrt(2.0 * np.pi)  # area of the smoothing Gaussian over its height
    peak = peak[smooth[peak] * bins_of_peak > max(_SMALLEST_SHARE * counts.sum(), 1.0)]
    peak = peak[np.argsort(-smooth[peak])]
    # Layers lie between bins, whose places follow the extreme depths: a layer half a bin off leaves fragments.
    place = peak + parabolic_peak(smooth[peak - 1], smooth[peak], smooth[peak + 1]).place
    kept: list[float] = []
    for centre in edges[0] + (place + 0.5) * (edges[1] - edges[0]):
        if all(abs(centre - other) > 1.5 * separation_per_m for other in kept):
            kept.append(float(centre))
    return np.array(kept)


def assign_layers(
    volume: CostVolume,
    layers: Sequence[Plane],
    pixels: PixelDepth,
    separation_per_m: float,
    step: int,
    lit: NDArray[np.bool_],
    allowed: NDArray[np.bool_] | None = None,
    outline_rounds: int = ROUNDS,
) -> NDArray[np.int32]:
    """Assign each pixel to the layer at whose depth the twins correlate best around it: shape (n_y, n_x), from 1.

    Args:
        layers: depths of the layers over the picture.
        pixels: depth of each pixel.
        separation_per_m: vergence by which layers differ.
        step: frame pixels from one downsampled pixel to the next.
        lit: shape (n_y, n_x), whether a pixel is lit.
        allowed: shape (n_layers, n_y, n_x), where each layer may be; everywhere by default.
        outline_rounds: most rounds of the refinement of outlines.
    """
    flat = np.array([plane.vergence_per_m for plane in layers])
    tilted = any(plane.tilted for plane in layers)
    vergence = np.stack([plane.over(volume.shape) for plane in layers]) if tilted else flat[:, None, None]
    products = volume.at(vergence if tilted else flat)
    difference = np.abs(pixels.vergence_per_m.astype(np.float32) - vergence.astype(np.float32))
    penalty = np.float32(0.05) * np.minimum(difference / np.float32(separation_per_m), np.float32(4.0))
    wide, narrow = (
        correlation_less(window_means(products, px // step | 1), penalty)
        for px in (_ASSIGNMENT_WINDOW_PX, _OUTLINE_WINDOW_PX)
    )
    wide = window_means(wide, 3)
    if allowed is not None:
        wide[~allowed] = narrow[~allowed] = -np.inf
    window = _SHARES_WINDOW_PX // step | 1
    layer = refined_outlines(wide.argmax(axis=0), _CORRELATION_WEIGHT * narrow, lit, window, outline_rounds)
    label = (layer + 1).astype(np.int32)
    if pixels.claimed.any() and not pixels.claimed.all():
        away, row, column = nearest(pixels.claimed)
        label = np.where(away * step > _ASSIGNMENT_WINDOW_PX, label[row, column], label).astype(np.int32)
    return np.asarray(label)


def connected_segments(
    layer: NDArray[np.int32], lit: NDArray[np.bool_], window_px: int, step: int
) -> NDArray[np.int32]:
    """Number the connected lit pixels of each layer from 1: shape (n_y, n_x), 0 for none.

    Specks are left out, and so is a part smaller than a window next to a larger one: it is the mixture of depths along
    an outline. ``window_px`` is the side of a window in frame pixels, ``step`` the frame pixels from one downsampled
    pixel to the next.
    """
    segment = np.zeros(layer.shape, dtype=np.int32)
    count = 0
    for index, box in enumerate(find_objects(np.where(lit, layer, 0)), start=1):
        if box is None:
            continue
        component, n_components = connected_components(opened((layer[box] == index) & lit[box], max(1, 2 // step)))
        sizes = np.bincount(component.ravel(), minlength=n_components + 1) * step**2
        large = np.append(False, sizes[1:] >= FEWEST_PX)
        numbers = np.where(large, count + np.cumsum(large), 0).astype(np.int32)
        segment[box] += numbers[component]
        count += int(large.sum())
    sizes = np.bincount(segment.ravel(), minlength=count + 1) * step**2
    large = sizes >= window_px**2
    large[0] = False
    near_large = distance(large[segment]) * step <= window_px if large.any() else np.zeros(layer.shape, bool)
    renumbered = np.zeros(count + 1, dtype=np.int32)
    beside = np.bincount(segment[near_large], minlength=count + 1) > 0
    kept = 1 + np.flatnonzero((large | ~beside)[1:])
    renumbered[kept] = np.arange(1, kept.size + 1)
    return np.asarray(renumbered[segment])


def opened(mask: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """Morphological opening of a mask, shape (n_y, n_x), by a cross, ``steps`` times; ten times faster than SciPy's."""
    for _ in range(steps):
        mask = ~dilated(~mask)
        mask[[0, -1]] = mask[:, [0, -1]] = False
    for _ in range(steps):
        mask = dilated(mask)
    return mask


def dilated(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Dilation of a mask, shape (n_y, n_x), by a cross; ten times faster than SciPy's."""
    wide = mask.copy()
    for into, of in ((wide, mask), (wide.T, mask.T)):
        into[1:] |= of[:-1]
        into[:-1] |= of[1:]
    return wide


def grown(segment: NDArray[np.int32], reach: float = np.inf) -> NDArray[np.int32]:
    """Give pixels without a segment, shape (n_y, n_x), to the nearest one within ``reach`` pixels: the same shape."""
    if not segment.any():
        return segment
    away, row, column = nearest(segment > 0)
    return np.where(away <= reach, segment[row, column], 0).astype(np.int32)


def segment_depth(volume: CostVolume, sums: FloatArray, pixels: float, tilt: Plane | None = None) -> SegmentDepth:
    """Measure a segment's depth at the peak of a spline through the correlation at all candidates.

    The error is infinite where the twins do not correlate, or best at an end of the candidates. ``sums`` are its
    products, shape (3, n_candidates), summed over its interior ``pixels`` along the plane ``tilt``, if there is one.
    """
    rho = correlation(sums)
    nodes = volume.vergences_per_m
    if not np.isfinite(rho).all() or rho.max() <= 0.0:
        return _segment(tilt, float(nodes[nodes.size // 2]), np.inf, 0.0, 0.0)
    peak = spline_peaks(rho[None])
    vergence, height = float(nodes[0]) + volume.step_per_m * float(peak.place[0]), float(peak.height[0])
    if not peak.inside[0]:  # still rising at the end of the calibrated range
        return _segment(tilt, vergence, np.inf, height, 0.0)
    samples = max(pixels * volume.samples, 1.0)
    error = standard_error(peak.height[0], peak.curvature[0] / volume.step_per_m**2, samples) / abs(vergence)
    candidate = int(np.abs(nodes - vergence).argmin())
    power = float(np.sqrt(sums[1, candidate] * sums[2, candidate])) / max(pixels, 1.0)
    return _segment(tilt, vergence, float(error), height, power)


def _segment(tilt: Plane | None, vergence: float, error: float, height: float, power: float) -> SegmentDepth:
    plane = Plane(vergence) if tilt is None else replace(tilt, vergence_per_m=vergence)
    return SegmentDepth(vergence, error, height, power, plane)


def with_error_of_straight(
    depth: SegmentDepth, light: NDArray[np.float32], mask: NDArray[np.bool_], samples: float
) -> SegmentDepth:
    """Depth with the error of a segment whose structure lies along one straight line; itself for other structure.

    Along such a line, the pixels are no independent samples: what differs between the twins at one is repeated at all
    others. Those across it count, as far as they hold the light's gradient.

    Args:
        depth: of the segment.
        light: shape (n_y, n_x), electrons.
        mask: shape (n_y, n_x), pixels that the depth is measured on.
        samples: independent samples a pixel.
    """
    place = np.stack(np.nonzero(mask), axis=1)
    if min(light.shape) < 2 or not place.size:
        return depth
    box = tuple(
        slice(max(0, low - 1), high + 2) for low, high in zip(place.min(axis=0), place.max(axis=0), strict=True)
    )
    part: NDArray[np.float64] = light[box].astype(np.float64)
    gradient = np.stack([np.gradient(part, axis=axis)[mask[box]] for axis in (0, 1)], axis=1)
    shares, directions = np.linalg.eigh(gradient.T @ gradient)
    if not shares[0] < _STRAIGHT * shares[1]:
        return depth
    across = np.rint(place @ directions[:, 1]).astype(np.intp)
    energy = np.bincount(across - across.min(), (gradient @ directions[:, 1]) ** 2)
    lines = float(energy.sum() ** 2 / (energy**2).sum())
    factor = float(np.sqrt(max(len(place) * samples / lines, 1.0)))
    return replace(depth, relative_error=depth.relative_error * factor, error_factor=factor)


def interior(segment: NDArray[np.int32], number: int, step: int) -> NDArray[np.bool_]:
    """The pixels of a segment away from other segments, shape (n_y, n_x), as far as a fifth of them remain.

    Next to another depth the pair's lobes mix both; next to darkness there is nothing to mix. ``segment`` holds the
    numbers of the segments from 1; ``step`` is the frame pixels from one downsampled pixel to the next.
    """
    mask: NDArray[np.bool_] = segment == number
    # Others farther away than the largest distance that is asked for do not matter.
    box = box_about(mask, _CLEAR_PX[0] // step + 1)
    own, inside = mask[box], np.zeros_like(mask)
    others = (segment[box] > 0) & ~own
    if not others.any():
        return mask
    away = distance(others)
    least = max(0.2 * FEWEST_PX / step**2, 0.2 * float(own.sum()))
    for px in _CLEAR_PX:
        inside[box] = own & (away > px / step)
        if inside.sum() >= least:
            return inside
    return mask


def is_textured(region: NDArray[np.bool_], texture: NDArray[np.bool_], reach: int) -> bool:
    """Whether a region, shape (n_y, n_x), of connected lit pixels shows texture away from its outline.

    True for one too small to have an interior. From ``reach`` pixels on a window contains the outline.
    """
    box = box_about(region)
    if min(region[box].shape) <= 2 * reach:
        return True
    inner = distance_transform_cdt(np.pad(region[box], 1), metric="taxicab")[1:-1, 1:-1] > reach
    return not inner.any() or float(texture[box][inner].mean()) > _LEAST_TEXTURED


def textured_components(lit: NDArray[np.bool_], texture: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """The connected components of ``lit``, shape (n_y, n_x), that :func:`is_textured`: the same shape."""
    component, count = connected_components(lit)
    keep = np.array([False, *(is_textured(component == k, texture, reach) for k in range(1, count + 1))])
    return np.asarray(keep[component])


def fragment_targets(depths: Sequence[SegmentDepth], label: NDArray[np.int32], step: int) -> NDArray[np.int32]:
    """The segment that each segment is merged into: itself, or a much larger neighbour of the same depth.

    Along outlines, in shadows and at the picture's rim, narrow strips become segments whose depths have large errors.
    Such a fragment belongs to a neighbour if their depths do not differ significantly. Depths are those of the segments
    from 1, ``label``, shape (n_y, n_x), has 0 for none, on pixels of ``step`` frame pixels; targets have the shape
    (len(depths) + 1,), 0 for 0.
    """
    count = len(depths) + 1
    target = np.arange(count, dtype=np.int32)
    sizes = np.bincount(label.ravel(), minlength=count)
    in_strip = _along_rim(label, count, _STRIP_PX // step)
    adjacent = adjacency(label, count)
    smallest_first: list[int] = (1 + np.argsort(sizes[1:], kind="stable")).tolist()
    for number in smallest_first:
        plane, error = depths[number - 1].plane, depths[number - 1].relative_error
        larger = np.flatnonzero(adjacent[number] & (sizes > _SIZE_RATIO * sizes[number]))
        larger = larger[larger > 0]
        if (plane.tilted and not in_strip[number]) or not larger.size or not sizes[number]:
            continue
        row, column = (np.array(float(axis.mean())) for axis in np.nonzero(label == number))
        vergences = np.array([float(depths[k - 1].plane.at(row, column)) for k in larger.tolist()])
        difference = np.abs(vergences / float(plane.at(row, column)) - 1.0)
        if difference.min() < max(_SAME_DEPTH * error, _STRIP_DIFFERENCE if in_strip[number] else 0.0):
            target[number] = larger[difference.argmin()]
    for number in reversed(smallest_first):  # fragments of a fragment follow it
        target[number] = target[target[number]]
    return target


def _along_rim(label: NDArray[np.int32], count: int, width: int) -> NDArray[np.bool_]:
    """Whether a segment is a strip along a side of the picture, by its number in ``label`` below ``count``.

    A strip touches the side, is long along it, and has nearly all of its pixels within ``width`` pixels of it. An axis
    along which the picture is at most three widths long has none.
    """
    sizes, is_strip = np.bincount(label.ravel(), minlength=count), np.zeros(count, dtype=bool)
    for lines in (label, label.T):
        for from_side in (lines, lines[::-1]) if len(lines) > 3 * width > 0 else ():
            beyond = np.bincount(from_side[width:].ravel(), minlength=count)
            touching = np.bincount(from_side[0], minlength=count) > 0
            for number in np.flatnonzero(touching & (beyond < _STRIP_REST * sizes)).tolist():
                length = np.count_nonzero((from_side[:width] == number).any(axis=0))
                is_strip[number] |= length**2 >= _STRIP_RATIO * sizes[number]
    return is_strip


def adjacency(label: NDArray[np.int32], count: int) -> NDArray[np.bool_]:
    """Whether segments, numbers in ``label`` below ``count``, touch each other: shape (count, count)."""
    adjacent = np.zeros(count * count, dtype=bool)
    for one, other in ((label[:-1], label[1:]), (label[:, :-1], label[:, 1:])):
        codes = np.bincount((one * np.int32(count) + other).ravel(), minlength=count * count)
        adjacent |= codes > 0
    both = adjacent.reshape(count, count)
    return np.asarray(both | both.T)
