"""Printed sizes of a mask: maps of the size error, its histogram, and the process window."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from metafab.report.style import (
    CONTRAST_MAP,
    HAIRLINE,
    INK,
    X_COLOUR,
    Y_COLOUR,
    dress,
    finished,
    logarithmic,
    picture,
)

if TYPE_CHECKING:
    from metafab.exposure.prediction import SizeMap
    from metafab.exposure.results import SizeErrors

_INKS = (Y_COLOUR, X_COLOUR)
#: The first of two curves that may coincide is the wider.
_WIDTHS = (3.2, 1.4)


def size_map(errors: SizeMap, axes: Axes, title: str, largest_nm: float) -> Axes:
    """Draw the mean size error of each block of the lens: blue where pillars print too small, vermilion too large.

    Args:
        errors: the map.
        title: title of the figure.
        largest_nm: end of the scale on both sides of 0.
    """
    n_y, n_x = errors.bias_nm.shape
    half_x, half_y = 0.5 * n_x * errors.block_um[0], 0.5 * n_y * errors.block_um[1]
    extent = (-half_x, half_x, -half_y, half_y)
    scale: dict[str, Any] = {"cmap": CONTRAST_MAP, "vmin": -largest_nm, "vmax": largest_nm}
    return picture(axes, errors.bias_nm, extent, "printed less wanted size / nm", title, bar=INK, **scale)


def size_histogram(parts: Mapping[str, SizeErrors], axes: Axes) -> Axes:
    """Draw the share of widths and lengths at each size error, on a logarithmic scale, by the name of each exposure."""
    ends_nm: list[float] = []
    for (name, errors), ink in zip(parts.items(), _INKS, strict=False):
        share = 100.0 * errors.cd_histogram / max(1.0, float(errors.cd_histogram.sum()))
        axes.stairs(np.where(share > 0.0, share, np.nan), errors.cd_edges_nm, color=ink, linewidth=1.5, label=name)
        held = np.flatnonzero(share)
        if held.size:
            ends_nm += errors.cd_edges_nm[[held[0], held[-1] + 1]].tolist()
    dress(axes, "printed less wanted size / nm", "share of widths and lengths per bin, %", "Size errors of all pillars")
    logarithmic(axes, "y")
    if ends_nm:
        axes.set_xlim(min(ends_nm) - 0.1, max(ends_nm) + 0.1)
    low = axes.get_ylim()[0]
    axes.set_yticks([tick for tick in axes.get_yticks() if low <= tick <= 100.0])
    axes.set_ylim(low, 1000.0)  # Room for the legend above 100 %.
    return finished(axes, loc="upper left")


def process_window(parts: Mapping[str, SizeErrors], axes: Axes) -> Axes:
    """Draw mean and standard deviation of the size error over the change of all doses, by the name of each exposure.

    Points at which no pillar prints are left out.
    """
    for (name, errors), ink, width in zip(parts.items(), _INKS, _WIDTHS, strict=False):
        table = [(p.dose_change_percent, p.bias_nm, p.rms_nm, p.unprinted_share) for p in errors.window]
        percent, mean, rms, unprinted = np.array(table).T
        mean = np.where(unprinted < 1.0, mean, np.nan)
        spread = np.sqrt(np.maximum(rms**2 - mean**2, 0.0))
        axes.fill_between(percent, mean - spread, mean + spread, color=ink, alpha=0.22, linewidth=0.0)
        axes.plot(percent, mean, color=ink, linewidth=width, label=name)
    axes.axhline(0.0, color=HAIRLINE, linewidth=0.8, zorder=0.0)
    dress(axes, "change of all doses, %", "printed less wanted size / nm", "Process window")
    return finished(axes, loc="upper left")
