"""The reference of all keys: each has a meaning, and default, range and unit are those of the spec."""

from __future__ import annotations

from metafab.spec import Design, Scene, UnitCell
from metafab.spec.keys.reference import keys_of, names_at, near

KEYS = {key.path: key for spec in (Design, UnitCell, Scene) for key in keys_of(spec)}


def test_every_key_has_a_meaning() -> None:
    silent = [path for path, key in KEYS.items() if not key.meaning]
    assert not silent, f"write a docstring under these fields of metafab/spec: {silent}"
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
