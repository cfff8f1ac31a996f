"""Libraries as HDF5 files (kind "metafab library", format 1) with units, descriptions and dimension scales.

A file holds the values on the grid, in ``/model`` the coefficients of the continuous functions, in ``/corners`` the
models over further axes, and in ``/neighbours`` the model of unlike neighbours. These groups are optional.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TypeVar

import h5py
import numpy as np

from metafab.core.conventions import ComplexArray
from metafab.core.errors import InputError
from metafab.core.figures import BuildStatistics, CornerStatistics
from metafab.core.storage import hdf5
from metafab.core.storage.files import plain
from metafab.core.storage.limits import beyond, limit
from metafab.library.axes import Corners
from metafab.library.fit.models import RankedModels
from metafab.library.fit.rational import Range, RationalModel, Shape
from metafab.library.library import Library, inputs_of
from metafab.library.neighbours.storage import neighbours_of, put_neighbours
from metafab.spec import UnitCell, canonical_toml
from metafab.spec.toml import LIBRARY_FORMAT, LIBRARY_KIND, embedded_unit_cell

#: Default of the limit ``memory_mb`` for a library in use: bytes at least, and bytes per byte of its file.
_BYTES, _EXPANSION = 256e6, 32
#: Memory of one size of a library in use, bytes.
_BYTES_OF_A_SIZE = 256

Statistics = TypeVar("Statistics", BuildStatistics, CornerStatistics)

_REMEDY = "build it with `metafab library build UNITCELL.toml`"
_AXES = {"wavelength_nm": "vacuum wavelength", "length_nm": "pillar size along y", "width_nm": "pillar size along x"}
_AMPLITUDES = {
    "t_xx": "zero-order transmission of x polarised light",
    "t_yy": "zero-order transmission of y polarised light",
    "r_xx": "zero-order reflection of x polarised light",
    "r_yy": "zero-order reflection of y polarised light",
}
#: Attribute prefixes of the statistics of a build, and of its corners.
_DETAIL, _CORNER_DETAIL = "detail_", "detail_corner_"


def save(library: Library, path: Path | str) -> None:
    """Write a library atomically; an earlier file of that name is replaced.

    Equal builds give equal bytes, on any machine. A corner of another library raises InputError.
    """
    path = Path(path)
    if library.corner:
        corner = ", ".join(f"{name} = {value:g}" for name, value in library.corner.items())
        remedy = "save the library from which `at` returned this corner"
        raise InputError.single(str(path), "library.corner", "a library of the unit cell's own values", corner, remedy)
    with hdf5.create(
        path, kind=LIBRARY_KIND, format_version=LIBRARY_FORMAT, inputs_sha256=library.inputs_sha256
    ) as file:
        file.attrs["unit_cell_toml"] = canonical_toml(library.unit_cell, path.parent)
        for name, text in _AXES.items():
            hdf5.put(file, name, getattr(library, name), units="nm", description=text, dims=(name,))
        for name, text in _AMPLITUDES.items():
            values = getattr(library, name)
            hdf5.put(file, name, values, units="1", description=text, dims=tuple(_AXES), compress=True)
        error = np.broadcast_to(library.error, library.t_xx.shape)
        text = "bound on the absolute error of each amplitude: solver certificate plus interpolation"
        hdf5.put(file, "error", error, units="1", description=text, dims=tuple(_AXES), compress=True)
        _put_statistics(file, library.statistics, _DETAIL)
        if library.model is not None:
            _put_model(file, library.model)
        if library.model_error is not None:
            text = "error of the continuous model around each size: solver certificate plus interpolation"
            hdf5.put(file, "model/error", library.model_error, units="1", description=text, compress=True)
        if library.corners is not None:
            _put_corners(file.create_group("corners"), library.corners)
        if library.neighbours is not None:
            put_neighbours(file.create_group("neighbours"), library.neighbours)


def load(path: Path | str) -> Library:
    """Read a library.

    A file that is missing, truncated, of another kind, newer or inconsistent raises InputError.
    """
    with hdf5.open_kind(path, kind=LIBRARY_KIND, format_version=LIBRARY_FORMAT, remedy=_REMEDY) as file:
        most_mb = limit("memory_mb", 1e-6 * max(_BYTES, Path(path).stat().st_size * _EXPANSION))
        taken_mb = 1e-6 * _BYTES_OF_A_SIZE * max(file[name].size for name in (*_AMPLITUDES, "error"))
        if taken_mb > most_mb:
            expected = f"at most {1e6 * most_mb / _BYTES_OF_A_SIZE:.3g} sizes"
            raise beyond(str(path), "sizes", "memory_mb", expected, f"{file['t_xx'].shape}")
        wavelength_nm, length_nm, width_nm = (np.asarray(file[name][()], dtype=np.float64) for name in _AXES)
        t_xx, t_yy, r_xx, r_yy = amplitudes = [_complex(file, name) for name in _AMPLITUDES]
        error = np.asarray(file["error"][()], dtype=np.float64)
        shape = (wavelength_nm.size, length_nm.size, width_nm.size)
        for name, values in zip((*_AMPLITUDES, "error"), (*amplitudes, error), strict=True):
            if values.shape != shape:
                raise InputError.single(str(path), name, f"shape {shape}", f"shape {values.shape}", _REMEDY)
        model_error = np.asarray(file["model/error"][()], dtype=np.float64) if "model/error" in file else None
        if model_error is not None and model_error.shape != shape[1:]:
            raise InputError.single(str(path), "model/error", f"shape {shape[1:]}", f"{model_error.shape}", _REMEDY)
        model = None
        if "model" in file:
            parts = [[_complex(file, f"model/{axis}/{part}") for axis in "xy"] for part in ("numerator", "denominator")]
            model = _checked(file["model/x"], (1, 0), np.stack(parts[0]), np.stack(parts[1]))
        return Library(
            embedded_unit_cell(str(file.attrs["unit_cell_toml"]), Path(path)),
            wavelength_nm,
            width_nm,
            length_nm,
            t_xx=t_xx,
            t_yy=t_yy,
            r_xx=r_xx,
            r_yy=r_yy,
            error=error,
            inputs_sha256=str(file.attrs["inputs_sha256"]),
            statistics=_statistics(BuildStatistics, file, _DETAIL),
            model=model,
            model_error=model_error,
            corners=_corners(file["corners"]) if "corners" in file else None,
            neighbours=neighbours_of(file["neighbours"]) if "neighbours" in file else None,
        )


def is_current(path: Path, unit_cell: UnitCell) -> bool:
    """Return whether ``path`` is a library that this version built from exactly this unit cell and target error."""
    try:
        with hdf5.open_kind(path, kind=LIBRARY_KIND, format_version=LIBRARY_FORMAT, remedy=_REMEDY) as file:
            return str(file.attrs["inputs_sha256"]) == inputs_of(unit_cell)
    except InputError:
        return False


def statistics_json(library: Library) -> dict[str, float | str]:
    """Return the statistics of a build as one JSON table, without figures that do not apply to the library (NaN).

    Those of corners have the prefix ``corner_``, those of the model of neighbours ``neighbours_``.
    """
    table: dict[str, float | str] = plain(library.statistics)
    if library.neighbours is not None:
        table |= {f"neighbours_{name}": value for name, value in plain(library.neighbours.overall).items()}
    if library.corners is not None:
        table |= {f"corner_{name}": value for name, value in plain(library.corners.statistics).items()}
    return {name: value for name, value in table.items() if value is not None}


def _put_statistics(group: h5py.Group, statistics: BuildStatistics | CornerStatistics, prefix: str) -> None:
    for name, value in vars(statistics).items():
        if isinstance(value, str) or not math.isnan(value):
            group.attrs[prefix + name] = value


def _statistics(kind: type[Statistics], group: h5py.Group, prefix: str) -> Statistics:
    """Statistics from attributes; missing ones take their defaults."""
    stored = {name: value for name, value in vars(kind()).items() if prefix + name in group.attrs}
    return kind(**{name: type(default)(group.attrs[prefix + name]) for name, default in stored.items()})


def _put_model(file: h5py.File, model: RationalModel) -> None:
    """Write ``/model/x`` and ``/model/y``, the coefficients of each polarisation."""
    for axis, numerator, denominator in zip("xy", model.numerator, model.denominator, strict=True):
        group = file.create_group(f"model/{axis}")
        group.attrs["degrees"] = model.shape.degrees
        _put_spans(group, model, "of the model")
        basis = "of T_i(u) T_j(v), i + j up to the degree, by i, then j; u, v in -1..1 over width, length"
        text = f"coefficients of t_{axis}{axis} and r_{axis}{axis} {basis}"
        hdf5.put(group, "numerator", numerator, units="1", description=text)
        hdf5.put(group, "denominator", denominator, units="1", description=f"coefficients {basis}")


def _put_corners(group: h5py.Group, corners: Corners) -> None:
    group.attrs["factor"], group.attrs["floor"] = corners.safety_factor, corners.floor
    _put_statistics(group, corners.statistics, _CORNER_DETAIL)
    text = "solved cells as points of a cube -1..1: width and length as made, then the axes but the bias"
    hdf5.put(group, "place", corners.place, units="1", description=text, compress=True)
    text = "solver's error of each solved cell"
    hdf5.put(group, "certificate", corners.certificate, units="1", description=text, compress=True)
    for k, model in enumerate((corners.models.best, *corners.models.rivals)):
        part = group.create_group(f"model_{k}")
        part.attrs["degrees"], part.attrs["axis_weight"] = model.shape.degrees, model.shape.weight
        part.attrs["variables"], part.attrs["sizes"] = model.shape.variables, model.shape.sizes
        _put_spans(part, model, "as made")
        basis = "of T_i(u) T_j(v) T_k(axis)..., i + j + weight k up to the degree, k slowest, then i, then j"
        text = f"coefficients by polarisation, term and (t, r) {basis}"
        hdf5.put(part, "numerator", model.numerator, units="1", description=text, compress=True)
        text = f"coefficients by polarisation and term {basis}"
        hdf5.put(part, "denominator", model.denominator, units="1", description=text, compress=True)


def _corners(group: h5py.Group) -> Corners:
    models = []
    for name in sorted(name for name in group if name.startswith("model_")):
        part = group[name]
        # Files that are older than axes in libraries of circles have no attribute `sizes`.
        further = *(int(part.attrs[name]) for name in ("axis_weight", "variables")), int(part.attrs.get("sizes", 2))
        models.append(_checked(part, further, _complex(part, "numerator"), _complex(part, "denominator")))
    place, certificate = (np.asarray(group[key][()], dtype=np.float64) for key in ("place", "certificate"))
    safety_factor, floor = (float(group.attrs[key]) for key in ("factor", "floor"))
    statistics = _statistics(CornerStatistics, group, _CORNER_DETAIL)
    return Corners(RankedModels(models[0], tuple(models[1:])), safety_factor, floor, place, certificate, statistics)


def _checked(
    group: h5py.Group, further: tuple[int, ...], numerator: ComplexArray, denominator: ComplexArray
) -> RationalModel:
    """Model with the degrees and ranges stored in ``group``; KeyError if the coefficients do not fit the degrees.

    ``further`` are the further fields of its shape.
    """
    above, below = (int(degree) for degree in group.attrs["degrees"])
    width_nm, length_nm = _span(group, "width_nm"), _span(group, "length_nm")
    shape = Shape((above, below), *further)
    if (numerator.shape, denominator.shape) != ((2, shape.terms[0], 2), (2, shape.terms[1])):
        raise KeyError(f"coefficients of degrees {above}, {below} in {group.name}")
    return RationalModel(width_nm, length_nm, shape, numerator, denominator)


def _put_spans(group: h5py.Group, model: RationalModel, range_of: str) -> None:
    for side, span_nm in (("width", model.width_nm), ("length", model.length_nm)):
        hdf5.put(group, f"{side}_nm", span_nm, units="nm", description=f"smallest and largest {side} {range_of}")


def _span(group: h5py.Group, name: str) -> Range:
    low, high = group[name][()]
    return float(low), float(high)


def _complex(group: h5py.Group, name: str) -> ComplexArray:
    return np.asarray(group[name][()], dtype=np.complex128)
