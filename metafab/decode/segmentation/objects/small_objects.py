"""Small objects before a surface, from the light that does not fit the surface's depth.

An object's light is left in the surface's null channel (:mod:`metafab.decode.segmentation.objects.null_channel`). An
object is a rectangle or an ellipse of even light, of a contrast of its own, whichever has more evidence. Depth, place
and size maximise the evidence by ascent, first in coarse steps. It falls for shapes that are too large as well as for
those that are too small. Blobs whose light no such shape explains are rejected. Depth and shape of the others, and the
error that decides whether they have a depth, follow from a model of both images with occlusion
(:mod:`metafab.decode.segmentation.objects.object_fit`): an object of 20 px may fit two depths in the null channel, and
one in the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import kept_threads
from metafab.decode.confidence import LARGEST_ERROR
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.objects.null_channel import WINDOW, NullChannel, Rectangle, ShapeEvidence
from metafab.decode.segmentation.objects.object_fit import FittedObject, fitted_objects
from metafab.decode.segmentation.objects.object_window import ObjectStart
from metafab.decode.segmentation.prepared_frame import PreparedFrame

#: Largest side of a blob that is searched, downsampled pixels: larger objects have segments.
_LARGEST_BLOB = 36
#: Fewest downsampled pixels of a blob, and the misfit that at least one of them needs: windows and blur widen the blob
#: of even a small object.
_FEWEST, _PEAK_MISFIT = 40, 6.0
#: Least distance of a blob from the border of the picture, half the misfit's window, downsampled pixels: its light may
#: be that from beyond the border.
_BORDER = 2
#: Most blobs that are searched; those of the largest misfit are taken.
_MOST_BLOBS = 40
#: Number of candidate depths.
_CANDIDATES = 9
#: Least vergence of a candidate over the surface's.
_NEAREST_RATIO = 1.12
#: Largest vergence of a candidate over the largest calibrated one.
_RANGE_SHARE = 0.97
#: Steps of the sides of rectangles at the candidates, downsampled pixels.
_COARSE_STEPS = (2.0, 1.0)
#: Moves of a rectangle (middle and half sides along y and x): as a whole, and each of its sides.
_MOVES = np.array(
    [[1, 0, 0, 0], [0, 1, 0, 0], *([y, x, abs(y), abs(x)] for y, x in ((0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5)))]
)
#: Ratio of the axes of an ellipse to the sides of a rectangle of equal area.
_ROUND = math.sqrt(4.0 / math.pi)
#: Most sweeps over the sides in one step, and least half side.
_SWEEPS, _LEAST_HALF = 5, 0.6
#: Extent of a blob beyond its object on each side: blur and the misfit's window, downsampled pixels.
_HALO = 4.0
#: Distance beyond its blob that a fitted rectangle may reach, half the misfit's window, downsampled pixels: the blob of
#: an object in light like the surface's is smaller than the object.
_BEYOND = 2.5
#: Evidence over that of no object, and over that of light at the surface's own depth, that an object needs.
_LEAST_EVIDENCE, _LEAST_MARGIN = 60.0, 20.0
#: Largest mean energy, over that of noise, that is left in a blob without its object: true objects left 0.8 to 1.8,
#: light of other causes 40 or more.
_LEFT = 3.0
#: Limits of the coarse search as multiples of those above: of the evidence, and of the energy left at the middle
#: candidate and at the best one. The coarse steps of 13 objects found left 4.5 and 3.6 at most.
_COARSE_EVIDENCE, _COARSE_LEFT = 0.5, (2.0, 1.5)
#: Relative difference of depths of one surface, and rounds in which a rectangle's light settles.
_ONE_SURFACE, _LIGHT_ROUNDS = 0.02, 3
#: Origin of the fitted rectangles' coordinates in the null channel's window.
_ORIGIN = np.array([WINDOW // 2, WINDOW // 2, 0.0, 0.0])


@dataclass(frozen=True)
class SmallObject:
    """An object that the segmentation by windows does not see; rows and columns of the downsampled pixels."""

    vergence_per_m: float  #: 1/depth.
    relative_error: float  #: Standard error of the depth over the depth.
    evidence: float  #: Natural logarithm of its probability over that of the surface alone.
    mask: NDArray[np.bool_]  #: Shape (n_y, n_x) of the blob, pixels more than half covered.
    misfit: NDArray[np.float32]  #: Shape (n_y, n_x) of the blob, energy left in the null channel over that of noise.
    blob: tuple[slice, slice]  #: Rows and columns of the blob.


def small_objects(
    prepared: PreparedFrame,
    optics: LayerOptics,
    vergence_per_m: FloatArray,
    foreign: NDArray[np.bool_],
    misfit: NDArray[np.float32],
) -> list[SmallObject]:
    """Find the small objects whose light does not fit the depth of its segment.

    Args:
        prepared: the frame.
        optics: the pair on its downsampled pixels.
        vergence_per_m: shape (n_y, n_x), 1/depth of each pixel's segment; NaN for none.
        foreign: shape (n_y, n_x), whether a pixel holds light that does not fit its segment.
        misfit: shape (n_y, n_x), misfit of each pixel at its segment's depth.

    Returns:
        The objects found, those of the largest misfit first, with errors below ``LARGEST_ERROR``; none where light of
        the surface's depth explains as much, and none at the border of the picture.
    """
    component, _ = connected_components(foreign)
    blobs: list[tuple[float, tuple[slice, slice], NDArray[np.bool_]]] = []
    for number, (rows, columns) in enumerate(find_objects(component), start=1):
        at = rows, columns
        own = np.asarray(component[at] == number)
        strength = misfit[at][own]
        ends = zip(at, foreign.shape, strict=True)
        is_within = all(one.start >= _BORDER and one.stop <= size - _BORDER for one, size in ends)
        is_wide = own.sum() >= _FEWEST and max(own.shape) <= _LARGEST_BLOB
        if is_within and is_wide and strength.max() >= _PEAK_MISFIT:
            blobs.append((float(strength.sum()), at, own))

    plain_light = ~foreign & ~prepared.spoiled

    def searched(blob: tuple[float, tuple[slice, slice], NDArray[np.bool_]]) -> _Search | None:
        _, at, own = blob
        weight = np.where(own, misfit[at], np.float32(0.0)).astype(np.float64)
        surface_per_m = float(np.median(vergence_per_m[at][own]))
        of_surface = plain_light & (np.abs(vergence_per_m / surface_per_m - 1.0) < _ONE_SURFACE)
        if not of_surface.any():
            return None
        level_e = prepared.inner[:, of_surface].mean(axis=1, dtype=np.float64)
        return _Search.of(prepared, optics, (surface_per_m, level_e), at, weight)

    with kept_threads() as pool:
        begun = pool.map(searched, sorted(blobs, key=lambda one: -one[0])[:_MOST_BLOBS])
        searches = [one for one in begun if one is not None]
        fitted = fitted_objects(prepared, optics, [one.start for one in searches])
        found = pool.map(_Search.found, searches, fitted)
    return [one for one in found if one is not None]


@dataclass(frozen=True)
class _Search:
    """A blob whose light a rectangle explains in coarse steps."""

    at: tuple[slice, slice]  # rows and columns of the blob
    own: NDArray[np.bool_]  # shape (n_y, n_x) of the blob, its pixels
    inside: tuple[slice, ...]  # the blob in the window of the null channel
    ascent: _Ascent
    start: ObjectStart

    @classmethod
    def of(
        cls,
        prepared: PreparedFrame,
        optics: LayerOptics,
        surface: tuple[float, FloatArray],
        at: tuple[slice, slice],
        weight: FloatArray,
    ) -> _Search | None:
        """Search a blob in coarse steps; None if nothing fits.

        ``surface`` is 1/depth and mean light in both images, shape (2,); ``weight``, shape (n_y, n_x), is the blob's
        misfit, 0 outside.
        """
        surface_per_m, level_e = surface
        total, size = weight.sum(), weight.shape
        row, column = (float((weight.sum(axis=1 - axis) * np.arange(size[axis])).sum() / total) for axis in (0, 1))
        middle = round(at[0].start + row), round(at[1].start + column)
        channel = NullChannel.of(prepared, optics, middle, surface_per_m)
        if channel is None or not (level_e > 0.0).all():
            return None
        # Rectangles are in the channel's window, whose middle is that of the blob.
        first = np.array([at[0].start - middle[0], at[1].start - middle[1]]) + WINDOW // 2
        limits = np.array([first - 0.5, first + size - np.array(0.5)])
        half = np.maximum(1.5, 0.5 * math.sqrt(np.count_nonzero(weight)) - _HALO)
        start = np.array([first[0] + row, first[1] + column, half, half])
        nearest = _NEAREST_RATIO * surface_per_m
        largest = _RANGE_SHARE * float(1.0 / optics.calibration.kernels.psf.depth_m.min())
        if largest <= nearest:
            return None
        inside = tuple(slice(int(f), int(f) + n) for f, n in zip(first, size, strict=True))
        ascent = _Ascent(ShapeEvidence(channel), limits, np.linspace(nearest, largest, _CANDIDATES), surface_per_m)
        even, (evidence, vergence, rectangle) = np.ones(2), ascent.begun(start)
        if evidence < _COARSE_EVIDENCE * _LEAST_EVIDENCE:
            return None
        # The fit starts at the middle candidate: the depth of most evidence may be the nearest one, 45 % off.
        begun = float(ascent.candidates[_CANDIDATES // 2])
        fit = ObjectStart(middle, max(size), surface_per_m, level_e, begun, rectangle - _ORIGIN)
        search = cls(at, weight > 0.0, inside, ascent, fit)
        most, most_at_best = (_LEFT * one for one in _COARSE_LEFT)
        if search._left(vergence, rectangle, even) > most:
            search, rectangle = search._as_ellipse(vergence, rectangle)
            if search._left(vergence, rectangle, even) > most:
                return None
        vergence, rectangle = search.ascent.over_depths(rectangle)
        if not search.start.is_round:
            search, rectangle = search._as_ellipse(vergence, rectangle)
        if search._left(vergence, rectangle, even) > most_at_best:
            return None
        return replace(search, start=replace(search.start, rectangle=rectangle - _ORIGIN))

    def _as_ellipse(self, vergence_per_m: float, rectangle: Rectangle) -> tuple[_Search, Rectangle]:
        """The search of an ellipse and its box, if that has more evidence than the rectangle; else those of this."""
        ascent, even = replace(self.ascent, evidence=self.ascent.evidence.of_ellipses), np.ones(2)
        of_same_area = rectangle * np.array([1.0, 1.0, _ROUND, _ROUND])
        evidence, box = ascent.over_sides(vergence_per_m, of_same_area, even, _COARSE_STEPS[-1:])
        if evidence <= self.ascent.evidence.at(vergence_per_m, rectangle, even):
            return self, rectangle
        return replace(self, ascent=ascent, start=replace(self.start, is_round=True)), box

    def found(self, fitted: FittedObject | None) -> SmallObject | None:
        """The object, if the fitted one explains the blob's light."""
        ascent, evidence_of, largest = self.ascent, self.ascent.evidence, float(self.ascent.candidates[-1])
        if fitted is None or not fitted.relative_error < LARGEST_ERROR or fitted.vergence_per_m > largest:
            return None
        vergence, rectangle, light = fitted.vergence_per_m, fitted.rectangle + _ORIGIN, np.ones(2)
        if not ascent.is_allowed(rectangle, _BEYOND):
            return None
        for _ in range(_LIGHT_ROUNDS):
            light = evidence_of.light(vergence, rectangle, light)
        evidence = evidence_of.at(vergence, rectangle, light)
        if evidence < _LEAST_EVIDENCE:
            return None
        at_surface, _ = ascent.over_sides(ascent.surface_per_m, rectangle, light, (1.0,))
        energy = self._energy(vergence, rectangle, light)
        mask = evidence_of.cover(rectangle)[self.inside] > 0.5
        if evidence - at_surface < _LEAST_MARGIN or energy[self.own].mean() > _LEFT or not mask.any():
            return None
        return SmallObject(vergence, fitted.relative_error, evidence, mask, energy, self.at)

    def _energy(self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray) -> NDArray[np.float32]:
        """Energy over that of noise that a rectangle leaves, shape (n_y, n_x) of the blob."""
        return self.ascent.evidence.left(vergence_per_m, rectangle, light)[self.inside]

    def _left(self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray) -> float:
        """Mean over the blob of the energy that a rectangle leaves."""
        return float(self._energy(vergence_per_m, rectangle, light)[self.own].mean())


