"""Accounts: where light goes, where error comes from, where time goes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from metafab.report.style import GOOD, INK, MUTED, X_COLOUR, Y_COLOUR, dress, legend, logarithmic

_MARKERS = "osD^vP*X<>"
#: Of series: inks of the house first, then hues that stay apart without red-green vision (after Okabe and Ito, 2008).
_COLOURS = (X_COLOUR, Y_COLOUR, GOOD, INK, MUTED, "#b5568c", "#a67c00", "#3f9fd0", "#6b4fa0")


def loss_chain(stages: Sequence[tuple[str, float]], axes: Axes) -> Axes:
    """Share of the light at the aperture that is left after each stage; what the stage took, pale beside it."""
    names, shares = [name for name, _ in stages], [share for _, share in stages]
    before = [1.0, *shares[:-1]]
    for place, (share, last) in enumerate(zip(shares, before, strict=True)):
        axes.barh(place, 100.0 * max(last - share, 0.0), left=100.0 * share, height=0.36, color=X_COLOUR, alpha=0.55)
    labels = [f"{100.0 * s:.1f} %" + (f"  × {s / b:.3f}" if b else "") for s, b in zip(shares, before, strict=True)]
    labels[:1] = [f"{100.0 * share:.1f} %" for share in shares[:1]]  # nothing stands before the first
    _bars(names, [100.0 * share for share in shares], axes, GOOD, [""] * len(shares))
    for place, label in enumerate(labels):
        axes.annotate(label, (1.0, place), (6, 0), xycoords=("axes fraction", "data"), textcoords="offset points",
                      va="center", fontsize=8.5, color=INK)  # fmt: skip
    dress(axes, "share of the light at the aperture / %", "", "Where the light goes")
    axes.set_xlim(0.0, 100.0)
    return axes


def error_budget(lines: Sequence[tuple[str, float, str]], axes: Axes) -> Axes:
    """Lines of the budget that share a unit, on a logarithmic scale: (source, value above 0, unit)."""
    values = [value for _, value, _ in lines]
    labels = [f"{value:.2g}" for value in values]
    _bars([source for source, _, _ in lines], values, axes, X_COLOUR, labels)
    logarithmic(axes, "x")
    if values:
        axes.set_xlim(min(values) / 3.0, max(values) * 1.5)
    return dress(axes, f"error / {lines[0][2]}" if lines else "", "", "Error budget")


def seconds(step_seconds: Mapping[str, float], axes: Axes) -> Axes:
    """Time of every step."""
    _bars(list(step_seconds), list(step_seconds.values()), axes, Y_COLOUR, [f"{s:.2f}" for s in step_seconds.values()])
    longest = max(step_seconds.values(), default=1.0)
    axes.set_xlim(0.0, longest or 1.0)
    return dress(axes, "seconds", "", "Time")


def error_against_time(rows: Sequence[Mapping[str, Any]], axes: Axes) -> Axes:
    """Benchmark rows, both axes logarithmic: lower left is better. Rows without an error or a time are left out.

    Rows that name their ``series`` are joined to one line each, with its name beside; others are points in a legend.
    A row's ``bound``, the least error that is possible, is a dash below it.
    """
    shown = with_error_and_time(rows)
    logarithmic(axes, "xy")
    series = list(dict.fromkeys(str(row["series"]) for row in shown if "series" in row))
    for index, name in enumerate(series):
        own = sorted((row for row in shown if row.get("series") == name), key=lambda row: float(row["seconds"]))
        colour, marker = _COLOURS[index % len(_COLOURS)], _MARKERS[index % len(_MARKERS)]
        axes.plot(
            [row["seconds"] for row in own], [row["error"] for row in own], f"{marker}-", color=colour, markersize=4.5
        )
    for index, row in enumerate(row for row in shown if "series" not in row):
        colour, marker = _COLOURS[index % len(_COLOURS)], _MARKERS[index % len(_MARKERS)]
        axes.plot(row["seconds"], row["error"], marker, color=colour, markersize=6, label=str(row["name"]))
    _bounds(shown, "seconds", axes)
    dress(axes, "seconds", "error", "Error against time")
    axes.grid(color=MUTED, linewidth=0.4, alpha=0.3)
    if series:
        _name_lines(axes, series)
    elif axes.lines:
        legend(axes, loc="center left", bbox_to_anchor=(1.02, 0.5))
    return axes


def with_error_and_time(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The rows that a plot of error against time shows."""
    return [row for row in rows if (row["error"] or 0.0) > 0.0 and (row["seconds"] or 0.0) > 0.0]


