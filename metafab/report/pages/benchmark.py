"""Benchmark rows as a page: table, error against time, and the same as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from metafab import __version__
from metafab.core.storage.files import whole_file, write_json
from metafab.report import figures, html
from metafab.report.render import save_both
from metafab.report.style import panel

_FIRST = ("room", "name", "error", "seconds", "peak_rss_mb")


def benchmark_page(rows: Sequence[Mapping[str, Any]], directory: Path) -> tuple[Path, ...]:
    """Write ``benchmark.html``, ``benchmark.json`` and one plot a room.

    Args:
        rows: one mapping a case with at least ``name``, ``error``, ``seconds``, ``peak_rss_mb``; ``room`` groups them.
        directory: where to write; created when needed.

    Returns:
        The written files, the page first.
    """
    directory.mkdir(parents=True, exist_ok=True)
    data = directory / "benchmark.json"
    write_json(data, {"metafab_version": __version__, "rows": list(rows)})
    parts, plots = [], []
    for room in dict.fromkeys(str(row.get("room", "")) for row in rows):
        own = [row for row in rows if str(row.get("room", "")) == room]
        figure = _plot(own)
        name = f"benchmark_{room or 'all'}"
        plots.append(directory / f"{name}.png")
        picture = html.wide(html.figure(save_both(figure, plots[-1], f"Error against time, {room}")))
        if len({row["photons"] for row in own if row.get("photons")}) > 1:
            light, axes = panel((7.4, 3.6), (0.7, 3.2, 0.52, 0.36))
            figures.error_against_photons(own, axes)
            plots.append(directory / f"{name}_photons.png")
            picture += html.figure(save_both(light, plots[-1], f"Error against light, {room}"))
        parts.append(html.section(name, room.capitalize() or "Benchmark", picture, _table(own)))
    page = directory / "benchmark.html"
    with whole_file(page) as part:
        part.write_text(_page("\n".join(parts)), encoding="utf-8")
    return (page, data, *plots)


def _plot(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Error against time, with room on the right for the longest name and below for all of them."""
    named = [str(row.get("series", row["name"])) for row in figures.with_error_and_time(rows)]
    beside_in = 0.6 + 0.068 * max(map(len, named), default=0)  # text of 8.5 points
    tall_in = max(3.6, 1.0 + 0.19 * len(dict.fromkeys(named)))
    figure, axes = panel((4.2 + beside_in, tall_in), (0.7, beside_in, 0.52, 0.36))
    figures.error_against_time(rows, axes)
    return figure


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    keys = [key for key in dict.fromkeys([*_FIRST, *(key for row in rows for key in row)]) if key != "room"]
    kinds = ["n" if any(isinstance(row.get(key), int | float) for row in rows) else "" for key in keys]
    head = ["peak MB" if key == "peak_rss_mb" else html.number(key.replace("_", " ")) for key in keys]
    return html.table(head, [[html.number(row.get(key)) for key in keys] for row in rows], kinds, "named")


def _page(content: str) -> str:
    style = (files("metafab.report") / "style.css").read_text(encoding="utf-8")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n<link rel="icon" href="data:,">\n'
        f"<title>Benchmarks – metafab</title>\n<style>\n{style}\n</style>\n</head>\n<body>\n"
        f'<header><p class="brand">metafab {__version__}</p><h1>Benchmarks</h1>'
        '<p class="subtitle">Error against time: lower left is better. A time without an error means nothing.</p>'
        f"</header>\n<main>\n{content}\n</main>\n</body>\n</html>\n"
    )
