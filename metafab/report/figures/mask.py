"""The written mask at three zooms, and fields of a simulated patch of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.report.style import (
    GOOD,
    HAIRLINE,
    INK,
    PHASE_MAP,
    PHASE_TICKS,
    SHARE_MAP,
    X_COLOUR,
    Extent,
    dress,
    picture,
)


def fill_map(fill: FloatArray, half_side_um: tuple[float, float], axes: Axes, marks_um: list[FloatArray]) -> Axes:
    """Draw the share of the surface that pillars cover, with frames at the places of the closer zooms.

    The share has the shape (n_y, n_x), 0 to 1 and NaN without pillars, over twice ``half_side_um``. ``marks_um`` holds
    an array (left, right, low, high), shape (4,), for each closer zoom.
    """
    half_x, half_y = half_side_um
    extent = (-half_x, half_x, -half_y, half_y)
    # Blocks on the rim lie partly outside the lens and do not set the scale.
    low, high = np.nanpercentile(fill, (2.0, 98.0)) if np.isfinite(fill).any() else (0.0, 1.0)
    bar = "#ffffff" if np.isfinite(fill[0, 0]) else INK
    scale: dict[str, Any] = {"cmap": SHARE_MAP, "vmin": low, "vmax": high}
    picture(axes, fill, extent, "share covered by pillars", "The whole mask", bar=bar, **scale)
    for left, right, low, high in marks_um:
        pad = max(0.0, 0.012 * 2 * half_x - (right - left) / 2)  # visible size of the frame
        corners_x = [left - pad, right + pad, right + pad, left - pad, left - pad]
        corners_y = [low - pad, low - pad, high + pad, high + pad, low - pad]
        axes.plot(corners_x, corners_y, color="#ffffff", linewidth=1.1)
    return axes


def pillar_outlines(
    rectangles_um: FloatArray, axes: Axes, title: str, *, outline: Outline = RECTANGLE, label_nearest: bool = False
) -> Axes:
    """Draw pillars (x, y of the centre, width, length), shape (n, 4), with the outlines of the file.

    ``label_nearest`` marks the pillar nearest to the middle and writes its width x length, or its diameter, above.
    """
    x, y = rectangles_um[:, 0], rectangles_um[:, 1]
    unit_um = outline.database_unit_nm * 1e-3
    paths = [
        Path(np.array([place]) + outline.vertices(*size) * unit_um, closed=False)
        for place, size in zip(rectangles_um[:, :2], np.rint(rectangles_um[:, 2:] / unit_um).astype(int), strict=True)
    ]
    # A single path is drawn as fast as a picture, and it follows the theme of the page.
    axes.add_patch(PathPatch(Path.make_compound_path(*paths), facecolor=GOOD, linewidth=0.0))
    dress(axes, "x / µm", "y / µm", title)
    axes.set(xlim=(x.min() - 0.2, x.max() + 0.2), ylim=(y.min() - 0.2, y.max() + 0.2), aspect="equal")
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color(HAIRLINE)
    if label_nearest and x.size:
        nearest = int(np.argmin((x - x.mean()) ** 2 + (y - y.mean()) ** 2))
        width_nm, length_nm = (1e3 * rectangles_um[nearest, 2:]).tolist()
        is_round = outline.shape in {"ellipse", "ring"} and width_nm == length_nm
        text = f"Ø {width_nm:g} nm" if is_round else f"{width_nm:g} × {length_nm:g} nm"
        axes.add_patch(PathPatch(paths[nearest], color=X_COLOUR, lw=0))
        axes.set_title(text, fontsize=9, color=X_COLOUR, loc="right", pad=7)
    return axes


def patch_phase(field: ComplexArray, x_um: FloatArray, y_um: FloatArray, axes: Axes, title: str) -> Axes:
    """Draw the phase of a field, shape (n_y, n_x), at the sites (x, y) of a patch on a cyclic scale."""
    extent = _extent(x_um, y_um)
    scale: dict[str, Any] = {"cmap": PHASE_MAP, "vmin": -math.pi, "vmax": math.pi}
    return picture(axes, np.angle(field), extent, "phase / rad", title, bar=INK, ticks=PHASE_TICKS, **scale)


def patch_amplitude(
    field: ComplexArray, x_um: FloatArray, y_um: FloatArray, axes: Axes, title: str, largest: float
) -> Axes:
    """Draw the amplitude of a field, shape (n_y, n_x), at the sites (x, y) of a patch, on a scale up to ``largest``."""
    extent = _extent(x_um, y_um)
    scale: dict[str, Any] = {"cmap": SHARE_MAP, "vmin": 0.0, "vmax": largest}
    return picture(axes, np.abs(field), extent, "field over incident field", title, **scale)


def _extent(x_um: FloatArray, y_um: FloatArray) -> Extent:
    """Extent of the patch, half a period beyond the outermost sites."""
    half_x, half_y = (0.5 * (axis[-1] - axis[0]) / max(1, axis.size - 1) for axis in (x_um, y_um))
    return (x_um[0] - half_x, x_um[-1] + half_x, y_um[0] - half_y, y_um[-1] + half_y)
