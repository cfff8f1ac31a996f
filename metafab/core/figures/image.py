"""Figures of a decoded image and of its segments."""

from __future__ import annotations

from dataclasses import dataclass

from metafab.core.storage.tables import optional


@dataclass(frozen=True)
class SegmentFigures:
    """Depth and contrast of one segment; standard errors are those of photon and read noise."""

    number: int  #: Number of the segment, from 1, as in the segment map of the image.
    pixels: int  #: Pixels of the segment.
    depth_m: float  #: Depth at the middle of the segment.
    slope_x_per_m: float  #: Change of 1/depth per pixel along x, 1/m; 0 for a segment of one depth.
    slope_y_per_m: float  #: Change of 1/depth per pixel along y, 1/m.
    #: Standard error of ``depth_m`` by its likelihood; depths scatter by 1.3 to 1.45 times that, which ``confidence``
    #: counts. Infinite where most pixels are saturated: the segment then has no depth in the image.
    error_m: float
    contrast: float  #: I_x / I_y, mean over the interior of the segment.
    contrast_error: float  #: Standard error of ``contrast``.
    correlation: float  #: Normalised cross-correlation of the twin images at that depth, 0 to 1.


@dataclass(frozen=True)
class DecodingFigures:
    """Figures of the decoding of a frame; None where a figure does not apply.

    From ``share_decoded`` to ``contrast_error`` they compare with the truth, and are None without one.
    """

    reason: str | None = optional()  #: Why nothing was decoded.
    #: Why the calibration does not seem to be the camera's, or that many pixels are saturated.
    warning: str | None = optional()
    layers: int | None = optional()  #: Depths at which many pixels lie.
    basis_images: int | None = optional()  #: Basis kernels that each image was filtered with.
    step_px: int | None = optional()  #: Frame pixels from one compared pixel to the next.
    pixels: int | None = optional()  #: Pixels of the window.
    pixels_without_signal: int | None = optional()  #: Pixels without light.
    pixels_without_texture: int | None = optional()  #: Lit pixels without a depth.
    pixels_broken: int | None = optional()  #: Saturated pixels, and those that are not a number.
    #: Median over the pixels of the contrast's relative standard error.
    contrast_standard_error: float | None = optional()
    twin_mismatch: float | None = optional()  #: Share of the twins' power that neither noise nor depth explains.
    seconds: float | None = optional()  #: Time of decoding.
    share_decoded: float | None = optional()  #: Of the pixels with a true depth, the share with a decoded one.
    nmae_pixel: float | None = optional()  #: Mean |depth error| / depth of the pixels' own depths.
    #: Peak signal-to-noise ratio of the x image; the peak is the largest true intensity.
    psnr_x_db: float | None = optional()
    ssim_x: float | None = optional()  #: Structural similarity of the x image.
    psnr_y_db: float | None = optional()  #: Peak signal-to-noise ratio of the y image.
    ssim_y: float | None = optional()  #: Structural similarity of the y image.
    object_error: float | None = optional()  #: Mean over the true objects of the median relative error of depth.
    worst_object_error: float | None = optional()  #: The largest of these.
    contrast_error: float | None = optional()  #: Mean relative error of the true objects' contrasts.
    changed_share: float | None = optional()  #: Share of a film frame's pixels that were decoded again.
