"""What a layout will cost, told before it is made."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from metafab import mask
from metafab.cli.whole import run_command
from metafab.layout import Assignment
from metafab.library import Library
from metafab.phase.profile import PhaseProfile
from metafab.run import Outcome
from metafab.spec import Design


def test_bytes_are_those_of_the_written_files(
    tiny: Assignment,
    profile: PhaseProfile,
    smooth_library: Library,
    tiny_design: Design,
    tiny_files: dict[str, Path],
) -> None:
    """All tiles are sampled: missing are the file's head and end (256 bytes in OASIS), each tile's frame and place."""
    plan = mask.plan(profile, smooth_library, tiny_design)
    assert plan["pillars"] == tiny.figures["pillars"]
    assert plan["sampled_tiles"] == plan["tiles"] <= 16
    for suffix in ("gds", "oas"):
        assert 0 < tiny_files[suffix].stat().st_size - plan["bytes"][suffix] < 300 + 120 * plan["tiles"]
    assert set(plan["seconds"]) == {"preparing", "mapping", "gds", "oas"}
    assert plan["core_hours"] > 0
    assert plan["advice"] == []


def test_a_centimetre_lens_is_planned_from_a_few_tiles_and_oasis_proposed(
    profile: PhaseProfile, smooth_library: Library, small_design: Design
) -> None:
    design = replace(small_design, device=replace(small_design.device, aperture_um=50_000.0))
    plan = mask.plan(profile, smooth_library, design)
    # pi (25 mm)^2 / (350 nm)^2 pillars of 64 bytes each; the rim's ring of cells is a share of 1e-5.
    assert plan["pillars"] == pytest.approx(16.03e9, rel=1e-3)
    assert plan["bytes"]["gds"] == pytest.approx(64 * plan["pillars"], rel=1e-2)
    assert plan["sampled_tiles"] == 16
    assert "write 'oas'" in plan["advice"][0]


def test_a_run_announces_a_large_gdsii_before_its_first_step(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """With a limit of one byte in place of 2^31; the announcement is out when the run begins."""
    said = []

    def begun(*_: object, **__: object) -> Outcome:
        said.append(capsys.readouterr().err)
        return Outcome({}, 0)

    monkeypatch.setattr("metafab.run.run", begun)
    design = Path(__file__).parents[2] / "layouts" / "helix_small.toml"
    run_command(design, tmp_path)
    monkeypatch.setattr(sys.modules[mask.plan.__module__], "GDSII_COMFORT_BYTES", 1)
    run_command(design, tmp_path)
    assert said[0] == ""
    assert "write 'oas'" in said[1]


def test_a_large_gdsii_is_announced_from_its_size_alone(small_design: Design) -> None:
    """2^31 bytes are 33.5 million pillars of 64 bytes: a circle of 2.29 mm at 350 nm."""

    def of(aperture_um: float, *formats: str) -> list[str]:
        device = replace(small_design.device, aperture_um=aperture_um)
        return mask.announcement(replace(small_design, device=device, mask=replace(small_design.mask, formats=formats)))

    assert of(2280.0, "gds", "oas") == []
    (sentence,) = of(2300.0, "gds", "oas")
    assert "2.2 GB" in sentence
    assert "write 'oas'" in sentence
    assert of(8000.0, "oas") == []
