"""A figure as PNG, or as PNG and SVG in one drawing.

Most of the time of a drawing goes into its layout: ticks, widths of texts, positions. For two forms, the layout is done
once, and every stroke goes to both.
"""

from __future__ import annotations

import base64
import io
import re
from html import escape
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D, TransformedPath
from numpy.typing import NDArray
from PIL import Image

from metafab.core.storage.files import whole_file
from metafab.report.style import CSS_VARIABLES

_DPI = 160
_COMPRESS_LEVEL = 1
#: Units of an SVG drawing in an inch: one unit is a point, as in matplotlib.
_SVG_DPI = 72


def save_png(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG on white; equal figures give equal bytes."""
    figure.set_dpi(_DPI)
    figure.set_facecolor("white")
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return _write_png(np.asarray(canvas.buffer_rgba()), path)


def save_both(figure: Figure, path: Path, label: str) -> str:
    """Write a figure as PNG on white, and return it as SVG element for a page, with a label for screen readers.

    The SVG follows the theme and the typeface of the page; its identifiers begin with the name of the file, which is
    unique on a page.
    """
    stream = io.StringIO()
    width_in, height_in = figure.get_size_inches()
    figure.set_dpi(_SVG_DPI)
    figure.set_facecolor("none")
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "metafab"}):
        both = _Both(width_in, height_in, stream)
        mixed: Any = MixedModeRenderer(figure, width_in, height_in, _DPI, both)
        figure.draw(mixed)
        both.finalize()
    _write_png(both.picture(), path)
    return _element(stream.getvalue(), path.stem, label, float(width_in))


class _Both(RendererSVG):
    """Renderer that writes every stroke as SVG and draws it on pixels."""

    def __init__(self, width_in: float, height_in: float, stream: io.StringIO) -> None:
        silent = {"Date": None, "Creator": None, "Format": None, "Type": None}
        super().__init__(width_in * _SVG_DPI, height_in * _SVG_DPI, stream, image_dpi=_DPI, metadata=silent)
        self._pixels: Any = RendererAgg(width_in * _DPI, height_in * _DPI, _DPI)
        self._enlarge = Affine2D().scale(_DPI / _SVG_DPI)
        paper, whole = self._pixels.new_gc(), Affine2D().scale(self._pixels.width, self._pixels.height)
        paper.set_linewidth(0.0)
        self._pixels.draw_path(paper, Outline.unit_rectangle(), whole, (1.0, 1.0, 1.0, 1.0))

    def picture(self) -> NDArray[np.uint8]:
        """The drawn pixels on white, shape (n_y, n_x, 3)."""
        rgba = np.asarray(self._pixels.buffer_rgba())
        return np.asarray(Image.fromarray(rgba).convert("RGB"))

    def draw_path(self, gc: Any, path: Any, transform: Any, rgbFace: Any = None) -> None:
        super().draw_path(gc, path, transform, rgbFace)
        self._pixels.draw_path(self._on_pixels(gc), path, transform + self._enlarge, rgbFace)

    def draw_markers(
        self, gc: Any, marker_path: Any, marker_trans: Any, path: Any, trans: Any, rgbFace: Any = None
    ) -> None:
        super().draw_markers(gc, marker_path, marker_trans, path, trans, rgbFace)
        larger = (marker_path, marker_trans + self._enlarge, path, trans + self._enlarge)
        self._pixels.draw_markers(self._on_pixels(gc), *larger, rgbFace)

    def draw_path_collection(self, *args: Any, **options: Any) -> None:
        # Draws each path with `draw_path`: the method of RendererSVG would draw no pixels.
        RendererBase.draw_path_collection(self, *args, **options)

    def draw_image(self, gc: Any, x: float, y: float, im: Any, transform: Any = None) -> None:
        # The image has the resolution of the pixels, first row lowest; strong compression takes longer than drawing.
        self._pixels.draw_image(self._on_pixels(gc), *self._enlarge.transform((x, y)), im)
        stream = io.BytesIO()
        Image.fromarray(np.flipud(im)).save(stream, format="PNG", compress_level=_COMPRESS_LEVEL)
        height, width = (count * _SVG_DPI / _DPI for count in im.shape[:2])
        place = {"x": x, "y": self.height - y - height, "width": width, "height": height}
        self.writer.element(
            "image",
            attrib={name: f"{value:.6f}" for name, value in place.items()}
            | {"xlink:href": "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()},
        )

    def option_scale_image(self) -> bool:
        return False

    def draw_text(
        self, gc: Any, x: float, y: float, s: str, prop: Any, angle: float, ismath: Any = False, mtext: Any = None
    ) -> None:
        super().draw_text(gc, x, y, s, prop, angle, ismath, mtext)
        at = self._enlarge.transform((x, y))
        self._pixels.draw_text(self._on_pixels(gc), *at, s, prop, angle, ismath, mtext)

    def _on_pixels(self, gc: Any) -> Any:
        """Copy of a graphics context whose clips are scaled to pixels."""
        own = self._pixels.new_gc()
        own.copy_properties(gc)
        if (rectangle := gc.get_clip_rectangle()) is not None:
            own.set_clip_rectangle(rectangle.transformed(self._enlarge))
        path, transform = gc.get_clip_path()
        if path is not None:
            own.set_clip_path(TransformedPath(path, transform + self._enlarge))
        return own


def _write_png(pixels: NDArray[np.uint8], path: Path) -> Path:
    picture = Image.fromarray(pixels).convert("RGB")
    with whole_file(path) as part:
        picture.save(part, format="PNG", dpi=(_DPI, _DPI), compress_level=_COMPRESS_LEVEL)
    return path


def _element(text: str, name: str, label: str, width_in: float) -> str:
    """The SVG element of a drawing, with prefixed identifiers, and with inks and typeface of the page."""
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
    # The page sets the size from the width in inches; the view box keeps the proportions.
    head, body = text.split(">", 1)
    head = re.sub(r' (?:width|height|version)="[^"]*"', "", head)
    body = re.sub(r"\n\s*", " ", body).strip()
    return f'{head} class="plot" style="--inches: {width_in:g}" role="img" aria-label="{escape(label)}">{body}'
