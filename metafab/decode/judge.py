"""A decoded image against the truth, where a simulation knows it."""

from __future__ import annotations

import dataclasses

import numpy as np

from metafab.camera.frame import RawFrame, Truth
from metafab.core.conventions import FloatArray
from metafab.decode.image import Image4D


def judged(image: Image4D, frame: RawFrame, *, seconds: float) -> Image4D:
    """``image`` with its errors and the time it took.

    ``details`` gets ``nmae_pixel``, ``share_decoded``, ``contrast_error`` (mean relative error of the contrast
    over whole segments) and ``psnr_x_db``, ``psnr_y_db`` (peak: the largest true intensity).
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
    for name, got, true in (
        ("psnr_x_db", image.intensity_x[mine], truth.intensity_x),
        ("psnr_y_db", image.intensity_y[mine], truth.intensity_y),
    ):
        mean_square = float(np.mean((got - true) ** 2))
        peak = float(true.max(initial=0.0))
        if mean_square > 0.0 and peak > 0.0:
            details[name] = 10.0 * float(np.log10(peak**2 / mean_square))
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


def _nmae(depth_m: FloatArray, true_m: FloatArray) -> float | None:
    both = np.isfinite(depth_m) & np.isfinite(true_m)
    return float(np.mean(np.abs(depth_m[both] / true_m[both] - 1.0))) if both.any() else None


def _overlap(image: Image4D, frame: RawFrame) -> tuple[tuple[slice, slice], Truth] | None:
    """The part of the decoded grid that the truth covers, and the truth there; grids meet at whole pixels."""
    if frame.truth is None or frame.truth_origin_um is None:
        return None
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
