"""``psf.h5``: what is written is read, and what cannot be used is refused with its faults."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.optics import Psf, load, save
from metafab.optics.point_spread import PsfDetails
from tests.conjugate_pair import helix_psf

DEPTHS = np.array([0.0025, 0.0029, 0.0034])


@pytest.fixture(scope="module")
def stack() -> Psf:
    return helix_psf(DEPTHS, window_px=16, tangents=(np.array([-0.05, 0.05]), np.array([0.0])))


def test_a_file_gives_back_the_stack(stack: Psf, tmp_path: Path) -> None:
    fit = {"nothing": float("nan"), "all": float("inf")}
    details = PsfDetails(4, 9, (0.9, 0.8), (0.2, 0.1), field_error=1e-4, seconds=1.5, camera_fit=fit)
    stack = replace(stack, details=details)
    save(stack, tmp_path / "psf.h5")
    back = load(tmp_path / "psf.h5")
    for name in ("depth_m", "psf", "centre_um", "phi_deg", "error", "efficiency", "extinction_ratio", "aperture_um"):
        assert np.array_equal(getattr(back, name), getattr(stack, name)), name
    assert (back.pixel_um, back.sensor_distance_um) == (stack.pixel_um, stack.sensor_distance_um)
    assert back.field is not None and stack.field is not None
    for name in ("tangent_x", "tangent_y", "psf", "centre_um"):
        assert np.array_equal(getattr(back.field, name), getattr(stack.field, name)), name
    untimed = replace(details, camera_fit={}, seconds=0.0)
    assert replace(back.details, camera_fit={}) == untimed, "the same pair has the same bytes, however long it took"
    assert back.details.camera_fit["all"] == float("inf")
    assert np.isnan(back.details.camera_fit["nothing"])


def test_a_stack_of_an_unknown_aperture_and_points_that_are_no_points(stack: Psf, tmp_path: Path) -> None:
    save(replace(stack, aperture_um=None), tmp_path / "unknown.h5")
    assert load(tmp_path / "unknown.h5").aperture_um is None
    save(replace(stack, aperture_um=np.array([[0.0, np.nan]])), tmp_path / "bad.h5")
    with pytest.raises(InputError, match="aperture_um"):
        load(tmp_path / "bad.h5")


def test_the_contracts_datasets_carry_units_and_scales(stack: Psf, tmp_path: Path) -> None:
    save(stack, tmp_path / "psf.h5")
    with h5py.File(tmp_path / "psf.h5") as file:
        assert file["psf"].shape == (2, 3, 16, 16)
        assert [dim[0].name for dim in file["psf"].dims] == ["/polarisation", "/depth_m", "/y_um", "/x_um"]
        for name in ("depth_m", "pixel_um", "psf", "centre_um", "phi_deg", "error"):
            assert "units" in file[name].attrs and file[name].attrs["description"]
        assert file["psf"].attrs["units"] == "1/um^2"


def test_the_same_stack_gives_the_same_bytes(stack: Psf, tmp_path: Path) -> None:
    for name in ("a.h5", "b.h5"):
        save(stack, tmp_path / name)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


@pytest.mark.parametrize("damage", ["missing", "empty", "truncated", "text", "foreign"])
def test_unusable_files_are_refused(stack: Psf, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "psf.h5"
    if damage == "empty":
        path.touch()
    elif damage == "truncated":
        save(stack, path)
        os.truncate(path, path.stat().st_size // 2)
    elif damage == "text":
        path.write_text("depth_m = 3\n", encoding="utf-8")
    elif damage == "foreign":
        with h5py.File(path, "w") as file:
            file["psf"] = np.zeros((2, 3, 4, 4))
    with pytest.raises(InputError, match="metafab psf"):
        load(path)


def test_arrays_that_do_not_fit_are_all_named(stack: Psf, tmp_path: Path) -> None:
    path = tmp_path / "psf.h5"
    save(stack, path)
    with h5py.File(path, "a") as file:
        file["psf"][0, 0, 0, 0] = np.nan
        for name in ("phi_deg", "error"):
            del file[name]
            file[name] = np.zeros(7)
    with pytest.raises(InputError) as caught:
        load(path)
    assert {fault.field for fault in caught.value.faults} == {"psf", "phi_deg", "error"}


def test_a_missing_dataset_is_named(stack: Psf, tmp_path: Path) -> None:
    path = tmp_path / "psf.h5"
    save(stack, path)
    with h5py.File(path, "a") as file:
        del file["centre_um"]
    with pytest.raises(InputError, match="centre_um"):
        load(path)


def test_ghosts_of_a_substrate_are_stored_and_checked(stack: Psf, tmp_path: Path) -> None:
    assert stack.field is not None
    faint = replace(stack, psf=0.1 * stack.psf, field=replace(stack.field, psf=0.1 * stack.field.psf))
    save(replace(stack, ghost=faint), tmp_path / "psf.h5")
    back = load(tmp_path / "psf.h5")
    assert back.ghost is not None and back.ghost.field is not None
    assert np.array_equal(back.psf, stack.psf) and np.array_equal(back.ghost.psf, faint.psf)
    assert np.array_equal(back.ghost.field.psf, faint.field.psf)
    with h5py.File(tmp_path / "psf.h5", "r+") as file:
        del file["ghost/field"]
    with pytest.raises(InputError, match="ghost/field"):
        load(tmp_path / "psf.h5")
