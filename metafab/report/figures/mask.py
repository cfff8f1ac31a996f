"""The written pillars at three zooms: the lens as a grey map, then outlines."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from metafab.core.conventions import FloatArray
from metafab.layout.outlines import RECTANGLE, Outline
from metafab.report.style import GOOD, HAIRLINE, INK, SHARE_MAP, X_COLOUR, bare, colour_bar, dress, scale_bar, show_map


def fill_map(fill: FloatArray, half_side_um: tuple[float, float], axes: Axes, marks_um: list[FloatArray]) -> Axes:
    """Share of the surface that pillars cover, over the whole lens; frames show where the other zooms lie.

    Args:
        fill: shape (n_y, n_x), 0 to 1; NaN where there is no pillar.
        half_side_um: half the width and half the height of the map.
        axes: where to draw.
        marks_um: (left, right, low, high) of each closer zoom.
    """
    half_x, half_y = half_side_um
    extent = (-half_x, half_x, -half_y, half_y)
    # Blocks on the rim are partly outside the lens: they do not set the scale.
    low, high = np.nanpercentile(fill, (2.0, 98.0)) if np.isfinite(fill).any() else (0.0, 1.0)
    image = show_map(axes, fill, extent, cmap=SHARE_MAP, vmin=low, vmax=high)
    colour_bar(image, axes, "share covered by pillars")
    for left, right, low, high in marks_um:
        pad = max(0.0, 0.012 * 2 * half_x - (right - left) / 2)  # a frame that can be seen
        corners_x = [left - pad, right + pad, right + pad, left - pad, left - pad]
        corners_y = [low - pad, low - pad, high + pad, high + pad, low - pad]
        axes.plot(corners_x, corners_y, color="#ffffff", linewidth=1.1)
    bare(axes, "The whole mask")
    scale_bar(axes, extent, "#ffffff" if np.isfinite(fill[0, 0]) else INK)
    return axes


def pillar_outlines(
    rectangles_um: FloatArray, axes: Axes, title: str, *, outline: Outline = RECTANGLE, label_nearest: bool = False
) -> Axes:
    """Pillars as the rectangles or polygons of the file.

    Args:
        rectangles_um: shape (n, 4), (x, y) of each centre, width and length.
        axes: where to draw.
        title: what is shown.
        outline: what sizes are drawn as.
        label_nearest: mark the pillar nearest to the middle and write its width x length above.
    """
    x, y = rectangles_um[:, 0], rectangles_um[:, 1]
    unit_um = outline.database_unit_nm * 1e-3
    paths = [
        Path(np.array([place]) + outline.vertices(*size) * unit_um, closed=False)
        for place, size in zip(rectangles_um[:, :2], np.rint(rectangles_um[:, 2:] / unit_um).astype(int), strict=True)
    ]
    # One outline for all: as fast as a picture, and it follows the page's theme.
    axes.add_patch(PathPatch(Path.make_compound_path(*paths), facecolor=GOOD, linewidth=0.0))
    dress(axes, "x / µm", "y / µm", title)
    axes.set(xlim=(x.min() - 0.2, x.max() + 0.2), ylim=(y.min() - 0.2, y.max() + 0.2), aspect="equal")
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color(HAIRLINE)
    if label_nearest and x.size:
        nearest = int(np.argmin((x - x.mean()) ** 2 + (y - y.mean()) ** 2))
        text = "{:g} × {:g} nm".format(*(1e3 * rectangles_um[nearest, 2:]).tolist())
        axes.add_patch(PathPatch(paths[nearest], color=X_COLOUR, lw=0))
        axes.set_title(text, fontsize=9, color=X_COLOUR, loc="right", pad=7)
    return axes
