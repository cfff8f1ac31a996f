"""Calibration of a camera from photographs of a point on the axis at known depths (the procedure of Fig. 2g).

The prediction from the mask is fitted to each image of the point: where it stands, and the vergence at which it looks
like this. From all of them together follow the camera's misalignments:

- the vergence offset, from a wrong distance of the sensor or another wavelength;
- its difference between the two images, from a sensor that is tilted about the y axis;
- rotation, magnification and shift of the sensor plane, from the places.

Distance and wavelength are not told apart. The mask's phase is what it is, and from there to the sensor light depends
on wavelength times distance alone (Fresnel): a wavelength longer by a share d and a sensor nearer by d leave the spots
as they are. The split disperses by 3.8 um a nanometre for the paper's lens, in opposite senses, but a farther sensor
moves the images apart alike: of their distance tan^2(theta) d is left, 0.15 um a nanometre, a twentieth of a pixel,
which is what places are known to. Else it is the object's own 1/depth, seen as (1 - d) / depth: 0.004 per metre a
nanometre at 30 cm, or 0.1 % of the depth. The offset has all of that in it, but for 0.02 % at the ends of 25 to 34 cm.

The calibrated stack is the prediction with these, so that it covers the field of view without a photograph of it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.camera.frames.frame import RawFrame
from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.numeric.splines import spline_weights
from metafab.decode.camera_fit.point import PointImage, find_point
from metafab.decode.registration.calibration import stretched
from metafab.optics.point_spread import Psf

_ROUNDS = 3
#: Places of one image's points are wrong together by so much: the pair is interpolated, and pixels are squares.
_COMMON_PX = 0.02
#: No image of a point, by its camera, is explained worse: shares of its power.
_LARGEST_MISFIT = 0.3
#: Nor do places fit worse to a sensor that is only turned, shifted and magnified, pixels.
_LARGEST_PLACE_RMS_PX = 0.5
#: Nor do depths differ more from the table's, as a share, where that is more than so many standard errors.
_LARGEST_DEPTH_RMS, _SIGMAS = 0.01, 5.0


@dataclass(frozen=True)
class CameraFit:
    """A camera against the prediction from its mask.

    Attributes:
        vergence_offset_per_m: what the camera adds to 1/depth, mean of both images.
        tilt_per_m: half the difference of the y and the x image's offset.
        rotation_deg: of the pair in the frame, counter-clockwise.
        magnification: of the sensor plane.
        shift_um: (x, y) of the axis in the frame.
        place_rms_px: residual of the places of the point's images.
        vergence_rms_per_m: residual of their vergences.
        vergence_error_per_m: standard error of ``vergence_offset_per_m``, and of ``tilt_per_m``.
        rotation_error_deg: standard error of ``rotation_deg``.
        magnification_error: standard error of ``magnification``.
        shift_error_um: standard error of either coordinate of ``shift_um``.
        chi_square: mean square of what the fit leaves of the photographs, in standard deviations of their noise.
        misfit: largest share of an image's power that the prediction does not explain, noise taken off.
    """

    vergence_offset_per_m: float
    tilt_per_m: float
    rotation_deg: float
    magnification: float
    shift_um: tuple[float, float]
    place_rms_px: float
    vergence_rms_per_m: float
    vergence_error_per_m: float = 0.0
    rotation_error_deg: float = 0.0
    magnification_error: float = 0.0
    shift_error_um: float = 0.0
    chi_square: float = 1.0
    misfit: float = 0.0

    @property
    def turn(self) -> FloatArray:
        """Places in the frame from predicted ones, without the shift: shape (2, 2) over (x, y)."""
        c, s = math.cos(math.radians(self.rotation_deg)), math.sin(math.radians(self.rotation_deg))
        return self.magnification * np.array([[c, -s], [s, c]])

    @property
    def back(self) -> FloatArray:
        """The inverse of ``turn``."""
        return np.asarray(np.linalg.inv(self.turn), dtype=np.float64)

    def offset_per_m(self, polarisation: int) -> float:
        """Vergence offset of one image, 0 for x and 1 for y."""
        return self.vergence_offset_per_m + (self.tilt_per_m if polarisation else -self.tilt_per_m)


#: What a fit leaves together, and why.
NOT_SEPARATED = (
    "sensor distance and wavelength: a fixed mask's images depend on their product alone, "
    "but for 1/depth, whose change is part of the vergence offset"
)

_AS_PREDICTED = CameraFit(0.0, 0.0, 0.0, 1.0, (0.0, 0.0), 0.0, 0.0)


def calibrate(frames: Sequence[RawFrame], depths_m: Sequence[float], predicted: Psf) -> tuple[Psf, CameraFit]:
    """Fit a prediction to photographs of a point on the axis.

    Args:
        frames: at least two, each with both images of the point.
        depths_m: depth of the point in each, inside the range of ``predicted``.
        predicted: the pair from the mask, of at least four depths.

    Returns:
        The calibrated pair over the depths that the prediction covers with the fitted offsets, and the fit. The pair's
        ``details`` hold the fit's figures; ``phi_deg`` is turned with it, and ``error`` stays the prediction's.

    Raises:
        InputError: too few frames, depths outside the range, another pixel, no image of a point in a frame, or images
            that are no camera's: saturated, unlike the prediction, at its end, or at odds with each other.
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


