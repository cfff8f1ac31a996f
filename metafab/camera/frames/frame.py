"""A raw frame of the sensor, and the truth of a simulated one; ``raw.h5``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from metafab.core.conventions import FloatArray
from metafab.core.display import Displayed, dataset
from metafab.core.errors import Fault, InputError
from metafab.core.storage import hdf5
from metafab.core.storage.pictures import require_few
from metafab.spec.fields import LARGEST

if TYPE_CHECKING:
    import xarray

RAW_KIND = "metafab raw frame"
RAW_FORMAT = 1
#: Unit and description of each array of a truth.
TRUTH_UNITS = {
    "depth_m": ("m", "object depth, NaN for none"),
    "intensity_x": ("e", "sharp image, x polarisation"),
    "intensity_y": ("e", "sharp image, y polarisation"),
    "label": ("1", "object number from 1, 0 for none"),
}


@dataclass(frozen=True)
class Truth:
    """The result of a perfect decoder, on the geometric image grid of the x polarisation."""

    depth_m: FloatArray  #: Shape (n_y, n_x), NaN where the scene is empty.
    intensity_x: FloatArray  #: Shape (n_y, n_x), mean electrons of x-polarised light.
    intensity_y: FloatArray  #: Shape (n_y, n_x), mean electrons of y-polarised light.
    label: NDArray[np.int32]  #: Shape (n_y, n_x), number of the object from 1, 0 for none.


@dataclass(frozen=True, repr=False)
class RawFrame(Displayed):
    """One exposure.

    Attributes:
        frame: shape (n_y, n_x), electrons (or counts of a real camera).
        pixel_um: pixel pitch.
        origin_um: (x, y) on the sensor plane of the centre of pixel [0, 0].
        read_noise_e: standard deviation of the read noise.
        truth: present for simulated frames.
        truth_origin_um: (x, y) on the sensor plane of the centre of pixel [0, 0] of the truth's grid.
        x_window: (row, column, rows, columns) of the x polarisation's image, where the field stop is known.
        saturation_e: level at which pixels saturate, where it is known.
        saturation_assumed: whether the level was inferred, because many pixels share it exactly.
        photons: mean number of photons that arrive on all pixels together; NaN for a frame that was read, because
            files do not hold it.
    """

    frame: FloatArray
    pixel_um: float
    origin_um: tuple[float, float]
    read_noise_e: float
    truth: Truth | None = None
    truth_origin_um: tuple[float, float] | None = None
    x_window: tuple[int, int, int, int] | None = None
    saturation_e: float | None = None
    saturation_assumed: bool = False
    photons: float = math.nan

    @property
    def holds_window(self) -> bool:
        """Whether ``x_window`` lies in the frame, or is not known."""
        if self.x_window is None or self.frame.ndim != 2:
            return True
        row, column, rows, columns = self.x_window
        n_y, n_x = self.frame.shape
        return min(row, column) >= 0 and min(rows, columns) > 0 and row + rows <= n_y and column + columns <= n_x

    def key_figures(self) -> dict[str, str]:
        """Size, pixel and mean signal."""
        return {
            "pixels": " x ".join(str(count) for count in self.frame.shape),
            "pixel": f"{self.pixel_um:g} um",
            "mean": f"{self.frame.mean():.4g} electrons",
        }

    def to_xarray(self) -> xarray.Dataset:
        """The frame over (y_um, x_um) on the sensor; MissingToolError without xarray."""
        axes = pixel_axes(self.frame.shape, self.origin_um, self.pixel_um)
        return dataset({"frame": (tuple(axes), self.frame, "electron")}, axes)


def pixel_axes(shape: tuple[int, ...], origin_um: tuple[float, float], pixel_um: float) -> dict[str, FloatArray]:
    """Places on the sensor of the rows, ``y_um``, and columns, ``x_um``, of a picture of shape (n_y, n_x)."""
    starts = {"y_um": (origin_um[1], shape[0]), "x_um": (origin_um[0], shape[1])}
    return {name: np.asarray(start + pixel_um * np.arange(count)) for name, (start, count) in starts.items()}


def save(frame: RawFrame, path: Path | str, *, inputs_sha256: str = "") -> None:
    """Write a frame; an interrupted write leaves no file."""
    with hdf5.create(path, kind=RAW_KIND, format_version=RAW_FORMAT, inputs_sha256=inputs_sha256) as file:
        put_axes(file, frame.frame.shape, frame.origin_um, frame.pixel_um)
        _image(file, "frame", frame.frame, "e", "raw frame (electrons, or counts of a camera)")
        file.attrs["pixel_um"] = frame.pixel_um
        file.attrs["origin_um"] = frame.origin_um
        file.attrs["read_noise_e"] = frame.read_noise_e
        if frame.x_window is not None:
            file.attrs["x_window"] = frame.x_window
        if frame.saturation_e is not None:
            file.attrs["saturation_e"] = frame.saturation_e
            file.attrs["saturation_assumed"] = frame.saturation_assumed
        if frame.truth is None or frame.truth_origin_um is None:
            return
        group = file.create_group("truth")
        group.attrs["origin_um"] = frame.truth_origin_um
        truth = frame.truth
        put_axes(group, truth.depth_m.shape, frame.truth_origin_um, frame.pixel_um)
        for name, (units, description) in TRUTH_UNITS.items():
            _image(group, name, getattr(truth, name), units, description)


def load(path: Path | str) -> RawFrame:
    """Read a frame; InputError if the file is missing, truncated, foreign or of a newer format."""
    remedy = "make it with `metafab capture SCENE.toml --psf PSF.h5`"
    with hdf5.open_kind(path, kind=RAW_KIND, format_version=RAW_FORMAT, remedy=remedy) as file:
        saturation = file.attrs.get("saturation_e")
        frame = stored_frame(file, float(file.attrs["read_noise_e"]), None if saturation is None else float(saturation))
    if faults := _faults(frame):
        raise InputError(str(path), faults)
    return frame


def stored_frame(
    file: h5py.File, read_noise_e: float, saturation_e: float | None, number: int | EllipsisType = ...
) -> RawFrame:
    """Return the frame of a file and its truth, or that of a ``number`` in a file of several."""
    truth, truth_origin_um, window = None, None, file.attrs.get("x_window")
    named = [file["frame"], *(file["truth"][name] for name in TRUTH_UNITS if "truth" in file)]
    require_few(Path(file.filename), sum(math.prod(dataset.shape[-2:]) for dataset in named))
    if "truth" in file:
        group = file["truth"]
        arrays = {name: group[name][number] for name in TRUTH_UNITS}
        floats = {name: values.astype(np.float64) for name, values in arrays.items() if name != "label"}
        truth = Truth(**floats, label=arrays["label"].astype(np.int32))
        truth_origin_um = _pair(group.attrs["origin_um"])
    return RawFrame(
        file["frame"][number].astype(np.float64),
        float(file.attrs["pixel_um"]),
        _pair(file.attrs["origin_um"]),
        read_noise_e,
        truth,
        truth_origin_um,
        None if window is None else (int(window[0]), int(window[1]), int(window[2]), int(window[3])),
        saturation_e,
        bool(file.attrs.get("saturation_assumed", False)),
    )


def _faults(frame: RawFrame) -> list[Fault]:
    """Faults of the attributes and shapes of a stored frame."""
    faults = []
    if frame.frame.ndim != 2:
        faults.append(Fault("frame", "rows and columns", f"an array of shape {frame.frame.shape}"))
    if not 0.0 < frame.pixel_um < np.inf:
        faults.append(Fault("pixel_um", "a pitch above zero", f"{frame.pixel_um:g}"))
    if not 0.0 <= frame.read_noise_e < np.inf:
        faults.append(Fault("read_noise_e", "electrons, not below zero", f"{frame.read_noise_e:g}"))
    if frame.saturation_e is not None and not frame.saturation_e > 0.0:
        faults.append(Fault("saturation_e", "electrons above zero", f"{frame.saturation_e:g}"))
    for name, origin_um in (("origin_um", frame.origin_um), ("truth/origin_um", frame.truth_origin_um or (0.0, 0.0))):
        if not np.abs(origin_um).max() < LARGEST:
            faults.append(Fault(name, "a place on the sensor", f"{origin_um}"))
    if not frame.holds_window:
        faults.append(Fault("x_window", f"a window in a frame of shape {frame.frame.shape}", f"{frame.x_window}"))
    if frame.truth is not None and len({part.shape for part in vars(frame.truth).values()}) > 1:
        shapes = ", ".join(str(part.shape) for part in vars(frame.truth).values())
        faults.append(Fault("truth", "arrays of one shape", shapes))
    return faults


def put_axes(group: h5py.Group, shape: tuple[int, ...], origin_um: tuple[float, float], pixel_um: float) -> None:
    """Write the places of the columns and rows of a picture (n_y, n_x) as the scales ``x_um`` and ``y_um``."""
    for name, place in pixel_axes(shape, origin_um, pixel_um).items():
        hdf5.put(group, name, place, units="um", description=f"{name[0]} on the sensor plane", dims=(name,))


def _image(group: h5py.Group, name: str, values: ArrayLike, units: str, description: str) -> None:
    hdf5.put(group, name, values, units=units, description=description, dims=("y_um", "x_um"), compress=True)


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])
