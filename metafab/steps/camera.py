"""A scene photographed through a stored PSF pair."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from metafab.core.files import file_sha256, fingerprint
from metafab.core.progress import Progress, silent
from metafab.run import Job, Step
from metafab.spec import Scene
from metafab.steps.outputs import in_folder, nothing_to_decode

if TYPE_CHECKING:
    from metafab.camera import RawFrame


def expose(
    scene: Scene, psf_path: Path, path: Path, *, seed: int | None = None, progress: Progress = silent
) -> RawFrame:
    """Photograph a scene through a stored PSF pair and keep the raw frame."""
    from metafab import camera, optics

    frame = camera.capture(scene, optics.load(psf_path), seed=seed, progress=progress)
    camera.save(frame, path, inputs_sha256=fingerprint(scene, seed, file_sha256(psf_path)))
    return frame


def _capture(job: Job) -> dict[str, Any]:
    assert job.design.scene is not None  # Without one the step has no point.
    frame = expose(job.design.scene, job.folder / "psf.h5", job.folder / "raw.h5", progress=job.progress)
    return {"shape": frame.frame.shape, "photons": float(frame.frame.sum())}


CAPTURE = Step(
    "capture", ("optics", "camera"), ("psf",),
    lambda d: d.scene, in_folder("raw.h5"), _capture, nothing_to_decode,
)  # fmt: skip
