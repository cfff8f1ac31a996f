"""A library as a file, and back: HDF5 with units, descriptions and dimension scales (kind "metafab library").

Besides the values on the grid, ``/model`` holds the coefficients of the continuous functions, so that a loaded
library is as continuous as a built one.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import h5py
import numpy as np

from metafab.core.errors import InputError
from metafab.core.storage import hdf5
from metafab.library.corners import Corners
from metafab.library.fit.corner_model import CornerModel, Shape
from metafab.library.fit.models import SizeModel
from metafab.library.fit.rational import RationalModel, terms
from metafab.library.library import Library, inputs_of
from metafab.spec import UnitCell, canonical_toml
from metafab.spec.embedded import LIBRARY_FORMAT, LIBRARY_KIND
from metafab.spec.toml import validate

_REMEDY = "build it with `metafab library build UNITCELL.toml`"
_AMPLITUDES = {
    "t_xx": "zero-order transmission of x polarised light",
    "t_yy": "zero-order transmission of y polarised light",
    "r_xx": "zero-order reflection of x polarised light",
    "r_yy": "zero-order reflection of y polarised light",
}


def save(library: Library, path: Path) -> None:
    """Write a library, whole or not at all; an earlier file under the name is replaced.

    The same build gives the same bytes, wherever and however fast it ran.
    """
    if library.corner:
        corner = ", ".join(f"{name} = {value:g}" for name, value in library.corner.items())
        remedy = "save the library that it is a corner of; `at` gives the corner again"
        raise InputError.single(str(path), "library.corner", "a library of the unit cell's own values", corner, remedy)
    dims = ("wavelength_nm", "length_nm", "width_nm")
    with hdf5.create(
        path, kind=LIBRARY_KIND, format_version=LIBRARY_FORMAT, inputs_sha256=library.inputs_sha256
    ) as file:
        file.attrs["unit_cell_toml"] = canonical_toml(library.unit_cell)
        for name, text in (
            ("wavelength_nm", "vacuum wavelength"),
            ("length_nm", "pillar size along y"),
            ("width_nm", "pillar size along x"),
        ):
            hdf5.put(file, name, getattr(library, name), units="nm", description=text, dims=(name,))
        for name, text in _AMPLITUDES.items():
            hdf5.put(file, name, getattr(library, name), units="1", description=text, dims=dims, compress=True)
        error = np.broadcast_to(library.error, library.t_xx.shape)
        text = "bound on the absolute error of each amplitude: solver certificate plus interpolation"
        hdf5.put(file, "error", error, units="1", description=text, dims=dims, compress=True)
        for name, value in library.details.items():
            file.attrs[f"detail_{name}"] = value
        if library.model is not None:
            for axis in ("x", "y"):
                _put_model(file.create_group(f"model/{axis}"), getattr(library.model, axis), axis)
        if library.model_error is not None:
            text = "error of the continuous model around each size: solver certificate plus interpolation"
            hdf5.put(file, "model/error", library.model_error, units="1", description=text, compress=True)
        if library.corners is not None:
            _put_corners(file.create_group("corners"), library.corners)


def _put_corners(group: h5py.Group, corners: Corners) -> None:
    group.attrs["factor"], group.attrs["floor"] = corners.factor, corners.floor
    for name, value in corners.details.items():
        group.attrs[f"detail_{name}"] = value
    text = "solved cells as points of a cube -1..1: width and length as made, then the axes but the bias"
    hdf5.put(group, "place", corners.place, units="1", description=text, compress=True)
    text = "solver's error of each solved cell"
    hdf5.put(group, "certificate", corners.certificate, units="1", description=text, compress=True)
    for k, model in enumerate(corners.models):
        part = group.create_group(f"model_{k}")
        part.attrs["degrees"], part.attrs["axis_weight"] = model.shape.degrees, model.shape.weight
        part.attrs["variables"] = model.shape.variables
        for side in ("width_nm", "length_nm"):
            text = f"smallest and largest {side.removesuffix('_nm')} as made"
            hdf5.put(part, side, getattr(model, side), units="nm", description=text)
        basis = "of T_i(u) T_j(v) T_k(axis)..., i + j + weight k up to the degree, k slowest, then i, then j"
        text = f"coefficients by polarisation, term and (t, r) {basis}"
        hdf5.put(part, "numerator", model.numerator, units="1", description=text, compress=True)
        text = f"coefficients by polarisation and term {basis}"
        hdf5.put(part, "denominator", model.denominator, units="1", description=text, compress=True)


def _corners(group: h5py.Group) -> Corners:
    models = []
    for name in sorted(name for name in group if name.startswith("model_")):
        part = group[name]
        above, below = (int(degree) for degree in part.attrs["degrees"])
        shape = Shape((above, below), int(part.attrs["axis_weight"]), int(part.attrs["variables"]))
        width, length = (tuple(float(edge) for edge in part[side][()]) for side in ("width_nm", "length_nm"))
        numerator, denominator = (
            np.asarray(part[key][()], dtype=np.complex128) for key in ("numerator", "denominator")
        )
        if (numerator.shape, denominator.shape) != ((2, shape.terms[0], 2), (2, shape.terms[1])):
            raise KeyError(f"coefficients of degrees {above}, {below} in {part.name}")
        models.append(CornerModel((width[0], width[1]), (length[0], length[1]), shape, numerator, denominator))
    place, certificate = (np.asarray(group[key][()], dtype=np.float64) for key in ("place", "certificate"))
    factor, floor = (float(group.attrs[key]) for key in ("factor", "floor"))
    return Corners(tuple(models), factor, floor, place, certificate, _details(group))


def load(path: Path | str) -> Library:
    """Read a library.

    Raises:
        InputError: the file is missing, truncated, foreign, of a newer format, or its content does not fit together.
    """
    with hdf5.open_kind(path, kind=LIBRARY_KIND, format_version=LIBRARY_FORMAT, remedy=_REMEDY) as file:
        wavelength_nm, width_nm, length_nm = (
            np.asarray(file[name][()], dtype=np.float64) for name in ("wavelength_nm", "width_nm", "length_nm")
        )
        amplitudes = {name: np.asarray(file[name][()], dtype=np.complex128) for name in _AMPLITUDES}
        error = np.asarray(file["error"][()], dtype=np.float64)
        shape = (wavelength_nm.size, length_nm.size, width_nm.size)
        for name, values in {**amplitudes, "error": error}.items():
            if values.shape != shape:
                raise InputError.single(str(path), name, f"shape {shape}", f"shape {values.shape}", _REMEDY)
        table = tomllib.loads(str(file.attrs["unit_cell_toml"]))
        details = _details(file)
        inputs = str(file.attrs["inputs_sha256"])
        model = SizeModel(_model(file["model/x"]), _model(file["model/y"])) if "model" in file else None
        model_error = np.asarray(file["model/error"][()], dtype=np.float64) if "model/error" in file else None
        if model_error is not None and model_error.shape != shape[1:]:
            raise InputError.single(str(path), "model/error", f"shape {shape[1:]}", f"{model_error.shape}", _REMEDY)
        corners = _corners(file["corners"]) if "corners" in file else None
    unit_cell = validate(UnitCell, table, str(path))
    return Library(
        unit_cell,
        wavelength_nm,
        width_nm,
        length_nm,
        t_xx=amplitudes["t_xx"],
        t_yy=amplitudes["t_yy"],
        r_xx=amplitudes["r_xx"],
        r_yy=amplitudes["r_yy"],
        error=error,
        inputs_sha256=inputs,
        details=details,
        model=model,
        model_error=model_error,
        corners=corners,
    )


def is_current(path: Path, unit_cell: UnitCell) -> bool:
    """Whether ``path`` is a library that this version built from exactly this unit cell (and target error)."""
    try:
        with hdf5.open_kind(path, kind=LIBRARY_KIND, format_version=LIBRARY_FORMAT, remedy=_REMEDY) as file:
            return str(file.attrs["inputs_sha256"]) == inputs_of(unit_cell)
    except InputError:
        return False


def _details(group: h5py.Group) -> dict[str, float | str]:
    prefix = "detail_"
    return {name.removeprefix(prefix): _plain(value) for name, value in group.attrs.items() if name.startswith(prefix)}


def _plain(value: object) -> float | str:
    return str(value) if isinstance(value, str) else float(np.asarray(value).item())


def _put_model(group: h5py.Group, model: RationalModel, axis: str) -> None:
    group.attrs["degrees"] = model.degrees
    for name in ("width_nm", "length_nm"):
        text = f"smallest and largest {name.removesuffix('_nm')} of the model"
        hdf5.put(group, name, getattr(model, name), units="nm", description=text)
    basis = "of T_i(u) T_j(v), i + j up to the degree, by i, then j; u, v in -1..1 over width, length"
    hdf5.put(
        group,
        "numerator",
        model.numerator,
        units="1",
        description=f"coefficients of t_{axis}{axis} and r_{axis}{axis} {basis}",
    )
    hdf5.put(group, "denominator", model.denominator, units="1", description=f"coefficients {basis}")


def _model(group: h5py.Group) -> RationalModel:
    above, below = (int(degree) for degree in group.attrs["degrees"])
    width, length = (tuple(float(edge) for edge in group[name][()]) for name in ("width_nm", "length_nm"))
    numerator = np.asarray(group["numerator"][()], dtype=np.complex128)
    denominator = np.asarray(group["denominator"][()], dtype=np.complex128)
    if numerator.shape != (terms(above), 2) or denominator.shape != (terms(below),):
        raise KeyError(f"coefficients of degrees {above}, {below} in {group.name}")
    return RationalModel((width[0], width[1]), (length[0], length[1]), (above, below), numerator, denominator)
