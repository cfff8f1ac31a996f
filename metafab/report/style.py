"""One look for all pictures: palette, colour maps, panels, and their two forms (PNG for paper, SVG for the page).

Colours come in two kinds. Named inks (text, rules, the two polarisations) turn into CSS variables in the SVG form, so
that the page can redraw them for dark rooms. Colour maps stay what they are: cyclic for phase, perceptually uniform
for everything else, all readable without red-green vision.
"""

from __future__ import annotations

import io
import re
from html import escape
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import ArrayLike
from PIL import Image

from metafab.core.files import whole_file

#: Inks of figures, and the CSS variables that they become.
INK, MUTED, HAIRLINE = "#20242c", "#6a7280", "#d3d8e0"
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

_DPI = 160


Margins = tuple[float, float, float, float]
#: (left, right, low, high) of a picture, in the units of its axes.
Extent = tuple[float, float, float, float]
#: Left, right, bottom and top margins in inches: of a plot, of a map with its colour bar, of a picture without ticks.
PLOT: Margins = (0.74, 0.22, 0.52, 0.36)
MAP: Margins = (0.74, 0.98, 0.52, 0.36)
PICTURE: Margins = (0.10, 0.86, 0.10, 0.36)
#: Of bars under their names, with room for values at their ends.
BARS: Margins = (0.10, 1.15, 0.52, 0.42)


def panel(size_in: tuple[float, float] = (4.0, 3.1), margins_in: Margins = PLOT) -> tuple[Figure, Axes]:
    """An empty figure with one pair of axes, free of pyplot and its global state.

    The place of the axes is fixed by margins: laying figures out by measuring their text takes longer than all else.
    """
    width, height = size_in
    left, right, bottom, top = margins_in
    figure = Figure(figsize=size_in)
    place = (left / width, bottom / height, 1.0 - (left + right) / width, 1.0 - (bottom + top) / height)
    return figure, figure.add_axes(place)


def dress(axes: Axes, x_label: str = "", y_label: str = "", title: str = "", title_ink: str = INK) -> Axes:
    """Labels, spines and ticks in the house's hand; labels at fixed places, which need no measuring."""
    width, height = _size_in(axes)
    axes.set_xlabel(x_label, fontsize=9, color=INK)
    axes.set_ylabel(y_label, fontsize=9, color=INK)
    axes.xaxis.set_label_coords(0.5, -0.31 / height)
    axes.yaxis.set_label_coords(-0.55 / width, 0.5)
    axes.set_title(title, fontsize=9.5, color=title_ink, loc="left", y=1.0, pad=7)
    axes.tick_params(labelsize=8.5, colors=MUTED, labelcolor=INK, length=3, width=0.7)
    axes.set_facecolor("none")
    for side, spine in axes.spines.items():
        spine.set_visible(side in {"left", "bottom"})
        spine.set_color(MUTED)
        spine.set_linewidth(0.7)
    return axes


def bare(axes: Axes, title: str = "", title_ink: str = INK) -> Axes:
    """Axes of a picture that carries its own scale bar: no ticks, no spines."""
    dress(axes, title=title, title_ink=title_ink)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    return axes


def show_map(axes: Axes, values: ArrayLike, extent: Extent, **options: Any) -> AxesImage:
    """An array as pixels, first row lowest, over ``extent``; NaN stays blank."""
    options = {"origin": "lower", "interpolation": "nearest", "aspect": "equal"} | options
    return axes.imshow(np.ma.masked_invalid(values), extent=extent, **options)


def colour_bar(mappable: ScalarMappable, axes: Axes, label: str, **options: Any) -> Colorbar:
    """A slim colour bar with its unit."""
    # Beside the picture, whatever its proportions, and as wide on every figure.
    width, _ = _size_in(axes)
    place = axes.inset_axes((1.0 + 0.10 / width, 0.0, 0.13 / width, 1.0))
    bar: Colorbar = axes.get_figure(root=True).colorbar(mappable, cax=place, **options)  # type: ignore[union-attr]
    bar.set_label(label, fontsize=9, color=INK)
    bar.ax.tick_params(labelsize=8.5, colors=MUTED, labelcolor=INK, length=3, width=0.7)
    bar.outline.set_visible(False)
    return bar


def legend(axes: Axes, **options: Any) -> None:
    """A legend without a frame."""
    axes.legend(frameon=False, fontsize=8.5, labelcolor=INK, **options)


def scale_bar(axes: Axes, extent_um: Extent, colour: str = "#ffffff") -> None:
    """A bar of a round length near the lower left corner of a picture of ``extent_um`` (left, right, low, high)."""
    left, right, low, high = extent_um
    width, height = right - left, high - low
    length = max(step * 10.0**power for power in range(-2, 5) for step in (1, 2, 5) if step * 10.0**power < width / 5)
    x, y = left + 0.05 * width, low + 0.06 * height
    axes.plot([x, x + length], [y, y], color=colour, linewidth=2.4, solid_capstyle="butt")
    text = f"{length:g} µm" if length < 1000 else f"{length / 1000:g} mm"
    axes.text(x, y + 0.02 * height, text, color=colour, fontsize=8.5, ha="left", va="bottom")


def depth_unit(depth_m: ArrayLike) -> tuple[float, str]:
    """The unit that suits some depths, as (how many of it make a metre, its name)."""
    largest = float(np.nanmax(np.asarray(depth_m, dtype=np.float64), initial=0.0))
    return (1e3, "mm") if largest < 0.02 else (1e2, "cm") if largest < 1.0 else (1.0, "m")


def save_png(figure: Figure, path: Path) -> Path:
    """The figure as a PNG on white, whole or not at all; the same figure gives the same bytes."""
    figure.set_dpi(_DPI)
    figure.set_facecolor("white")
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    with whole_file(path) as part:
        picture.save(part, format="PNG", dpi=(_DPI, _DPI), compress_level=4)
    return path


def svg(figure: Figure, name: str, label: str) -> str:
    """The figure as an SVG element to stand inside a page: inks follow the page's theme, text its typeface.

    Args:
        figure: what to show.
        name: prefix of all identifiers, unique on the page.
        label: what a screen reader says.
    """
    stream = io.StringIO()
    figure.set_dpi(_DPI)  # of pictures inside the drawing
    figure.set_facecolor("none")
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "metafab"}):
        # The canvas' own method: savefig would draw every figure twice.
        canvas: Any = FigureCanvasSVG(figure)
        canvas.print_svg(stream, metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r"url\(#", f"url(#{name}-", text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = re.sub(r"font-family: [^;\"]*", "font-family: inherit", text)
    text = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1; font-family: inherit", text)
    for colour, variable in CSS_VARIABLES.items():
        text = text.replace(colour, f"var({variable})")
    # The page sets the size; the view box keeps the proportions.
    head, body = text.split(">", 1)
    head = re.sub(r' (?:width|height|version)="[^"]*"', "", head)
    body = re.sub(r"\n\s*", " ", body).strip()
    return f'{head} class="plot" role="img" aria-label="{escape(label)}">{body}'


def _size_in(axes: Axes) -> tuple[float, float]:
    """Width and height of the axes' place in inches (of the root's, for axes inside axes)."""
    width, height = axes.get_figure(root=True).get_size_inches()  # type: ignore[union-attr]
    place = axes.get_position(original=True)
    return float(width * place.width), float(height * place.height)
