"""The decoded 4D image: two intensities, their contrast, depth, and the confidence in it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.display import Displayed
from metafab.core.labelled import dataset

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class SegmentFigures:
    """Depth and contrast of one segment; standard errors are those of photon and read noise.

    Attributes:
        number: of the segment, from 1, as in :attr:`Image4D.segment`.
        pixels: pixels of the segment.
        depth_m: depth at the middle of the segment.
        slope_x_per_m: change of 1/depth per pixel along x, 1/m; 0 for a segment of one depth.
        slope_y_per_m: change of 1/depth per pixel along y, 1/m.
        error_m: standard error of ``depth_m``.
        contrast: I_x / I_y, mean over the interior of the segment.
        contrast_error: standard error of ``contrast``.
        correlation: normalised cross-correlation of the twin images at that depth, 0 to 1.
    """

    number: int
    pixels: int
    depth_m: float
    slope_x_per_m: float
    slope_y_per_m: float
    error_m: float
    contrast: float
    contrast_error: float
    correlation: float


@dataclass(frozen=True)
class DecodeFigures:
    """Figures of a decoded frame; None where a figure does not apply, and those against the truth without one.

    Attributes:
        reason: why nothing was decoded.
        warning: why the calibration does not seem to be the camera's.
        layers: depths at which many pixels lie.
        basis_images: basis kernels that each image was filtered with.
        step_px: frame pixels from one compared pixel to the next.
        pixels: pixels of the window.
        pixels_without_signal: pixels without light.
        pixels_without_texture: lit pixels without a depth.
        pixels_broken: saturated pixels, and those that are not a number.
        contrast_standard_error: median over the pixels of the contrast's relative standard error.
        twin_mismatch: share of the twins' power that neither noise nor depth explains.
        seconds: time of decoding.
        changed_share: share of a film frame's pixels that were decoded again.
        share_decoded: of the pixels with a true depth, the share with a decoded one.
        nmae_pixel: mean |depth error| / depth of the pixels' own depths.
        psnr_x_db: peak signal-to-noise ratio of the x image; the peak is the largest true intensity.
        ssim_x: structural similarity of the x image.
        psnr_y_db: peak signal-to-noise ratio of the y image.
        ssim_y: structural similarity of the y image.
        object_error: mean over the true objects of the median relative error of depth.
        worst_object_error: the largest of these.
        contrast_error: mean relative error of the true objects' contrasts.
    """

    reason: str | None = None
    warning: str | None = None
    layers: int | None = None
    basis_images: int | None = None
    step_px: int | None = None
    pixels: int | None = None
    pixels_without_signal: int | None = None
    pixels_without_texture: int | None = None
    pixels_broken: int | None = None
    contrast_standard_error: float | None = None
    twin_mismatch: float | None = None
    seconds: float | None = None
    changed_share: float | None = None
    share_decoded: float | None = None
    nmae_pixel: float | None = None
    psnr_x_db: float | None = None
    ssim_x: float | None = None
    psnr_y_db: float | None = None
    ssim_y: float | None = None
    object_error: float | None = None
    worst_object_error: float | None = None
    contrast_error: float | None = None

    def known(self) -> dict[str, float | str]:
        """The figures that apply, by name, for JSON."""
        return {name: value for name, value in asdict(self).items() if value is not None}


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
    figures: DecodeFigures = field(default_factory=DecodeFigures)

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
        """All maps over (y_um, x_um).

        Raises:
            MissingToolError: xarray is not installed.
        """
        axes, (n_y, n_x) = ("y_um", "x_um"), self.depth_m.shape
        units = {"intensity_x": "electron", "intensity_y": "electron", "contrast": "", "depth_m": "m", "confidence": ""}
        variables = {name: (axes, getattr(self, name), unit) for name, unit in units.items()}
        x_um, y_um = (
            origin + np.arange(count) * self.pixel_um for origin, count in zip(self.origin_um, (n_x, n_y), strict=True)
        )
        return dataset({**variables, "segment": (axes, self.segment, "")}, {"y_um": y_um, "x_um": x_um})
