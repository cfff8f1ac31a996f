"""The benchmark page: every row in the table and the JSON, every series a line with its name."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from metafab.benchmark import BenchmarkRow, DepthView
from metafab.report import benchmark_page
from metafab.report.figures import accounts as figures
from metafab.report.style import panel


def _row(series: str, seconds: float | None, error: float | None, **further: Any) -> BenchmarkRow:
    table = {"room": "cell", "name": f"{series} {seconds}", "series": series, "error": error, "seconds": seconds}
    return BenchmarkRow.of(table | further)


ROWS = [
    _row("slow", 2.0, 1e-2),
    _row("fast", 0.1, 1e-3),
    _row("slow", 1.0, 5e-2),
    _row("fast", 0.01, 2e-2),
    _row("missing", None, None, skipped="not installed"),
    _row("exact", 1.0, 0.0),
]


def test_a_series_is_one_line_in_order_of_time() -> None:
    _, axes = panel()
    figures.error_against_time(ROWS, axes)
    drawn = [(list(line.get_xdata()), list(line.get_ydata())) for line in axes.lines]
    assert drawn == [([1.0, 2.0], [5e-2, 1e-2]), ([0.01, 0.1], [2e-2, 1e-3])]
    assert axes.get_xscale() == axes.get_yscale() == "log"


def test_each_line_is_named_in_its_colour_and_no_name_covers_another() -> None:
    _, axes = panel((7.2, 3.6), (0.7, 3.0, 0.52, 0.36))
    many = [_row(f"solver {k}", seconds, 1e-2) for k in range(9) for seconds in (1.0, 2.0)]
    figures.error_against_time(many, axes)
    assert sorted(text.get_text() for text in axes.texts) == [f"solver {k}" for k in range(9)]
    colour = {text.get_text(): text.get_color() for text in axes.texts}
    assert [colour[f"solver {k}"] for k in range(9)] == [line.get_color() for line in axes.lines]
    assert len({*colour.values()}) == 9
    heights = sorted(text.get_position()[1] for text in axes.texts)
    # A ninth of 2.72 inches is 21.8 points; text of 8.5 points needs less than half of it.
    assert min(np.subtract(high, low) for low, high in pairwise(heights)) * 2.72 * 72.0 > 2 * 8.5


def test_the_least_possible_error_stands_below_its_row(tmp_path: Path) -> None:
    rows = [
        _row("pair", seconds, error, photons=photons, bound=0.25 * error)
        for photons, seconds, error in ((3000.0, 0.1, 1e-3), (300.0, 0.2, 4e-3))
    ]
    _, axes = panel()
    figures.error_against_time([*rows, _row("fast", 0.01, 2e-2)], axes)
    dashes = [(*line.get_xdata(), *line.get_ydata()) for line in axes.lines if line.get_marker() == "_"]
    assert sorted(dashes) == [(0.1, 2.5e-4), (0.2, 1e-3)]
    _, axes = panel()
    figures.error_against_photons(rows, axes)
    drawn = [(list(line.get_xdata()), list(line.get_ydata())) for line in axes.lines]
    assert drawn == [([300.0, 3000.0], [4e-3, 1e-3]), ([300.0, 3000.0], [1e-3, 2.5e-4])]
    *_, light = benchmark_page(rows, tmp_path)
    assert light.name == "benchmark_cell_photons.png"
    picture = np.asarray(Image.open(light).convert("L"))
    assert picture[:, -3:].min() == picture[-3:].min() == picture[:3].min() == 255
    one_level = [replace(row, photons=300.0) for row in rows]
    assert len(benchmark_page(one_level, tmp_path)) == 3  # one level of light is no curve


def test_rows_without_a_series_stay_points_in_a_legend() -> None:
    _, axes = panel()
    figures.error_against_time([BenchmarkRow("a", error=0.1, seconds=1.0)], axes)
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["a"]
    assert not axes.texts


def test_a_skipped_row_reaches_table_and_json_with_its_reason(tmp_path: Path) -> None:
    page, data, _ = benchmark_page(ROWS, tmp_path)
    assert json.loads(data.read_text())["rows"] == [row.table() for row in ROWS]
    text = page.read_text(encoding="utf-8")
    assert "not installed" in text
    assert text.count("<tr>") == 1 + len(ROWS)


@pytest.mark.parametrize("series", [True, False], ids=["lines", "points"])
@pytest.mark.parametrize("name", ["a", "a name of a case, as long as the longest that the rooms give, 2048 x 2048"])
def test_no_name_is_cut_at_the_rim(series: bool, name: str, tmp_path: Path) -> None:
    """Ink of the last columns and rows of the picture would be text that goes on outside it."""
    rows = [_row(f"{name} {k}", 0.1 * (k + 1), 10.0**-k) for k in range(14)]
    if not series:
        rows = [replace(row, series=None) for row in rows]
    *_, plot = benchmark_page(rows, tmp_path)
    picture = np.asarray(Image.open(plot).convert("L"))
    assert picture[:, -3:].min() == 255
    assert picture[-3:].min() == picture[:3].min() == 255


def test_benchmark_page_keeps_every_row(tmp_path: Path) -> None:
    rows = [
        BenchmarkRow("ours", "cell", 1e-3, 0.01, 120.0),
        BenchmarkRow("a peer & <friends>", "cell", 1.3e-2, 2.5, 300.0),
        BenchmarkRow("no error known", "layout", None, 0.3, 90.0),
    ]
    page, data, *plots = benchmark_page(rows, tmp_path / "out")
    assert json.loads(data.read_text())["rows"] == [row.table() for row in rows]
    assert [plot.name for plot in plots] == ["benchmark_cell.png", "benchmark_layout.png"]
    assert all(plot.read_bytes().startswith(b"\x89PNG") for plot in plots)
    text = page.read_text(encoding="utf-8")
    assert "a peer &amp; &lt;friends&gt;" in text
    assert "http" not in text.replace("http://www.w3.org", "")


def test_global_state_stays_as_it_was(tmp_path: Path) -> None:
    """In a fresh process: drawing neither imports pyplot nor chooses a backend nor changes a setting."""
    code = (
        "import sys, matplotlib\n"
        "before = matplotlib.rcParams.copy()\n"
        "from pathlib import Path\n"
        "from metafab.benchmark import BenchmarkRow\n"
        "from metafab.report import benchmark_page\n"
        f"benchmark_page([BenchmarkRow('a', error=0.1, seconds=1.0)], Path({str(tmp_path)!r}))\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        "after = matplotlib.rcParams.copy()\n"
        "assert all(dict.__getitem__(after, key) == dict.__getitem__(before, key) for key in before)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_case_with_maps_is_a_row_of_figures_and_a_picture(tmp_path: Path) -> None:
    maps = [np.full((12, 16), value) for value in (900.0, 890.0, 0.3, 0.301, 0.9)]
    maps[3][:4] = np.nan
    view = DepthView(*maps, np.array([0.2, 0.9]), np.array([0.3, 1.0]))
    table = {"room": "scenes", "name": "edge: wall", "weakness": "wrong side", "measured": 0.38, "goal": 0.08}
    shown = BenchmarkRow.of(table | {"met": False, "view": view})
    page, data, picture = benchmark_page([shown, BenchmarkRow.of(table | {"name": "edge: near"})], tmp_path)
    rows = json.loads(data.read_text(encoding="utf-8"))["rows"]
    assert rows[0]["measured"] == 0.38 and rows[0]["met"] is False and "view" not in rows[0]
    assert picture.name == "scenes_edge.png"
    assert Image.open(picture).size[0] > 1000
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") == 1 and "edge: wrong side" in text and "<td" in text
