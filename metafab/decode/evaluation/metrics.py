"""A decoded image against the truth, where a simulation knows it."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.ndimage import gaussian_filter

from metafab.camera.frames.frame import RawFrame, Truth
from metafab.core.conventions import FloatArray
from metafab.decode.image import Image4D

#: Pixels of the window of the structural similarity.
_SSIM_REACH = 11


def judged(image: Image4D, frame: RawFrame, *, seconds: float) -> Image4D:
    """``image`` with its errors and the time it took.

    ``details`` gets ``nmae_pixel``, ``object_error`` and ``worst_object_error`` (mean and largest over the true objects
    of the median error of their pixels), ``share_decoded``, ``contrast_error`` (mean relative error of the contrast
    over whole segments), ``psnr_x_db``, ``psnr_y_db`` (peak: the largest true intensity) and ``ssim_x``, ``ssim_y``.
    """
    details = {**image.details, "seconds": seconds}
    overlap = _overlap(image, frame)
    if overlap is None:
        return dataclasses.replace(image, details=details)
    mine, truth = overlap
    known = np.isfinite(truth.depth_m)
    decoded = known & np.isfinite(image.depth_m[mine])
    nmae = _nmae(image.depth_m[mine], truth.depth_m)
    details["share_decoded"] = float(decoded.sum() / max(1, known.sum()))
    if image.depth_pixel_m is not None:
        pixel = _nmae(image.depth_pixel_m[mine], truth.depth_m)
        if pixel is not None:
            details["nmae_pixel"] = pixel
    for axis, got, true in (
        ("x", image.intensity_x[mine], truth.intensity_x),
        ("y", image.intensity_y[mine], truth.intensity_y),
    ):
        mean_square = float(np.mean((got - true) ** 2))
        peak = float(true.max(initial=0.0))
        if mean_square > 0.0 and peak > 0.0:
            details[f"psnr_{axis}_db"] = 10.0 * float(np.log10(peak**2 / mean_square))
        if peak > 0.0 and min(true.shape) >= _SSIM_REACH:
            details[f"ssim_{axis}"] = structural_similarity(got, true, peak)
    of_objects = [abs(error) for error in object_errors(image, frame).values()]
    if of_objects:
        details["object_error"] = float(np.mean(of_objects))
        details["worst_object_error"] = max(of_objects)
    errors = []
    for number in np.unique(truth.label[truth.label > 0]):
        mask = (truth.label == number) & decoded
        y, true_y = image.intensity_y[mine][mask].sum(), truth.intensity_y[mask].sum()
        if y > 0.0 and true_y > 0.0:
            ratio = image.intensity_x[mine][mask].sum() / y
            errors.append(abs(ratio / (truth.intensity_x[mask].sum() / true_y) - 1.0))
    if errors:
        details["contrast_error"] = float(np.mean(errors))
    return dataclasses.replace(image, nmae=nmae, details=details)


def structural_similarity(got: FloatArray, true: FloatArray, peak: float) -> float:
    """Mean structural similarity (Wang et al., IEEE Trans. Image Process. 13, 600, 2004; Eq. 13).

    Args:
        got: shape (n_y, n_x).
        true: the same shape.
        peak: range of the values, the ``L`` of its constants.

    Returns:
        1 for equal images, with its Gaussian window of 1.5 pixels and K = (0.01, 0.03).
    """
    low, high = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    mean_a, mean_b, square_a, square_b, product = (
        gaussian_filter(part, 1.5, truncate=3.5) for part in (got, true, got * got, true * true, got * true)
    )
    variance = np.maximum(square_a - mean_a**2, 0.0) + np.maximum(square_b - mean_b**2, 0.0)
    likeness = (2.0 * mean_a * mean_b + low) / (mean_a**2 + mean_b**2 + low)
    return float(np.mean(likeness * (2.0 * (product - mean_a * mean_b) + high) / (variance + high)))


def object_errors(image: Image4D, frame: RawFrame) -> dict[int, float]:
    """The error of each true object's depth, whatever becomes of its outline: median of z / z_true - 1 of its pixels.

    Args:
        image: decoded from ``frame``.
        frame: with its truth; without it there is nothing to tell.

    Returns:
        By the number of each object of which anything is decoded.
    """
    overlap = _overlap(image, frame)
    if overlap is None:
        return {}
    mine, truth = overlap
    depth_m = image.depth_m[mine]
    known = np.isfinite(depth_m) & np.isfinite(truth.depth_m)
    return {
        int(number): float(np.median(depth_m[mask] / truth.depth_m[mask])) - 1.0
        for number in np.unique(truth.label[truth.label > 0])
        if (mask := known & (truth.label == number)).any()
    }


def _nmae(depth_m: FloatArray, true_m: FloatArray) -> float | None:
    both = np.isfinite(depth_m) & np.isfinite(true_m)
    return float(np.mean(np.abs(depth_m[both] / true_m[both] - 1.0))) if both.any() else None


def _overlap(image: Image4D, frame: RawFrame) -> tuple[tuple[slice, slice], Truth] | None:
    """The part of the decoded grid that the truth covers, and the truth there; grids meet at whole pixels."""
    if frame.truth is None or frame.truth_origin_um is None:
        return None
    if not image.pixel_um > 0.0 or not np.isfinite([*frame.truth_origin_um, *image.origin_um]).all():
        return None  # a frame that was not decoded, for it does not know where it stands
    slices, parts = [], []
    for axis in (1, 0):
        offset = round((frame.truth_origin_um[axis] - image.origin_um[axis]) / image.pixel_um)
        have, true = image.depth_m.shape[1 - axis], frame.truth.depth_m.shape[1 - axis]
        start, stop = max(0, offset), min(have, offset + true)
        if stop <= start:
            return None
        slices.append(slice(start, stop))
        parts.append(slice(start - offset, stop - offset))
    crop = (parts[0], parts[1])
    truth = frame.truth
    part = Truth(truth.depth_m[crop], truth.intensity_x[crop], truth.intensity_y[crop], truth.label[crop])
    return (slices[0], slices[1]), part
