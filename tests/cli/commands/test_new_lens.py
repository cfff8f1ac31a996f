"""``metafab new`` for a lens of one's own: wavelength, material, shape and aperture give files that fit each other."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from metafab.spec import load_design
from metafab.steps.preflight import preflight
from tests.main_job import metafab

OWN = ["--na", "0.6", "--aperture-um", "100", "--wavelength-nm", "532", "--shape", "circle", "--material", "TiO2"]


def test_a_lens_of_ones_own(tmp_path: Path) -> None:
    answer = metafab("new", "own", "--kind", "metalens", *OWN, "-o", tmp_path, "--json")
    assert answer.code == 0, answer.stderr
    assert [Path(name).name for name in answer.json["files"]] == ["own.toml", "own_cell.toml"]
    design = load_design(tmp_path / "own.toml")
    preflight(design)
    assert design.unit_cell.cell.shape == "circle"
    assert design.wavelength_um == pytest.approx(0.532)
    focal_um = 50.0 / math.tan(math.asin(0.6))
    assert design.device.aperture_um == 100.0
    assert design.device.focal_length_mm == pytest.approx(1e-3 * focal_um, rel=1e-4)
    # An eighth of wavelength / NA: four samples per finest fringe.
    assert design.sensor.pixel_um == pytest.approx(0.532 / 0.6 / 8.0, rel=0.01)
    assert design.rules.min_gap_nm == design.unit_cell.cell.period_nm[0] - design.unit_cell.sweep.width_nm[1]
    assert design.rules.min_feature_nm == design.unit_cell.sweep.width_nm[0]
    text = (tmp_path / "own.toml").read_text(encoding="utf-8")
    assert "numerical aperture is 0.6" in text
    again = metafab("new", "own", "--kind", "metalens", *OWN, "-o", tmp_path)
    assert again.code == 2


def test_a_lens_of_rings_has_rules_for_walls_and_holes(tmp_path: Path) -> None:
    options = ["--wavelength-nm", "1550", "--material", "Si", "--shape", "ring"]
    answer = metafab("new", "own", "--kind", "metalens", *options, "-o", tmp_path, "--json")
    assert answer.code == 0, answer.stderr
    design = load_design(tmp_path / "own.toml")
    preflight(design)
    cell, (narrowest_nm, _) = design.unit_cell.cell, design.unit_cell.sweep.width_nm
    assert cell.inner_diameter_nm is not None
    assert design.rules.min_feature_nm == 0.5 * (narrowest_nm - cell.inner_diameter_nm)
    assert design.rules.min_gap_nm <= cell.inner_diameter_nm
    assert design.min_side_nm == narrowest_nm
    # Coarser than the half micrometre of visible light; 64 pixels then hold the dark rings at any wavelength.
    assert design.sensor.pixel_um == pytest.approx(1.55 / 0.2 / 8.0, rel=0.01)
    text = (tmp_path / "own_cell.toml").read_text(encoding="utf-8")
    (tmp_path / "own_cell.toml").write_text(text.replace('"ring"', '"circle"'), encoding="utf-8")
    answer = metafab("layout", tmp_path / "own.toml")
    assert answer.code == 2
    assert "a ring, and no other shape" in answer.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--na", "1.2"], "`--na`"),
        (["--aperture-um", "0"], "`--aperture-um`"),
        (["--wavelength-nm", "532"], "--wavelength-nm and --material"),
        (["--wavelength-nm", "532", "--material", "TiO3"], "did you mean `TiO2`?"),
        (["--wavelength-nm", "532", "--material", "TiO2", "--shape", "circel"], "did you mean `circle`?"),
        (["--wavelength-nm", "2500", "--material", "TiO2"], "a record that holds 2500 nm"),
    ],
)
def test_what_does_not_go_together_leaves_no_file(options: list[str], message: str, tmp_path: Path) -> None:
    answer = metafab("new", "own", "--kind", "metalens", *options, "-o", tmp_path)
    assert answer.code == 2
    assert message in answer.stderr
    assert list(tmp_path.iterdir()) == []
