"""Raw frames of a scene, the 4D images decoded from them, films, and the calibration of a camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.figures import DecodingFigures, SegmentFigures
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import HDF5_SUFFIXES, file_sha256, fingerprint
from metafab.core.storage.provenance import named_files
from metafab.spec import Scene
from metafab.spec.fields import LARGEST
from metafab.steps.job import Job, Step, in_folder, no_images

if TYPE_CHECKING:
    from metafab.camera import Counts, RawFrame
    from metafab.decode import CameraFit, DecoderNumerics, Image4D


#: Share of a camera's pixels far below its black level from which the level is called too high.
_MOST_BELOW_BLACK = 0.01


@dataclass(frozen=True)
class CaptureFigures:
    """Figures of a raw frame."""

    shape: tuple[int, ...]  #: (rows, columns); of a batch, (frames, rows, columns).
    #: Mean number of photons that arrive on all pixels together; of a batch, on those of all frames.
    photons: float


@dataclass(frozen=True)
class DepthFigures:
    """Error of the decoded depth, and the decoded segments."""

    #: Mean |depth error| / depth over pixels, with the depths of their segments; None without truth.
    nmae: float | None
    segments: tuple[SegmentFigures, ...]  #: Depth and contrast of each segment.


@dataclass(frozen=True)
class DecodeFigures(DecodingFigures, DepthFigures):
    """All figures of a decoded image; those of depth come first, as dataclass fields start with the last base."""

    @classmethod
    def of(cls, image: Image4D) -> DecodeFigures:
        """Figures of a decoded image."""
        return cls(image.nmae, image.segments, **vars(image.figures))


@dataclass(frozen=True)
class FilmFigures:
    """Errors and times of a decoded film, one entry for each frame; None where a frame has no truth."""

    frames: int  #: Number of frames.
    #: Mean |depth error| / depth; this and the following are those of :class:`DecodeFigures`.
    nmae: tuple[float | None, ...]
    nmae_pixel: tuple[float | None, ...]
    object_error: tuple[float | None, ...]
    worst_object_error: tuple[float | None, ...]
    contrast_error: tuple[float | None, ...]
    share_decoded: tuple[float | None, ...]
    changed_share: tuple[float | None, ...]
    objects: tuple[dict[int, float], ...]  #: Relative depth error of each object, by its number.
    decode_seconds: tuple[float | None, ...]  #: Time of decoding.

    @classmethod
    def of(cls, film: Sequence[tuple[RawFrame, Image4D]]) -> FilmFigures:
        """Figures of a film of raw and decoded frames."""
        from metafab.decode import object_errors

        frames = [DecodeFigures.of(image) for _, image in film]
        return cls(
            frames=len(frames),
            nmae=tuple(frame.nmae for frame in frames),
            nmae_pixel=tuple(frame.nmae_pixel for frame in frames),
            object_error=tuple(frame.object_error for frame in frames),
            worst_object_error=tuple(frame.worst_object_error for frame in frames),
            contrast_error=tuple(frame.contrast_error for frame in frames),
            share_decoded=tuple(frame.share_decoded for frame in frames),
            changed_share=tuple(frame.changed_share for frame in frames),
            objects=tuple(object_errors(image, raw) for raw, image in film),
            decode_seconds=tuple(frame.seconds for frame in frames),
        )


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
            photons, shape = photons + (draw.frame.photons or 0.0), draw.frame.frame.shape
            progress("capture", done, total)
            yield draw

    inputs = fingerprint([scene for _, scene in scenes], draws, start, file_sha256(psf_path))
    names = [file.name for file, _ in scenes]
    camera.save_batch(frames(), total, names, psf, path, inputs_sha256=inputs)
    return CaptureFigures((total, *shape), photons)


def decode_file(
    raw_path: Path,
    psf_path: Path,
    path: Path,
    *,
    unfit: Literal["refuse", "empty"] = "refuse",
    counts: Counts | None = None,
    numerics: DecoderNumerics | None = None,
    progress: Progress = silent,
) -> Image4D:
    """Decode a stored raw frame, simulated or from a camera, with a stored PSF pair, and write the 4D image.

    Args:
        unfit: treatment of a frame that cannot be decoded: "refuse" raises an error, "empty" writes an empty image with
            the reason. A dark frame gives an empty image in both cases.
        counts: meaning of the counts in a camera's own file; electrons by default.

    Raises:
        InputError: a file cannot be read, or the frame is refused; nothing is written or replaced.
    """
    from metafab import camera, decode, optics

    calibration = optics.load(psf_path)
    frame = camera.load_frame(raw_path, calibration, counts=counts or camera.Counts())
    if unfit == "refuse" and (fault := _unfit(frame.frame)) is not None:
        raise InputError(str(raw_path), [fault])
    warnings: list[str] = []
    if raw_path.suffix.lower() not in HDF5_SUFFIXES:
        frame, warnings = _without_defects(frame)
    image = decode.decode(frame, calibration, numerics=numerics, progress=progress)
    reason = image.figures.reason or decode.NO_LIGHT
    if unfit == "refuse" and reason != decode.NO_LIGHT:
        raise InputError.single(str(raw_path), "frame", "one that can be decoded", reason, "is it this camera's?")
    if frame.saturation_assumed:
        warnings.append(_assumed_saturation(frame))
    for warning in warnings:
        image = _with_warning(image, warning)
    decode.save(image, path, inputs_sha256=fingerprint(file_sha256(raw_path), file_sha256(psf_path)))
    return image


def _without_defects(frame: RawFrame) -> tuple[RawFrame, list[str]]:
    """A camera's frame whose dead pixels hold no datum, and sentences about them and about its black level."""
    from metafab.camera.frames.defects import dead_pixels, share_below_black

    if (share := share_below_black(frame.frame, frame.read_noise_e)) > _MOST_BELOW_BLACK:
        return frame, [
            f"{100.0 * share:.2g} % of the pixels lie far below the black level: contrast and depth are wrong where it "
            "is too high; give a lower one (`--black COUNTS`), or the camera's read noise (`--read-noise-e E`)"
        ]
    dead = dead_pixels(frame.frame, frame.read_noise_e)
    if dead.has_pattern:
        return frame, [
            "many pixels are dark between bright ones: a mosaic of colours or polarisers, or interlaced rows? Decode a "
            "frame of one colour and polariser"
        ]
    if not (count := int(dead.where.sum())):
        return frame, []
    noun = "dead pixel is" if count == 1 else "dead pixels are"
    sentence = f"{count} {noun} left out: no light between bright pixels on all sides, or all along a row or column"
    return replace(frame, frame=np.where(dead.where, np.nan, frame.frame)), [sentence]


