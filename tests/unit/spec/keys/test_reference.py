"""The reference of all keys: each has a meaning, and default, range and unit are those of the spec."""

from __future__ import annotations

import pytest

from metafab.core.errors import InputError
from metafab.spec import Design, Scene, UnitCell
from metafab.spec.keys.reference import keys_of, names_at, near
from metafab.spec.keys.search import files, search
from tests.main_job import metafab

KEYS = {key.path: key for spec in (Design, UnitCell, Scene) for key in keys_of(spec)}


def test_every_key_has_a_meaning() -> None:
    silent = [path for path, key in KEYS.items() if not key.meaning]
    assert not silent, f"write a comment (#:) beside these fields of metafab/spec: {silent}"
    assert len(KEYS) > 200


def test_meanings_are_sentences() -> None:
    assert [path for path, key in KEYS.items() if not key.meaning.endswith(".")] == []


def test_types_ranges_units_and_defaults_are_those_of_the_spec() -> None:
    aperture = KEYS["device.aperture_um"]
    assert (aperture.kind, aperture.unit, aperture.default) == ("number", "um", "required")
    assert aperture.allowed == "above 0, at most 300000"
    assert KEYS["mask.tone"].allowed == '"negative", "positive", "inverted"'
    assert KEYS["mask.formats"].default == '["gds", "oas"]'
    assert KEYS["mask.chip"].kind == "table"
    assert KEYS["mask.copies[].at_um"].kind == "[number, number]"
    assert KEYS["phase[].array.file"].default == "required"
    vortex = KEYS["phase[].vortex.term"]
    assert (vortex.allowed, vortex.meaning) == ('"vortex"', "A spiral phase of integer charge.")
    assert KEYS["rules.max_aspect_ratio"].default == ""
    assert KEYS["mask.exposure.dose_uc_per_cm2"].unit == "uC/cm2"


def test_names_of_a_table_are_found_by_its_place() -> None:
    assert "margin_um" in names_at(Design, ("mask", "chip"))
    assert "zones" in names_at(Design, ("phase", 0, "spiral_zones"))
    assert "mask" in names_at(Design, ())
    assert names_at(Design, ("name",)) == ()


def test_only_similar_names_are_suggested() -> None:
    assert near("aperture", ["aperture_um", "focal_length_mm"]) == "did you mean `aperture_um`?"
    assert near("zzz", ["aperture_um"]) == ""


def test_a_part_of_a_name_finds_its_keys() -> None:
    assert {key.path for key in search("mask.chip.mark")} == {
        "mask.chip.mark_um", "mask.chip.mark_line_um", "mask.chip.mark_layer"
    }  # fmt: skip
    assert any(key.path == "cell.period_nm" for key in search("PERIOD"))
    assert not any(key.path.startswith("unit_cell") for key in files()["design"])


def test_a_misspelt_name_gets_its_neighbour() -> None:
    with pytest.raises(InputError, match="did you mean `aperture_um`"):
        search("apperture_um")


def test_the_command_prints_type_range_default_and_meaning() -> None:
    answer = metafab("keys", "scene.read_noise")
    assert answer.stdout == "scene.read_noise_e  (number; electrons; at least 0; default 2)\n    Read noise, rms.\n"
    keys = metafab("keys", "scene.read_noise", "--json").json["keys"]
    assert keys[0]["allowed"] == "at least 0"
    assert metafab("keys", "zzz").code == 2
