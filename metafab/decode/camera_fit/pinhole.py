"""Calibration of a camera from photographs of a point on the axis at known depths (the procedure of Fig. 2g).

The prediction from the mask is fitted to each image of the point: its place on the sensor, and its vergence. All fits
together give the misalignment of the camera:

- the vergence offset, from an error of the sensor's distance or of the wavelength;
- its difference between the two images, from a tilt of the sensor about the y axis;
- rotation, magnification and shift of the sensor plane, from the places.

Distance and wavelength cannot be separated. The phase of the mask is fixed, and behind it light depends on the product
of wavelength and distance alone (Fresnel): a wavelength longer by a share d, with a sensor nearer by d, gives the same
spots. The split of Shen's lens disperses by 3.8 um per nanometre, in opposite senses, but a farther sensor moves
the images apart as well. In their separation the two changes cancel but for tan^2(theta) d: 0.15 um per nanometre, a
twentieth of a pixel, which is the accuracy of the places. The only other difference is the object's 1/depth, seen as
(1 - d) / depth: 0.004 per metre and nanometre at 30 cm, or 0.1 % of the depth. The offset contains all of it except
0.02 % at the ends of 25 to 34 cm.

The calibrated stack is the prediction with this misalignment, so that it covers the field of view without photographs
of all of it.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.camera.frames.frame import RawFrame
from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.numeric.interpolation import spline_weights
from metafab.core.storage.limits import require_modest_table
from metafab.decode.camera_fit.point import PointImage, find_point
from metafab.decode.registration.calibration import stretched
from metafab.optics.point_spread import Psf

#: Rounds of fitting: each uses the rotation and magnification of the one before.
_ROUNDS = 3
#: Systematic error common to the places of one image, pixels: the pair is interpolated, and pixels are squares.
_COMMON_PX = 0.02
#: Share of an image's power that the prediction may leave unexplained; images of a point by its camera have less.
_LARGEST_MISFIT = 0.3
#: Largest rms residual of the places against a rotated, shifted and magnified sensor, pixels.
_LARGEST_PLACE_RMS_PX = 0.5
#: Relative rms residual of depth above which the table of depths is doubted, if it also exceeds ``_SIGMAS`` standard
#: errors.
_LARGEST_DEPTH_RMS, _SIGMAS = 0.01, 5.0


@dataclass(frozen=True)
class CameraFit:
    """Misalignment of a camera against the prediction from its mask."""

    vergence_offset_per_m: float  #: Offset of the fitted 1/depth, mean of both images.
    tilt_per_m: float  #: Half the difference between the offsets of the y and the x image.
    rotation_deg: float  #: Rotation of the pair in the frame, counter-clockwise.
    magnification: float  #: Of the sensor plane.
    shift_um: tuple[float, float]  #: (x, y) of the axis in the frame.
    place_rms_px: float  #: Rms residual of the places of the point's images.
    vergence_rms_per_m: float  #: Rms residual of their vergences.
    vergence_error_per_m: float = 0.0  #: Standard error of ``vergence_offset_per_m``, and of ``tilt_per_m``.
    rotation_error_deg: float = 0.0  #: Standard error of ``rotation_deg``.
    magnification_error: float = 0.0  #: Standard error of ``magnification``.
    shift_error_um: float = 0.0  #: Standard error of either coordinate of ``shift_um``.
    chi_square: float = 1.0  #: Mean square of the residual over that of the photographs' noise.
    misfit: float = 0.0  #: Largest share of an image's power that neither the prediction nor noise explains.

    @property
    def turn(self) -> FloatArray:
        """Matrix from predicted places to places in the frame, without the shift: shape (2, 2) over (x, y)."""
        c, s = math.cos(math.radians(self.rotation_deg)), math.sin(math.radians(self.rotation_deg))
        return self.magnification * np.array([[c, -s], [s, c]])

    @property
    def back(self) -> FloatArray:
        """The inverse of ``turn``: shape (2, 2)."""
        return np.asarray(np.linalg.inv(self.turn), dtype=np.float64)

    def offset_per_m(self, polarisation: int) -> float:
        """Vergence offset of one image, 0 for x and 1 for y."""
        return self.vergence_offset_per_m + (self.tilt_per_m if polarisation else -self.tilt_per_m)


#: Parameters that no fit can separate, and the reason.
NOT_SEPARATED = (
    "the distance of the sensor and the wavelength: the images of a mask follow from the product of both. What else "
    "the wavelength changes is the same shift of 1/depth for all objects, and is part of the vergence offset"
)

_AS_PREDICTED = CameraFit(0.0, 0.0, 0.0, 1.0, (0.0, 0.0), 0.0, 0.0)


def calibrate(frames: Sequence[RawFrame], depths_m: Sequence[float], predicted: Psf) -> tuple[Psf, CameraFit]:
    """Calibrate a camera from photographs of a point on the axis, at least two, each with both images of the point.

    ``depths_m`` of the point lie inside the range of ``predicted``, the pair from the mask, of at least four depths.
    Returns the calibrated pair, over the depths that the prediction covers with the fitted offsets, and the fit. The
    pair's ``details.camera_fit`` holds the figures of the fit; ``phi_deg`` includes its rotation, and ``error`` is that
    of the prediction.

    InputError for too few frames, depths outside the range, another pixel pitch, no image of a point in a frame, or
    images that are saturated, unlike the prediction, at an end of its range, or inconsistent.
    """
    _check(frames, depths_m, predicted)
    vergence = 1.0 / np.asarray(depths_m, dtype=np.float64)
    fit = _AS_PREDICTED
    for _ in range(_ROUNDS):
        kernels = PairKernels(_turned(predicted, fit))
        points = [
            [find_point(frame, z, p, kernels, _expected_um(predicted, p, fit)) for p in (0, 1)]
            for frame, z in zip(frames, depths_m, strict=True)
        ]
        fit = _fit(points, vergence, predicted)
    if faults := _faults(points, depths_m, fit):
        raise InputError("calibration", faults)
    return _calibrated(predicted, fit), fit


#: What to do about a table of depths.
_LINES = "write one line `frame, depth in m` for each photograph, with a comma and a decimal point"


def read_depths(path: Path, frames: Sequence[Path]) -> list[float]:
    """Read the depths of frames from a table of lines "file name, depth in m"; lines that start with # are skipped.

    A line may name the path of a frame in place of its file name; of frames with one file name it has to.

    InputError if the table cannot be read, a depth is not a positive number, or a frame is not in it, or repeats.
    """
    try:
        require_modest_table(path)
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        got = "no text in UTF-8" if isinstance(error, UnicodeDecodeError) else f"none ({error.strerror or error})"
        raise InputError.single(str(path), "file", "a readable table of depths", got, _LINES) from error
    table: dict[str, float] = {}
    faults = []
    for number, line in enumerate(lines, start=1):
        name, _, depth = (part.strip() for part in line.partition(","))
        if not name or name.startswith("#"):
            continue
        name = str(Path(name))  # as frames are given, without ./ and //
        if name in table:
            faults.append(Fault(f"line {number}", "each file name once", f"{name} again"))
        try:
            table[name] = float(depth)
        except ValueError:
            table[name] = math.nan
        if not (math.isfinite(table[name]) and table[name] > 0.0):
            faults.append(Fault(f"line {number}", "a file name and a depth in m", line, _LINES))
    named = Counter(frame.name for frame in frames)
    keys = [frame.name if named[frame.name] == 1 and frame.name in table else str(frame) for frame in frames]
    for frame, key in zip(frames, keys, strict=True):
        if key not in table:
            alike = named[frame.name]
            got = "none" if alike == 1 else f"none with its path, of {alike} frames of this name"
            faults.append(Fault(key, "a line with its depth", got, _LINES))
    if faults:
        raise InputError(str(path), faults)
    return [table[key] for key in keys]


def _check(frames: Sequence[RawFrame], depths_m: Sequence[float], predicted: Psf) -> None:
    low, high = float(predicted.depth_m.min()), float(predicted.depth_m.max())
    if len(frames) != len(depths_m) or len(set(depths_m)) < 2:
        got = f"{len(frames)} frames and {len(set(depths_m))} depths"
        expected = "frames at two depths or more, each with its depth"
        raise InputError.single("calibration", "frames", expected, got, "photograph the point at further depths")
    if predicted.depth_m.size < 4:
        expected = "a prediction at four depths or more"
        raise InputError.single("calibration", "psf", expected, f"{predicted.depth_m.size}")
    for frame, depth_m in zip(frames, depths_m, strict=True):
        if not low <= depth_m <= high:
            expected = f"a depth that the prediction covers, {low:g} to {high:g} m"
            remedy = "predict the pair over a wider range (`metafab psf --depths-m ...`)"
            raise InputError.single("calibration", "depth_m", expected, f"{depth_m:g}", remedy)
        if abs(frame.pixel_um / predicted.pixel_um - 1.0) > 1e-6:
            expected = f"{predicted.pixel_um:g} um as the prediction"
            remedy = "predict the pair on the camera's pixels (`metafab psf --pixel-um P`)"
            raise InputError.single("calibration", "pixel_um", expected, f"{frame.pixel_um:g} um", remedy)


def _turned(psf: Psf, fit: CameraFit) -> Psf:
    """The stack on the axis with the sensor's rotation and magnification, places and depths unchanged."""
    n_y, n_x = psf.psf.shape[-2:]
    flat = stretched(psf.psf.reshape(-1, n_y, n_x).astype(np.float32), fit.back)
    return dataclasses.replace(psf, psf=flat.reshape(psf.psf.shape).astype(np.float64), field=None, ghost=None)


