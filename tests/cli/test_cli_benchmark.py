"""``metafab benchmark``: every room in turn, on one page, and one room for real."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from metafab import benchmark
from metafab.cli.app import app
from tests.main_job import metafab


def test_all_runs_every_room_and_writes_one_page(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: list[tuple[str, bool]] = []

    def fake_room(room: str) -> Any:
        def rows(quick: bool) -> list[dict[str, Any]]:
            asked.append((room, quick))
            return [{"name": f"{room} {k}", "error": 10.0**-k, "seconds": 0.1 * k, "peak_rss_mb": 1.0} for k in (1, 2)]

        return SimpleNamespace(rows=rows)

    monkeypatch.setattr(benchmark, "_load", fake_room)
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
    assert callable(benchmark._load(room).rows)


@pytest.mark.slow
def test_a_quick_room_measures_something(tmp_path: Path) -> None:
    answer = metafab("benchmark", "drc", "--quick", "--json", "-o", tmp_path)
    assert answer.code == 0, answer.stderr
    assert all(row["seconds"] > 0.0 and row["peak_rss_mb"] > 0.0 for row in answer.json["rows"])
    assert (tmp_path / "benchmark_drc.png").read_bytes().startswith(b"\x89PNG")
