"""Segments whose light falls on saturated pixels: errors of their depths, and segments without a depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance
from metafab.decode.registration.downsampling import repeated
from metafab.decode.segmentation.prepared_frame import SPOILED_PX, PreparedFrame
from metafab.decode.segmentation.regions import LEAST_KEPT
from metafab.decode.segmentation.segments import Regions

#: Relative errors of depth and contrast over the square of the share of broken pixels. Measured at a textured wall
#: whose brightest pixels saturate, three draws each: at shares of 0.19, 0.36 and 0.54, depths err by up to 0.2, 0.7 and
#: 1.4 %, contrasts by up to 0.2, 2.4 and 4.7 %.
_DEPTH_ERROR, _CONTRAST_ERROR = 0.05, 0.15
#: Share of broken pixels from which a segment has no depth: at 0.55 to 0.78, depths err by up to 17 % and contrasts by
#: up to 33 %.
_MOST_BROKEN = 0.55
#: Share of broken pixels from which these explain twins that differ, and are named in a warning: at 0.19, twins differ
#: by 2 to 3 % of their power, and depths are right within their errors.
_NAMED_BROKEN = 0.25


@dataclass(frozen=True)
class BrokenLight:
    """Share of saturated pixels, and of those beside such, in the light of a frame's segments."""

    #: Shape (n,), share of each segment's pixels and of those whose blur reaches them; 0 where so few pixels are
    #: spoiled that the depth is measured without these.
    share: FloatArray
    of_window: float  #: Share of the pixels of the window.

    @classmethod
    def of(cls, prepared: PreparedFrame, regions: Regions) -> BrokenLight:
        """Shares of a frame's segments."""
        count, bad = len(regions.depths), prepared.twins.bad
        share = np.zeros(count)
        if not bad.any():
            return cls(share, 0.0)
        step = prepared.downsampling.step
        clean = np.where(prepared.spoiled, 0, regions.interior)
        whole, left = (np.bincount(label.ravel(), minlength=count + 1)[1:] for label in (regions.interior, clean))
        lit, reach = bad | repeated(prepared.lit, step, bad.shape), -(-SPOILED_PX // step)
        places = find_objects(regions.interior, max_label=count)
        for index in np.flatnonzero((whole > 0) & (left <= LEAST_KEPT * whole)).tolist():
            about = tuple(slice(max(side.start - reach, 0), side.stop + reach) for side in places[index])
            fine = tuple(slice(step * side.start, step * side.stop) for side in about)
            own = distance(regions.interior[about] == index + 1) * step <= SPOILED_PX
            near = repeated(own, step, bad[fine].shape)
            share[index] = int(np.count_nonzero(bad[fine] & near)) / max(int(np.count_nonzero(lit[fine] & near)), 1)
        # Pixels that are no number lie anywhere; saturated ones are the brightest, which carry the texture.
        return cls(prepared.saturated_share * share, prepared.saturated_share * float(bad.mean()))

    @property
    def refused(self) -> NDArray[np.bool_]:
        """Whether each segment has no depth, by its number from 1: shape (n + 1,), False for 0."""
        return np.append(False, self.share > _MOST_BROKEN)

    @property
    def depth_error(self) -> FloatArray:
        """Relative error of each segment's depth, shape (n,); inf without a depth."""
        return np.where(self.refused[1:], np.inf, _DEPTH_ERROR * self.share**2)

    @property
    def contrast_error(self) -> FloatArray:
        """Relative error of each segment's contrast, shape (n,); inf without a depth."""
        return np.where(self.refused[1:], np.inf, _CONTRAST_ERROR * self.share**2)

    @property
    def warning(self) -> str | None:
        """Warning that too many pixels are saturated; None for few."""
        largest = float(self.share.max(initial=0.0)) if self.share.size else self.of_window
        if largest < _NAMED_BROKEN:
            return None
        where = f" about segment {1 + int(self.share.argmax())}" if self.share.size else ""
        without = int(np.count_nonzero(self.refused))
        noun = "segment is" if without == 1 else "segments are"
        rest = f"; {without} {noun} without a depth" if without else ""
        return f"{100.0 * largest:.0f} % of the pixels{where} are saturated or beside such: expose less{rest}"
