"""Raw frames -> 4D images, and the calibration of a camera."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metafab.core.files import file_sha256, fingerprint
from metafab.core.progress import Progress, silent
from metafab.run import Job, Step
from metafab.steps.outputs import in_folder, nothing_to_decode

if TYPE_CHECKING:
    from metafab.decode import CameraFit, Image4D


def restore(raw_path: Path, psf_path: Path, path: Path, *, progress: Progress = silent) -> Image4D:
    """Decode a stored raw frame, ours or a camera's, by a stored PSF pair and keep the 4D image."""
    from metafab import camera, decode, optics

    calibration = optics.load(psf_path)
    image = decode.decode(camera.load_frame(raw_path, calibration), calibration, progress=progress)
    decode.save(image, path, inputs_sha256=fingerprint(file_sha256(raw_path), file_sha256(psf_path)))
    return image


def calibrate(frames: Sequence[Path], depths_path: Path, psf_path: Path, path: Path) -> CameraFit:
    """Calibration of a camera from photographs of a point at the depths of a table."""
    from metafab import camera, decode, optics

    predicted = optics.load(psf_path)
    depths_m = decode.read_depths(depths_path, frames)
    calibrated, fit = decode.calibrate([camera.load_frame(f, predicted) for f in frames], depths_m, predicted)
    optics.save(calibrated, path, inputs_sha256=fingerprint(file_sha256(psf_path), *map(file_sha256, frames)))
    return fit


def _decode(job: Job) -> dict[str, Any]:
    folder = job.folder
    image = restore(folder / "raw.h5", folder / "psf.h5", folder / "decoded.h5", progress=job.progress)
    return {"nmae": image.nmae, "segments": image.segments, **image.details}


DECODE = Step(
    "decode", ("optics", "camera", "decode"), ("psf", "capture"),
    lambda d: None, in_folder("decoded.h5"), _decode, nothing_to_decode,
)  # fmt: skip
