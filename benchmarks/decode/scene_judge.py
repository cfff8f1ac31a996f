"""Measures of a decoded frame against its truth; each takes a :class:`Decoded` and returns one number."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from metafab.camera import RawFrame
from metafab.camera.frames.frame import Truth
from metafab.core.conventions import FloatArray
from metafab.decode import Image4D
from metafab.decode.evaluation import overlap

#: Relative error of depth from which a pixel is wrong.
WRONG = 0.05
#: Confidence from which a pixel is sure.
SURE = 0.9
#: Distance from outlines beyond which a pixel is inside of its surface.
_OUTLINES_PX = 20.0
#: Share of an object's pixels that must have a depth for the object to be found.
_FOUND_SHARE = 0.3
#: Number of the wall in scenes that have one: the first object.
WALL = 1


@dataclass(frozen=True)
class Decoded:
    """A decoded frame and its truth, on the overlap of their grids."""

    image: Image4D  #: The decoded image.
    truth: Truth  #: The truth in the overlap.
    depth_m: FloatArray  #: Shape (n_y, n_x), decoded depth; NaN for none.
    own_depth_m: FloatArray  #: Shape (n_y, n_x), depth of each pixel by itself.
    confidence: FloatArray  #: Shape (n_y, n_x).
    intensity: FloatArray  #: Shape (2, n_y, n_x), decoded I_x and I_y.

    @classmethod
    def of(cls, image: Image4D, frame: RawFrame) -> Decoded:
        """Cut image and truth to their overlap."""
        both = overlap(image, frame)
        if both is None:
            raise ValueError(f"no pixel of the frame was decoded: {image.figures.reason}")
        here, truth = both
        own = image.depth_m if image.depth_pixel_m is None else image.depth_pixel_m
        intensity = np.stack([image.intensity_x[here], image.intensity_y[here]])
        return cls(image, truth, image.depth_m[here], own[here], image.confidence[here], intensity)

    @cached_property
    def error(self) -> FloatArray:
        """Relative error of depth, shape (n_y, n_x); NaN where decoded or true depth is missing."""
        return np.asarray(self.depth_m / self.truth.depth_m - 1.0)

    @cached_property
    def true_intensity(self) -> FloatArray:
        """Shape (2, n_y, n_x), true I_x and I_y."""
        return np.stack([self.truth.intensity_x, self.truth.intensity_y])

    @cached_property
    def edge_px(self) -> FloatArray:
        """Distance of each pixel from the nearest change of object, pixels."""
        label, edge = self.truth.label, np.zeros(self.truth.label.shape, dtype=np.bool_)
        for across, changed in ((label, edge), (label.T, edge.T)):
            change = across[1:] != across[:-1]
            changed[1:] |= change
            changed[:-1] |= change
        return np.asarray(distance_transform_edt(~edge))

    @cached_property
    def objects(self) -> list[int]:
        """Numbers of the objects that the truth shows."""
        return [int(number) for number in np.unique(self.truth.label[self.truth.label > 0])]

    def of_object(self, number: int) -> NDArray[np.bool_]:
        """Pixels of an object, shape (n_y, n_x)."""
        return np.asarray(self.truth.label == number)

    def share(self, number: int) -> float:
        """Share of an object's pixels that have a depth."""
        return float(np.isfinite(self.error[self.of_object(number)]).mean())

    def bias(self, number: int) -> float:
        """Median relative error of an object's decoded pixels; NaN without any."""
        errors = self.error[self.of_object(number) & np.isfinite(self.error)]
        return float(np.median(errors)) if errors.size else np.nan


def all_error(seen: Decoded) -> float:
    """Mean relative error over all decoded pixels."""
    return float(np.nanmean(np.abs(seen.error)))


def inside_error(seen: Decoded) -> float:
    """Mean relative error over the decoded pixels that are more than 20 px from the nearest outline."""
    return float(np.nanmean(np.abs(seen.error[seen.edge_px > _OUTLINES_PX])))


def decoded_share(seen: Decoded) -> float:
    """Share of the pixels with a true depth that have a decoded one."""
    return float(np.isfinite(seen.error).sum() / np.isfinite(seen.truth.depth_m).sum())


def object_error(seen: Decoded) -> float:
    """Mean over the objects of their median error; an object without a depth counts as wholly wrong."""
    return float(np.mean([_or_whole(seen.bias(number)) for number in seen.objects]))


def worst_object_error(seen: Decoded) -> float:
    """Largest of the objects' median errors; an object without a depth counts as wholly wrong."""
    return max(_or_whole(seen.bias(number)) for number in seen.objects)


def wall_error(seen: Decoded) -> float:
    """Median error of the wall."""
    return _or_whole(seen.bias(WALL))


def last_object_error(seen: Decoded) -> float:
    """Mean error over the last object's decoded pixels."""
    mask = seen.of_object(seen.objects[-1]) & np.isfinite(seen.error)
    return float(np.abs(seen.error[mask]).mean()) if mask.any() else 1.0


def last_object_share(seen: Decoded) -> float:
    """Share of the last object's pixels that have a depth."""
    return seen.share(seen.objects[-1])


def found(seen: Decoded) -> float:
    """Number of objects before the wall that are found within 1 %."""
    return float(sum(_is_found(seen, number, 0.01) for number in seen.objects if number != WALL))


def bars_found(seen: Decoded) -> float:
    """Number of objects before the wall that are found within 2 %."""
    return float(sum(_is_found(seen, number, 0.02) for number in seen.objects if number != WALL))


