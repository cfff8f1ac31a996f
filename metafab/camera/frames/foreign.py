"""Frames in the files of real cameras: TIFF and PNG of 8, 12 or 16 bit, and NumPy arrays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metafab.camera.frames.frame import RawFrame, load
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.files import HDF5_SUFFIXES, whole_file
from metafab.core.storage.pictures import read_counts
from metafab.optics.point_spread import Psf

#: Files of counts, and the largest count of 16 bits.
_COUNTED = {".tif", ".tiff", ".png", ".npy"}
_FULL_COUNT = 2**16 - 1
#: Pixels at exactly the largest value are saturated if they exceed this number and this share of the frame.
_PILED_UP = (50, 1e-5)
#: Least ratio of saturated pixels to pixels at the next lower value: without saturation, a histogram falls off.
_SPIKE = 4.0


@dataclass(frozen=True)
class Counts:
    """Meaning of a camera's counts; by default they are electrons."""

    black: float = 0.0  #: Counts of a pixel without light.
    electrons_per_count: float = 1.0  #: Gain.
    read_noise_e: float = 0.0  #: Standard deviation without light, electrons.
    #: Counts of a saturated pixel; by default the largest of the file type, or a value that many pixels share.
    white: float | None = None

    def electrons(self, counts: FloatArray | float) -> FloatArray:
        """Electrons of counts, scalar or array: the same shape."""
        return np.asarray((np.asarray(counts, dtype=np.float64) - self.black) * self.electrons_per_count)


_ELECTRONS = Counts()


def load_frame(path: Path, psf: Psf, *, counts: Counts = _ELECTRONS, first_row: str = "top") -> RawFrame:
    """Read a frame: a ``raw.h5``, or a file of a real camera with the optical axis at the centre of the picture.

    Args:
        path: a ``raw.h5``, a grey TIFF or PNG (8 to 16 bit; 12-bit counts are not rescaled), a 2-D ``.npy``.
        psf: the calibration; its ``pixel_um`` is the camera's pixel pitch.
        counts: meaning of the file's counts.
        first_row: whether the file's first row is the picture's "top" (as in TIFF and PNG) or "bottom".

    Returns:
        The frame in electrons, its lowest row first. Its ``saturation_e`` is ``counts.white``; without it, the file
        type's largest value, or the frame's own largest value where many pixels share it (``saturation_assumed``).

    Raises:
        InputError: the file cannot be read or is no grey picture, or ``counts`` is given for a ``raw.h5``.
    """
    if path.suffix.lower() in HDF5_SUFFIXES:
        if counts != _ELECTRONS:
            expected = "a camera's TIFF, PNG or .npy, where counts are given a meaning"
            got = "metafab's own frame, in electrons already"
            raise InputError.single(str(path), "file", expected, got, "leave them out")
        return load(path)
    values, saturation = read_counts(path)
    piled_up = None if counts.white is not None else _piled_up(values, counts.black)
    assumed = piled_up is not None and (saturation is None or piled_up < saturation)
    saturation = counts.white if counts.white is not None else piled_up if assumed else saturation
    frame = counts.electrons(values[::-1] if first_row == "top" else values)
    n_y, n_x = frame.shape
    origin_um = (-psf.pixel_um * (n_x // 2), -psf.pixel_um * (n_y // 2))
    full_e = None if saturation is None else float(counts.electrons(saturation))
    return RawFrame(
        np.ascontiguousarray(frame),
        psf.pixel_um,
        origin_um,
        counts.read_noise_e,
        saturation_e=full_e,
        saturation_assumed=assumed,
    )


def _piled_up(values: FloatArray, black: float) -> float | None:
    """Saturation level: the largest value, if many pixels share it exactly; else None."""
    finite = values[np.isfinite(values)]
    if not finite.size or (peak := float(finite.max())) <= max(black, float(finite.min())):
        return None
    full = int((finite == peak).sum())
    if full <= max(_PILED_UP[0], _PILED_UP[1] * values.size):
        return None
    below = int((finite == finite[finite < peak].max()).sum())
    return peak if full > _SPIKE * below else None


def require_frame_name(path: Path) -> None:
    """Raise InputError unless the ending of a name is one of a raw frame."""
    if path.suffix.lower() not in {*HDF5_SUFFIXES, *_COUNTED}:
        raise InputError.single(str(path), "output", "a .h5, .tif, .png or .npy file", repr(path.suffix))


def counts_of(frame: RawFrame, *, black: int = 0) -> Counts:
    """Meaning of the counts that :func:`save_counts` writes, with ``black`` for a pixel without light.

    The largest count of 16 bits is the frame's level of saturation, so that saturated pixels are known from the file
    alone. Without such a level, a count is an electron. A black level outside the lower half of the 16 bits raises
    InputError.
    """
    if not 0 <= black <= _FULL_COUNT // 2:
        raise InputError.single("counts", "black", f"0 to {_FULL_COUNT // 2} counts", f"{black}")
    gain = 1.0 if frame.saturation_e is None else frame.saturation_e / (_FULL_COUNT - black)
    return Counts(float(black), gain, frame.read_noise_e, float(_FULL_COUNT))


def save_counts(frame: RawFrame, path: Path, *, black: int = 0) -> None:
    """Write a frame as a camera would: whole counts of 16 bits, the axis in the middle, top row first.

    The file is a .tif, .tiff, .png or .npy (else InputError), without the frame's truth. Pixels stand on whole
    multiples of the pitch from the axis. With ``black`` = 0, noise below zero is cut off, and the mean of dark pixels
    rises by 0.4 of the read noise; see :func:`counts_of`.
    """
    require_frame_name(path)
    meant = counts_of(frame, black=black)
    whole = np.full(counted_shape(frame), black, dtype=np.uint16)
    starts = (round(start / frame.pixel_um) for start in frame.origin_um[::-1])
    row, column = (n // 2 + start for n, start in zip(whole.shape, starts, strict=True))
    n_y, n_x = frame.frame.shape
    counted = np.round(frame.frame / meant.electrons_per_count + black)
    whole[row : row + n_y, column : column + n_x] = np.clip(counted, 0, _FULL_COUNT)
    with whole_file(path) as part:
        _write(np.ascontiguousarray(whole[::-1]), part, path.suffix.lower())


def counted_shape(frame: RawFrame) -> tuple[int, int]:
    """(rows, columns) of the picture that :func:`save_counts` writes, with the axis in its middle."""
    starts = (round(start / frame.pixel_um) for start in frame.origin_um[::-1])
    n_y, n_x = (2 * max(-start, start + n) for start, n in zip(starts, frame.frame.shape, strict=True))
    return n_y, n_x


def _write(values: np.ndarray, path: Path, kind: str) -> None:
    if kind == ".npy":
        with path.open("wb") as file:
            np.save(file, values)
    elif kind == ".png":
        from PIL import Image

        Image.fromarray(values).save(path, format="png")
    else:
        import tifffile

        tifffile.imwrite(path, values, compression=None, metadata=None)
