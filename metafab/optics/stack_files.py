"""Stacks of pictures in files of other programs: MATLAB, HDF5, NumPy and TIFF; and tables of depths."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage import hdf5
from metafab.core.storage.files import HDF5_SUFFIXES, require_file
from metafab.core.storage.limits import require_modest_table
from metafab.core.storage.pictures import read_array, require_few

#: Files of one array, as :func:`read_array` reads them.
_PICTURES = (".npy", ".npz", ".tif", ".tiff", ".png")
#: A line of a table in which a comma is the decimal point: as two depths, 0,25 would be 0 and 25 m.
_DECIMAL_COMMA = re.compile(r"-?0,\d+")
#: Header that a table of depths may have.
_HEADER = "depth_m"
_REMEDY = "export the stack as .npy of shape (depths, rows, columns) or (2, depths, rows, columns)"


def read_stack(path: Path, depths: int, names: Sequence[str] = ()) -> FloatArray:
    """Read a stack of pictures over depth, of one or two channels: shape (channels, depths, rows, columns).

    The axes may stand as (depths, rows, columns) or (rows, columns, depths); an axis of two channels may stand before
    or after the depths. If a shape fits several, the last axis is the depth in a MATLAB file and the
    first in all others. Rows are in the file's order.

    Args:
        path: .mat (version 5 or 7.3), .h5, .npy, .npz of one array, or .tif with a page for each picture.
        depths: number of depths.
        names: arrays of a MATLAB or HDF5 file, one for both channels or one for each; by default the only array of 3 or
            4 axes.

    Raises:
        InputError: the file cannot be read, is too large, or holds no such stack of finite real numbers.
    """
    suffix = path.suffix.lower()
    if suffix not in {".mat", *HDF5_SUFFIXES}:
        if names:
            expected = "a MATLAB or HDF5 file, where an array has a name"
            raise InputError.single(str(path), "names", expected, f"a {suffix} file", "leave them out")
        if suffix not in _PICTURES:
            expected = f"a .mat, .h5, {', '.join(_PICTURES[:-1])} or {_PICTURES[-1]} file"
            raise InputError.single(str(path), "file", expected, repr(suffix), _REMEDY)
        arrays = [read_array(path)]
    else:
        require_file(path, "a stack of pictures")
        if not path.stat().st_size:
            expected = "a readable MATLAB or HDF5 file"
            raise InputError.single(str(path), "file", expected, "an empty file", "was it written whole?")
        read = _read_hdf5 if h5py.is_hdf5(path) else _read_matlab
        try:
            arrays = read(path, names)
        except InputError:
            raise
        except Exception as error:  # readers raise errors of any type on a broken file
            got = f"a truncated or foreign file ({type(error).__name__}: {error})"
            raise InputError.single(str(path), "file", "a readable MATLAB or HDF5 file", got, _REMEDY) from error
    stacks = [_ordered(values, depths, path, depth_last=suffix == ".mat") for values in arrays]
    if len({stack.shape[1:] for stack in stacks}) > 1 or sum(len(stack) for stack in stacks) > 2:
        got = " and ".join(str(stack.shape) for stack in stacks)
        raise InputError.single(str(path), "shape", "two channels of equal shape at most", got, "name the arrays")
    return np.concatenate(stacks)


def lowest_row_first(stack: FloatArray) -> FloatArray:
    """Turn pictures, shape (..., n_y, n_x), with the top row first upside down about their middle row ``n_y // 2``.

    Of an even number of rows, the top one becomes the lowest: the middle row of a file stays the middle.
    """
    turned = stack[..., ::-1, :]
    return turned if stack.shape[-2] % 2 else np.roll(turned, 1, axis=-2)


def read_depths(path: Path) -> FloatArray:
    """Read depths from a .npy file, or from a text file of numbers separated by commas, blanks or lines (# comments).

    The first line of a text file may be the header ``depth_m``. Shape (n,), in the file's order and units. InputError
    if it cannot be read, or holds something other than numbers.
    """
    if path.suffix.lower() == ".npy":
        values = read_array(path)
        if values.dtype.kind not in "iuf":
            raise InputError.single(str(path), "depths", "real numbers", str(values.dtype))
        return values.astype(np.float64).ravel()
    remedy = f"one depth in metres a line, with a decimal point; the first line may be `{_HEADER}`"
    try:
        require_modest_table(path)
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        got = "no text in UTF-8" if isinstance(error, UnicodeDecodeError) else f"none ({error.strerror or error})"
        raise InputError.single(str(path), "depths", "a readable table of numbers", got, remedy) from error
    lines = [line for each in text.splitlines() if (line := each.partition("#")[0].strip())]
    if len(lines) > 1 and all(_DECIMAL_COMMA.fullmatch(line) for line in lines):
        raise InputError.single(str(path), "depths", "numbers", f"decimal commas, such as {lines[0]}", remedy)
    if lines and lines[0].strip(", ").lower() == _HEADER:
        del lines[0]
    depths_m: list[float] = []
    for word in (word for line in lines for word in line.replace(",", " ").split()):
        try:
            depths_m.append(float(word))
        except ValueError:
            got = repr(word) if len(word) <= 40 else repr(word[:37] + "...")
            raise InputError.single(str(path), "depths", "a readable table of numbers", got, remedy) from None
    if not depths_m:
        raise InputError.single(str(path), "depths", "a readable table of numbers", "no number", remedy)
    return np.array(depths_m)


def _read_hdf5(path: Path, names: Sequence[str]) -> list[np.ndarray]:
    """Arrays of an HDF5 file; those of MATLAB 7.3 in MATLAB's order of axes."""
    with hdf5.open_file(path) as file:
        shapes: dict[str, tuple[int, ...]] = {}

        def visit(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                shapes[name] = item.shape or ()

        file.visititems(visit)
        chosen = _chosen(path, shapes, names)
        hdf5.require_modest(file, path, names=[f"/{name}" for name in chosen])
        arrays = [np.asarray(file[name][...]) for name in chosen]
    return [array.transpose() for array in arrays] if path.suffix.lower() == ".mat" else arrays


def _read_matlab(path: Path, names: Sequence[str]) -> list[np.ndarray]:
    """Arrays of a MATLAB file of version 5."""
    from scipy.io import loadmat, whosmat

    shapes = {name: tuple(shape) for name, shape, _ in whosmat(path)}
    chosen = _chosen(path, shapes, names)
    # A few compressed bytes can state thousands of millions of values.
    require_few(path, sum(math.prod(shapes[name]) for name in chosen))
    content = loadmat(path, variable_names=chosen)
    return [np.asarray(content[name]) for name in chosen]


def _chosen(path: Path, shapes: dict[str, tuple[int, ...]], names: Sequence[str]) -> list[str]:
    """Names of the arrays to read: those asked for, or the only one of 3 or 4 axes."""
    stacks = [name for name, shape in shapes.items() if len(shape) in {3, 4}]
    held = ", ".join(f"{name} {shapes[name]}" for name in stacks) or "none"
    wanted = [name.strip("/") for name in names]
    if len(wanted) > 2 or len(set(wanted)) < len(wanted):
        raise InputError.single(str(path), "names", "one name, or one for each of two channels", ", ".join(names))
    if missing := [name for name in wanted if name not in shapes]:
        expected = f"an array of the file ({held})"
        raise InputError.single(str(path), "names", expected, ", ".join(missing), "choose one of these")
    if not wanted and len(stacks) != 1:
        remedy = "name one, or one for each channel" if stacks else _REMEDY
        raise InputError.single(str(path), "names" if stacks else "content", "one array of 3 or 4 axes", held, remedy)
    chosen = wanted or stacks
    for name in chosen:
        require_few(path, *shapes[name])
    return chosen


def _ordered(values: np.ndarray, depths: int, path: Path, *, depth_last: bool) -> FloatArray:
    """The array as (channels, depths, rows, columns)."""
    if values.dtype.kind not in "buif":
        raise InputError.single(str(path), "type", "real numbers", str(values.dtype), "export the irradiance")
    first, last = {3: ("dyx", "yxd"), 4: ("cdyx", "yxdc")}.get(values.ndim, ("", ""))
    orders = [first, last] if values.ndim == 3 else [first, "dcyx", last, "yxcd"] if values.ndim == 4 else []
    if depth_last:
        orders.reverse()
    for order in orders:
        size = dict(zip(order, values.shape, strict=True))
        if size["d"] == depths and size.get("c", 1) in {1, 2} and min(size["x"], size["y"]) > 1:
            target = [order.index(axis) for axis in "cdyx" if axis in order]
            ordered = values.transpose(target).astype(np.float64)
            return ordered if values.ndim == 4 else ordered[None]
    expected = f"{depths} pictures, one for each of the {depths} depths, of one or two channels"
    raise InputError.single(str(path), "shape", expected, f"an array of shape {values.shape}", _REMEDY)
