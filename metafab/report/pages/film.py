"""A decoded film as GIF or MP4: raw frame, all-in-focus images of both polarisations, depth, and contrast.

The lens inverts its images; the film shows the scene upright.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from metafab.camera.frames.frame import RawFrame
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError, MetafabError, MissingToolError
from metafab.core.storage.files import whole_file
from metafab.decode.image import Image4D
from metafab.report.figures.image import contrast_reach
from metafab.report.style import (
    CONTRAST_MAP,
    DEPTH_MAP,
    INK,
    POLARISATION_COLOUR,
    bare,
    colour_bar,
    depth_unit,
    show_map,
)

_DPI = 100
_WIDTH_IN = 9.0
_KINDS = (".gif", ".mp4")


def require_film_name(path: Path) -> None:
    """Raise InputError unless a name ends with .gif or .mp4, and MissingToolError for .mp4 without ffmpeg."""
    if path.suffix.lower() not in _KINDS:
        raise InputError.single("film", "output", "a name ending with .gif or .mp4", str(path))
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise MissingToolError("ffmpeg, which writes .mp4 files, was not found: install it, or ask for a .gif")


def write_film(film: Sequence[tuple[RawFrame, Image4D]], path: Path, *, frame_interval_s: float) -> Path:
    """Draw every frame, raw and decoded, of one camera and write the film, played in real time; return its path.

    Pillow writes a .gif, whose interval is rounded to hundredths of a second, and ffmpeg an .mp4.
    """
    require_film_name(path)
    pictures = list(_pictures(film, frame_interval_s))
    with whole_file(path) as part:
        if path.suffix.lower() == ".gif":
            _write_gif(pictures, part, frame_interval_s)
        else:
            _write_mp4(pictures, part, frame_interval_s)
    return path


def _pictures(film: Sequence[tuple[RawFrame, Image4D]], frame_interval_s: float) -> Sequence[NDArray[np.uint8]]:
    raw, image = film[0]
    scale, unit = depth_unit(image.depth_m)
    depths = [scale * decoded.depth_m[np.isfinite(decoded.depth_m)] for _, decoded in film]
    known = np.concatenate(depths) if any(d.size for d in depths) else np.array([0.0, 1.0])
    bright = max(_top(raw.frame) for raw, _ in film)
    sharp = max(_top(part) for _, decoded in film for part in (decoded.intensity_x, decoded.intensity_y))
    reach = max(contrast_reach(decoded) for _, decoded in film)
    figure, places = _frame(raw, image)
    light: dict[str, Any] = {"cmap": "gray", "vmin": 0.0}
    panels = [
        _panel(places[0], raw.frame, "Raw frame, turned upright: y and x polarisation", **light, vmax=bright),
        _panel(places[1], image.intensity_x, "I_x, all in focus", POLARISATION_COLOUR["x"], **light, vmax=sharp),
        _panel(places[2], image.intensity_y, "I_y, all in focus", POLARISATION_COLOUR["y"], **light, vmax=sharp),
        _panel(places[3], scale * image.depth_m, "Depth", cmap=DEPTH_MAP, vmin=known.min(), vmax=known.max()),
        _panel(places[4], image.contrast, "Contrast I_x / I_y", cmap=CONTRAST_MAP, norm=LogNorm(1.0 / reach, reach)),
    ]
    colour_bar(panels[3], places[3], f"depth / {unit}")
    ratios = (1.0 / reach, 1.0, reach)
    colour_bar(panels[4], places[4], "I_x / I_y", (ratios, [f"{ratio:.2g}" for ratio in ratios]))
    caption = figure.text(0.02, 0.012, "", fontsize=9, color=INK)
    canvas: Any = FigureCanvasAgg(figure)
    drawn = []
    for number, (frame, decoded) in enumerate(film):
        values = (frame.frame, decoded.intensity_x, decoded.intensity_y, scale * decoded.depth_m, decoded.contrast)
        for panel, value in zip(panels, values, strict=True):
            panel.set_data(np.ma.masked_invalid(value[::-1, ::-1]))
        caption.set_text(_caption(number * frame_interval_s, decoded))
        canvas.draw()
        drawn.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    return drawn


def _caption(time_s: float, decoded: Image4D) -> str:
    """Time, depth errors, and share of the pixels that were decoded again."""
    parts = [f"t = {time_s:.2f} s"]
    if decoded.nmae is not None:
        parts.append(f"depth within {100.0 * decoded.nmae:.2f} % over all pixels")
    if (worst := decoded.figures.worst_object_error) is not None:
        parts.append(f"{100.0 * worst:.2f} % of each object")
    if (changed := decoded.figures.changed_share) is not None:
        parts.append(f"{100.0 * changed:.0f} % decoded again")
    return ", ".join(parts)


def _frame(raw: RawFrame, image: Image4D) -> tuple[Figure, list[Axes]]:
    """Raw frame above the two images, with depth and contrast below them, or in one row for tall images."""
    title_in, gap_in, bar_in, foot_in = 0.3, 0.15, 0.8, 0.2
    n_y, n_x = image.depth_m.shape
    columns = 2 if n_x > 1.3 * n_y else 4
    tall_in = (_WIDTH_IN - 2.0 * gap_in) * raw.frame.shape[0] / raw.frame.shape[1]
    wide_in = (_WIDTH_IN - (columns + 1) * gap_in - 2.0 * bar_in) / columns
    low_in = wide_in * n_y / n_x
    row_in, rows = low_in + title_in + gap_in, 4 // columns
    # Video codecs need even numbers of pixels.
    height_in = 0.02 * np.ceil(50.0 * (tall_in + rows * row_in + title_in + gap_in + foot_in))
    figure = Figure(figsize=(_WIDTH_IN, height_in), dpi=_DPI, facecolor="white")

    def place(left: float, bottom: float, width: float, height: float) -> Axes:
        return figure.add_axes((left / _WIDTH_IN, bottom / height_in, width / _WIDTH_IN, height / height_in))

    # Depth and contrast, the last two panels, have a colour bar.
    lefts = [gap_in + k * (wide_in + gap_in) for k in range(columns)]
    lefts = [left + (bar_in if k == columns - 1 else 0.0) for k, left in enumerate(lefts)]
    return figure, [
        place(gap_in, gap_in + foot_in + rows * row_in, _WIDTH_IN - 2.0 * gap_in, tall_in),
        *(
            place(left, gap_in + foot_in + row * row_in, wide_in, low_in)
            for row in reversed(range(rows))
            for left in lefts
        ),
    ]


def _panel(axes: Axes, values: FloatArray, title: str, ink: str = INK, **options: Any) -> Any:
    bare(axes, title, ink)
    n_y, n_x = values.shape
    return show_map(axes, values[::-1, ::-1], (0.0, float(n_x), 0.0, float(n_y)), **options)


def _top(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return (float(np.percentile(finite, 99.8)) if finite.size else 1.0) or 1.0


def _write_gif(pictures: Sequence[NDArray[np.uint8]], path: Path, interval_s: float) -> None:
    palette = _palette()
    frames = [Image.fromarray(p).quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
    centiseconds = max(2, round(100.0 * interval_s))
    frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=10 * centiseconds, loop=0)


def _palette() -> Image.Image:
    """Palette of 256 colours: greys, depths, contrasts, and both inks with their tints."""
    share, white = np.linspace(0.0, 1.0, 80), np.ones(3)
    inks = [np.array(to_rgb(ink)) for ink in POLARISATION_COLOUR.values()]
    colours = [
        np.outer(share, white),
        colormaps[DEPTH_MAP](share)[:, :3],
        CONTRAST_MAP(share)[:, :3],
        *(ink + np.outer(np.arange(8) / 8.0, white - ink) for ink in inks),
    ]
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.round(255.0 * np.concatenate(colours)).astype(np.uint8).tobytes())
    return palette


def _write_mp4(pictures: Sequence[NDArray[np.uint8]], path: Path, interval_s: float) -> None:
    n_y, n_x = (n // 2 * 2 for n in pictures[0].shape[:2])
    command = [
        "ffmpeg", "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{n_x}x{n_y}",
        "-r", f"{1.0 / interval_s:.6g}", "-i", "-", "-pix_fmt", "yuv420p", "-f", "mp4", str(path),
    ]  # fmt: skip
    light = b"".join(np.ascontiguousarray(p[:n_y, :n_x]).tobytes() for p in pictures)
    done = subprocess.run(command, input=light, capture_output=True, check=False)
    if done.returncode != 0:
        raise MetafabError(f"ffmpeg could not write {path.name}: {done.stderr.decode(errors='replace').strip()}")
