"""Save and load PSF stacks (``psf.h5``)."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import h5py
import numpy as np

from metafab.core.errors import Fault, InputError
from metafab.core.storage import hdf5
from metafab.core.storage.files import plain, untimed
from metafab.optics.point_spread import NeighbourMap, Psf, PsfDetails, PsfField

#: Units, description and dimensions of datasets by name.
Datasets: TypeAlias = dict[str, tuple[str, str, tuple[str, ...]]]

PSF_KIND = "metafab psf"
PSF_FORMAT = 1

_REMEDY = "write it with `metafab psf LAYOUT --design DESIGN.toml -o PSF.h5`"
_IRRADIANCE = "irradiance at pixel centres per unit power of that polarisation at the aperture"
_CENTRE = "(x, y) on the sensor of each centre pixel"
_TANGENT = "object direction, tangent of the angle to the axis"
_STACK = ("polarisation", "depth_m")
_FIELD = (*_STACK, "tangent_y", "tangent_x")

#: Datasets by their attributes in :class:`Psf`: units, description, dimensions.
_DATASETS = {
    "depth_m": ("m", "object distance along the axis", ("depth_m",)),
    "psf": ("1/um^2", _IRRADIANCE, (*_STACK, "y_um", "x_um")),
    "centre_um": ("um", _CENTRE, (*_STACK, "axis")),
    "phi_deg": ("degree", "orientation of the main lobe of PSF_x", ("depth_m",)),
    "error": ("1", "relative L2 error of the irradiance", ("depth_m",)),
    "efficiency": ("1", "share of the power that falls into the window", _STACK),
    "extinction_ratio": ("1", "wanted over unwanted power in the window of PSF_x", ("depth_m",)),
}
#: Datasets of the group ``field`` by their attributes in :class:`PsfField`.
_FIELD_DATASETS = {
    "tangent_x": ("1", _TANGENT, ("tangent_x",)),
    "tangent_y": ("1", _TANGENT, ("tangent_y",)),
    "psf": ("1/um^2", "irradiance at pixel centres over the field of view", (*_FIELD, "y_um", "x_um")),
    "centre_um": ("um", _CENTRE, (*_FIELD, "axis")),
}
#: Datasets of the group ``neighbours`` by their attributes in :class:`NeighbourMap`.
_NEIGHBOUR_DATASETS = {
    "x_um": ("um", "centres of the blocks of pillars", ("x_um",)),
    "y_um": ("um", "centres of the blocks of pillars", ("y_um",)),
    "change": (
        "1",
        "rms change of the amplitudes by unlike neighbours, over their rms",
        ("polarisation", "y_um", "x_um"),
    ),
    "kept": ("1", "light in the wave of pillars among equal ones, over its light", ("polarisation", "y_um", "x_um")),
}


def save(psf: Psf, path: Path | str, *, inputs_sha256: str = "") -> None:
    """Write ``psf`` to ``path``, whole or not at all; ``inputs_sha256`` is the fingerprint of its inputs."""
    with hdf5.create(path, kind=PSF_KIND, format_version=PSF_FORMAT, inputs_sha256=inputs_sha256) as file:
        put(file, psf)


def put(group: h5py.Group, psf: Psf) -> None:
    """Write ``psf`` into a group of an open file, as :func:`save` does into a file of its own."""
    group.attrs["details"] = json.dumps(plain(untimed(psf.details.figures())))
    group.attrs["sensor_distance_um"] = psf.sensor_distance_um
    hdf5.put(group, "pixel_um", psf.pixel_um, units="um", description="sampling step on the sensor plane")
    hdf5.put(group, "polarisation", [b"x", b"y"], units="1", description="polarisation", dims=("polarisation",))
    hdf5.put(group, "axis", [b"x", b"y"], units="1", description="coordinate on the sensor", dims=("axis",))
    for name, count in zip(("y_um", "x_um"), psf.psf.shape[2:], strict=True):
        offsets = (np.arange(count) - count // 2) * psf.pixel_um
        hdf5.put(group, name, offsets, units="um", description="from the window's centre pixel", dims=(name,))
    _put_stack(group, psf)
    if psf.aperture_um is not None:
        about = "points of the aperture that carry equal shares of its power"
        numbers = np.arange(len(psf.aperture_um))
        hdf5.put(group, "point", numbers, units="1", description="number of the point", dims=("point",))
        hdf5.put(group, "aperture_um", psf.aperture_um, units="um", description=about, dims=("point", "axis"))
    if psf.ghost is not None:
        _put_stack(group.create_group("ghost"), psf.ghost)
    if psf.neighbours is not None:
        _put_all(group.create_group("neighbours"), psf.neighbours, _NEIGHBOUR_DATASETS)


def _put_stack(group: h5py.Group, psf: Psf) -> None:
    _put_all(group, psf, _DATASETS)
    if psf.field is not None:
        _put_all(group.create_group("field"), psf.field, _FIELD_DATASETS)


def _put_all(group: h5py.Group, result: Psf | PsfField | NeighbourMap, datasets: Datasets) -> None:
    for name, (units, description, dims) in datasets.items():
        data, compress = getattr(result, name), name == "psf"
        hdf5.put(group, name, data, units=units, description=description, dims=dims, compress=compress)


def load(path: Path | str) -> Psf:
    """Read a file that :func:`save` wrote.

    InputError if the file is missing, truncated, foreign or of a newer format, or its arrays do not fit together.
    """
    with hdf5.open_kind(Path(path), kind=PSF_KIND, format_version=PSF_FORMAT, remedy=_REMEDY) as file:
        psf = replace(
            _stack(file, file),
            details=_details(str(file.attrs["details"])),
            ghost=_stack(file, file["ghost"]) if "ghost" in file else None,
            aperture_um=file["aperture_um"][...] if "aperture_um" in file else None,
            neighbours=_neighbours(file["neighbours"]) if "neighbours" in file else None,
        )
    _check(psf, Path(path))
    return psf


def _stack(file: h5py.File, group: h5py.Group) -> Psf:
    """The pair in a group; the sampling is that of the file."""
    return Psf(
        pixel_um=float(file["pixel_um"][()]),
        sensor_distance_um=float(file.attrs["sensor_distance_um"]),
        field=PsfField(**{name: group["field"][name][...] for name in _FIELD_DATASETS}) if "field" in group else None,
        **{name: group[name][...].astype(np.float64) for name in _DATASETS},
    )


def _neighbours(group: h5py.Group) -> NeighbourMap:
    return NeighbourMap(**{name: group[name][...] for name in _NEIGHBOUR_DATASETS})


def _details(text: str) -> PsfDetails:
    """Details from JSON, in which NaN is null and infinity is a text."""
    figures = {name: math.nan if value is None else value for name, value in json.loads(text).items()}
    numbers = {k: float(v) for k, v in figures.items() if isinstance(v, int | float) or v in {"inf", "-inf"}}
    return PsfDetails.of_figures(numbers)


def _check(psf: Psf, path: Path) -> None:
    """Refuse arrays that do not fit together, all faults at once."""
    size = {"polarisation": 2, "axis": 2, "depth_m": psf.depth_m.size}
    size |= dict(zip(("y_um", "x_um"), psf.psf.shape[2:], strict=False))
    faults = _shape_faults("", psf, _DATASETS, size)
    if psf.field is not None:
        size |= {"tangent_x": psf.field.tangent_x.size, "tangent_y": psf.field.tangent_y.size}
        faults += _shape_faults("field/", psf.field, _FIELD_DATASETS, size)
    if psf.ghost is not None:
        faults += _ghost_faults(psf, psf.ghost, size)
    if (found := psf.neighbours) is not None:
        blocks = size | {"x_um": found.x_um.size, "y_um": found.y_um.size}
        faults += _shape_faults("neighbours/", found, _NEIGHBOUR_DATASETS, blocks)
    if psf.depth_m.size == 0 or np.any(np.diff(psf.depth_m) <= 0.0):
        faults.append(Fault("depth_m", "ascending depths", str(psf.depth_m)))
    if psf.aperture_um is not None and not (
        psf.aperture_um.shape == (len(psf.aperture_um), 2)
        and len(psf.aperture_um)
        and np.isfinite(psf.aperture_um).all()
    ):
        faults.append(Fault("aperture_um", "finite points, shape (n, 2)", f"shape {psf.aperture_um.shape}", _REMEDY))
    if not np.all(np.isfinite(psf.psf)):
        faults.append(Fault("psf", "finite irradiance", "NaN or infinity", _REMEDY))
    if faults:
        raise InputError(str(path), faults)


def _ghost_faults(psf: Psf, ghost: Psf, size: dict[str, int]) -> list[Fault]:
    """Faults of the pair that a birefringent substrate adds."""
    faults = _shape_faults("ghost/", ghost, _DATASETS, size)
    if psf.field is not None and ghost.field is not None:
        faults += _shape_faults("ghost/field/", ghost.field, _FIELD_DATASETS, size)
    if (psf.field is None) != (ghost.field is None):
        expected = "a field in both the pair and the ghost, or in neither"
        faults.append(Fault("ghost/field", expected, "a field in one of them", _REMEDY))
    if not np.all(np.isfinite(ghost.psf)):
        faults.append(Fault("ghost/psf", "finite irradiance", "NaN or infinity", _REMEDY))
    return faults


def _shape_faults(
    prefix: str, result: Psf | PsfField | NeighbourMap, datasets: Datasets, size: dict[str, int]
) -> list[Fault]:
    faults = []
    for name, (_, _, dims) in datasets.items():
        expected, shape = tuple(size.get(dim, 0) for dim in dims), getattr(result, name).shape
        if shape != expected:
            faults.append(Fault(f"{prefix}{name}", f"shape {expected}", str(shape)))
    return faults