@dataclass(frozen=True)
class _Ascent:
    """Ascent of the evidence over rectangles and depths."""

    evidence: ShapeEvidence
    limits: FloatArray  # (2, 2), least and largest (row, column) of the blob, at the edges of its pixels
    candidates: FloatArray  # vergences, evenly spaced
    surface_per_m: float

    def over_sides(
        self, vergence_per_m: float, rectangle: Rectangle, light: FloatArray, steps: Sequence[float]
    ) -> tuple[float, Rectangle]:
        """Ascent over the rectangle by moves of its sides at one depth: the evidence and the rectangle."""
        best = self.evidence.at(vergence_per_m, rectangle, light)
        for step in steps:
            for _ in range(_SWEEPS):
                moved = False
                for move in _MOVES:
                    for change in (step, -step):
                        other = rectangle + change * move
                        if not self.is_allowed(other):
                            continue
                        evidence = self.evidence.at(vergence_per_m, other, light)
                        if evidence > best:
                            best, rectangle, moved = evidence, other, True
                            break
                if not moved:
                    break
        return best, rectangle

    def begun(self, rectangle: Rectangle) -> tuple[float, float, Rectangle]:
        """Ascent in coarse steps at the middle candidate: evidence, depth and rectangle."""
        middle = float(self.candidates[_CANDIDATES // 2])
        evidence, rectangle = self.over_sides(middle, rectangle, np.ones(2), _COARSE_STEPS)
        return evidence, middle, rectangle

    def over_depths(self, rectangle: Rectangle) -> tuple[float, Rectangle]:
        """Ascent over depths and rectangles in turn: the depth and the rectangle."""
        depths, even, step, index = self.candidates.tolist(), np.ones(2), _COARSE_STEPS[-1:], _CANDIDATES // 2
        for _ in range(_CANDIDATES):
            profile = [self.evidence.at(vergence, rectangle, even) for vergence in depths]
            before, index = index, int(np.argmax(profile))
            if index == before:
                break
            _, rectangle = self.over_sides(depths[index], rectangle, even, step)
        # Rectangles that are best at neighbouring depths can be better than the one that is best here.
        beside = [(*self.over_sides(one, rectangle, even, step), one) for one in depths[max(index - 1, 0) : index + 2]]
        _, rectangle, vergence = max(beside, key=lambda one: one[0])
        return vergence, rectangle

    def is_allowed(self, rectangle: Rectangle, beyond: float = 0.0) -> bool:
        """Whether a rectangle lies within the blob, or as far beyond it, and is no smaller than the least one."""
        places = zip(rectangle[:2].tolist(), rectangle[2:].tolist(), *self.limits.tolist(), strict=True)
        return all(
            half >= _LEAST_HALF and low - beyond <= mid - half and mid + half <= high + beyond
            for mid, half, low, high in places
        )
