"""The decoded 4D image: two intensities, their contrast, depth, and its confidence."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metafab.camera.frames.frame import pixel_axes
from metafab.core.conventions import FloatArray
from metafab.core.display import Displayed
from metafab.core.figures import DecodingFigures, SegmentFigures
from metafab.core.labelled import dataset

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, repr=False)
class Image4D(Displayed):
    """All-in-focus polarisation images and depth on the geometric image grid of the x polarisation.

    Attributes:
        intensity_x: shape (n_y, n_x), electrons.
        intensity_y: shape (n_y, n_x), electrons.
        contrast: shape (n_y, n_x), I_x / I_y; NaN where there is no signal.
        depth_m: shape (n_y, n_x), depth of the pixel's segment; NaN where no depth is claimed.
        confidence: shape (n_y, n_x), 0 to 1 (:mod:`metafab.decode.confidence`); 0 where no depth is claimed.
        segment: shape (n_y, n_x), number of the segment from 1; 0 for none.
        origin_um: (x, y) on the sensor of the centre of pixel [0, 0].
        pixel_um: pixel pitch.
        segments: figures of each segment.
        depth_pixel_m: shape (n_y, n_x), depth of each pixel from the window about it; NaN where none is claimed.
        contrast_error: shape (n_y, n_x), standard error of each pixel's contrast by photon and read noise; NaN where
            there is no signal.
        nmae: mean |depth error| / depth over decoded pixels with known truth; None without truth.
        figures: figures of the decoding.
    """

    intensity_x: FloatArray
    intensity_y: FloatArray
    contrast: FloatArray
    depth_m: FloatArray
    confidence: FloatArray
    segment: NDArray[np.int32]
    origin_um: tuple[float, float]
    pixel_um: float
    segments: tuple[SegmentFigures, ...] = ()
    depth_pixel_m: FloatArray | None = None
    contrast_error: FloatArray | None = None
    nmae: float | None = None
    figures: DecodingFigures = field(default_factory=DecodingFigures)

    def key_figures(self) -> dict[str, str]:
        """Size, segments, depths and share of decoded pixels."""
        known = np.isfinite(self.depth_m)
        depths = f"{self.depth_m[known].min():g} to {self.depth_m[known].max():g} m" if known.any() else "none"
        return {
            "pixels": " x ".join(str(count) for count in self.depth_m.shape),
            "segments": str(len(self.segments)),
            "depths": depths,
            "decoded": f"{100.0 * known.mean():.1f} % of the pixels",
        }

    def to_xarray(self) -> xarray.Dataset:
        """All maps over (y_um, x_um); MissingToolError if xarray is not installed."""
        axes = pixel_axes(self.depth_m.shape, self.origin_um, self.pixel_um)
        units = {"intensity_x": "electron", "intensity_y": "electron", "contrast": "", "depth_m": "m", "confidence": ""}
        units["segment"] = ""
        return dataset({name: (tuple(axes), getattr(self, name), unit) for name, unit in units.items()}, axes)
