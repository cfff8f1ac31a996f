"""Page of benchmark rows: table, plots of error against time, and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from metafab import __version__
from metafab.benchmark import BenchmarkRow
from metafab.core.storage.files import whole_file, write_json
from metafab.report import html
from metafab.report.assets import asset
from metafab.report.figures.accounts import error_against_photons, error_against_time, with_error_and_time
from metafab.report.figures.image import depth_view
from metafab.report.render import save_both
from metafab.report.style import panel

_FIRST = ("room", "name", "error", "seconds", "peak_rss_mb")


def benchmark_page(rows: Sequence[BenchmarkRow], directory: Path) -> tuple[Path, ...]:
    """Write ``benchmark.html``, ``benchmark.json``, one plot for each room and one picture for each row with a view.

    The folder is created when needed. Returns the written files, the page first.
    """
    directory.mkdir(parents=True, exist_ok=True)
    data = directory / "benchmark.json"
    write_json(data, {"metafab_version": __version__, "rows": [row.table() for row in rows]})
    parts: list[str] = []
    plots: list[Path] = []
    for room in dict.fromkeys(row.room for row in rows):
        of_room = [row for row in rows if row.room == room]
        if any(row.view for row in of_room):
            pictures = {directory / f"{room}_{row.name.partition(':')[0]}.png": row for row in of_room if row.view}
            plots += pictures
            drawn = [_judged(path, row) for path, row in pictures.items()]
            parts.append(html.section(f"benchmark_{room}", room.capitalize(), _table(of_room), *drawn))
            continue
        figure = _plot(of_room)
        name = f"benchmark_{room or 'all'}"
        plots.append(directory / f"{name}.png")
        picture = html.wide(html.figure(save_both(figure, plots[-1], f"Error against time, {room}")))
        if len({row.photons for row in of_room if row.photons}) > 1:
            light, axes = panel((7.4, 3.6), (0.7, 3.2, 0.52, 0.36))
            error_against_photons(of_room, axes)
            plots.append(directory / f"{name}_photons.png")
            picture += html.figure(save_both(light, plots[-1], f"Error against light, {room}"))
        parts.append(html.section(name, room.capitalize() or "Benchmark", picture, _table(of_room)))
    page = directory / "benchmark.html"
    with whole_file(page) as part:
        part.write_text(_page("\n".join(parts)), encoding="utf-8")
    return (page, data, *plots)


def _judged(path: Path, row: BenchmarkRow) -> str:
    """Picture of a row's view, titled with the weakness that its case measures."""
    if row.view is None:
        return ""
    title = f"{row.name.partition(':')[0]}: {row.weakness}"
    return html.wide(html.figure(save_both(depth_view(row.view), path, title), title))


def _plot(rows: Sequence[BenchmarkRow]) -> Figure:
    """Plot of error against time, with space on the right for the longest name and in height for all names."""
    names = [row.series or row.name for row in with_error_and_time(rows)]
    beside_in = 0.6 + 0.068 * max(map(len, names), default=0)  # text of 8.5 points
    tall_in = max(3.6, 1.0 + 0.19 * len(dict.fromkeys(names)))
    figure, axes = panel((4.2 + beside_in, tall_in), (0.7, beside_in, 0.52, 0.36))
    error_against_time(rows, axes)
    return figure


def _table(rows: Sequence[BenchmarkRow]) -> str:
    tables = [row.table() for row in rows]
    keys = [key for key in dict.fromkeys([*_FIRST, *(key for table in tables for key in table)]) if key != "room"]
    kinds = ["n" if any(isinstance(table.get(key), int | float) for table in tables) else "" for key in keys]
    head = ["peak MB" if key == "peak_rss_mb" else html.number(key.replace("_", " ")) for key in keys]
    return html.table(head, [[html.number(table.get(key)) for key in keys] for table in tables], kinds, "named")


def _page(content: str) -> str:
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n<link rel="icon" href="data:,">\n'
        f"<title>Benchmarks – metafab</title>\n<style>\n{asset('style.css')}\n</style>\n</head>\n<body>\n"
        f'<header><p class="brand">metafab {__version__}</p><h1>Benchmarks</h1>'
        '<p class="subtitle">Error against time: lower left is better. A time without an error means nothing.</p>'
        f"</header>\n<main>\n{content}\n</main>\n</body>\n</html>\n"
    )
