"""A library as a file, and back: HDF5 with units, descriptions and dimension scales (kind "metafab library").

Besides the values on the grid, ``/model`` holds the coefficients of the continuous functions, so that a loaded
library is as continuous as a built one.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import h5py
import numpy as np

from metafab.core import hdf5
from metafab.core.errors import InputError
from metafab.library.library import Library, inputs_of
from metafab.library.models import SizeModel
from metafab.library.rational import RationalModel, terms
from metafab.spec import UnitCell, canonical_toml
from metafab.spec.embedded import LIBRARY_FORMAT, LIBRARY_KIND
from metafab.spec.load import validate

_REMEDY = "build it with `metafab library build UNITCELL.toml`"
_AMPLITUDES = {
    "t_xx": "zero-order transmission of x polarised light",
    "t_yy": "zero-order transmission of y polarised light",
    "r_xx": "zero-order reflection of x polarised light",
    "r_yy": "zero-order reflection of y polarised light",
}


def save(library: Library, path: Path) -> None:
    """Write a library, whole or not at all; an earlier file under the name is replaced."""
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


def load(path: Path) -> Library:
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
        text = str(file.attrs["unit_cell_toml"])
        prefix = "detail_"
        details = {
            name.removeprefix(prefix): _plain(value) for name, value in file.attrs.items() if name.startswith(prefix)
        }
        inputs = str(file.attrs["inputs_sha256"])
        model = SizeModel(_model(file["model/x"]), _model(file["model/y"])) if "model" in file else None
        model_error = np.asarray(file["model/error"][()], dtype=np.float64) if "model/error" in file else None
        if model_error is not None and model_error.shape != shape[1:]:
            raise InputError.single(str(path), "model/error", f"shape {shape[1:]}", f"{model_error.shape}", _REMEDY)
    unit_cell = validate(UnitCell, tomllib.loads(text), str(path))
    return Library(
        unit_cell,
        wavelength_nm,
        width_nm,
        length_nm,
        **amplitudes,
        error=error,
        inputs_sha256=inputs,
        details=details,
        model=model,
        model_error=model_error,
    )


def is_current(path: Path, unit_cell: UnitCell) -> bool:
    """Whether ``path`` is a library that this version built from exactly this unit cell (and target error)."""
    try:
        with hdf5.open_kind(path, kind=LIBRARY_KIND, format_version=LIBRARY_FORMAT, remedy=_REMEDY) as file:
            return str(file.attrs["inputs_sha256"]) == inputs_of(unit_cell)
    except InputError:
        return False


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
