"""Small pictures of results for notebooks; :class:`metafab.core.display.Displayed` calls :func:`picture`."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from metafab.camera.frames.frame import RawFrame
from metafab.decode.image import Image4D
from metafab.layout import Assignment, PillarMap
from metafab.library import Library
from metafab.optics import Psf
from metafab.report.figures.image import depth, intensity, raw_frame
from metafab.report.figures.library import phase_map, transmittance_map
from metafab.report.figures.mask import fill_map, picture_of, pillar_outlines
from metafab.report.figures.psf import pair_over_depth

#: Resolution of the pictures (dots per inch).
_DPI = 80


def picture(result: object) -> str:
    """HTML image of a result, or "" for a result without a picture."""
    draw = next((function for kind, function in _DRAWINGS.items() if isinstance(result, kind)), None)
    if draw is None:
        return ""
    canvas: Any = FigureCanvasAgg(draw(result))
    stream = io.BytesIO()
    canvas.print_png(stream)
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    return f'<img src="data:image/png;base64,{data}" alt="{type(result).__name__}" />'


def _row(count: int, width_in: float = 3.6, height_in: float = 3.0) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(width_in * count, height_in), dpi=_DPI)
    figure.set_layout_engine("constrained", wspace=0.1)  # a colour bar's label stands clear of its neighbour's
    return figure, [figure.add_subplot(1, count, place + 1) for place in range(count)]


def _library(library: Library) -> Figure:
    figure, (left, right) = _row(2)
    phase_map(library, left, "x")
    transmittance_map(library, right, "x")
    return figure


def _pillars(pillars: PillarMap) -> Figure:
    figure, (left, right) = _row(2)
    shown = picture_of(pillars)
    fill_map(shown.fill, shown.half_side_um, left, shown.frames_um())
    pillar_outlines(shown.zooms[-1], right, "Pillars")
    return figure


def _psf(psf: Psf) -> Figure:
    figure, (axes,) = _row(1, width_in=1.5 + 1.1 * min(psf.depth_m.size, 8))
    pair_over_depth(psf, axes)
    return figure


def _frame(frame: RawFrame) -> Figure:
    figure, (axes,) = _row(1, width_in=7.2)
    raw_frame(frame, axes)
    return figure


def _image(image: Image4D) -> Figure:
    figure, (left, right) = _row(2)
    intensity(image, left, "x")
    depth(image, right)
    return figure


_DRAWINGS: dict[type, Callable[[Any], Figure]] = {
    Library: _library,
    PillarMap: _pillars,
    Assignment: lambda mapped: _pillars(mapped.pillars),
    Psf: _psf,
    RawFrame: _frame,
    Image4D: _image,
}
