"""Loss chain, error budget, time of the steps, and benchmarks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import itemgetter
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from metafab.benchmark import BenchmarkRow
from metafab.report.accounts import Stage
from metafab.report.style import GOOD, INK, MUTED, X_COLOUR, Y_COLOUR, dress, finished, logarithmic
from metafab.steps.summary import BudgetLine

_MARKERS = "osD^vP*X<>"
#: Colours of series: inks of the house, then hues that differ without red-green vision (Okabe and Ito, 2008).
_COLOURS = (X_COLOUR, Y_COLOUR, GOOD, INK, MUTED, "#b5568c", "#a67c00", "#3f9fd0", "#6b4fa0")


def loss_chain(stages: Sequence[Stage], axes: Axes) -> Axes:
    """Draw the share of the light at the aperture after each stage, with the loss of the stage in a pale colour."""
    shares = [stage.share for stage in stages]
    labels = [f"{100.0 * share:.1f} %" for share in shares]
    for place in range(1, len(shares)):
        share, before = shares[place], shares[place - 1]
        lost = 100.0 * max(before - share, 0.0)
        axes.barh(place, lost, left=100.0 * share, height=0.36, color=X_COLOUR, alpha=0.55)
        labels[place] += f"  × {share / before:.3f}" if before else ""
    _bars([stage.name for stage in stages], [100.0 * share for share in shares], axes, GOOD, [""] * len(shares))
    text: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 8.5, "color": INK}
    for place, label in enumerate(labels):
        axes.annotate(label, (1.0, place), (6, 0), xycoords=("axes fraction", "data"), **text)
    dress(axes, "share of the light at the aperture / %", "", "Losses of light")
    axes.set_xlim(0.0, 100.0)
    return axes


def error_budget(lines: Sequence[BudgetLine], axes: Axes) -> Axes:
    """Draw the lines of the error budget that share a unit, on a logarithmic scale; values are above 0."""
    values = [line.value for line in lines if line.value is not None]
    labels = [f"{value:.2g}" for value in values]
    _bars([line.source for line in lines], values, axes, X_COLOUR, labels)
    logarithmic(axes, "x")
    if values:
        axes.set_xlim(min(values) / 3.0, max(values) * 1.5)
    return dress(axes, f"error / {lines[0].unit}" if lines else "", "", "Error budget")


def error_against_time(rows: Sequence[BenchmarkRow], axes: Axes) -> Axes:
    """Draw benchmark rows with a known error and time, both axes logarithmic: lower left is better.

    Rows of one series are joined to a line with a name; other rows are points in a legend. A dash marks the smallest
    possible error of a row.
    """
    known = with_error_and_time(rows)
    logarithmic(axes, "xy")
    series = list(dict.fromkeys(row.series for row in known if row.series is not None))
    for index, name in enumerate(series):
        line = sorted((row for row in known if row.series == name), key=lambda row: row.seconds or 0.0)
        x, y = [row.seconds or 0.0 for row in line], [row.error or 0.0 for row in line]
        axes.plot(x, y, f"{_marker(index)}-", color=_colour(index), markersize=4.5)
    for index, row in enumerate(row for row in known if row.series is None):
        x, y = [row.seconds or 0.0], [row.error or 0.0]
        axes.plot(x, y, _marker(index), color=_colour(index), markersize=6, label=None if series else row.name)
    _bounds(known, axes)
    dress(axes, "seconds", "error", "Error against time")
    if series:
        _name_lines(axes, series)
    return finished(axes, loc="center left", bbox_to_anchor=(1.02, 0.5))


def with_error_and_time(rows: Sequence[BenchmarkRow]) -> list[BenchmarkRow]:
    """Rows with a known error and a known time, both above 0."""
    return [row for row in rows if (row.error or 0.0) > 0.0 and (row.seconds or 0.0) > 0.0]


def error_against_photons(rows: Sequence[BenchmarkRow], axes: Axes) -> Axes:
    """Draw the error of decoding over the signal of a pixel, a line for each series, with its dashed bound."""
    logarithmic(axes, "xy")
    names = list(dict.fromkeys(row.series for row in rows if row.photons and row.series is not None))
    for index, name in enumerate(names):
        of_series = [(row.photons, row) for row in rows if row.series == name and row.photons]
        line, colour = sorted(of_series, key=itemgetter(0)), _colour(index)
        photons = [count for count, _ in line]
        error = [row.error or math.nan for _, row in line]
        bound = [row.bound or math.nan for _, row in line]
        axes.plot(photons, error, f"{_marker(index)}-", markersize=4.5, label=name, color=colour)
        axes.plot(photons, bound, f"{_marker(index)}--", markersize=3.0, linewidth=0.8, alpha=0.7, color=colour)
    dress(axes, "electrons a pixel", "error", "Error against light, with its Cramér-Rao bound (dashed)")
    return finished(axes, loc="center left", bbox_to_anchor=(1.02, 0.5))


def _marker(index: int) -> str:
    return _MARKERS[index % len(_MARKERS)]


def _colour(index: int) -> str:
    return _COLOURS[index % len(_COLOURS)]


def _bounds(rows: Sequence[BenchmarkRow], axes: Axes) -> None:
    """Draw a dash at the smallest possible error of each row, and a thin line up to the row."""
    for row in rows:
        if row.bound and row.seconds and row.error:
            axes.vlines(row.seconds, row.bound, row.error, color=MUTED, linewidth=0.6, alpha=0.6, zorder=1.0)
            axes.plot([row.seconds], [row.bound], "_", color=INK, markersize=6.0, zorder=1.5)


def _name_lines(axes: Axes, names: Sequence[str]) -> None:
    """Write the name of each line in the right margin, joined to the last point of the line."""
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
    axes.set_ylim(len(names) - 0.6, -0.75)  # first row on top
