"""Sweeps of other programs as tables of sizes and complex amplitudes.

Columns (.csv) and arrays (.npz, .h5) go by name: sizes ``width_nm`` and ``length_nm``, or ``diameter_nm`` (also in
``_um`` and ``_m``); amplitudes ``t`` for both polarisations or ``t_xx`` and ``t_yy``. In a table of numbers an
amplitude ``t`` consists of ``t_re`` and ``t_im``, or of ``t_abs`` and ``t_phase_rad`` or ``t_phase_deg``. Case does not
count, except that ``T``, the letter of a power transmittance, is no amplitude. Other columns are left out. Arrays are
columns of equal length, or maps of shape (n_length, n_width) over ``width_nm``, shape (n_width,), and ``length_nm``,
shape (n_length,).
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import h5py
import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.core.storage import hdf5
from metafab.core.storage.limits import beyond, limit, require_modest_table
from metafab.core.storage.pictures import read_arrays

#: Modulus below which a negative one is rounding.
_ROUNDING = 1e-6
#: Amplitudes of a file: the ratio of the electric fields; a modulus that is the power transmittance, with the phase of
#: that ratio; or a scattering parameter, whose squared modulus is the power transmittance.
Quantity: TypeAlias = Literal["field", "power", "s21"]

_UNITS_NM = {"nm": 1.0, "um": 1e3, "m": 1e9}
_SUFFIXES = ("_re", "_im", "_abs", "_phase_rad", "_phase_deg")
#: Largest file, MB, unless the limit ``memory_mb`` is stated.
_LARGEST_MB = 1000.0
#: Most sizes of a sweep; a million of them takes 1 s to compare.
_MOST_SIZES = 2_000_000
#: Widest range of phases in radians: 16 turns take 16 wavelengths of optical path more in one pillar than in another.
#: Wrapped phases in degrees span up to 360.
_WIDEST_RAD = 100.0


@dataclass(frozen=True)
class SweepTable:
    """Solved sizes of a sweep."""

    size_nm: FloatArray  #: Shape (n, 2), width and length.
    t_xx: ComplexArray  #: Shape (n,), amplitude for x polarised light, as the file has it.
    t_yy: ComplexArray | None  #: Shape (n,), likewise for y; None if the file has one amplitude.
    has_diameters: bool  #: Whether the file names diameters; then widths equal lengths.
    left_out: int  #: Rows without a finite amplitude.


def read_sweep(path: Path) -> SweepTable:
    """Read a sweep; InputError if the file cannot be read, lacks a column, or has no finite row."""
    columns = _columns(path)
    sizes, has_diameters = _sizes(columns, path)
    shape = _common_shape(sizes, path)
    one = _amplitude(columns, "t", path)
    t_xx = one if one is not None else _amplitude(columns, "t_xx", path)
    t_yy = None if one is not None else _amplitude(columns, "t_yy", path)
    if t_xx is None:
        expected = "an amplitude `t`, or `t_xx` (and `t_yy`), as _re and _im, or _abs and _phase_rad or _phase_deg"
        raise InputError.single(str(path), "columns", expected, f"the columns {', '.join(columns)}", "rename them")
    for name, t in (("t_xx", t_xx), ("t_yy", t_yy)):
        if t is not None and t.shape != shape:
            remedy = "transpose it: a row for each length" if t.T.shape == shape else ""
            raise InputError.single(str(path), name, f"shape {shape} like the sizes", f"shape {t.shape}", remedy)
    size_nm = np.stack([np.broadcast_to(size, shape).ravel() for size in sizes], axis=1)
    t_xx, t_yy = t_xx.ravel(), None if t_yy is None else t_yy.ravel()
    finite = np.isfinite(size_nm).all(axis=1) & np.isfinite(t_xx) & (True if t_yy is None else np.isfinite(t_yy))
    if not finite.any():
        raise InputError.single(str(path), "rows", "at least one with finite numbers", f"none of {finite.size}")
    size_nm = np.round(size_nm[finite], 6)  # 1e-6 nm: units of um and m round
    _, first, count = np.unique(size_nm, axis=0, return_index=True, return_counts=True)
    if count.max() > 1:
        twice = size_nm[first[count > 1][0]]
        got = f"{twice[0]:g} x {twice[1]:g} nm more than once"
        raise InputError.single(str(path), "rows", "each size once", got, "one wavelength and one height a file")
    t_yy = None if t_yy is None else t_yy[finite]
    return SweepTable(size_nm, t_xx[finite], t_yy, has_diameters, int(np.count_nonzero(~finite)))


def _columns(path: Path) -> dict[str, NDArray[np.generic]]:
    """Arrays of a file by lower-case name; ``T`` keeps its case."""
    expected = "a .csv, .npz or .h5 file with a sweep"
    readers = {".csv": _csv, ".npz": _npz, ".h5": _h5, ".hdf5": _h5}
    if path.suffix.lower() not in readers:
        raise InputError.single(str(path), "file", expected, f"the ending {path.suffix!r}")
    try:
        most_mb = limit("memory_mb", _LARGEST_MB)
        if path.stat().st_size > 1e6 * most_mb:
            raise beyond(str(path), "file", "memory_mb", f"at most {most_mb:.0f} MB", "a larger one")
        columns = readers[path.suffix.lower()](path)
        if (most := max((values.size for values in columns.values()), default=0)) > _MOST_SIZES:
            raise InputError.single(str(path), "rows", f"at most {_MOST_SIZES} sizes", f"{most}")
        return columns
    except InputError:
        raise
    except Exception as error:  # the readers raise many types for a broken file
        raise InputError.single(str(path), "file", expected, f"an unreadable one ({error})") from error


def _csv(path: Path) -> dict[str, NDArray[np.generic]]:
    require_modest_table(path)
    with path.open(encoding="utf-8-sig", newline="") as stream:
        lines = [line for line in stream if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise ValueError("no rows")
    delimiter = next((sign for sign in ",;\t" if sign in lines[0]), None)
    rows = [line.split() for line in lines] if delimiter is None else list(csv.reader(lines, delimiter=delimiter))
    names = [_lower(name.strip()) for name in rows[0]]
    if uneven := next((n for n, row in enumerate(rows, start=1) if len(row) != len(names)), None):
        raise ValueError(f"{len(rows[uneven - 1])} cells in row {uneven}, not {len(names)} as in the header")
    cells = {name: [row[k].strip() for row in rows[1:]] for k, name in enumerate(names)}
    return {
        name: np.array([complex(v.replace("i", "j")) if _is_complex(v) else _real(v) for v in values])
        for name, values in cells.items()
    }


def _lower(name: str) -> str:
    """Lower-case name of a column, except for ``T``: a transmittance."""
    return name if name == "T" else name.lower()


def _real(text: str) -> float:
    return float(text) if text else float("nan")


def _is_complex(text: str) -> bool:
    """Whether a cell is a complex number such as 0.1+0.2j or 0.1-0.2i; "inf" and "nan" are none."""
    return text[-1:] in {"i", "j"}


def _npz(path: Path) -> dict[str, NDArray[np.generic]]:
    return {_lower(name): array for name, array in read_arrays(path).items()}


def _h5(path: Path) -> dict[str, NDArray[np.generic]]:
    with hdf5.open_file(path) as file:
        names = [name for name in file if isinstance(file[name], h5py.Dataset)]
        hdf5.require_modest(file, path, names=["/" + name for name in names])
        return {_lower(name): _as_written(file[name]) for name in names}


def _as_written(item: h5py.Dataset) -> NDArray[np.generic]:
    """Array of a dataset; MATLAB (version 7.3) stores matrices by columns, transposed here, and vectors as matrices."""
    values = _complex_of_parts(item[()])
    if "MATLAB_class" not in item.attrs:
        return values
    return values.ravel() if 1 in values.shape else values.T


def _complex_of_parts(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Complex numbers of a record of two parts, as MATLAB and others store them."""
    names = values.dtype.names
    if names is None or len(names) != 2:
        return np.asarray(values)
    record: Any = values
    return np.asarray(record[names[0]] + 1j * record[names[1]])


