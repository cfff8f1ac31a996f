"""Common style of all figures: palette, colour maps, panels, scales.

Named inks (text, rules, the two polarisations) become CSS variables in the SVG form, so that the page can change them
for its dark theme. Colour maps are fixed: cyclic for phase, perceptually uniform otherwise. All can be read without
red-green vision.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import LogFormatter
from numpy.typing import ArrayLike

#: Inks of the figures and their CSS variables.
INK = "#20242c"
MUTED = "#6a7280"
HAIRLINE = "#d3d8e0"
X_COLOUR, Y_COLOUR = "#c4511d", "#1d6fb3"
IDEAL, GOOD = "#8b919c", "#2c7f62"
CSS_VARIABLES = {
    INK: "--ink",
    MUTED: "--muted",
    HAIRLINE: "--hairline",
    X_COLOUR: "--x",
    Y_COLOUR: "--y",
    IDEAL: "--ideal",
    GOOD: "--good",
}
POLARISATION_COLOUR = {"x": X_COLOUR, "y": Y_COLOUR}

PHASE_MAP = "twilight"
LIGHT_MAP = "inferno"
DEPTH_MAP = "viridis"
SHARE_MAP = "cividis"
ERROR_MAP = "magma_r"
#: I_x / I_y on a logarithmic scale: blue where y wins, vermilion where x does.
CONTRAST_MAP = LinearSegmentedColormap.from_list(
    "polarisation_contrast", ["#0f4a80", Y_COLOUR, "#a9c9e4", "#f4f2ee", "#ecbf9f", X_COLOUR, "#8a2f08"]
)

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

Margins = tuple[float, float, float, float]
#: (left, right, low, high) of a picture, in the units of its axes.
Extent = tuple[float, float, float, float]
#: Values and names of the ticks of a scale.
Ticks = tuple[Sequence[float], Sequence[str]]
NO_TICKS: Ticks = ((), ())
PHASE_TICKS: Ticks = ((-math.pi, 0.0, math.pi), ("−π", "0", "π"))
#: Left, right, bottom and top margins in inches: of a plot, of a map with its colour bar, of a picture without ticks.
PLOT: Margins = (0.74, 0.22, 0.52, 0.36)
MAP: Margins = (0.74, 0.98, 0.52, 0.36)
PICTURE: Margins = (0.10, 0.86, 0.10, 0.36)
#: Margins of bars under their names, with room for values at their ends and half a label of the first tick.
BARS: Margins = (0.26, 1.15, 0.52, 0.42)


def panel(size_in: tuple[float, float] = (4.0, 3.1), margins_in: Margins = PLOT) -> tuple[Figure, Axes]:
    """An empty figure with one pair of axes, made without pyplot and its global state.

    Fixed margins place the axes; a layout that measures text takes longer than the drawing.
    """
    width, height = size_in
    left, right, bottom, top = margins_in
    figure = Figure(figsize=size_in)
    place = (left / width, bottom / height, 1.0 - (left + right) / width, 1.0 - (bottom + top) / height)
    return figure, figure.add_axes(place)


def dress(axes: Axes, x_label: str = "", y_label: str = "", title: str = "", title_ink: str = INK) -> Axes:
    """Set title, labels, spines and ticks; labels have fixed places, so that no text is measured."""
    width, height = _size_in(axes)
    axes.set_xlabel(x_label, fontsize=9, color=INK)
    axes.set_ylabel(y_label, fontsize=9, color=INK)
    axes.xaxis.set_label_coords(0.5, -0.31 / height)
    axes.yaxis.set_label_coords(-0.55 / width, 0.5)
    axes.set_title(title, fontsize=9.5, color=title_ink, loc="left", y=1.0, pad=7)
    axes.tick_params(which="both", labelsize=8.5, colors=MUTED, labelcolor=INK, length=3, width=0.7)
    axes.set_facecolor("none")
    for side, spine in axes.spines.items():
        spine.set_visible(side in {"left", "bottom"})
        spine.set_color(MUTED)
        spine.set_linewidth(0.7)
    return axes


def bare(axes: Axes, title: str = "", title_ink: str = INK) -> Axes:
    """Set the title, and remove ticks and spines: for a picture with a scale bar."""
    dress(axes, title=title, title_ink=title_ink)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    return axes


def show_map(axes: Axes, values: ArrayLike, extent: Extent, **options: Any) -> AxesImage:
    """Draw an array of shape (n_y, n_x) as pixels over ``extent``, first row lowest; NaN stays blank."""
    options = {"origin": "lower", "interpolation": "nearest", "aspect": "equal"} | options
    return axes.imshow(np.ma.masked_invalid(values), extent=extent, **options)


def map_with_bar(
    axes: Axes, values: ArrayLike, extent: Extent, label: str, ticks: Ticks = NO_TICKS, **options: Any
) -> None:
    """Draw an array, shape (n_y, n_x), as :func:`show_map` does, and the :func:`colour_bar` of its values."""
    colour_bar(show_map(axes, values, extent, **options), axes, label, ticks)


def colour_bar(mappable: ScalarMappable, axes: Axes, label: str, ticks: Ticks = NO_TICKS) -> Axes:
    """Draw a colour bar to the right of a picture, with one width on all figures; ``label`` is quantity and unit.

    It is drawn as an image, four times faster than matplotlib's own. Without ``ticks`` it has round values.
    """
    width, _ = _size_in(axes)
    bar = axes.inset_axes((1.0 + 0.10 / width, 0.0, 0.13 / width, 1.0))
    shades = np.linspace(0.0, 1.0, 256)[:, None]
    across: dict[str, Any] = {
        "transform": bar.transAxes,
        "extent": (0.0, 1.0, 0.0, 1.0),
        "origin": "lower",
        "aspect": "auto",
    }
    bar.imshow(shades, cmap=mappable.cmap, **across)
    if isinstance(mappable.norm, LogNorm):
        logarithmic(bar, "y")
    # A picture of one value gets a range around it.
    mappable.set_clim(*bar.yaxis.get_major_locator().nonsingular(*mappable.get_clim()))
    bar.set(xticks=(), ylim=mappable.get_clim())
    if ticks[0]:
        bar.set_yticks(*ticks)
        bar.minorticks_off()
    bar.yaxis.tick_right()
    bar.yaxis.set_label_position("right")
    bar.set_ylabel(label, fontsize=9, color=INK)
    bar.tick_params(which="both", labelsize=8.5, colors=MUTED, labelcolor=INK, length=3, width=0.7)
    bar.spines[:].set_visible(False)
    return bar


def logarithmic(axes: Axes, which: str) -> None:
    """Set logarithmic scales along ``which`` ("x", "y" or "xy"), with ticks as plain text."""
    for letter in which:
        axes.set(**{f"{letter}scale": "log"})
        axis = axes.xaxis if letter == "x" else axes.yaxis
        axis.set_major_formatter(_Powers())
        axis.set_minor_formatter(_Powers())


class _Powers(LogFormatter):
    """Ticks such as 0.01, 2, 10⁵, without matplotlib's typesetter of formulas, which is slow to load."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return power_text(x) if super().__call__(x, pos) else ""


