"""Table ``[rgbd]`` of a scene: a picture with its depth, and the checks of its files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.storage.pictures import read_counts
from metafab.spec.fields import LARGEST, Positive, spec

_ONE_SHAPE = "give all files of `[rgbd]` one shape"


def _near_and_far(value: Any) -> Any:
    """The value of ``depth_range_m``; ValueError with one sentence for whatever is wrong with it."""
    pair = value if isinstance(value, list | tuple) else ()
    numbers = [each for each in pair if isinstance(each, int | float) and not isinstance(each, bool)]
    if not (len(pair) == len(numbers) == 2 and 0.0 < numbers[0] < numbers[1] <= LARGEST):
        raise ValueError(f"must be [near, far], two depths in m with 0 < near < far <= {LARGEST:g}")
    return value


class RgbdArrays(NamedTuple):
    """The pictures of a table ``[rgbd]``, of one shape (n_y, n_x), top row first."""

    light: FloatArray  #: Finite, not below zero, not zero everywhere.
    depth_m: FloatArray  #: NaN where the depth is unknown.
    contrast: FloatArray  #: I_x / I_y, above zero.


@spec()
class Rgbd:
    """A picture with its depth, which fills the field (table ``[rgbd]`` of a scene file).

    All files have one shape. Integer depths need ``depth_range_m``, and 0 marks their unknown pixels.
    """

    image_file: Path  #: Brightness: .png, .tif, .npy or .npz; colours are averaged.
    depth_file: Path  #: Depth, NaN or infinite where it is unknown: .npy, .npz, .tif, .png.
    contrast_file: Path | None = None  #: I_x / I_y of each pixel; 1 without the key.
    #: [near, far] that the file's depths are scaled into.
    depth_range_m: Annotated[tuple[Positive, Positive], BeforeValidator(_near_and_far)] | None = None

    def depths_m(self) -> FloatArray:
        """Depths of the file, shape (n_y, n_x), top row first; NaN where they are unknown.

        A file of the table that is missing (all of them are named), one that cannot be read, or whose depths make no
        sense, raises InputError.
        """
        self._require_files()
        return self._depths_m()

    def arrays(self) -> RgbdArrays:
        """Read all files; InputError with the faults of all of them if one cannot be read, or they do not fit."""
        self._require_files()
        readers = {"image_file": self._light, "depth_file": self._depths_m}
        if self.contrast_file is not None:
            readers["contrast_file"] = self._contrast
        found: dict[str, FloatArray] = {}
        errors: list[InputError] = []
        for key, read in readers.items():
            try:
                found[key] = read()
            except InputError as error:
                errors.append(error)
        errors += self._unlike(found)
        if errors:
            raise _joined(errors)
        light = found["image_file"]
        return RgbdArrays(light, found["depth_file"], found.get("contrast_file", np.ones(light.shape)))

    def _require_files(self) -> None:
        named = {"image_file": self.image_file, "depth_file": self.depth_file, "contrast_file": self.contrast_file}
        faults = []
        for key, path in named.items():
            if path is not None and not path.is_file():
                got = f"a folder, {path}" if path.is_dir() else f"none at {path}"
                faults.append(Fault(f"rgbd.{key}", "a file", got, "check the path"))
        if faults:
            raise InputError("scene", faults)

    def _unlike(self, found: dict[str, FloatArray]) -> Iterator[InputError]:
        """One error for each file whose shape is not that of the light."""
        if (light := found.get("image_file")) is None:
            return
        for key, values in found.items():
            if values.shape != light.shape:
                expected = f"shape {light.shape}, that of {self.image_file.name}"
                yield InputError.single(str(getattr(self, key)), f"rgbd.{key}", expected, f"{values.shape}", _ONE_SHAPE)

    def _light(self) -> FloatArray:
        values, _ = _read(self.image_file, "rgbd.image_file", colours=True)
        sound = np.isfinite(values) & (values >= 0.0)
        if not sound.all() or values.max() <= 0.0:
            expected, got = "finite light, not below zero, and some above", _unsound(values, sound)
            remedy = "give a picture with light" if sound.all() else "set such pixels to 0"
            raise InputError.single(str(self.image_file), "rgbd.image_file", expected, got, remedy)
        return values

    def _contrast(self) -> FloatArray:
        assert self.contrast_file is not None
        values, _ = _read(self.contrast_file, "rgbd.contrast_file", colours=True)
        sound = (values > 0.0) & (values <= LARGEST)
        if not sound.all():
            expected = f"ratios I_x / I_y above zero, at most {LARGEST:g}"
            remedy = "set such pixels to 1, the ratio of unpolarised light"
            source, got = str(self.contrast_file), _unsound(values, sound)
            raise InputError.single(source, "rgbd.contrast_file", expected, got, remedy)
        return values

    def _depths_m(self) -> FloatArray:
        source, field = str(self.depth_file), "rgbd.depth_file"
        values, largest_count = _read(self.depth_file, field)
        if largest_count is not None:
            if self.depth_range_m is None:
                got = "whole numbers without a scale"
                remedy = "add `depth_range_m = [near, far]`, or save depths in m as a .npy or .tif of floats"
                raise InputError.single(source, field, "depths in m", got, remedy)
            values = np.where(values > 0.0, values, np.nan)
        known = np.isfinite(values)
        if not known.any():
            got = "none: no value is finite" if largest_count is None else "none: no value is above 0"
            raise InputError.single(source, field, "known depths", got, "is it the right file?")
        values = np.where(known, values, np.nan)
        low, high = float(values[known].min()), float(values[known].max())
        if max(abs(low), abs(high)) > LARGEST:
            expected, got = f"depths of at most {LARGEST:g}", f"{low:g} to {high:g}"
            raise InputError.single(source, field, expected, got, "mark unknown ones by NaN")
        if self.depth_range_m is not None:
            if low == high:
                got, remedy = f"{low:g} everywhere", "leave `depth_range_m` out, and save depths in m as floats"
                raise InputError.single(source, field, "several depths to scale into `depth_range_m`", got, remedy)
            near, far = self.depth_range_m
            return np.asarray(near + (far - near) * ((values - low) / (high - low)))
        if low <= 0.0:
            got = _unsound(values, ~known | (values > 0.0))
            raise InputError.single(source, field, "depths above zero, in m", got, "mark unknown ones by NaN")
        return values


def _read(path: Path, field: str, *, colours: bool = False) -> tuple[FloatArray, float | None]:
    """A picture and its saturation level, as :func:`read_counts`; InputError names the key of the file."""
    try:
        return read_counts(path, colours=colours)
    except InputError as error:
        raise InputError(error.source, [replace(fault, field=field) for fault in error.faults]) from error


def _joined(errors: list[InputError]) -> InputError:
    """One error of all: that of a single file, or the faults of several with their files."""
    if len({error.source for error in errors}) == 1:
        return InputError(errors[0].source, [fault for error in errors for fault in error.faults])
    faults = [replace(f, field=f"{f.field} -> {error.source}") for error in errors for f in error.faults]
    return InputError("scene", faults)


def _unsound(values: FloatArray, sound: NDArray[np.bool_]) -> str:
    """First example and number of a picture's values that are not ``sound``; "0 everywhere" if all are."""
    wrong = values[~sound]
    return f"values such as {wrong[0]:g} in {wrong.size} of {values.size} pixels" if wrong.size else "0 everywhere"