def read_depths(path: Path, frames: Sequence[Path]) -> list[float]:
    """The depths of frames from a table of lines "file name, depth in m"; a line that starts with # is left out.

    Raises:
        InputError: the table cannot be read, a depth is not a positive number, or a frame is not in it.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError.single(str(path), "file", "a readable table of depths", str(error)) from error
    table: dict[str, float] = {}
    faults = []
    for number, line in enumerate(lines, start=1):
        name, _, depth = (part.strip() for part in line.partition(","))
        if not name or name.startswith("#"):
            continue
        try:
            table[name] = float(depth)
        except ValueError:
            table[name] = math.nan
        if not (math.isfinite(table[name]) and table[name] > 0.0):
            faults.append(Fault(f"line {number}", "a file name and a depth in m", line))
    faults += [Fault(frame.name, "a line with its depth", "none") for frame in frames if frame.name not in table]
    if faults:
        raise InputError(str(path), faults)
    return [table[frame.name] for frame in frames]


def _check(frames: Sequence[RawFrame], depths_m: Sequence[float], predicted: Psf) -> None:
    low, high = float(predicted.depth_m.min()), float(predicted.depth_m.max())
    if len(frames) != len(depths_m) or len(set(depths_m)) < 2:
        got = f"{len(frames)} frames and {len(set(depths_m))} depths"
        raise InputError.single("calibration", "frames", "frames at two depths or more, each with its depth", got)
    if predicted.depth_m.size < 4:
        raise InputError.single(
            "calibration", "psf", "a prediction at four depths or more", f"{predicted.depth_m.size}"
        )
    for frame, depth_m in zip(frames, depths_m, strict=True):
        if not low <= depth_m <= high:
            raise InputError.single(
                "calibration", "depth_m", f"a depth that the prediction covers, {low:g} to {high:g} m", f"{depth_m:g}",
                "predict the pair over a wider range (`metafab psf --depths-m ...`)",
            )  # fmt: skip
        if abs(frame.pixel_um / predicted.pixel_um - 1.0) > 1e-6:
            raise InputError.single(
                "calibration", "pixel_um", f"{predicted.pixel_um:g} um as the prediction", f"{frame.pixel_um:g} um",
                "predict the pair on the camera's pixels (`metafab psf --pixel-um P`)",
            )  # fmt: skip


def _turned(psf: Psf, fit: CameraFit) -> Psf:
    """The stack on the axis with the sensor's rotation and magnification; neither places nor depths are moved."""
    n_y, n_x = psf.psf.shape[-2:]
    flat = stretched(psf.psf.reshape(-1, n_y, n_x).astype(np.float32), fit.back)
    return dataclasses.replace(psf, psf=flat.reshape(psf.psf.shape).astype(np.float64), field=None)