def _expected_um(predicted: Psf, polarisation: int, fit: CameraFit) -> FloatArray:
    """Expected place (x, y) in the frame of the image of a point on the axis."""
    middle = predicted.centre_um[polarisation, predicted.depth_m.size // 2]
    return np.asarray(fit.turn @ middle + np.array(fit.shift_um))


def _fit(points: Sequence[Sequence[PointImage]], vergence: FloatArray, predicted: Psf) -> CameraFit:
    """Fit the misalignment to the images (x, y) of each frame.

    Standard errors follow from the noise of the photographs, or from the residuals where these are larger.
    """
    found = np.array([[(p.vergence_per_m, *p.place_um, *p.variance) for p in pair] for pair in points])
    offset = found[..., 0] - vergence[:, None]
    by_image = np.median(offset, axis=0)
    centre = predicted.centre_um[:, predicted.depth_m.size // 2]
    want = np.broadcast_to(centre[None], (vergence.size, 2, 2)).reshape(-1, 2)
    got = found[..., 1:3].reshape(-1, 2)
    # Similarity transform of the plane as complex numbers: got = factor want + shift.
    z, w = want[:, 0] + 1j * want[:, 1], got[:, 0] + 1j * got[:, 1]
    (factor, shift), *_ = np.linalg.lstsq(np.stack([z, np.ones_like(z)], axis=1), w, rcond=None)
    away_um = np.abs(factor * z + shift - w)
    place_variance = max(float(np.mean(found[..., 4:])), float(np.sum(away_um**2)) / (2.0 * z.size - 4.0))
    lever = float(np.sum(np.abs(z - z.mean()) ** 2))
    # The systematic error of one image's places looks like a rotation; residuals do not show it.
    common = z.size / 2.0 * (_COMMON_PX * predicted.pixel_um) ** 2
    turn_error = math.sqrt((place_variance + common) / lever)
    # A median's variance is pi / 2 times a mean's; both images' halves add up.
    scatter = float(np.sum((offset - by_image) ** 2)) / max(1, 2 * vergence.size - 2)
    each = np.maximum(found[..., 3].mean(axis=0), scatter)
    vergence_error = math.sqrt(0.5 * math.pi * float(each.sum()) / vergence.size) / 2.0
    return CameraFit(
        float(by_image.mean()),
        float(0.5 * (by_image[1] - by_image[0])),
        math.degrees(math.atan2(factor.imag, factor.real)),
        float(abs(factor)),
        (float(shift.real), float(shift.imag)),
        float(np.sqrt(np.mean(away_um**2))) / predicted.pixel_um,
        float(np.sqrt(np.mean((offset - by_image) ** 2))),
        vergence_error,
        math.degrees(turn_error / abs(factor)),
        turn_error,
        math.sqrt(place_variance / z.size + (turn_error * abs(z.mean())) ** 2),
        float(np.mean([p.chi_square for pair in points for p in pair])),
        max(p.misfit for pair in points for p in pair),
    )


def _faults(points: Sequence[Sequence[PointImage]], depths_m: Sequence[float], fit: CameraFit) -> list[Fault]:
    """Reasons why the photographs give no calibration."""
    faults = []
    for pair, depth_m in zip(points, depths_m, strict=True):
        name, misfit = f"frame at {depth_m:g} m", max(p.misfit for p in pair)
        if pixels := sum(p.full_pixels for p in pair):
            faults.append(Fault(name, "points that are not saturated", f"{pixels} full pixels", "expose shorter"))
        elif misfit > _LARGEST_MISFIT:
            expected = f"images of a point as predicted, but for {100.0 * _LARGEST_MISFIT:.0f} % of their power"
            remedy = "is it a point, of this mask, the right way up and not mirrored, and is the noise stated?"
            faults.append(Fault(name, expected, f"{100.0 * misfit:.0f} % unlike it", remedy))
        elif any(p.at_end for p in pair):
            remedy = "check the depths, or predict the pair over a wider range (`metafab psf --depths-m ...`)"
            faults.append(Fault(name, "images like the prediction inside its range", "like an end of it", remedy))
    if not faults and fit.place_rms_px > _LARGEST_PLACE_RMS_PX:
        expected = f"places of a sensor that is turned, shifted and magnified, within {_LARGEST_PLACE_RMS_PX:g} pixels"
        remedy = "was the point on the axis in each, and the camera left alone between them?"
        faults.append(Fault("place_rms_px", expected, f"{fit.place_rms_px:.3g} pixels", remedy))
    noise = math.sqrt(np.mean([p.variance[0] for pair in points for p in pair]))
    limit = max(_LARGEST_DEPTH_RMS * float(np.mean(1.0 / np.asarray(depths_m))), _SIGMAS * noise)
    if not faults and fit.vergence_rms_per_m > limit:
        expected = f"depths that differ from the table's by one offset, within {limit:.3g} per metre"
        remedy = "does each line of the table of depths hold the depth of its frame?"
        faults.append(Fault("vergence_rms_per_m", expected, f"{fit.vergence_rms_per_m:.3g} per metre", remedy))
    return faults


def _calibrated(predicted: Psf, fit: CameraFit) -> Psf:
    """The prediction with the misalignment, at the depths that stay inside its range."""
    nodes = 1.0 / predicted.depth_m
    offsets = [fit.offset_per_m(p) for p in (0, 1)]
    keep = np.all([(nodes + d >= nodes.min()) & (nodes + d <= nodes.max()) for d in offsets], axis=0)
    depth_m = predicted.depth_m[keep]
    weights = [spline_weights(nodes, nodes[keep] + d) for d in offsets]

    def moved(stack: NDArray[np.floating], centre: FloatArray) -> tuple[NDArray[np.float32], FloatArray]:
        """Interpolate and rotate a stack and its centres, both with axes (polarisation, depth, ...)."""
        new = np.stack([np.tensordot(weights[p], stack[p], axes=(1, 0)) for p in (0, 1)])
        n_y, n_x = new.shape[-2:]
        turned = stretched(new.reshape(-1, n_y, n_x).astype(np.float32), fit.back).reshape(new.shape)
        places = np.stack([np.tensordot(weights[p], centre[p], axes=(1, 0)) for p in (0, 1)])
        return turned, places @ fit.turn.T + np.array(fit.shift_um)

    psf, centre_um = moved(predicted.psf, predicted.centre_um)
    field = predicted.field
    if field is not None:
        over_field, centres = moved(field.psf, field.centre_um)
        field = dataclasses.replace(field, psf=over_field, centre_um=centres)
    figures = {k: v for k, v in dataclasses.asdict(fit).items() if isinstance(v, float)}
    mean = spline_weights(nodes, nodes[keep] + fit.vergence_offset_per_m)
    phi_deg = np.degrees(np.unwrap(np.radians(predicted.phi_deg)))
    return dataclasses.replace(
        predicted,
        depth_m=depth_m,
        psf=psf.astype(np.float64),
        centre_um=centre_um,
        phi_deg=(mean @ phi_deg + fit.rotation_deg + 180.0) % 360.0 - 180.0,
        error=predicted.error[keep],
        efficiency=predicted.efficiency[:, keep],
        extinction_ratio=predicted.extinction_ratio[keep],
        sensor_distance_um=predicted.sensor_distance_um * fit.magnification,
        field=field,
        details=dataclasses.replace(predicted.details, camera_fit=figures),
        ghost=None if predicted.ghost is None else _calibrated(predicted.ghost, fit),
    )
