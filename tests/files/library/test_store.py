"""Library files: they come back exactly, open with plain h5py, and bad ones are refused with what to do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from metafab import library
from metafab.core.errors import InputError
from metafab.core.storage.hdf5 import SEAL_BYTES
from metafab.library import Library
from metafab.library.library import inputs_of
from metafab.spec import UnitCell
from metafab.spec.toml import unit_cell_of_library
from tests import library_ridges as ridges


@pytest.fixture(scope="module")
def built(unit_cell: UnitCell) -> Library:
    return library.build(replace(unit_cell, sweep=replace(unit_cell.sweep, size_grid_nm=5.0)), solver=ridges.solve)


@pytest.fixture
def path(built: Library, tmp_path: Path) -> Path:
    library.save(built, tmp_path / "library.h5")
    return tmp_path / "library.h5"


def test_a_library_comes_back_exactly(built: Library, path: Path) -> None:
    again = library.load(str(path))
    for name in ("wavelength_nm", "width_nm", "length_nm", "t_xx", "t_yy", "r_xx", "r_yy", "error"):
        assert np.array_equal(getattr(again, name), getattr(built, name)), name
    assert again.unit_cell == built.unit_cell == unit_cell_of_library(path)
    assert again.statistics == built.statistics
    sizes = np.random.default_rng(1).uniform(100.0, 250.0, (2, 50))
    assert np.array_equal(library.evaluate(again, *sizes).t_xx, library.evaluate(built, *sizes).t_xx)


def test_datasets_are_described_and_have_scales(path: Path) -> None:
    with h5py.File(path) as file:
        for name in ("t_xx", "t_yy", "r_xx", "r_yy", "error"):
            dataset = file[name]
            assert dataset.attrs["units"] == "1"
            assert dataset.attrs["description"]
            assert dataset.dims[2][0].name == "/width_nm"
            assert dataset.dims[1][0].name == "/length_nm"
        assert file["t_xx"].dtype == np.complex128
    assert path.stat().st_size < 5_000_000


def test_a_file_is_current_for_its_own_unit_cell_only(built: Library, path: Path, unit_cell: UnitCell) -> None:
    assert library.is_current(path, built.unit_cell)
    assert not library.is_current(path, unit_cell)
    assert not library.is_current(path.with_name("none.h5"), unit_cell)


def test_a_corner_is_not_saved_as_if_it_were_the_library(smooth_library: Library, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cd_bias_nm = 5"):
        library.save(replace(smooth_library, corner={"cd_bias_nm": 5.0}), tmp_path / "corner.h5")
    assert not list(tmp_path.iterdir())


def test_bad_files_are_refused(path: Path, tmp_path: Path) -> None:
    whole = path.read_bytes()
    cases = {"missing": None, "empty": b"", "foreign": b"not a library", "truncated": whole[: len(whole) // 2]}
    for name, content in cases.items():
        bad = tmp_path / f"{name}.h5"
        if content is not None:
            bad.write_bytes(content)
        with pytest.raises(InputError, match="metafab library build"):
            library.load(bad)


def test_missing_and_misshapen_datasets_are_refused(path: Path) -> None:
    with h5py.File(path, "a") as file:
        values = file["t_yy"][()]
        del file["t_yy"]
    with pytest.raises(InputError, match="t_yy"):
        library.load(path)
    with h5py.File(path, "a") as file:
        file["t_yy"] = values[:, :-1]
    with pytest.raises(InputError, match="shape"):
        library.load(path)


def test_a_small_file_holds_no_library_of_millions_of_sizes(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-SEAL_BYTES])
    with h5py.File(path, "r+") as file:
        del file["t_xx"]
        file.create_dataset("t_xx", (1, 2000, 1000), "c16", chunks=(1, 1000, 1000), compression="gzip")
    with pytest.raises(InputError, match=r"at most 1e\+06 sizes"):
        library.load(path)


def test_the_library_of_a_moved_project_is_the_same_file(smooth_library: Library, tmp_path: Path) -> None:
    contents = []
    for place in ("here", "some/where/else"):
        folder = tmp_path / place
        folder.mkdir(parents=True)
        (folder / "glass.csv").write_text("wavelength_nm,n,k\n600,2.41,0\n1000,2.39,0\n")
        materials = smooth_library.unit_cell.materials
        glass = replace(materials.pillar, n=None, record=str(folder / "glass.csv"))
        cell = replace(smooth_library.unit_cell, materials=replace(materials, pillar=glass))
        path = folder / "glass.h5"
        library.save(replace(smooth_library, unit_cell=cell, inputs_sha256=inputs_of(cell)), path)
        assert library.load(path).unit_cell == unit_cell_of_library(path) == cell
        assert library.is_current(path, cell)
        contents.append(path.read_bytes())
    assert contents[0] == contents[1]