def _expected_um(predicted: Psf, polarisation: int, fit: CameraFit) -> FloatArray:
    """Where an image of a point on the axis stands in the frame."""
    middle = predicted.centre_um[polarisation, predicted.depth_m.size // 2]
    return np.asarray(fit.turn @ middle + np.array(fit.shift_um))


def _fit(points: Sequence[Sequence[PointImage]], vergence: FloatArray, predicted: Psf) -> CameraFit:
    """Misalignments from the images of each frame, x before y.

    Standard errors are of the photographs' noise or of what they disagree by, whichever is more.
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
    # What one image's places have in common looks like a turn: photographs cannot disagree about it.
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
    """Why the photographs are no calibration."""
    full, unlike, at_end = {}, {}, {}
    for pair, z in zip(points, depths_m, strict=True):
        if pixels := sum(p.full_pixels for p in pair):
            full[z] = f"{pixels} full pixels"
        elif (misfit := max(p.misfit for p in pair)) > _LARGEST_MISFIT:
            unlike[z] = f"{misfit:.0%} unlike it"
        elif any(p.at_end for p in pair):
            at_end[z] = "like an end of it"
    faults = [
        Fault(f"frame at {' and '.join(f'{z:g}' for z in got)} m", expected, ", ".join(got.values()), remedy)
        for got, expected, remedy in (
            (full, "points that are not saturated", "expose shorter"),
            (
                unlike,
                f"images of a point as predicted, but for {_LARGEST_MISFIT:.0%} of their power",
                "is it a point, of this mask, the right way up and not mirrored, and is the noise stated?",
            ),
            (
                at_end,
                "images like the prediction inside its range",
                "check the depths, or predict the pair over a wider range (`metafab psf --depths-m ...`)",
            ),
        )
        if got
    ]
    if not faults and fit.place_rms_px > _LARGEST_PLACE_RMS_PX:
        expected = f"places of a sensor that is turned, shifted and magnified, within {_LARGEST_PLACE_RMS_PX:g} pixels"
        remedy = "was the point on the axis in each, and the camera left alone between them?"
        faults.append(Fault("place_rms_px", expected, f"{fit.place_rms_px:.3g} pixels", remedy))
    noise = math.sqrt(np.mean([p.variance[0] for pair in points for p in pair]))
    limit = max(_LARGEST_DEPTH_RMS * float(np.mean(1.0 / np.asarray(depths_m))), _SIGMAS * noise)
    if not faults and fit.vergence_rms_per_m > limit:
        expected = f"depths that differ from the table's by one offset, within {limit:.3g} per metre"
        remedy = "does each frame's line in the table of depths tell its own depth?"
        faults.append(Fault("vergence_rms_per_m", expected, f"{fit.vergence_rms_per_m:.3g} per metre", remedy))
    return faults


def _calibrated(predicted: Psf, fit: CameraFit) -> Psf:
    """The prediction as the fitted camera sees it, at those of its depths that stay inside its range."""
    nodes = 1.0 / predicted.depth_m
    offsets = [fit.offset_per_m(p) for p in (0, 1)]
    keep = np.all([(nodes + d >= nodes.min()) & (nodes + d <= nodes.max()) for d in offsets], axis=0)
    depth_m = predicted.depth_m[keep]
    weights = [spline_weights(nodes, nodes[keep] + d) for d in offsets]

    def moved(stack: NDArray[np.floating], centre: FloatArray) -> tuple[NDArray[np.float32], FloatArray]:
        """Both with axes (polarisation, depth, ...)."""
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
    )