def bars_claimed(seen: Decoded) -> float:
    """Number of objects before the wall on most of whose decoded pixels the wall's depth is claimed."""
    wall_m = np.nanmedian(seen.truth.depth_m[seen.of_object(WALL)])
    claimed = 0
    for number in seen.objects:
        mask = seen.of_object(number) & np.isfinite(seen.error)
        if number != WALL and seen.share(number) > _FOUND_SHARE:
            as_wall = np.abs(seen.depth_m[mask] - wall_m) < np.abs(seen.depth_m[mask] - seen.truth.depth_m[mask])
            claimed += bool(as_wall.mean() > 0.5)
    return float(claimed)


def wrong_side_near(seen: Decoded) -> float:
    """Share of the wall's pixels 0 to 3 px from its edge with a depth that is nearer to the object's."""
    return _wrong_side(seen, 0.0, 3.0)


def wrong_side_far(seen: Decoded) -> float:
    """Share of the wall's pixels 3 to 6 px from its edge with a depth that is nearer to the object's."""
    return _wrong_side(seen, 3.0, 6.0)


def swapped(seen: Decoded) -> float:
    """Share of all objects' pixels that have a depth nearer to another object's."""
    means = {number: float(np.nanmean(seen.truth.depth_m[seen.of_object(number)])) for number in seen.objects}
    others = np.full(seen.error.shape, np.inf)
    for number, mean_m in means.items():
        here = seen.truth.label != number
        others[here] = np.minimum(others[here], np.abs(seen.depth_m - mean_m)[here])
    known = np.isfinite(seen.truth.depth_m)
    return float((others < np.abs(seen.depth_m - seen.truth.depth_m))[known].mean())


def sure_and_wrong(seen: Decoded) -> float:
    """Of the pixels with confidence above 0.9, the share that is off by more than 5 %."""
    sure = (seen.confidence > SURE) & np.isfinite(seen.error)
    return float((np.abs(seen.error[sure]) > WRONG).mean()) if sure.any() else 0.0


def miscalibration(seen: Decoded) -> float:
    """Expected calibration error: mean |confidence - share within 5 %| over the bins of the reliability diagram."""
    confidence, right, count = reliability(seen)
    return float(np.sum(np.abs(confidence - right) * count) / count.sum())


def reliability(seen: Decoded, bins: int = 10) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Reliability diagram: of each bin of confidence, the mean confidence, share within 5 %, and number of pixels.

    Empty bins are left out.
    """
    known = np.isfinite(seen.error)
    confidence, right = seen.confidence[known], np.abs(seen.error[known]) <= WRONG
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    count = np.bincount(place, minlength=bins).astype(np.float64)
    full = count > 0.0
    sums = (np.bincount(place, weights, minlength=bins)[full] for weights in (confidence, right))
    mean_confidence, share_right = (total / count[full] for total in sums)
    return mean_confidence, share_right, count[full]


def contrast_error(seen: Decoded) -> float:
    """Mean relative error of the objects' contrasts, each over its decoded pixels."""
    errors = []
    for number in seen.objects:
        mask = seen.of_object(number) & np.isfinite(seen.error)
        decoded, true = seen.intensity[:, mask].sum(axis=1), seen.true_intensity[:, mask].sum(axis=1)
        errors.append(abs(decoded[0] / decoded[1] * true[1] / true[0] - 1.0) if mask.any() else 1.0)
    return float(np.mean(errors))


def tails(seen: Decoded) -> float:
    """Error of I_x 4 to 24 px from highlights over that elsewhere, mean absolute error over mean light.

    Highlights are pixels of 10 times the median light.
    """
    true = seen.true_intensity[0]
    away_px = distance_transform_edt(true < 10.0 * np.median(true))
    relative = np.abs(seen.intensity[0] - true)
    near, elsewhere = (away_px > 4.0) & (away_px <= 24.0), away_px > 40.0
    return float(relative[near].mean() / true[near].mean() / (relative[elsewhere].mean() / true[elsewhere].mean()))


def side_bias(seen: Decoded) -> float:
    """Largest of both sides' median error of the pixels' own depths, 8 to 80 px from the sides of the frame."""
    error = seen.own_depth_m / seen.truth.depth_m - 1.0
    return max(abs(float(np.nanmedian(part))) for part in (error[:, 8:80], error[:, -80:-8]))


def pull(seen: Decoded) -> float:
    """Largest error of an object's depth over the standard error that its segment states."""
    worst = 0.0
    for number in seen.objects:
        bias = seen.bias(number)
        depth_m = np.nanmean(seen.truth.depth_m[seen.of_object(number)])
        decoded_m = depth_m * (1.0 + bias)
        of_depth = [s for s in seen.image.segments if abs(s.depth_m / decoded_m - 1.0) < 0.005]
        if not np.isfinite(bias) or not of_depth:
            return np.inf
        worst = max(worst, abs(bias) * depth_m / max(of_depth, key=lambda s: s.pixels).error_m)
    return worst


def has_astray(seen: Decoded) -> float:
    """1 where any decoded object's median error is above 5 %, 0 otherwise."""
    return float(any(abs(seen.bias(number)) > WRONG for number in seen.objects))


def _or_whole(error: float) -> float:
    return abs(error) if np.isfinite(error) else 1.0


def _is_found(seen: Decoded, number: int, tolerance: float) -> bool:
    return seen.share(number) > _FOUND_SHARE and abs(seen.bias(number)) <= tolerance


def _wrong_side(seen: Decoded, low_px: float, high_px: float) -> float:
    wall = seen.of_object(WALL)
    wall_m, object_m = (float(np.nanmedian(seen.truth.depth_m[part])) for part in (wall, ~wall))
    band = wall & (seen.edge_px >= low_px) & (seen.edge_px < high_px)
    return float((np.abs(seen.depth_m - object_m) < np.abs(seen.depth_m - wall_m))[band].mean())