def _sizes(columns: Mapping[str, NDArray[np.generic]], path: Path) -> tuple[tuple[FloatArray, FloatArray], bool]:
    """Width and length, broadcast against each other, and whether they are diameters."""
    found = {}
    for name in ("diameter", "width", "length"):
        for unit, factor in _UNITS_NM.items():
            if f"{name}_{unit}" in columns:
                found[name] = factor * np.asarray(columns[f"{name}_{unit}"], dtype=np.float64)
    if "diameter" in found:
        return (found["diameter"], found["diameter"]), True
    if found.keys() != {"width", "length"}:
        expected = "`width_nm` and `length_nm`, or `diameter_nm` (or in _um, _m)"
        got = f"the columns {', '.join(columns)}"
        raise InputError.single(str(path), "columns", expected, got, "rename them; the unit is part of the name")
    width, length = found["width"], found["length"]
    maps = any(np.ndim(values) == 2 for values in columns.values())
    if maps and width.ndim == length.ndim == 1:
        return (width[None, :], length[:, None]), False
    return (width, length), False


def _common_shape(sizes: tuple[FloatArray, FloatArray], path: Path) -> tuple[int, ...]:
    """Shape of the amplitudes over these widths and lengths; InputError if they do not belong together."""
    width, length = sizes
    try:
        return np.broadcast_shapes(width.shape, length.shape)
    except ValueError as error:
        expected = (
            "widths and lengths of one shape, or of shapes (n_width,) and (n_length,) beside maps (n_length, n_width)"
        )
        got = f"`width` of shape {width.shape}, `length` of shape {length.shape}"
        raise InputError.single(str(path), "sizes", expected, got) from error