def error_against_photons(rows: Sequence[Mapping[str, Any]], axes: Axes) -> Axes:
    """Decoding rows by the light of a pixel, each ``series`` a line, and below it the least error possible, dashed."""
    logarithmic(axes, "xy")
    names = list(dict.fromkeys(str(row["series"]) for row in rows if row.get("photons") and "series" in row))
    for index, name in enumerate(names):
        own = sorted((row for row in rows if row.get("series") == name), key=lambda row: float(row["photons"]))
        colour, marker = _COLOURS[index % len(_COLOURS)], _MARKERS[index % len(_MARKERS)]
        photons = [row["photons"] for row in own]
        axes.plot(photons, [row["error"] for row in own], f"{marker}-", color=colour, markersize=4.5, label=name)
        bound = [row.get("bound") or math.nan for row in own]
        axes.plot(photons, bound, f"{marker}--", color=colour, markersize=3.0, linewidth=0.8, alpha=0.7)
    dress(axes, "electrons a pixel", "error", "Error against light, with its Cramér-Rao bound (dashed)")
    axes.grid(color=MUTED, linewidth=0.4, alpha=0.3)
    if names:
        legend(axes, loc="center left", bbox_to_anchor=(1.02, 0.5))
    return axes


def _bounds(rows: Sequence[Mapping[str, Any]], key: str, axes: Axes) -> None:
    """A dash at the least possible error of each row that has one, and a thin line up to the row."""
    for row in rows:
        if row.get("bound"):
            axes.vlines(row[key], row["bound"], row["error"], color=MUTED, linewidth=0.6, alpha=0.6, zorder=1.0)
            axes.plot(row[key], row["bound"], "_", color=INK, markersize=6.0, zorder=1.5)


def _name_lines(axes: Axes, names: Sequence[str]) -> None:
    """Each line's name in the right margin, joined to the line's last point, in the order of these points."""
    lines = sorted(zip(axes.lines, names, strict=False), key=lambda pair: float(np.asarray(pair[0].get_ydata())[-1]))
    for place, (line, name) in enumerate(lines):
        last = (float(np.asarray(line.get_xdata())[-1]), float(np.asarray(line.get_ydata())[-1]))
        axes.annotate(
            name,
            last,
            (1.05, (place + 0.5) / len(lines)),
            textcoords="axes fraction",
            va="center",
            fontsize=8.5,
            color=line.get_color(),
            arrowprops={"arrowstyle": "-", "color": line.get_color(), "linewidth": 0.6, "alpha": 0.5},
        )


def _bars(names: Sequence[str], values: Sequence[float], axes: Axes, colour: str, labels: Sequence[str]) -> None:
    places = range(len(names))
    axes.barh(places, values, height=0.36, color=colour)
    for place, name, value, label in zip(places, names, values, labels, strict=True):
        text: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8.5, "color": INK}
        axes.annotate(label, (value, place), (4, 0), va="center", **text)
        axes.annotate(name, (0.0, place - 0.22), (3, 1.5), xycoords=("axes fraction", "data"), va="bottom", **text)
    axes.set_yticks([])
    axes.set_ylim(len(names) - 0.6, -0.75)  # the first row on top