def power_text(value: float) -> str:
    """Text of a tick at a positive number of few digits."""
    exponent = math.floor(math.log10(value) + 1e-9)
    if -4 <= exponent <= 4:
        return f"{value:g}"
    digits = f"{value / 10.0**exponent:g}"
    power = "10" + str(exponent).translate(_RAISED)
    return power if digits == "1" else f"{digits}×{power}"


def legend(axes: Axes, **options: Any) -> None:
    """Draw a legend without a frame."""
    axes.legend(frameon=False, fontsize=8.5, labelcolor=INK, **options)


def finished(axes: Axes, **options: Any) -> Axes:
    """Add grid lines to a plot, and a legend if anything has a label."""
    axes.grid(color=MUTED, linewidth=0.4, alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        legend(axes, **options)
    return axes


def picture(
    axes: Axes,
    values: ArrayLike,
    extent_um: Extent,
    label: str,
    title: str,
    *,
    bar: str = "#ffffff",
    title_ink: str = INK,
    **options: Any,
) -> Axes:
    """Draw an array, shape (n_y, n_x), as a picture with a colour bar and a scale bar of the colour ``bar``."""
    map_with_bar(axes, values, extent_um, label, **options)
    bare(axes, title, title_ink)
    scale_bar(axes, extent_um, bar)
    return axes


def scale_bar(axes: Axes, extent_um: Extent, colour: str = "#ffffff", *, text_above: bool = False) -> None:
    """Draw a bar of a round length in the lower left corner of a picture of ``extent_um`` (left, right, low, high).

    Its text is below it, where a round lens leaves more room, or above it, where a small picture has room.
    """
    left, right, low, high = extent_um
    width, height = right - left, high - low
    length = max(step * 10.0**power for power in range(-2, 5) for step in (1, 2, 5) if step * 10.0**power < width / 5)
    x, y = left + 0.05 * width, low + 0.08 * height
    axes.plot([x, x + length], [y, y], color=colour, linewidth=2.4, solid_capstyle="butt")
    text = f"{length:g} µm" if length < 1000 else f"{length / 1000:g} mm"
    shade = {"facecolor": "#000000", "alpha": 0.35, "edgecolor": "none", "pad": 1.2}
    axes.text(
        x,
        y + (0.03 if text_above else -0.02) * height,
        text,
        color=colour,
        fontsize=8.5,
        va="bottom" if text_above else "top",
        bbox=shade if colour == "#ffffff" else None,
    )


def depth_unit(depth_m: ArrayLike) -> tuple[float, str]:
    """Number of units in a metre, and name of the unit, for depths of any shape."""
    depths = np.asarray(depth_m, dtype=np.float64)
    largest = float(np.max(depths[np.isfinite(depths)], initial=0.0))
    return (1e3, "mm") if largest < 0.02 else (1e2, "cm") if largest < 1.0 else (1.0, "m")


def depth_text(depth_m: float) -> str:
    """A depth with the unit that suits it."""
    if depth_m == math.inf:
        return "∞"
    scale, unit = depth_unit(depth_m)
    return f"{scale * depth_m:.4g} {unit}"


def _size_in(axes: Axes) -> tuple[float, float]:
    """Width and height of the axes in inches."""
    width, height = axes.get_figure(root=True).get_size_inches()  # type: ignore[union-attr]
    place = axes.get_position(original=True)
    return float(width * place.width), float(height * place.height)
