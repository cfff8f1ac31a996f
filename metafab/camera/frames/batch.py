"""Training data in one HDF5 file: raw frames of scenes with their truth, their seeds, and the PSF pair."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from metafab.camera.frames.frame import TRUTH_UNITS, RawFrame, put_axes, stored_frame
from metafab.core.errors import InputError
from metafab.core.storage import hdf5
from metafab.optics import store
from metafab.optics.point_spread import Psf

BATCH_KIND = "metafab batch"
BATCH_FORMAT = 1
#: Space that a frame may take on the disk, as a multiple of its arrays before they are deflated.
_ROOM = 2.0


@dataclass(frozen=True)
class Draw:
    """A frame of one of several scenes."""

    scene: int  #: Number of the scene from 0.
    seed: int  #: Seed of its textures and noise.
    frame: RawFrame  #: The frame with its truth.


def save_batch(
    draws: Iterable[Draw], count: int, scenes: Sequence[str], psf: Psf, path: Path, *, inputs_sha256: str = ""
) -> None:
    """Write ``count`` frames of one shape as they come, one in memory at a time; an interrupted write leaves no file.

    ``scenes`` are names, ``psf`` is the pair that made the frames. A frame whose shape or place on the sensor is not
    the first one's raises InputError, a full disk OSError.
    """
    with hdf5.create(
        path, kind=BATCH_KIND, format_version=BATCH_FORMAT, inputs_sha256=inputs_sha256, streamed=True
    ) as file:
        store.put(file.create_group("pair"), psf)
        names = [name.encode() for name in scenes]
        hdf5.put(file, "scene_file", names, units="1", description="file of each scene")
        numbers, first = np.arange(count), None
        hdf5.put(file, "number", numbers, units="1", description="number of the frame", dims=("number",))
        figures = []
        for number, draw in enumerate(draws):
            frame = draw.frame
            if first is None:
                first = frame
                _reserve(file, frame, count)
            elif _place(frame) != _place(first):
                expected = f"frames of one shape and place: shape {first.frame.shape}"
                got = f"shape {frame.frame.shape}"
                raise InputError.single(scenes[draw.scene], "field_px", expected, got, "give all scenes one field")
            hdf5.require_space(path, int(_ROOM * frame.frame.nbytes))
            file["frame"][number] = frame.frame
            for name in TRUTH_UNITS if frame.truth is not None else ():
                file["truth"][name][number] = getattr(frame.truth, name)
            saturation_e = np.nan if frame.saturation_e is None else frame.saturation_e
            figures.append((draw.seed, draw.scene, frame.read_noise_e, saturation_e))
        of_frames = (
            ("seed", "1", "seed of textures and noise"),
            ("scene", "1", "number of the scene in `scene_file` from 0"),
            ("read_noise_e", "e", "standard deviation of the read noise"),
            ("saturation_e", "e", "level at which pixels saturate, NaN for none"),
        )
        for (name, units, about), values in zip(of_frames, zip(*figures, strict=True), strict=True):
            hdf5.put(file, name, values, units=units, description=about, dims=("number",))


def load_draw(path: Path | str, number: int) -> Draw:
    """Read one frame of a batch, numbered from 0.

    A file that is missing, truncated, foreign, newer, or without such a frame raises InputError.
    """
    remedy = "make it with `metafab capture SCENE.toml --psf PSF.h5 --draws N`"
    with hdf5.open_kind(path, kind=BATCH_KIND, format_version=BATCH_FORMAT, remedy=remedy) as file:
        count = file["frame"].shape[0]
        if not 0 <= number < count:
            raise InputError.single(str(path), "number", f"0 to {count - 1}", f"{number}")
        saturation_e = float(file["saturation_e"][number])
        known_e = None if np.isnan(saturation_e) else saturation_e
        frame = stored_frame(file, float(file["read_noise_e"][number]), known_e, number)
        return Draw(int(file["scene"][number]), int(file["seed"][number]), frame)


def _place(frame: RawFrame) -> tuple[object, ...]:
    return frame.frame.shape, frame.origin_um, frame.truth_origin_um, frame.x_window


def _reserve(file: h5py.File, frame: RawFrame, count: int) -> None:
    """Make room for ``count`` frames like the first one.

    Frames and truth are stored in single precision, which is finer than their noise and interpolation.
    """
    if frame.truth is None or frame.truth_origin_um is None or frame.x_window is None:
        raise ValueError("a frame of a batch holds its truth and its window")
    truth = file.create_group("truth")
    for group, origin_um, shape in (
        (file, frame.origin_um, frame.frame.shape),
        (truth, frame.truth_origin_um, frame.truth.depth_m.shape),
    ):
        group.attrs["origin_um"] = origin_um
        put_axes(group, shape, origin_um, frame.pixel_um)
    file.attrs["pixel_um"], file.attrs["x_window"] = frame.pixel_um, frame.x_window
    dims = ("number", "y_um", "x_um")
    whole = (count, *frame.frame.shape)
    hdf5.reserve(file, "frame", whole, np.float32, units="e", description="raw frames", dims=dims)
    for name, (units, about) in TRUTH_UNITS.items():
        shape, dtype = (count, *frame.truth.depth_m.shape), np.int32 if name == "label" else np.float32
        hdf5.reserve(truth, name, shape, dtype, units=units, description=about, dims=dims)
