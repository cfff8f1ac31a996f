"""A scene photographed through a stored PSF pair."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import HDF5_SUFFIXES, file_sha256, fingerprint
from metafab.spec import Scene
from metafab.steps.job import Job, Step
from metafab.steps.outputs import in_folder, nothing_to_decode

if TYPE_CHECKING:
    from metafab.camera import RawFrame


def expose(
    scene: Scene, psf_path: Path, path: Path, *, seed: int | None = None, progress: Progress = silent
) -> RawFrame:
    """Photograph a scene through a stored PSF pair and keep the raw frame."""
    ((frame, _),) = expose_film(scene, psf_path, path, 1, seed=seed, progress=progress)
    return frame


def expose_film(
    scene: Scene,
    psf_path: Path,
    path: Path,
    frames: int,
    *,
    seed: int | None = None,
    black: int = 0,
    progress: Progress = silent,
) -> Iterator[tuple[RawFrame, Path]]:
    """The frames of a scene, each kept as it comes: in ``path`` itself, or numbered from 1 where they are several.

    In a ``.h5`` with the truth; in a TIFF, PNG or NumPy file in whole counts above ``black``, as a camera writes them.
    """
    from metafab import camera, optics

    camera.require_frame_name(path)
    psf, shown = optics.load(psf_path), replace(scene, frames=frames)
    inputs = fingerprint(scene, frames, seed, file_sha256(psf_path))
    for number, frame in enumerate(camera.film(shown, psf, seed=seed, progress=progress), start=1):
        own = path if frames == 1 else path.with_name(f"{path.stem}_{number:04d}{path.suffix}")
        if path.suffix.lower() in HDF5_SUFFIXES:
            camera.save(frame, own, inputs_sha256=inputs)
        else:
            camera.save_counts(frame, own, black=black)
        yield frame, own


def _capture(job: Job) -> dict[str, Any]:
    assert job.design.scene is not None  # Without one the step has no point.
    frame = expose(job.design.scene, job.folder / "psf.h5", job.folder / "raw.h5", progress=job.progress)
    return {"shape": frame.frame.shape, "photons": float(frame.frame.sum())}


CAPTURE = Step(
    "capture", ("optics", "camera"), ("psf",),
    lambda d: d.scene, in_folder("raw.h5"), _capture, nothing_to_decode,
)  # fmt: skip
