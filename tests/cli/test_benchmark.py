"""``metafab benchmark``: every room in turn, on one page, and one room for real."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from metafab import benchmark
from metafab.cli.entry import app
from metafab.core.errors import MissingToolError
from metafab.spec import load_design
from tests.main_job import SMALL, metafab


def test_all_runs_every_room_and_writes_one_page(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: list[tuple[str, bool]] = []

    def fake_room(room: str) -> Any:
        def rows(quick: bool, **_told: Any) -> list[dict[str, Any]]:
            asked.append((room, quick))
            return [{"name": f"{room} {k}", "error": 10.0**-k, "seconds": 0.1 * k, "peak_rss_mb": 1.0} for k in (1, 2)]

        return SimpleNamespace(rows=rows)

    monkeypatch.setattr(benchmark, "load_room", fake_room)
    answer = CliRunner().invoke(app, ["benchmark", "all", "--quick", "--json", "-o", str(tmp_path)])
    assert answer.exit_code == 0, answer.output
    assert asked == [(room, True) for room in benchmark.ROOMS]
    shown = json.loads(answer.stdout)
    assert [row["room"] for row in shown["rows"]] == [room for room in benchmark.ROOMS for _ in range(2)]
    pictures = {f"benchmark_{room}.png" for room in benchmark.ROOMS}
    assert {path.name for path in tmp_path.iterdir()} == {"benchmark.html", "benchmark.json", *pictures}
    page = (tmp_path / "benchmark.html").read_text(encoding="utf-8")
    assert all(f"{room} {k}" in page for room in benchmark.ROOMS for k in (1, 2))
    assert page.count("<svg") == len(benchmark.ROOMS)


@pytest.mark.parametrize("room", benchmark.ROOMS)
def test_every_room_has_a_benchmark(room: str) -> None:
    assert callable(benchmark.load_room(room).rows)


def test_a_room_without_its_tools_says_so_and_the_others_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def rows(quick: bool, **_told: Any) -> list[dict[str, Any]]:
        raise MissingToolError("no interpreter has Meep")

    row = {"name": "one", "error": 1e-3, "seconds": 1.0, "peak_rss_mb": 1.0}
    rooms = {room: SimpleNamespace(rows=lambda quick, **_told: [row]) for room in benchmark.ROOMS}
    monkeypatch.setattr(benchmark, "load_room", (rooms | {"meep": SimpleNamespace(rows=rows)}).__getitem__)
    table = benchmark.rows_of("all")
    assert len(table) == len(benchmark.ROOMS)
    assert [row.name for row in table if row.seconds is None] == ["not run: no interpreter has Meep"]
    with pytest.raises(MissingToolError):
        benchmark.rows_of("meep")


def test_the_scaled_camera_turns_as_the_small_one() -> None:
    """Defocus over the rim, R^2 / lambda (1/z - 1/z0), keeps its value at every depth, and so do pixels."""
    module = benchmark.load_room("end_to_end")
    small = load_design(SMALL)
    large = module.scaled(small, 2000.0)
    for before, after in zip(small.verify.depths_m, large.verify.depths_m, strict=True):
        defocus = [
            design.device.aperture_um**2 * (1.0 / z - 1.0 / design.sensor.focus_depth_m)
            for design, z in ((small, before), (large, after))
        ]
        assert defocus[0] == pytest.approx(defocus[1])
    assert large.scene is not None and small.scene is not None
    for before_object, after_object in zip(small.scene.objects, large.scene.objects, strict=True):
        for a, b in zip(before_object.size, after_object.size, strict=True):
            assert a * small.device.focal_length_mm == pytest.approx(b * large.device.focal_length_mm)


@pytest.mark.parametrize("count", [2, 8, 16])
def test_the_deeper_camera_sees_the_same_range(count: int) -> None:
    small = load_design(SMALL)
    depths_m = benchmark.load_room("end_to_end").deeper(small, count).verify.depths_m
    assert (depths_m[0], depths_m[-1], len(depths_m)) == (small.verify.depths_m[0], small.verify.depths_m[-1], count)
    steps = np.diff(1.0 / np.array(depths_m))
    assert np.all(steps < 0.0)
    assert steps == pytest.approx(np.full(count - 1, steps[0]))


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_the_finer_camera_sees_the_same_field(share: float) -> None:
    small = load_design(SMALL)
    fine = benchmark.load_room("end_to_end").finer(small, share)
    assert fine.scene is not None and small.scene is not None
    for before, after in zip(small.scene.field_px, fine.scene.field_px, strict=True):
        assert after == share * before
        assert after * fine.sensor.pixel_um == pytest.approx(before * small.sensor.pixel_um)
    window_um = [design.verify.window_px * design.sensor.pixel_um for design in (small, fine)]
    assert window_um[0] == pytest.approx(window_um[1])


@pytest.mark.slow
def test_a_quick_room_measures_something(tmp_path: Path) -> None:
    answer = metafab("benchmark", "drc", "--quick", "--json", "-o", tmp_path)
    assert answer.code == 0, answer.stderr
    assert all(row["seconds"] > 0.0 and row["peak_rss_mb"] > 0.0 for row in answer.json["rows"])
    assert (tmp_path / "benchmark_drc.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("room", "name"), [("apertures", "2mm"), ("apertures", "nan"), ("cluster", "sos")])
def test_a_part_that_is_none_is_refused_by_name(room: str, name: str) -> None:
    answer = metafab("benchmark", room, "--only", name)
    assert answer.code == 2
    assert f"got {name!r}" in answer.stderr and "an aperture in whole um" in answer.stderr
