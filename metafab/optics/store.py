"""Save and load PSF stacks (``psf.h5``)."""

from __future__ import annotations

import json
import math
from pathlib import Path

import h5py
import numpy as np

from metafab.core.errors import Fault, InputError
from metafab.core.storage import hdf5
from metafab.core.storage.files import plain, untimed
from metafab.optics.point_spread import Psf, PsfDetails, PsfField

PSF_KIND = "metafab psf"
PSF_FORMAT = 1

_REMEDY = "write it with `metafab psf LAYOUT --design DESIGN.toml -o PSF.h5`"


def save(psf: Psf, path: Path, *, inputs_sha256: str = "") -> None:
    """Write ``psf`` to ``path``, whole or not at all; ``inputs_sha256`` is the fingerprint of its inputs."""
    with hdf5.create(path, kind=PSF_KIND, format_version=PSF_FORMAT, inputs_sha256=inputs_sha256) as file:
        file.attrs["details"] = json.dumps(plain(untimed(psf.details.figures())))
        file.attrs["sensor_distance_um"] = psf.sensor_distance_um
        hdf5.put(file, "pixel_um", psf.pixel_um, units="um", description="sampling step on the sensor plane")
        hdf5.put(file, "polarisation", [b"x", b"y"], units="1", description="polarisation", dims=("polarisation",))
        hdf5.put(file, "axis", [b"x", b"y"], units="1", description="coordinate on the sensor", dims=("axis",))
        hdf5.put(
            file, "depth_m", psf.depth_m, units="m", description="object distance along the axis", dims=("depth_m",)
        )
        _put_offsets(file, "y_um", psf.psf.shape[2], psf.pixel_um)
        _put_offsets(file, "x_um", psf.psf.shape[3], psf.pixel_um)
        hdf5.put(
            file, "psf", psf.psf, units="1/um^2", compress=True,
            description="irradiance at pixel centres per unit power of that polarisation at the aperture",
            dims=("polarisation", "depth_m", "y_um", "x_um"),
        )  # fmt: skip
        hdf5.put(
            file, "centre_um", psf.centre_um, units="um", description="(x, y) on the sensor of each centre pixel",
            dims=("polarisation", "depth_m", "axis"),
        )  # fmt: skip
        for name, units, description, dims in (
            ("phi_deg", "degree", "orientation of the main lobe of PSF_x", ("depth_m",)),
            ("error", "1", "relative L2 error of the irradiance", ("depth_m",)),
            ("efficiency", "1", "share of the power that falls into the window", ("polarisation", "depth_m")),
            ("extinction_ratio", "1", "wanted over unwanted power in x's window", ("depth_m",)),
        ):
            hdf5.put(file, name, getattr(psf, name), units=units, description=description, dims=dims)
        if psf.field is not None:
            _put_field(file.create_group("field"), psf.field)


def load(path: Path | str) -> Psf:
    """Read a file that :func:`save` wrote.

    Raises:
        InputError: the file is missing, truncated, foreign or of a newer format, or its arrays do not fit together.
    """
    with hdf5.open_kind(Path(path), kind=PSF_KIND, format_version=PSF_FORMAT, remedy=_REMEDY) as file:
        psf = Psf(
            depth_m=file["depth_m"][...],
            pixel_um=float(file["pixel_um"][()]),
            psf=file["psf"][...].astype(np.float64),
            centre_um=file["centre_um"][...],
            phi_deg=file["phi_deg"][...],
            error=file["error"][...],
            efficiency=file["efficiency"][...],
            extinction_ratio=file["extinction_ratio"][...],
            sensor_distance_um=float(file.attrs["sensor_distance_um"]),
            field=_field(file["field"]) if "field" in file else None,
            details=_details(str(file.attrs["details"])),
        )
    _check(psf, Path(path))
    return psf


def _details(text: str) -> PsfDetails:
    """Details from JSON, in which NaN is null and infinity is a text."""
    figures = {name: math.nan if value is None else value for name, value in json.loads(text).items()}
    numbers = {k: float(v) for k, v in figures.items() if isinstance(v, int | float) or v in {"inf", "-inf"}}
    return PsfDetails.of_figures(numbers)


def _put_offsets(file: h5py.File, name: str, count: int, pixel_um: float) -> None:
    offsets = (np.arange(count) - count // 2) * pixel_um
    hdf5.put(file, name, offsets, units="um", description="from the window's centre pixel", dims=(name,))


def _put_field(group: h5py.Group, field: PsfField) -> None:
    for name in ("tangent_x", "tangent_y"):
        hdf5.put(
            group,
            name,
            getattr(field, name),
            units="1",
            description="object direction, tangent to the axis",
            dims=(name,),
        )
    dims = ("polarisation", "depth_m", "tangent_y", "tangent_x")
    hdf5.put(
        group, "psf", field.psf, units="1/um^2", compress=True,
        description="irradiance at pixel centres over the field of view", dims=(*dims, "y_um", "x_um"),
    )  # fmt: skip
    hdf5.put(
        group, "centre_um", field.centre_um, units="um", description="(x, y) on the sensor of each centre pixel",
        dims=(*dims, "axis"),
    )  # fmt: skip


def _field(group: h5py.Group) -> PsfField:
    return PsfField(group["tangent_x"][...], group["tangent_y"][...], group["psf"][...], group["centre_um"][...])


def _check(psf: Psf, path: Path) -> None:
    shape, n_depth = psf.psf.shape, psf.depth_m.size
    faults = []
    if len(shape) != 4 or shape[:2] != (2, n_depth):
        faults.append(Fault("psf", f"shape (2, {n_depth}, n_y, n_x)", str(shape)))
    for name, expected in (
        ("centre_um", (2, n_depth, 2)),
        ("phi_deg", (n_depth,)),
        ("error", (n_depth,)),
        ("efficiency", (2, n_depth)),
        ("extinction_ratio", (n_depth,)),
    ):
        got = getattr(psf, name).shape
        if got != expected:
            faults.append(Fault(name, f"shape {expected}", str(got)))
    if psf.field is not None:
        grid = (2, n_depth, psf.field.tangent_y.size, psf.field.tangent_x.size)
        if psf.field.psf.shape != (*grid, *shape[2:]):
            faults.append(Fault("field/psf", f"shape {(*grid, *shape[2:])}", str(psf.field.psf.shape)))
        if psf.field.centre_um.shape != (*grid, 2):
            faults.append(Fault("field/centre_um", f"shape {(*grid, 2)}", str(psf.field.centre_um.shape)))
    if n_depth == 0 or np.any(np.diff(psf.depth_m) <= 0.0):
        faults.append(Fault("depth_m", "ascending depths", str(psf.depth_m)))
    if not np.all(np.isfinite(psf.psf)):
        faults.append(Fault("psf", "finite irradiance", "NaN or infinity", _REMEDY))
    if faults:
        raise InputError(str(path), faults)
