"""Frames of a real camera: TIFF and PNG of 8, 12 or 16 bit, and NumPy arrays; ours written as one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metafab.camera.frame import RawFrame
from metafab.camera.store import load
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.files import whole_file
from metafab.core.pictures import read_counts
from metafab.optics.point_spread import Psf

_OWN = {".h5", ".hdf5"}
_COUNTED = {".tif", ".tiff", ".png", ".npy"}


@dataclass(frozen=True)
class Counts:
    """What a camera's counts mean; the defaults take them for electrons.

    Attributes:
        black: counts of a pixel without light.
        electrons_per_count: gain.
        read_noise_e: standard deviation without light, electrons.
    """

    black: float = 0.0
    electrons_per_count: float = 1.0
    read_noise_e: float = 0.0

    def electrons(self, counts: FloatArray | float) -> FloatArray:
        """Electrons of counts."""
        return np.asarray((np.asarray(counts, dtype=np.float64) - self.black) * self.electrons_per_count)


_ELECTRONS = Counts()


def load_frame(path: Path, psf: Psf, *, counts: Counts = _ELECTRONS, first_row: str = "top") -> RawFrame:
    """A frame from a file: metafab's own, or a real camera's with the optical axis assumed at its centre.

    Args:
        path: a ``raw.h5``, a grey TIFF or PNG (8 to 16 bit; 12-bit counts are taken as they are), a 2-D ``.npy``.
        psf: the calibration; its ``pixel_um`` is the camera's pixel pitch.
        counts: what the file's numbers mean.
        first_row: whether the file's first row is the picture's "top" (as TIFF and PNG have it) or "bottom".

    Returns:
        The frame in electrons with its lowest row first, as everywhere in metafab. Pixels at the file type's largest
        value are saturated: the level travels with the frame.

    Raises:
        InputError: the file cannot be read, is no grey picture, or is metafab's own, in electrons already.
    """
    if path.suffix.lower() in _OWN:
        if counts != _ELECTRONS:
            expected = "a camera's TIFF, PNG or .npy, where counts are given a meaning"
            raise InputError.single(
                str(path), "file", expected, "metafab's own frame, in electrons already", "leave them out"
            )
        return load(path)
    values, saturation = read_counts(path)
    frame = counts.electrons(values[::-1] if first_row == "top" else values)
    n_y, n_x = frame.shape
    origin_um = (-psf.pixel_um * (n_x // 2), -psf.pixel_um * (n_y // 2))
    full_e = None if saturation is None else float(counts.electrons(saturation))
    return RawFrame(np.ascontiguousarray(frame), psf.pixel_um, origin_um, counts.read_noise_e, saturation_e=full_e)


def require_frame_name(path: Path) -> None:
    """Refuse names of files that no frame can be written to.

    Raises:
        InputError: the file's ending is none of those.
    """
    if path.suffix.lower() not in _OWN | _COUNTED:
        raise InputError.single(str(path), "output", "a .h5, .tif, .png or .npy file", repr(path.suffix))


def save_counts(frame: RawFrame, path: Path) -> None:
    """Write a frame as a camera would: whole counts of 16 bits, one an electron, the axis in the middle, top row first.

    Args:
        frame: whose pixels stand on whole multiples of the pitch from the axis; its truth is left out.
        path: a .tif, .tiff, .png or .npy file.

    Raises:
        InputError: another kind of file.
    """
    require_frame_name(path)
    half = [
        max(-round(start / frame.pixel_um), round(start / frame.pixel_um) + count)
        for start, count in zip(frame.origin_um[::-1], frame.frame.shape, strict=True)
    ]
    whole = np.zeros([2 * n for n in half], dtype=np.uint16)
    row, column = (n + round(start / frame.pixel_um) for n, start in zip(half, frame.origin_um[::-1], strict=True))
    n_y, n_x = frame.frame.shape
    whole[row : row + n_y, column : column + n_x] = np.clip(np.round(frame.frame), 0, 2**16 - 1)
    with whole_file(path) as part:
        _write(np.ascontiguousarray(whole[::-1]), part, path.suffix.lower())


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