def _assumed_saturation(frame: RawFrame) -> str:
    """Warning for a frame whose white level was inferred from its own pixels."""
    full = int((frame.frame == frame.saturation_e).sum())
    return (
        f"{full} pixels share exactly the largest value: taken as saturated; give the camera's white level "
        "(`--white COUNTS`)"
    )


def _with_warning(image: Image4D, sentence: str) -> Image4D:
    earlier = image.figures.warning
    return replace(image, figures=replace(image.figures, warning=f"{earlier}; {sentence}" if earlier else sentence))


def _unfit(values: FloatArray) -> Fault | None:
    """Fault of pixel values that no exposure produces."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return Fault("frame", "electrons or counts", "no finite number", "was the file written whole?")
    if finite.max() < 0.0:
        return Fault("frame", "electrons or counts, some of them not below zero", f"at most {finite.max():g}")
    if finite.max() > LARGEST:
        return Fault("frame", f"electrons or counts up to {LARGEST:g}", f"{finite.max():g}")
    return None


def decoded_film(
    scene: Scene,
    psf_path: Path,
    frames: int | None,
    *,
    scene_path: Path | None = None,
    seed: int | None = None,
    progress: Progress = silent,
) -> Iterator[tuple[RawFrame, Image4D]]:
    """Simulate and decode the frames of a moving scene one by one; unchanged regions are decoded once.

    One pair serves exposure and decoding. Number of frames and seed of textures and noise are those of the scene by
    default. InputError if the pair does not suit the scene, or its frames do not hold both images; it names
    ``scene_path``, the scene's file, if given.
    """
    from metafab import camera, decode, optics

    pair = optics.load(psf_path)
    filmed = scene if frames is None else replace(scene, frames=frames)
    decoder = None
    shots = camera.film(filmed, pair, seed=seed, progress=progress)
    for _ in range(filmed.frames):
        with of_scene_file(scene_path, scene):
            raw = next(shots)
        if decoder is None:
            still = decode.Decoder.of(pair, raw.frame.shape, raw.origin_um, raw.x_window)
            if still is None:
                expected, got = "a calibration of a camera that shows both images", "one that does not"
                remedy = "calibrate the pair over the field"
                raise InputError.single(str(psf_path), "psf", expected, got, remedy)
            decoder = decode.VideoDecoder(still)
        yield raw, decoder(raw)


def calibrate(
    frames: Sequence[Path], depths_path: Path, psf_path: Path, path: Path, *, counts: Counts | None = None
) -> CameraFit:
    """Calibrate a camera from photographs of a point source at known depths, and write its PSF pair.

    Args:
        depths_path: CSV table with the depth of each photograph.
        psf_path: PSF pair predicted from the mask.
        path: file of the calibrated pair.
        counts: meaning of the counts in the camera's own files; electrons by default.

    Returns:
        The fitted parameters of the camera.
    """
    from metafab import camera, decode, optics

    predicted = optics.load(psf_path)
    depths_m = decode.read_depths(depths_path, frames)
    meaning = counts or camera.Counts()
    pictures = [camera.load_frame(file, predicted, counts=meaning) for file in frames]
    calibrated, fit = decode.calibrate(pictures, depths_m, predicted)
    optics.save(calibrated, path, inputs_sha256=fingerprint(file_sha256(psf_path), *map(file_sha256, frames)))
    return fit


def _capture(job: Job) -> CaptureFigures:
    assert job.design.scene is not None  # The step is not needed without one.
    folder, progress = job.folder, job.work.progress
    ((frame, _),) = capture(job.design.scene, folder / "psf.h5", folder / "raw.h5", progress=progress)
    return CaptureFigures(frame.frame.shape, frame.photons or 0.0)


def _decode(job: Job) -> DecodeFigures:
    from metafab.decode import DecoderNumerics

    raw, psf, decoded = (job.folder / name for name in ("raw.h5", "psf.h5", "decoded.h5"))
    numerics = DecoderNumerics(step_px=None if job.skips else 1)
    image = decode_file(raw, psf, decoded, unfit="empty", numerics=numerics, progress=job.work.progress)
    return replace(DecodeFigures.of(image), seconds=None)


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

DECODE = Step(
    name="decode",
    rooms=("information", "optics", "camera", "decode"),
    after=("psf", "capture"),
    inputs=lambda design: None,
    outputs=in_folder("decoded.h5"),
    work=_decode,
    figures=DecodeFigures,
    not_needed=no_images,
)
