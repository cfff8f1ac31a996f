"""Errors of a decoded image against the truth of a simulated frame, and the Cramer-Rao bound of depth at each place.

The information (:mod:`metafab.information.fisher`) is summed over the frequencies of the *local* pair: kernels
integrated over pixels, y on the grid of x. Aberrations blur the pair off the axis: at the edge of Shen's field it
carries a sixth of the information on the axis. Divided by the number of frequencies it is the information of a pixel; a
window much larger than the blur has the sum of its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from metafab.camera.frames.frame import RawFrame, Truth
from metafab.core.conventions import FloatArray
from metafab.decode.image import Image4D
from metafab.decode.matching.filters import BLOCK_PX
from metafab.decode.registration.calibration import Calibration
from metafab.information.fisher import known_texture_information, twin_information
from metafab.information.texture import Texture

#: Side of the window of the structural similarity, pixels.
_SSIM_WINDOW_PX = 11
#: Side of the transforms over that of the kernels.
_ROOM = 2
#: Half step of vergence, relative, of the central difference.
_STEP = 1e-3


def evaluated(image: Image4D, frame: RawFrame, *, seconds: float) -> Image4D:
    """``image`` with the time that it took and, where the truth is known, its errors."""
    image = replace(image, figures=replace(image.figures, seconds=seconds))
    both = overlap(image, frame)
    if both is None:
        return image
    here, truth = both
    depth_m, intensity_x, intensity_y = image.depth_m[here], image.intensity_x[here], image.intensity_y[here]
    known = np.isfinite(truth.depth_m)
    decoded = known & np.isfinite(depth_m)
    psnr_x, ssim_x = _image_quality(intensity_x, truth.intensity_x)
    psnr_y, ssim_y = _image_quality(intensity_y, truth.intensity_y)
    of_objects = [abs(error) for error in object_errors(image, frame).values()]
    contrast_errors = []
    for number in np.unique(truth.label[truth.label > 0]):
        mask = (truth.label == number) & decoded
        y, true_y = intensity_y[mask].sum(), truth.intensity_y[mask].sum()
        if y > 0.0 and true_y > 0.0:
            ratio = intensity_x[mask].sum() / y
            contrast_errors.append(abs(ratio / (truth.intensity_x[mask].sum() / true_y) - 1.0))
    figures = replace(
        image.figures,
        share_decoded=float(decoded.sum() / max(1, known.sum())),
        nmae_pixel=None if image.depth_pixel_m is None else _nmae(image.depth_pixel_m[here], truth.depth_m),
        psnr_x_db=psnr_x,
        ssim_x=ssim_x,
        psnr_y_db=psnr_y,
        ssim_y=ssim_y,
        object_error=float(np.mean(of_objects)) if of_objects else None,
        worst_object_error=max(of_objects, default=None),
        contrast_error=float(np.mean(contrast_errors)) if contrast_errors else None,
    )
    return replace(image, nmae=_nmae(depth_m, truth.depth_m), figures=figures)


def _image_quality(image: FloatArray, truth: FloatArray) -> tuple[float | None, float | None]:
    """Peak signal-to-noise ratio in dB and structural similarity; None where they are not defined."""
    mean_square, peak = float(np.mean((image - truth) ** 2)), float(truth.max(initial=0.0))
    psnr_db = 10.0 * float(np.log10(peak**2 / mean_square)) if mean_square > 0.0 and peak > 0.0 else None
    large = peak > 0.0 and min(truth.shape) >= _SSIM_WINDOW_PX
    return psnr_db, structural_similarity(image, truth, peak) if large else None


def structural_similarity(image: FloatArray, truth: FloatArray, peak: float) -> float:
    """Mean structural similarity of two images of shape (n_y, n_x); 1 for equal ones.

    Wang et al., IEEE Trans. Image Process. 13, 600, 2004, Eq. 13, with its Gaussian window of 1.5 pixels and
    K = (0.01, 0.03); ``peak`` is the range of the values, the ``L`` of its constants.
    """
    low, high = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    mean_a, mean_b, square_a, square_b, product = (
        gaussian_filter(part, 1.5, truncate=3.5) for part in (image, truth, image * image, truth * truth, image * truth)
    )
    variance = np.maximum(square_a - mean_a**2, 0.0) + np.maximum(square_b - mean_b**2, 0.0)
    luminance = (2.0 * mean_a * mean_b + low) / (mean_a**2 + mean_b**2 + low)
    return float(np.mean(luminance * (2.0 * (product - mean_a * mean_b) + high) / (variance + high)))


def object_errors(image: Image4D, frame: RawFrame) -> dict[int, float]:
    """Relative depth error of each true object: the median of z / z_true - 1 over its pixels, by the object's number.

    Objects without a decoded pixel are left out; without truth there are none.
    """
    both = overlap(image, frame)
    if both is None:
        return {}
    here, truth = both
    depth_m = image.depth_m[here]
    known = np.isfinite(depth_m) & np.isfinite(truth.depth_m)
    errors = {}
    for number in np.unique(truth.label[truth.label > 0]):
        mask = known & (truth.label == number)
        if mask.any():
            errors[int(number)] = float(np.median(depth_m[mask] / truth.depth_m[mask])) - 1.0
    return errors


def _nmae(depth_m: FloatArray, true_m: FloatArray) -> float | None:
    """Mean |depth error| / depth where both are known; None without any."""
    both = np.isfinite(depth_m) & np.isfinite(true_m)
    return float(np.mean(np.abs(depth_m[both] / true_m[both] - 1.0))) if both.any() else None


@dataclass(frozen=True)
class _Span:
    """Overlap of two grids along one axis: slices in the image and in the truth."""

    image: slice
    truth: slice


def overlap(image: Image4D, frame: RawFrame) -> tuple[tuple[slice, slice], Truth] | None:
    """Part of a decoded image that the truth of its frame covers, and the truth there; None without any.

    The grids are a whole number of pixels apart.
    """
    if frame.truth is None or frame.truth_origin_um is None:
        return None
    if not image.pixel_um > 0.0 or not np.isfinite([*frame.truth_origin_um, *image.origin_um]).all():
        return None  # a frame that was not decoded, for its place is not known
    spans = []
    for axis, n, true_n in zip((1, 0), image.depth_m.shape, frame.truth.depth_m.shape, strict=True):
        offset = round((frame.truth_origin_um[axis] - image.origin_um[axis]) / image.pixel_um)
        start, stop = max(0, offset), min(n, offset + true_n)
        if stop <= start:
            return None
        spans.append(_Span(slice(start, stop), slice(start - offset, stop - offset)))
    rows, columns = spans
    crop = (rows.truth, columns.truth)
    truth = Truth(**{item.name: getattr(frame.truth, item.name)[crop] for item in fields(Truth)})
    return (rows.image, columns.image), truth


@dataclass(frozen=True)
class DepthBound:
    """Information about depth in each pixel of a decoder's window."""

    depth_m: float  #: Depth of the texture.
    #: Shape (n_y, n_x), 1/m^2 a pixel, for unknown texture and brightness ratio: a decoder's case.
    unknown_per_m2: FloatArray
    #: Shape (n_y, n_x), 1/m^2 a pixel, for known texture; the difference is the cost of an unknown texture.
    known_per_m2: FloatArray

    @classmethod
    def of(
        cls, calibration: Calibration, depth_m: float, texture: Texture, extent_px: tuple[int, int] | None = None
    ) -> DepthBound:
        """Evaluate the bound of a calibration for a texture.

        Args:
            depth_m: inside the calibrated depths.
            texture: electrons a pixel of either image, contrast and noise.
            extent_px: (n_y, n_x) of the piece over which the texture has its contrast; the window by default.
        """
        stack, vergence = calibration.stack, 1.0 / depth_m
        shape = (_ROOM * stack.shape[-2], _ROOM * stack.shape[-1])
        on_axis = texture.signal_to_noise(shape, extent_px or calibration.grid.shape)
        weights = calibration.depth_weights(vergence * np.array([1.0 - _STEP, 1.0, 1.0 + _STEP]))
        per_m = vergence / (2.0 * _STEP)  # 1 / (2 _STEP vergence) per unit of vergence, and d(1/z) = -dz / z^2
        information = np.empty((stack.shape[2], 2))
        for field in range(stack.shape[2]):
            low, at, high = np.fft.fft2(np.tensordot(weights, stack[:, :, field], axes=(1, 1)), shape)
            slope = (high - low) * per_m
            signal_to_noise = on_axis / _relative_noise(texture, float(np.abs(at[:, 0, 0]).mean()))
            information[field, 0] = twin_information(at, slope, signal_to_noise)
            information[field, 1] = known_texture_information(slope, signal_to_noise)
        shares = calibration.block_weights(calibration.grid.shape, 1, BLOCK_PX)
        by_block = np.maximum(shares @ (information / (shape[0] * shape[1])), 0.0)
        whole = by_block.repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)
        n_y, n_x = calibration.grid.shape
        return cls(depth_m, whole[:n_y, :n_x, 0], whole[:n_y, :n_x, 1])

    def relative_error(self, mask: NDArray[np.bool_] | tuple[slice, slice], *, known: bool = False) -> float:
        """Smallest standard error of depth over depth, from pixels of one depth together; infinite without pixels.

        The mask has the shape (n_y, n_x), or consists of the slices of a window. ``known`` says whether the texture is
        known.
        """
        total = float((self.known_per_m2 if known else self.unknown_per_m2)[mask].sum())
        return 1.0 / (np.sqrt(total) * self.depth_m) if total > 0.0 else float("inf")


def _relative_noise(texture: Texture, light: float) -> float:
    """Variance of a pixel with a share ``light`` of the light on the axis, over the variance on the axis."""
    dark = texture.background_e + texture.read_noise_e**2
    return (light * texture.electrons + dark) / (texture.electrons + dark)
