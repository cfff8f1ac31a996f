"""What a layout will cost, estimated before it is made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from metafab import layout, mask
from metafab.cli.commands.run import run_command
from metafab.layout import Assignment
from metafab.layout.mapping import TileMapping
from metafab.library import Library
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Copy, Design, Dose
from tests.conftest import ROOT


def test_bytes_are_those_of_the_written_files(
    tiny: Assignment,
    profile: PhaseProfile,
    smooth_library: Library,
    tiny_design: Design,
    tiny_files: dict[str, Path],
) -> None:
    """All tiles are sampled: missing are the file's head and end (256 bytes in OASIS), each tile's frame and place."""
    plan = mask.plan(profile, smooth_library, tiny_design)
    assert plan.pillars == tiny.figures.pillars
    assert plan.sampled_tiles == plan.tiles <= 16
    for suffix in ("gds", "oas"):
        assert 0 < tiny_files[suffix].stat().st_size - plan.bytes[suffix] < 300 + 120 * plan.tiles
    assert set(plan.seconds) == {"preparing", "mapping", "gds", "oas"}
    assert plan.core_hours > 0
    assert plan.advice == []
    assert plan.mappings == 1


@pytest.mark.parametrize("dose", [None, Dose(by="size"), Dose(by="density")])
def test_the_plan_counts_how_often_a_lens_that_is_not_kept_is_mapped(
    dose: Dose | None,
    profile: PhaseProfile,
    smooth_library: Library,
    tiny_design: Design,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Against the calls of the mapping while a mask is written."""
    calls: list[object] = []
    mapped = TileMapping.__call__

    def counted(self: TileMapping, place: Any) -> Any:
        calls.append(place)
        return mapped(self, place)

    design = replace(tiny_design, mask=replace(tiny_design.mask, dose=dose))
    plan = mask.plan(profile, smooth_library, design, workers=7, kept_sites=0)
    monkeypatch.setattr(TileMapping, "__call__", counted)
    assignment = layout.assign(profile, smooth_library, design, kept_sites=0)
    mask.write(assignment.pillars, tmp_path, design)
    assert len(calls) == plan.mappings * plan.tiles
    assert plan.workers == 7
    working = sum(seconds for step, seconds in plan.seconds.items() if step != "preparing")
    assert plan.core_hours == pytest.approx(7 * working / 3600.0)


def test_a_centimetre_lens_is_planned_from_a_few_tiles_and_oasis_proposed(
    profile: PhaseProfile, smooth_library: Library, small_design: Design
) -> None:
    design = replace(small_design, device=replace(small_design.device, aperture_um=50_000.0))
    plan = mask.plan(profile, smooth_library, design)
    # pi (25 mm)^2 / (350 nm)^2 pillars of 64 bytes each; the rim's ring of cells is a share of 1e-5.
    assert plan.pillars == pytest.approx(16.03e9, rel=1e-3)
    assert plan.bytes["gds"] == pytest.approx(64 * plan.pillars, rel=1e-2)
    assert plan.sampled_tiles == 16
    assert plan.mappings == 2  # 16 thousand million sites are not kept, but mapped again for the writers
    assert "write 'oas'" in plan.advice[0]


class _BegunError(Exception):
    """The first step would run now."""


def test_a_run_announces_a_large_gdsii_before_its_first_step(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Of a lens of 2.4 mm, 36.9 million pillars; the announcement is out when the first step begins."""

    def begun(*_: object) -> None:
        raise _BegunError

    monkeypatch.setattr("metafab.run._State.bring_up_to_date", begun)
    small = ROOT / "layouts" / "helix_small.toml"
    large = tmp_path / "large.toml"
    table = small.with_name("helix_2mm.toml").read_text().replace("aperture_um = 2000.0", "aperture_um = 2400.0")
    assert "aperture_um = 2400.0" in table
    large.write_text(table.replace("../unitcell_lib", str(ROOT / "unitcell_lib")))
    with pytest.raises(_BegunError):
        run_command(small, tmp_path / "small")
    assert capsys.readouterr().err == ""
    with pytest.raises(_BegunError):
        run_command(large, tmp_path / "large")
    assert "write 'oas'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "options",
    [
        {"tone": "inverted", "copies": (Copy((0.0, 0.0)), Copy((200.0, 0.0), 4.0), Copy((400.0, 0.0)))},
        {"flat": True, "copies": (Copy((0.0, 0.0)), Copy((200.0, 0.0), 4.0), Copy((400.0, 0.0)))},
    ],
)
def test_the_plan_counts_all_that_is_drawn(
    options: dict[str, Any],
    tiny: Assignment,
    profile: PhaseProfile,
    smooth_library: Library,
    tiny_design: Design,
    tmp_path: Path,
) -> None:
    """The field around pillars, and copies; without pillars are at most tiles at the corners, one shape each."""
    design = replace(tiny_design, mask=replace(tiny_design.mask, **options))
    plan = mask.plan(profile, smooth_library, design)
    written = {file.path.suffix[1:]: file.bytes for file in mask.write(tiny.pillars, tmp_path, design)}
    for suffix in ("gds", "oas"):
        assert 0 < written[suffix] - plan.bytes[suffix] < 500 + 1500 * plan.tiles
    assert plan.bytes["gds"] >= 64 * 3 * tiny.figures.pillars


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


def test_the_announcement_counts_the_inverted_field_and_flat_copies(small_design: Design) -> None:
    """6.4 million pillars make a large file where each is drawn six times, or ten times the field included."""
    device = replace(small_design.device, aperture_um=1000.0)

    def of(**options: object) -> list[str]:
        return mask.announcement(replace(small_design, device=device, mask=replace(small_design.mask, **options)))

    copies = tuple(Copy((1100.0 * number, 0.0)) for number in range(6))
    assert of(tone="positive", copies=copies) == []
    assert of(tone="inverted") == []
    assert "2.5 GB" in of(copies=copies, flat=True)[0]
    assert "4.1 GB" in of(tone="inverted", copies=(*copies[:1], replace(copies[1], bias_nm=4.0)))[0]
