"""Reader of grey pictures and stacks of them: TIFF and PNG of 8, 12 or 16 bit, and NumPy arrays."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError

_SUFFIXES = {".tif": "tiff", ".tiff": "tiff", ".png": "png", ".npy": "npy", ".npz": "npz"}
#: Most pixels of a picture, times its colours or pages; as floats they take 512 MiB.
MOST_SAMPLES = 1 << 26
#: Longest side of a picture (pixels); no image sensor has more.
_LONGEST_SIDE_PX = 1 << 16
_REMEDY = "save it as a grey TIFF, PNG or .npy of shape (rows, columns)"


def read_grey(path: Path) -> FloatArray:
    """Read a picture as floats, shape (rows, columns), first row as in the file; colours are averaged.

    Raises:
        InputError: the file cannot be read, or is no picture.
    """
    return read_counts(path, colours=True)[0]


def read_counts(path: Path, *, colours: bool = False) -> tuple[FloatArray, float | None]:
    """Read a grey picture and its saturation level.

    Args:
        path: .tif, .tiff, .png or .npy, or an .npz of one array.
        colours: whether colours are averaged; otherwise they are refused.

    Returns:
        The values, shape (rows, columns), first row as in the file; and the count at which the file type saturates,
        None for floats. 12-bit counts are not rescaled.

    Raises:
        InputError: the file cannot be read, or is no grey picture.
    """
    values = read_array(path)
    if values.ndim == 3 and colours:
        values = values[..., :3].mean(axis=-1).astype(values.dtype)
    if values.ndim != 2 or values.size == 0:
        got = f"an array of shape {values.shape}"
        raise InputError.single(str(path), "shape", "one grey frame (rows, columns)", got, _REMEDY)
    if values.dtype.kind not in "buif":
        raise InputError.single(str(path), "type", "real numbers", str(values.dtype), _REMEDY)
    return values.astype(np.float64), _saturation(values)


def read_array(path: Path) -> np.ndarray:
    """Read the array of a picture file, of any shape and type: the pages of a TIFF are its first axis.

    Args:
        path: .tif, .tiff, .png or .npy, or an .npz of one array; at most 2**26 values.

    Raises:
        InputError: the file cannot be read.
    """
    kind = _SUFFIXES.get(path.suffix.lower())
    if kind is None:
        raise InputError.single(str(path), "file", "a .tif, .tiff, .png, .npy or .npz file", repr(path.suffix), _REMEDY)
    if not path.is_file():
        raise InputError.single(str(path), "file", f"a {kind} file", "no file at that path", "check the path")
    try:
        return _decoders()[kind](path)
    except Exception as error:  # image libraries raise errors of any type on a broken file
        got = f"a truncated or foreign file ({type(error).__name__}: {error})"
        raise InputError.single(str(path), "file", f"a readable {kind} file", got, _REMEDY) from error


def _decoders() -> dict[str, Callable[[Path], np.ndarray]]:
    def tiff(path: Path) -> np.ndarray:
        import tifffile

        # tifffile logs every unusual tag of a camera's file; a user gets one message instead.
        logging.getLogger("tifffile").setLevel(logging.CRITICAL)
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            # A damaged size field may claim billions of strips.
            if max(page.imagewidth, page.imagelength) > _LONGEST_SIDE_PX:
                raise ValueError(f"{page.imagelength} x {page.imagewidth} pixels, more than {_LONGEST_SIDE_PX} a side")
            _require_few(*file.series[0].shape)
            return np.asarray(file.asarray())

    def png(path: Path) -> np.ndarray:
        from PIL import Image

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(path)
        with image:
            _require_few(*image.size)
            image.load()
            grey = image.convert("RGB") if image.mode in {"P", "RGBA", "LA", "PA"} else image
            return np.asarray(grey)

    def npy(path: Path) -> np.ndarray:
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        _require_few(*mapped.shape)
        return np.array(mapped)

    def npz(path: Path) -> np.ndarray:
        with np.load(path, allow_pickle=False) as file:
            if len(file.files) != 1:
                raise ValueError(f"{len(file.files)} arrays ({', '.join(file.files)}), not one")
            values = file[file.files[0]]
        _require_few(*values.shape)
        return np.asarray(values)

    return {"tiff": tiff, "png": png, "npy": npy, "npz": npz}


def _require_few(*shape: int) -> None:
    """Refuse a picture by the size in its header, before it is decoded."""
    if math.prod(shape) > MOST_SAMPLES:
        raise ValueError(f"{' x '.join(map(str, shape))} pixels, more than {MOST_SAMPLES} in all")


def _saturation(values: np.ndarray) -> float | None:
    """The largest count of the sensor behind the file: 12-bit counts often come in 16-bit files."""
    if values.dtype.kind not in "ui":
        return None
    bits = 8 * values.dtype.itemsize
    peak = int(values.max(initial=0))
    if bits == 16 and peak in {2**10 - 1, 2**12 - 1, 2**14 - 1}:
        return float(peak)
    return float(2**bits - 1)
