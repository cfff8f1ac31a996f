"""``metafab cell`` on unit cells with sloped walls, diffraction and birefringent substrates."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from metafab.cli.console import coverage_warning
from tests.main_job import UNIT_CELL, metafab

WIDE = """
[cell]
period_nm = [900.0, 350.0]
height_nm = 600.0
{geometry}
[materials]
pillar = {{ n = 2.4 }}
substrate = {substrate}
[illumination]
wavelength_nm = 800.0
[sweep]
width_nm = [100.0, 250.0]
length_nm = [100.0, 250.0]
size_grid_nm = 2.0
"""
SIZES = ("--width-nm", "150", "--length-nm", "210", "--target-error", "5e-2", "--json")


def _file(folder: Path, geometry: str = "", substrate: str = "{ n = 1.46 }") -> Path:
    path = folder / "cell.toml"
    path.write_text(WIDE.format(geometry=geometry, substrate=substrate), encoding="utf-8")
    return path


def test_a_wide_cell_lists_its_orders(tmp_path: Path) -> None:
    answer = metafab("cell", _file(tmp_path), *SIZES)
    assert answer.code == 0, answer.stderr
    found = answer.json["diffraction"]
    # sin(theta) = 800 / 900 in air; 800 / 900 / 1.46 in the substrate.
    assert [each["order"] for each in found["transmitted"]] == [[-1, 0], [0, 0], [1, 0]]
    assert [each["polar_deg"] for each in found["transmitted"]] == pytest.approx([62.734, 0.0, 62.734], abs=1e-3)
    assert [each["azimuth_deg"] for each in found["reflected"]] == pytest.approx([180.0, 0.0, 0.0])
    for polarisation in ("x", "y"):
        every = found["transmitted"] + found["reflected"]
        assert sum(each[f"efficiency_{polarisation}"] for each in every) == pytest.approx(1.0, abs=1e-9)
        zero = found["transmitted"][1][f"efficiency_{polarisation}"]
        assert zero == pytest.approx(answer.json[f"transmittance_{polarisation}"], abs=2.0 * found["error"])
    assert "steps" not in answer.json["details"]


def test_slopes_and_crystals_come_from_the_file(tmp_path: Path) -> None:
    sloped = _file(tmp_path, 'sidewall_angle_deg = 89.5\nsizes_at = "top"')
    answer = metafab("cell", sloped, *SIZES)
    assert answer.code == 0, answer.stderr
    assert answer.json["details"]["steps"] >= 4
    assert 0.0 < answer.json["details"]["slicing_error"] < answer.json["error"] <= 5e-2
    crystal = _file(tmp_path, substrate="{ n = 1.7601, n_y = 1.7522, n_z = 1.7601 }")
    answer = metafab("cell", crystal, *SIZES, "--angle-deg", "5", "--azimuth-deg", "30")
    assert answer.code == 0, answer.stderr
    assert 0.0 < answer.json["details"]["inconsistency"] < 1e-10
    # Light out of the planes of symmetry mixes the polarisations.
    assert abs(complex(*answer.json["t_xy"])) > 1e-4


@pytest.mark.parametrize(
    ("geometry", "substrate", "options", "said"),
    [
        ("sidewall_angle_deg = 45.0", "{ n = 1.46 }", (), "sidewall_angle_deg"),
        ('sizes_at = "waist"', "{ n = 1.46 }", (), "sizes_at"),
        ("sidewall_angle_deg = 70.0", "{ n = 1.46 }", (), "from the pillar's bottom to its top"),
        ("", "{ n = 1.76, n_y = 1.75 }", ("--angle-deg", "5"), "n_z"),
    ],
)
def test_what_cannot_be_solved_is_refused(
    tmp_path: Path, geometry: str, substrate: str, options: tuple[str, ...], said: str
) -> None:
    answer = metafab("cell", _file(tmp_path, geometry, substrate), *SIZES, *options)
    assert answer.code == 2
    assert said in answer.stderr
    assert not answer.stdout


@pytest.mark.parametrize(
    ("options", "field"),
    [
        (("--angle-deg", "20", "--azimuth-deg", "nan"), "--azimuth-deg"),
        (("--wavelength-nm", "1e-3"), "period_nm"),
        (("--wavelength-nm", "532nm"), "'--wavelength-nm': expected a number, got 532nm"),
    ],
)
def test_cells_that_cannot_be_solved_are_refused_by_name(tmp_path: Path, options: tuple[str, ...], field: str) -> None:
    answer = metafab("cell", _file(tmp_path), *SIZES, *options)
    assert answer.code == 2
    assert field in answer.stderr
    assert "Input should" not in answer.stderr


def test_a_result_never_replaces_what_it_is_made_from(tmp_path: Path) -> None:
    spec = tmp_path / "cell.toml"
    spec.write_bytes(Path(UNIT_CELL).read_bytes())
    answer = metafab("library", "build", str(spec), "-o", str(spec))
    assert answer.code == 2
    assert "which is read" in answer.stderr
    assert spec.read_bytes() == Path(UNIT_CELL).read_bytes()


def test_a_pillar_in_micrometres_is_refused_and_none_is_taken(tmp_path: Path) -> None:
    answer = metafab("cell", _file(tmp_path), "--width-nm", "0.15", "--length-nm", "0.21", "--json")
    assert (answer.code, answer.stdout) == (2, "")
    assert "`--width-nm`: expected 0, or at least 0.8 nm" in answer.stderr
    assert "`--length-nm`: expected 0, or at least 0.8 nm" in answer.stderr
    none = metafab("cell", _file(tmp_path), "--width-nm", "0", "--target-error", "5e-2", "--json")
    assert none.code == 0, none.stderr


def test_a_circle_has_one_size() -> None:
    cell = UNIT_CELL.with_name("sin_circles_633nm.toml")
    answer = metafab("cell", cell, "--width-nm", "150", "--length-nm", "210", "--json")
    assert (answer.code, answer.stdout) == (2, "")
    assert "`--length-nm`: expected the width: both are the diameter of a circle" in answer.stderr


def test_a_library_far_from_a_turn_is_said_to_be() -> None:
    assert coverage_warning(4.2) == []
    (said,) = coverage_warning(0.4)
    assert "at least half of the light reach 0.4 rad" in said
    (said,) = coverage_warning(0.0)
    assert "no size is among the sizes that transmit at least half" in said


def test_circles_of_a_hexagonal_lattice_list_their_orders(tmp_path: Path) -> None:
    """By spectral elements; the first orders leave into the substrate alone."""
    path = _file(tmp_path, 'shape = "circle"\nlattice = "hexagonal"')
    path.write_text(path.read_text(encoding="utf-8").replace("[900.0, 350.0]", "[660.0, 572.0]"), encoding="utf-8")
    size = "--width-nm", "200", "--length-nm", "200", "--target-error", "0.1", "--json"
    answer = metafab("cell", path, *size)
    assert answer.code == 0, answer.stderr
    found = answer.json["diffraction"]
    assert [each["order"] for each in found["transmitted"]] == [[0, 0]]
    assert len(found["reflected"]) == 7
    upwards = next(each for each in found["reflected"] if each["order"] == [0, 2])
    polar_deg = math.degrees(math.asin(800.0 / (1.46 * 572.0)))
    assert (upwards["polar_deg"], upwards["azimuth_deg"]) == pytest.approx((polar_deg, 90.0))
    for polarisation in ("x", "y"):
        every = found["transmitted"] + found["reflected"]
        assert sum(each[f"efficiency_{polarisation}"] for each in every) == pytest.approx(1.0, abs=found["error"])