def _require_moduli(values: NDArray[np.generic], column: str, path: Path) -> None:
    """Refuse negative moduli."""
    if np.iscomplexobj(values):
        raise InputError.single(str(path), column, "moduli", "complex numbers", f"name the column `{column[:-4]}`")
    lowest = float(np.nanmin(np.asarray(values, dtype=np.float64), initial=np.inf))
    if lowest < -_ROUNDING:
        expected, remedy = "moduli of 0 or more", "are they decibels? Then convert them: 10^(dB / 20)"
        raise InputError.single(str(path), column, expected, f"{lowest:g}", remedy)


def _amplitude(columns: Mapping[str, NDArray[np.generic]], name: str, path: Path) -> ComplexArray | None:
    """Complex amplitude of one name; None if the file has none."""
    if name in columns:
        if not np.iscomplexobj(columns[name]):
            expected, got = "complex numbers, such as 0.1+0.2j", "real ones, which have no phase"
            remedy = f"name its parts `{name}_re` and `{name}_im`, or `{name}_abs` and `{name}_phase_rad` (or _deg)"
            raise InputError.single(str(path), name, expected, got, remedy)
        return np.asarray(columns[name], dtype=np.complex128)
    parts = {suffix: np.asarray(columns[name + suffix]) for suffix in _SUFFIXES if name + suffix in columns}
    if not parts:
        return None
    if parts.keys() == {"_re", "_im"}:
        return np.asarray(parts["_re"] + 1j * parts["_im"], dtype=np.complex128)
    if "_abs" in parts and not {"_re", "_im"} & parts.keys():
        _require_moduli(parts["_abs"], f"{name}_abs", path)
    if parts.keys() == {"_abs", "_phase_rad"}:
        phases = parts["_phase_rad"][np.isfinite(parts["_phase_rad"])]
        if phases.size and (span := float(np.ptp(phases))) > _WIDEST_RAD:
            expected, got = f"radians, within {_WIDEST_RAD:g} of each other", f"a range of {span:.4g}"
            remedy = f"are they degrees? Then name the column `{name}_phase_deg`"
            raise InputError.single(str(path), f"{name}_phase_rad", expected, got, remedy)
        return np.asarray(parts["_abs"] * np.exp(1j * parts["_phase_rad"]), dtype=np.complex128)
    if parts.keys() == {"_abs", "_phase_deg"}:
        return np.asarray(parts["_abs"] * np.exp(1j * np.radians(parts["_phase_deg"])), dtype=np.complex128)
    got = ", ".join(name + suffix for suffix in parts)
    expected = f"`{name}_re` and `{name}_im`, or `{name}_abs` and one of `{name}_phase_rad`, `{name}_phase_deg`"
    raise InputError.single(str(path), "columns", expected, got)
