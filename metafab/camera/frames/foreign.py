"""Frames of a real camera: TIFF and PNG of 8, 12 or 16 bit, and NumPy arrays; ours written as one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metafab.camera.frames.frame import RawFrame
from metafab.camera.frames.store import load
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.files import HDF5_SUFFIXES, whole_file
from metafab.core.storage.pictures import read_counts
from metafab.optics.point_spread import Psf

_COUNTED = {".tif", ".tiff", ".png", ".npy"}
_FULL_COUNT = 2**16 - 1
#: So many pixels, and so large a share of all, at exactly the largest value, are full and not bright by chance...
_PILED_UP = (50, 1e-5)
#: ...where they are so many times as many as those at the next lower value: below a full well, light thins out.
_SPIKE = 4.0


@dataclass(frozen=True)
class Counts:
    """What a camera's counts mean; the defaults take them for electrons.

    Attributes:
        black: counts of a pixel without light.
        electrons_per_count: gain.
        read_noise_e: standard deviation without light, electrons.
        white: counts of a pixel that is full; by default the file type's largest, or what many pixels share.
    """

    black: float = 0.0
    electrons_per_count: float = 1.0
    read_noise_e: float = 0.0
    white: float | None = None

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
        The frame in electrons with its lowest row first, as everywhere in metafab. Pixels at ``counts.white`` are
        saturated, without it those at the file type's largest value, or at the frame's own largest where many share
        it (``saturation_assumed``): the level travels with the frame.

    Raises:
        InputError: the file cannot be read, is no grey picture, or is metafab's own, in electrons already.
    """
    if path.suffix.lower() in HDF5_SUFFIXES:
        if counts != _ELECTRONS:
            expected = "a camera's TIFF, PNG or .npy, where counts are given a meaning"
            raise InputError.single(
                str(path), "file", expected, "metafab's own frame, in electrons already", "leave them out"
            )
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
        np.ascontiguousarray(frame), psf.pixel_um, origin_um, counts.read_noise_e,
        saturation_e=full_e, saturation_assumed=assumed,
    )  # fmt: skip


def _piled_up(values: FloatArray, black: float) -> float | None:
    """The largest value, where so many pixels have exactly this one that they are full; else None."""
    finite = values[np.isfinite(values)]
    if not finite.size or (peak := float(finite.max())) <= max(black, float(finite.min())):
        return None
    full = int((finite == peak).sum())
    if full <= max(_PILED_UP[0], _PILED_UP[1] * values.size):
        return None
    below = int((finite == finite[finite < peak].max()).sum())
    return peak if full > _SPIKE * below else None


def require_frame_name(path: Path) -> None:
    """Refuse names of files that no frame can be written to.

    Raises:
        InputError: the file's ending is none of those.
    """
    if path.suffix.lower() not in {*HDF5_SUFFIXES, *_COUNTED}:
        raise InputError.single(str(path), "output", "a .h5, .tif, .png or .npy file", repr(path.suffix))


def counts_of(frame: RawFrame, *, black: int = 0) -> Counts:
    """What the counts mean that :func:`save_counts` writes.

    A frame that knows at which level it saturates fills the 16 bits with it, so that full pixels are known from the
    file alone; else a count is an electron.

    Args:
        frame: in electrons.
        black: counts of a pixel without light.

    Raises:
        InputError: a black level outside of the lower half of the 16 bits.
    """
    if not 0 <= black <= _FULL_COUNT // 2:
        raise InputError.single("counts", "black", f"0 to {_FULL_COUNT // 2} counts", f"{black}")
    gain = 1.0 if frame.saturation_e is None else frame.saturation_e / (_FULL_COUNT - black)
    return Counts(float(black), gain, frame.read_noise_e, float(_FULL_COUNT))


def save_counts(frame: RawFrame, path: Path, *, black: int = 0) -> None:
    """Write a frame as a camera would: whole counts of 16 bits, the axis in the middle, top row first.

    Args:
        frame: whose pixels stand on whole multiples of the pitch from the axis; its truth is left out.
        path: a .tif, .tiff, .png or .npy file.
        black: counts of a pixel without light. At 0, noise below zero is cut off: dark pixels are brighter as a mean
            by 0.4 of the read noise.

    Raises:
        InputError: another kind of file, or a black level outside of the lower half of the 16 bits.
    """
    require_frame_name(path)
    meant = counts_of(frame, black=black)
    half = [
        max(-round(start / frame.pixel_um), round(start / frame.pixel_um) + count)
        for start, count in zip(frame.origin_um[::-1], frame.frame.shape, strict=True)
    ]
    whole = np.full([2 * n for n in half], black, dtype=np.uint16)
    row, column = (n + round(start / frame.pixel_um) for n, start in zip(half, frame.origin_um[::-1], strict=True))
    n_y, n_x = frame.frame.shape
    counted = np.round(frame.frame / meant.electrons_per_count + black)
    whole[row : row + n_y, column : column + n_x] = np.clip(counted, 0, _FULL_COUNT)
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
