"""Readers by named dimensions (xarray, netCDF) refuse an array with scales on some of its axes and none on others."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from metafab import optics
from metafab.optics.store import save
from tests.closed_form_run import turning_psf
from tests.conftest import MainJob


def half_scaled(path: Path) -> list[str]:
    """Arrays of a file with some axes scaled and others not, or with a scale of another length."""
    faulty = []

    def look(name: str, item: h5py.Dataset | h5py.Group) -> None:
        if not isinstance(item, h5py.Dataset) or item.is_scale:
            return
        scaled = [len(item.dims[axis]) for axis in range(item.ndim)]
        lengths = [item.dims[axis][0].size if count else None for axis, count in enumerate(scaled)]
        if 0 < sum(map(bool, scaled)) < item.ndim or (any(scaled) and tuple(lengths) != item.shape):
            faulty.append(f"{path.name}:{name} {scaled}")

    with h5py.File(path) as file:
        file.visititems(look)
    return faulty


def test_every_axis_of_a_psf_pair_over_the_field_is_scaled(tmp_path: Path) -> None:
    save(turning_psf(), tmp_path / "psf.h5")
    assert half_scaled(tmp_path / "psf.h5") == []
    with h5py.File(tmp_path / "psf.h5") as file:
        of_field = [scale[0].name for scale in file["field/centre_um"].dims]
        assert of_field == ["/polarisation", "/depth_m", "/field/tangent_y", "/field/tangent_x", "/axis"]


def test_a_file_without_the_scale_of_the_last_axis_loads(tmp_path: Path) -> None:
    path = tmp_path / "psf.h5"
    save(turning_psf(), path)
    with h5py.File(path, "a") as file:
        for array in (file["centre_um"], file["field/centre_um"]):
            array.dims[array.ndim - 1].detach_scale(file["axis"])
        del file["axis"]
    assert len(half_scaled(path)) == 2  # as files were before
    assert np.array_equal(optics.load(path).psf, turning_psf().psf)


def test_every_array_of_a_run_is_scaled_wholly_or_not_at_all(main_job: MainJob) -> None:
    paths = [*main_job.folder.rglob("*.h5"), *main_job.folder.parent.glob("*.h5")]
    assert {"psf.h5", "ideal_psf.h5", "raw.h5", "decoded.h5"} <= {path.name for path in paths}
    assert [fault for path in paths for fault in half_scaled(path)] == []
