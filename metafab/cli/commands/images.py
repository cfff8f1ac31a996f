"""Commands ``capture``, ``film``, ``decode`` and ``calibrate``: raw frames and the images decoded from them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from metafab.cli.app import Json, app, require_finite, require_positive
from metafab.cli.console import announce, open_work, show
from metafab.cli.outputs import NamedHdf5Output, NamedOutput, Output, require_file_output, require_hdf5_name
from metafab.core.errors import InputError
from metafab.core.storage.tables import optional

if TYPE_CHECKING:
    from metafab.camera import Counts

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE.toml", help="Scene file, or a design with a scene.")]
PsfOption = Annotated[Path, typer.Option("--psf", metavar="PSF.h5", help="PSF pair over depth.")]
Seed = Annotated[int | None, typer.Option(min=0, help="Seed of the noise [default: the scene's].")]
Black = Annotated[
    float, typer.Option("--black", metavar="COUNTS", help="Black level of the camera [for its own files].")
]
Gain = Annotated[
    float, typer.Option("--electrons-per-count", metavar="E", help="Gain of the camera [for its own files].")
]
ReadNoise = Annotated[
    float, typer.Option("--read-noise-e", min=0.0, metavar="E", help="Read noise of the camera [for its own files].")
]
White = Annotated[
    float | None,
    typer.Option("--white", metavar="COUNTS", help="White level of the camera [default: the largest value]."),
]


@dataclass(frozen=True)
class CaptureAnswer:
    """Written frames, as ``metafab capture --json`` prints them; of files in counts with their :class:`Counts`."""

    shape: tuple[int, ...]  #: Rows and columns of a frame; of a batch, frames before them.
    #: Mean number of photons that arrive on all pixels together; of a batch, on those of all frames; one value for each
    #: frame of a film.
    photons: float | list[float]
    seconds: float  #: Time of the command.
    #: Path of a single frame or of a batch; ``files``: paths of the frames of a film. One of them is None.
    file: Path | None = optional()
    files: list[Path] | None = optional()


def _counts(black: float, gain: float, read_noise_e: float, white: float | None) -> Counts:
    """Check the options of a camera that counts."""
    from metafab.camera import Counts

    require_finite("--black", black)
    require_positive("--electrons-per-count", gain)
    require_finite("--read-noise-e", read_noise_e)
    require_finite("--white", white)
    if white is not None and white <= black:
        raise InputError.single("--white", "value", f"more than the black level, {black:g} counts", f"{white:g}")
    return Counts(black, gain, read_noise_e, white)


@app.command("capture")
def capture_command(
    scenes: Annotated[
        list[Path], typer.Argument(metavar="SCENE.toml...", help="Scene file, or a design with a scene.")
    ],
    psf: PsfOption,
    output: Output = None,
    seed: Seed = None,
    frames: Annotated[int, typer.Option(min=1, metavar="N", help="Frames of a film, in files numbered from 1.")] = 1,
    draws: Annotated[
        int | None,
        typer.Option(
            min=1, max=1_000_000, metavar="N", help="Frames of each scene, of successive seeds, with truth in one .h5."
        ),
    ] = None,
    black: Annotated[
        int, typer.Option(min=0, max=32767, metavar="COUNTS", help="Black level [for .tif, .png and .npy].")
    ] = 0,
    json_: Json = False,
) -> None:
    """Simulate the raw frame of a scene, the frames of a film, or a batch of frames for learning.

    A frame is an .h5 with its truth, or counts in .tif, .png or .npy.
    """
    from metafab.core.storage.files import HDF5_SUFFIXES

    path = output or Path("raw.h5" if draws is None else "batch.h5")
    in_counts = path.suffix.lower() not in HDF5_SUFFIXES
    if black and not in_counts:
        expected = "a .tif, .png or .npy file, whose counts have a black level"
        raise InputError.single("capture", "--black", expected, f"{path.name}, in electrons", "leave it out")
    if draws is not None:
        require_hdf5_name(path)
        if frames > 1:
            expected, remedy = "a film (`--frames`) or a batch (`--draws`)", "leave one of them out"
            raise InputError.single("capture", "--draws", expected, "both", remedy)
        show(_batch(scenes, psf, path, draws, seed), json_)
        return
    if len(scenes) > 1:
        raise InputError.single("capture", "SCENE", "one scene", f"{len(scenes)}", "add `--draws N` for a batch")
    answer, counts = _frames(scenes[0], psf, path, frames, seed, black if in_counts else None)
    # The options that `decode` needs to read files in counts.
    show(answer, json_, **({} if counts is None else vars(counts)))


def _batch(scenes: list[Path], psf: Path, path: Path, draws: int, seed: int | None) -> CaptureAnswer:
    """Write a batch of frames of scenes."""
    from metafab.core.storage.provenance import named_files
    from metafab.spec import load_scene
    from metafab.steps.images import capture_batch

    with open_work() as (work, cost):
        pairs = [(scene, load_scene(scene)) for scene in scenes]
        require_file_output(path, [*scenes, psf, *named_files([scene for _, scene in pairs])])
        batch = capture_batch(pairs, psf, path, draws, seed=seed, progress=work.progress)
    return CaptureAnswer(shape=batch.shape, photons=batch.photons, seconds=cost.seconds, file=path)


def _frames(
    scene_path: Path, psf: Path, path: Path, frames: int, seed: int | None, black: int | None
) -> tuple[CaptureAnswer, Counts | None]:
    """Write the frames of a scene: in counts over a ``black`` level, with their meaning, or in electrons (None)."""
    from metafab.camera import counts_of
    from metafab.camera.frames.foreign import counted_shape
    from metafab.core.storage.provenance import named_files
    from metafab.spec import load_scene
    from metafab.steps.images import capture, frame_files

    photons: list[float] = []
    files: list[Path] = []
    shape: tuple[int, ...] = ()
    counts: Counts | None = None
    scene = load_scene(scene_path)
    for file in frame_files(path, frames):
        require_file_output(file, [scene_path, psf, *named_files(scene)])
    with open_work() as (work, cost):
        for frame, file in capture(
            scene, psf, path, frames, scene_path=scene_path, seed=seed, black=black or 0, progress=work.progress
        ):
            counts = None if black is None else counts_of(frame, black=black)
            shape = frame.frame.shape if black is None else counted_shape(frame)
            photons.append(frame.photons)
            files.append(file)
    answer = CaptureAnswer(
        shape=shape,
        photons=photons[0] if frames == 1 else photons,
        seconds=cost.seconds,
        file=files[0] if frames == 1 else None,
        files=None if frames == 1 else files,
    )
    return answer, counts


@app.command("film")
def film_command(
    scene: SceneFile,
    psf: PsfOption,
    output: NamedOutput = Path("film.gif"),
    frames: Annotated[int | None, typer.Option(min=1, metavar="N", help="Frames [default: the scene's].")] = None,
    seed: Seed = None,
    json_: Json = False,
) -> None:
    """Simulate, decode and draw a film of a moving scene: .gif, or .mp4 with ffmpeg."""
    from metafab import report
    from metafab.core.storage.provenance import named_files
    from metafab.spec import load_scene
    from metafab.steps.images import FilmFigures, decoded_film

    report.require_film_name(output)
    moving = load_scene(scene)
    require_file_output(output, named_files(moving))
    with open_work() as (work, cost):
        film = list(decoded_film(moving, psf, frames, scene_path=scene, seed=seed, progress=work.progress))
        report.write_film(film, output, frame_interval_s=moving.frame_interval_s)
    show(FilmFigures.of(film), json_, seconds=cost.seconds, file=output)


@app.command("decode")
def decode_command(
    raw: Annotated[Path, typer.Argument(metavar="RAW", help="Raw frame: .h5, .tif, .png or .npy.")],
    psf: PsfOption,
    output: NamedHdf5Output = Path("decoded.h5"),
    black: Black = 0.0,
    electrons_per_count: Gain = 1.0,
    read_noise_e: ReadNoise = 0.0,
    white: White = None,
    fast: Annotated[bool, typer.Option("--fast", help="Faster: segments and their outlines are not refined.")] = False,
    json_: Json = False,
) -> None:
    """Decode a raw frame to a 4D image: both intensities, contrast and depth."""
    from metafab.core.storage.files import plain
    from metafab.steps.images import DecodeFigures, decode_file

    with open_work() as (work, _):
        from metafab.decode import FAST

        counts = _counts(black, electrons_per_count, read_noise_e, white)
        image = decode_file(raw, psf, output, counts=counts, numerics=FAST if fast else None, progress=work.progress)
        figures = DecodeFigures.of(image)
    if figures.reason is not None:
        announce([f"{raw}: {figures.reason}; the image is empty"])
    if figures.warning is not None:
        announce([f"{raw}: {figures.warning}"])
    table = plain(figures)
    if figures.nmae is None:
        del table["nmae"]  # Without truth, the answer has no error.
    show(table, json_, file=output)


@app.command("calibrate")
def calibrate_command(
    frames: Annotated[
        list[Path], typer.Argument(metavar="FRAMES...", help="Frames of a point on the axis: .h5, .tif, .png, .npy.")
    ],
    psf: Annotated[Path, typer.Option("--psf", metavar="PSF.h5", help="PSF pair predicted from the mask.")],
    depths: Annotated[Path, typer.Option("--depths", metavar="DEPTHS.csv", help="Lines `frame, depth in m`.")],
    output: NamedHdf5Output = Path("calibrated.h5"),
    black: Black = 0.0,
    electrons_per_count: Gain = 1.0,
    read_noise_e: ReadNoise = 0.0,
    white: White = None,
    json_: Json = False,
) -> None:
    """Calibrate a camera from photographs of a point source at known depths."""
    from metafab import decode
    from metafab.steps.images import calibrate

    counts = _counts(black, electrons_per_count, read_noise_e, white)
    fit = calibrate(frames, depths, psf, output, counts=counts)
    announce([f"not told apart: {decode.NOT_SEPARATED}"])
    show(fit, json_, not_separated=decode.NOT_SEPARATED, frames=len(frames), file=output)
