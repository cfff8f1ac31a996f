"""The ``[substrate]`` table: cuts, refusals, and what it excludes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.spec import Design, load_design
from metafab.spec.substrate import OPTIC_AXIS_DEG

ROOT = Path(__file__).parents[3]


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str], Design]:
    text = (ROOT / "layouts" / "helix_small.toml").read_text(encoding="utf-8")
    text = text.replace("../unitcell_lib", str(ROOT / "unitcell_lib"))

    def load(table: str) -> Design:
        path = tmp_path / "design.toml"
        path.write_text(f"{text}\n{table}", encoding="utf-8")
        return load_design(path)

    return load


def test_a_design_without_the_table_has_no_crystal(written: Callable[[str], Design]) -> None:
    assert written("").substrate is None


def test_cuts_and_own_crystals(written: Callable[[str], Design]) -> None:
    named = written('[substrate]\nthickness_um = 460.0\ncut = "r-plane"\nazimuth_deg = 45.0').substrate
    assert named is not None and named.tilt_deg == pytest.approx(57.6, abs=0.05)
    assert (OPTIC_AXIS_DEG["c-plane"], OPTIC_AXIS_DEG["a-plane"]) == (0.0, 90.0)
    quartz = 'ordinary = { n = 1.5383 }\nextraordinary = { n = 1.5472 }\nback_face = "coated"'
    own = written(f"[substrate]\nthickness_um = 100.0\noptic_axis_deg = 0.0\n{quartz}").substrate
    assert own is not None and own.tilt_deg == 0.0 and own.ordinary.n == 1.5383


@pytest.mark.parametrize(
    ("table", "field", "words"),
    [
        ('thickness_um = 0.0\ncut = "r-plane"', "substrate.thickness_um", "greater than 0"),
        ("thickness_um = 460.0", "substrate", "give either `cut`"),
        ('thickness_um = 460.0\ncut = "r-plane"\noptic_axis_deg = 3.0', "substrate", "not both"),
        ('thickness_um = 460.0\ncut = "n-plane"', "substrate.cut", "r-plane"),
        ('thickness_um = 460.0\ncut = "r-plane"\nazimuth_deg = nan', "substrate.azimuth_deg", ""),
        ('thickness_um = 460.0\ncut = "r-plane"\nordinary = { n = 1.7, k = 0.1 }', "substrate", "transparent"),
        ('thickness_um = 4600.0\ncut = "r-plane"', "", "nearest object"),
        ('thickness_um = 460.0\ncut = "r-plane"\n[optics]\nsubstrate_um = 460.0', "", "not both"),
    ],
)
def test_bad_tables_are_refused(written: Callable[[str], Design], table: str, field: str, words: str) -> None:
    with pytest.raises(InputError) as refused:
        written(f"[substrate]\n{table}")
    fault = refused.value.faults[0]
    assert field in fault.field
    assert words in str(refused.value)
