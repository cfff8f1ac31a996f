"""Raw frames -> 4D images, and the calibration of a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import file_sha256, fingerprint
from metafab.spec.fields import LARGEST
from metafab.steps.job import Job, Step
from metafab.steps.outputs import in_folder, nothing_to_decode

if TYPE_CHECKING:
    from metafab.camera import Counts, RawFrame
    from metafab.decode import CameraFit, Image4D


def restore(
    raw_path: Path,
    psf_path: Path,
    path: Path,
    *,
    unfit: Literal["refuse", "empty"] = "refuse",
    counts: Counts | None = None,
    progress: Progress = silent,
) -> Image4D:
    """Decode a stored raw frame, ours or a camera's, by a stored PSF pair and keep the 4D image.

    Args:
        raw_path: the frame.
        psf_path: the pair.
        path: where the image goes.
        unfit: what becomes of a frame that cannot be decoded: refused, or an empty image with the reason. A dark one
            can always be decoded, to an empty image.
        counts: what the numbers of a camera's own file mean; electrons by default.
        progress: called after each candidate depth.

    Raises:
        InputError: a file cannot be read, or the frame is refused; nothing is written or replaced.
    """
    from metafab import camera, decode, optics

    calibration = optics.load(psf_path)
    frame = camera.load_frame(raw_path, calibration, counts=counts or camera.Counts())
    if unfit == "refuse" and (fault := _unfit(frame.frame)) is not None:
        raise InputError(str(raw_path), [fault])
    image = decode.decode(frame, calibration, progress=progress)
    reason = image.figures.reason or decode.NO_LIGHT
    if unfit == "refuse" and reason != decode.NO_LIGHT:
        raise InputError.single(str(raw_path), "frame", "one that can be decoded", reason, "is it this camera's?")
    if frame.saturation_assumed:
        image = _warned(image, full_pixels(frame))
    decode.save(image, path, inputs_sha256=fingerprint(file_sha256(raw_path), file_sha256(psf_path)))
    return image


def full_pixels(frame: RawFrame) -> str:
    """What to say of a frame whose white level was taken from its own pixels."""
    full = int((frame.frame == frame.saturation_e).sum())
    return (
        f"{full} pixels share exactly the largest value: taken as saturated; give the camera's white level "
        "(`--white COUNTS`)"
    )


def _warned(image: Image4D, sentence: str) -> Image4D:
    """With one more warning."""
    before = image.figures.warning
    return replace(image, figures=replace(image.figures, warning=f"{before}; {sentence}" if before else sentence))


def _unfit(values: FloatArray) -> Fault | None:
    """What no exposure leaves in a frame."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return Fault("frame", "electrons or counts", "no finite number", "was the file written whole?")
    if finite.max() < 0.0:
        return Fault("frame", "electrons or counts, some of them not below zero", f"at most {finite.max():g}")
    if finite.max() > LARGEST:
        return Fault("frame", f"electrons or counts up to {LARGEST:g}", f"{finite.max():g}")
    return None


def calibrate(
    frames: Sequence[Path], depths_path: Path, psf_path: Path, path: Path, *, counts: Counts | None = None
) -> CameraFit:
    """Calibration of a camera from photographs of a point at the depths of a table."""
    from metafab import camera, decode, optics

    predicted = optics.load(psf_path)
    depths_m = decode.read_depths(depths_path, frames)
    meant = counts or camera.Counts()
    pictures = [camera.load_frame(file, predicted, counts=meant) for file in frames]
    calibrated, fit = decode.calibrate(pictures, depths_m, predicted)
    optics.save(calibrated, path, inputs_sha256=fingerprint(file_sha256(psf_path), *map(file_sha256, frames)))
    return fit


def _decode(job: Job) -> dict[str, Any]:
    folder = job.folder
    image = restore(folder / "raw.h5", folder / "psf.h5", folder / "decoded.h5", unfit="empty", progress=job.progress)
    return {"nmae": image.nmae, "segments": image.segments, **image.figures.known()}


DECODE = Step(
    "decode", ("information", "optics", "camera", "decode"), ("psf", "capture"),
    lambda d: None, in_folder("decoded.h5"), _decode, nothing_to_decode,
)  # fmt: skip
