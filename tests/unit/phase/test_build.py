"""Phase terms of design files: every term is built, and unusable ones are refused with their path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.phase import profile_of
from metafab.spec import canonical_toml, load_design

LAYOUTS = Path(__file__).parents[3] / "layouts"


def _written(folder: Path, phase: str) -> Path:
    text = (LAYOUTS / "helix_small.toml").read_text()
    start, end = text.index("[[phase]]"), text.index("[rules]")
    text = text[:start] + phase + "\n" + text[end:]
    file = folder / "design.toml"
    file.write_text(text.replace("../unitcell_lib", str(LAYOUTS.parent / "unitcell_lib")))
    return file


ALL_TERMS = """
[[phase]]
term = "spiral_zones"
zones = 3
[[phase]]
term = "split_lens"
object_depth_m = 0.003
[[phase]]
term = "lens"
polarisation = "y"
[[phase]]
term = "vortex"
charge = 2
[[phase]]
term = "grating"
angle_deg = 3.0
azimuth_deg = 20.0
[[phase]]
term = "axicon"
angle_deg = 1.0
[[phase]]
term = "double_helix"
[[phase]]
term = "zernike"
degree = 2
order = 0
amplitude_rad = 0.5
[[phase]]
term = "zernikes"
coefficients_rad = [0.0, 0.1]
[[phase]]
term = "radial"
coefficients = [-3.0]
[[phase]]
term = "array"
file = "phase.npy"
pitch_um = 10.0
"""


def test_every_term_of_a_file_is_in_the_profile(tmp_path: Path) -> None:
    np.save(tmp_path / "phase.npy", np.full((21, 21), 0.25))
    profile = profile_of(load_design(_written(tmp_path, ALL_TERMS)))
    assert len(profile.terms) == ALL_TERMS.count("[[phase]]")
    x_um, y_um = np.linspace(-90.0, 90.0, 7), np.linspace(-80.0, 80.0, 5)
    phase = profile(x_um, y_um)
    assert phase.shape == (2, 5, 7)
    assert np.isfinite(phase).all()
    total = sum(term(x_um, y_um, "y") for term in profile.terms)
    np.testing.assert_allclose(phase[1], total, atol=1e-9)
    assert profile.terms[-1](x_um, y_um, "x") == pytest.approx(0.25)


def test_a_canonical_file_says_the_same(tmp_path: Path) -> None:
    np.save(tmp_path / "phase.npy", np.full((21, 21), 0.25))
    text = canonical_toml(load_design(_written(tmp_path, ALL_TERMS)))
    assert 'term = "array"' in text
    assert str(tmp_path / "phase.npy") in text


@pytest.mark.parametrize(
    ("phase", "message"),
    [
        ('[[phase]]\nterm = "zernike"\ndegree = 3\norder = 2', "order"),
        ('[[phase]]\nterm = "spiral_zones"\nzones = 1\noptimise = "peak"', "at least 2"),
        ('[[phase]]\nterm = "array"\npitch_um = 1.0', "file"),
        ('[[phase]]\nterm = "axicon"\nangle_deg = 95.0', "angle_deg"),
        ('[[phase]]\nterm = "hologram"', "phase"),
    ],
)
def test_faulty_terms_are_refused(tmp_path: Path, phase: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_design(_written(tmp_path, phase))


@pytest.mark.parametrize(
    ("phase", "message"),
    [
        ('[[phase]]\nterm = "lens"\nobject_depth_m = 0.0005', "beyond the focal length"),
        ('[[phase]]\nterm = "spiral_zones"\n[[phase]]\nterm = "spiral_zones"', "at most one"),
        ('[[phase]]\nterm = "array"\nfile = "none.npy"\npitch_um = 1.0', "no file at that path"),
    ],
)
def test_terms_that_cannot_be_built_are_refused(tmp_path: Path, phase: str, message: str) -> None:
    design = load_design(_written(tmp_path, phase))
    with pytest.raises(InputError, match=message):
        profile_of(design)


def test_each_polarisation_may_have_a_helix_of_its_own(tmp_path: Path) -> None:
    phase = "\n".join(
        f'[[phase]]\nterm = "spiral_zones"\nzones = {n}\npolarisation = "{p}"' for n, p in ((2, "x"), (3, "y"))
    )
    profile = profile_of(load_design(_written(tmp_path, phase)))
    x_um = np.array([90.0])
    y_um = np.array([1.0])
    angle = np.arctan2(1.0, 90.0)
    assert profile(x_um, y_um)[0, 0, 0] == pytest.approx(2 * angle)
    assert np.exp(1j * profile(x_um, y_um)[1, 0, 0]) == pytest.approx(np.exp(3j * (angle - np.pi)))
