"""Raw frames of a scene: one, the frames of a film, or a batch for learning; the step ``capture``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import HDF5_SUFFIXES, file_sha256, fingerprint
from metafab.core.storage.provenance import named_files
from metafab.spec import Scene
from metafab.steps.job import Job, Step, in_folder, no_images

if TYPE_CHECKING:
    from metafab.camera import RawFrame


@dataclass(frozen=True)
class CaptureFigures:
    """Figures of a raw frame."""

    shape: tuple[int, ...]  #: (rows, columns); of a batch, (frames, rows, columns).
    #: Mean number of photons that arrive on all pixels together; of a batch, on those of all frames.
    photons: float


def frame_files(path: Path, frames: int) -> list[Path]:
    """Files of a film's frames: ``path`` of one alone, several have numbers from 1."""
    if frames == 1:
        return [path]
    return [path.with_name(f"{path.stem}_{number:04d}{path.suffix}") for number in range(1, frames + 1)]


@contextmanager
def of_scene_file(path: Path | None, scene: Scene) -> Iterator[None]:
    """Head the InputErrors of a scene, and of the files that it names, by the path of its own file, if there is one."""
    try:
        yield
    except InputError as error:
        named = {str(file) for file in named_files(scene)}
        if path is None or error.source not in {"scene", *named}:
            raise
        source = str(path) if error.source == "scene" else f"{path} -> {error.source}"
        raise InputError(source, error.faults) from error


def capture(
    scene: Scene,
    psf_path: Path,
    path: Path,
    frames: int = 1,
    *,
    scene_path: Path | None = None,
    seed: int | None = None,
    black: int = 0,
    progress: Progress = silent,
) -> Iterator[tuple[RawFrame, Path]]:
    """Simulate the frames of a scene through a stored PSF pair, write each and yield it with its path.

    Several frames get numbers from 1. An ``.h5`` holds electrons and the truth; a TIFF, PNG or NumPy file holds whole
    counts over ``black``, as a camera writes them. ``seed`` of the noise is that of the scene by default. Errors name
    ``scene_path``, the scene's file, if given.
    """
    from metafab import camera, optics

    camera.require_frame_name(path)
    psf, filmed = optics.load(psf_path), replace(scene, frames=frames)
    inputs = fingerprint(scene, frames, seed, file_sha256(psf_path))
    shots = camera.film(filmed, psf, seed=seed, progress=progress)
    for file in frame_files(path, frames):
        with of_scene_file(scene_path, scene):
            frame = next(shots)
        if path.suffix.lower() in HDF5_SUFFIXES:
            camera.save(frame, file, inputs_sha256=inputs)
        else:
            camera.save_counts(frame, file, black=black)
        yield frame, file


def capture_batch(
    scenes: Sequence[tuple[Path, Scene]],
    psf_path: Path,
    path: Path,
    draws: int,
    *,
    seed: int | None = None,
    progress: Progress = silent,
) -> CaptureFigures:
    """Simulate frames of scenes through a stored PSF pair, with textures and noise of their own, into one ``.h5`` file.

    Each scene has ``draws`` frames; ``seed`` is that of the first frame (default: of the first scene), and each next
    frame has the next one. InputError with the scene's file if a scene does not fit the pair, or the fields are unlike;
    nothing is written, and fields and pictures are checked before the first frame.
    """
    from metafab import camera, optics

    for file, scene in scenes[1:]:
        if scene.field_px != scenes[0][1].field_px:
            expected, got = ("{} x {} pixels".format(*one.field_px) for one in (scenes[0][1], scene))
            expected += f", the field of {scenes[0][0].name}"
            raise InputError.single(str(file), "field_px", expected, got, "give all scenes one field")
    start, total = scenes[0][1].seed if seed is None else seed, draws * len(scenes)
    if start + total - 1 > np.iinfo(np.int64).max:
        expected = f"a seed of which the last of {total} is below 2^63, which the file holds"
        raise InputError.single(str(scenes[0][0]), "seed", expected, f"{start}", "start with a smaller one")
    psf, photons = optics.load(psf_path), 0.0
    for file, scene in scenes:
        with of_scene_file(file, scene):
            camera.require_fit(scene, psf)
    shape: tuple[int, ...] = ()

    def frames() -> Iterator[camera.Draw]:
        nonlocal photons, shape
        shots = camera.batch([scene for _, scene in scenes], psf, draws, start)
        for done in range(1, total + 1):
            with of_scene_file(*scenes[(done - 1) // draws]):
                draw = next(shots)
            photons, shape = photons + draw.frame.photons, draw.frame.frame.shape
            progress("capture", done, total)
            yield draw

    inputs = fingerprint([scene for _, scene in scenes], draws, start, file_sha256(psf_path))
    names = [file.name for file, _ in scenes]
    camera.save_batch(frames(), total, names, psf, path, inputs_sha256=inputs)
    return CaptureFigures((total, *shape), photons)


def _capture(job: Job) -> CaptureFigures:
    assert job.design.scene is not None  # The step is not needed without one.
    folder, progress = job.folder, job.work.progress
    ((frame, _),) = capture(job.design.scene, folder / "psf.h5", folder / "raw.h5", progress=progress)
    return CaptureFigures(frame.frame.shape, frame.photons)


CAPTURE = Step(
    name="capture",
    rooms=("optics", "camera"),
    after=("psf",),
    inputs=lambda design: design.scene,
    outputs=in_folder("raw.h5"),
    work=_capture,
    figures=CaptureFigures,
    not_needed=no_images,
)
