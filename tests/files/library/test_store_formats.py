"""Libraries of every released format keep loading: files written here as that release wrote them."""

from __future__ import annotations

import math
from pathlib import Path

import h5py
import numpy as np

from metafab import library
from metafab.core.figures import BuildStatistics

#: The unit cell as format 1 of version 0.1 stored it: no key that came later.
UNIT_CELL = """
source = ""
[cell]
period_nm = [350.0, 350.0]
height_nm = 600.0
shape = "rectangle"
[materials.pillar]
n = 3.6941
k = 0.0065
n_error = 0.01
[materials.substrate]
n = 1.7601
k = 0.0
n_error = 0.0
[materials.ambient]
n = 1.0
k = 0.0
n_error = 0.0
[illumination]
wavelength_nm = 800.0
side = "substrate"
[sweep]
width_nm = [100.0, 120.0]
length_nm = [100.0, 120.0]
size_grid_nm = 4.0
target_error = 0.002
[solver]
name = "rcwa"
"""


def write_format_1(path: Path, *, continuous: bool) -> np.ndarray:
    """A file of format 1 by plain h5py; t_xx = (1 + u / 2) / (1 + 0.1 v), u and v in -1..1. Returns t_xx."""
    side = np.linspace(100.0, 120.0, 6)
    u, v = np.meshgrid((side - 110.0) / 10.0, (side - 110.0) / 10.0)
    t = ((1.0 + 0.5 * u) / (1.0 + 0.1 * v)).astype(np.complex128)
    with h5py.File(path, "w") as file:
        file.attrs.update(kind="metafab library", format_version=1, inputs_sha256="0" * 64, metafab_version="0.1.0")
        file.attrs["unit_cell_toml"] = UNIT_CELL
        file.attrs["detail_points_solved"] = 36
        file["wavelength_nm"], file["length_nm"], file["width_nm"] = np.array([800.0]), side, side
        for name, values in (("t_xx", t), ("t_yy", t.T), ("r_xx", 0.1 * t), ("r_yy", 0.1 * t.T)):
            file[name] = values[None]
        file["error"] = np.full((1, 6, 6), 1e-3)
        if continuous:
            for axis in ("x", "y"):
                group = file.create_group(f"model/{axis}")
                group.attrs["degrees"] = (1, 1)
                group["width_nm"] = group["length_nm"] = np.array([100.0, 120.0])
                # Terms by i, then j: 1, T_1(v), T_1(u).
                own, other = (2, 1) if axis == "x" else (1, 2)
                numerator, denominator = np.zeros((3, 2), dtype=complex), np.zeros(3, dtype=complex)
                numerator[0], numerator[own] = (1.0, 0.1), (0.5, 0.05)
                denominator[0], denominator[other] = 1.0, 0.1
                group["numerator"], group["denominator"] = numerator, denominator
            file["model/error"] = np.full((6, 6), 1.5e-3)
    return t


def test_format_1_with_a_model(tmp_path: Path) -> None:
    t = write_format_1(tmp_path / "old.h5", continuous=True)
    old = library.load(tmp_path / "old.h5")
    assert np.array_equal(old.t_xx[0], t)
    assert old.statistics == BuildStatistics(points_solved=36)
    assert old.corners is None
    assert old.unit_cell.sweep.axes is None
    held = library.evaluate(old, 113.0, 104.5)
    # u = 0.3, v = -0.55; the spline may add a tenth of the target.
    assert math.isclose(held.t_xx.real, 1.15 / 0.945, abs_tol=2e-4)
    assert math.isclose(held.t_yy.real, (1.0 - 0.275) / 1.03, abs_tol=2e-4)
    assert held.error >= 1.5e-3


def test_format_1_on_a_grid_alone(tmp_path: Path) -> None:
    t = write_format_1(tmp_path / "old.h5", continuous=False)
    old = library.load(tmp_path / "old.h5")
    assert old.model is None
    assert old.at_sizes(104.0, 116.0).t_xx == t[4, 1]
    assert library.build_size_table(old, database_unit_nm=0.5, cells=8).size_dbu.shape == (37, 2)


def test_an_old_library_written_again_says_the_same(tmp_path: Path) -> None:
    write_format_1(tmp_path / "old.h5", continuous=True)
    old = library.load(tmp_path / "old.h5")
    library.save(old, tmp_path / "new.h5")
    new = library.load(tmp_path / "new.h5")
    assert new.unit_cell == old.unit_cell
    assert np.array_equal(new.t_yy, old.t_yy)
    assert np.array_equal(new.surface.tiles.coefficients, old.surface.tiles.coefficients)
    with h5py.File(tmp_path / "new.h5") as file:
        assert int(file.attrs["format_version"]) == 1
        assert "corners" not in file
