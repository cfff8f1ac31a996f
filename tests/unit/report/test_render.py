"""One drawing, two forms: SVG and PNG show the same, the same way up; the same figure gives the same bytes."""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from PIL import Image

from metafab.report.render import save_both, save_png
from metafab.report.style import colour_bar, dress, legend, logarithmic, panel, power_text, show_map


def _everything() -> Figure:
    """Strokes of each kind: lines, dashes, markers, patches, text, turned text, a picture, a collection, clipping."""
    figure, axes = panel()
    show_map(axes, np.arange(12.0).reshape(3, 4), (0.0, 4.0, 0.0, 3.0), aspect="auto")
    axes.plot([0.0, 4.0], [0.0, 9.0], "o--", color="#c4511d", label="leaves the axes at the top")
    axes.bar([1.0, 2.0], [1.0, 2.0], width=0.3, color="#2c7f62")
    axes.quiver([1.0, 3.0], [1.0, 2.0], [1.0, 0.5], [0.0, 1.0])
    axes.scatter(np.linspace(0.0, 4.0, 50), np.full(50, 2.5), s=3, rasterized=True)
    dress(axes, "x / µm", "y / µm", "Title")
    axes.set(xlim=(0.0, 4.0), ylim=(0.0, 3.0))
    legend(axes)
    return figure


def test_pixels_beside_the_svg_are_those_of_a_drawing_of_their_own(tmp_path: Path) -> None:
    alone = np.asarray(Image.open(save_png(_everything(), tmp_path / "alone.png")), dtype=np.float64)
    save_both(_everything(), tmp_path / "both.png", "all")
    both = np.asarray(Image.open(tmp_path / "both.png"), dtype=np.float64)
    assert both.shape == alone.shape == (496, 640, 3)
    difference = np.abs(both - alone).max(axis=2)
    # Text and lines may fall half a pixel elsewhere, which changes their rims; a stroke that one of the two lacks,
    # doubles or draws in another width changes more.
    assert np.mean(difference > 64.0) < 0.01
    assert np.mean(difference) < 2.0


@pytest.mark.parametrize("colour", ["#c4511d", "#2c7f62"])
def test_a_stroke_has_the_same_width_on_pixels(colour: str, tmp_path: Path) -> None:
    """A rule of 3 points is 3/72 inch: 6.67 pixels at 160 dots an inch."""
    figure, axes = panel()
    axes.set_axis_off()
    axes.plot([0.0, 1.0], [0.5, 0.5], color=colour, linewidth=3.0, snap=False)
    save_both(figure, tmp_path / "rule.png", "rule")
    column = np.asarray(Image.open(tmp_path / "rule.png"), dtype=np.float64)[:, 320]
    ink = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    covered = ((255.0 - column) / (255.0 - ink)).mean(axis=1).sum()
    assert covered == pytest.approx(3.0 / 72.0 * 160.0, abs=0.1)


def test_a_picture_inside_the_svg_stands_upright(tmp_path: Path) -> None:
    figure, axes = panel()
    show_map(axes, np.array([[0.0, 0.0], [1.0, 1.0]]), (0.0, 1.0, 0.0, 1.0), cmap="gray", aspect="auto")
    text = save_both(figure, tmp_path / "upright.png", "two rows")
    (encoded,) = re.findall(r"data:image/png;base64,([^\"]+)", text)
    inside = np.asarray(Image.open(io.BytesIO(base64.b64decode(encoded))).convert("L"))
    assert inside[0].min() == 255, "the second row of the array lies higher"
    assert inside[-1].max() == 0
    (element,) = re.findall(r"<image[^>]*>", text)
    place = {name: float(value) for name, value in re.findall(r' (x|y|width|height)="([\d.]+)"', element)}
    box = axes.get_position()
    assert place["y"] == pytest.approx(72.0 * 3.1 * (1.0 - box.y1), abs=0.5)
    assert place["height"] == pytest.approx(72.0 * 3.1 * box.height, abs=0.5)
    assert place["x"] == pytest.approx(72.0 * 4.0 * box.x0, abs=0.5)


def test_the_same_figure_gives_the_same_bytes(tmp_path: Path) -> None:
    texts, pictures = [], []
    for _ in range(2):
        texts.append(save_both(_everything(), tmp_path / "same.png", "all"))
        pictures.append((tmp_path / "same.png").read_bytes())
    assert texts[0] == texts[1]
    assert pictures[0] == pictures[1]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.0, "1"),
        (0.001, "0.001"),
        (2000.0, "2000"),
        (6e-4, "0.0006"),
        (1e-5, "10⁻⁵"),
        (6e-5, "6×10⁻⁵"),
        (3e12, "3×10¹²"),
    ],
)
def test_powers_read_as_plain_text(value: float, text: str) -> None:
    assert power_text(value) == text


@pytest.mark.parametrize(("low", "high"), [(1e-7, 1e2), (2e-4, 2e-3), (1.0, 3.0)])
def test_logarithmic_ticks_need_no_typesetter_and_are_never_absent(low: float, high: float) -> None:
    _, axes = panel()
    axes.plot([low, high], [low, high])
    logarithmic(axes, "xy")
    for axis in (axes.xaxis, axes.yaxis):
        texts = [label.get_text() for minor in (False, True) for label in axis.get_ticklabels(minor=minor)]
        assert any(texts)
        assert not any("$" in text for text in texts)


def test_colour_bar_spans_the_limits_of_its_picture() -> None:
    _, axes = panel()
    image = show_map(axes, np.array([[1e-3, 1.0]]), (0.0, 1.0, 0.0, 1.0), norm=LogNorm(1e-3, 1.0))
    bar = colour_bar(image, axes, "error")
    assert bar.get_ylim() == (1e-3, 1.0)
    assert bar.get_yscale() == "log"
    flat = show_map(axes, np.full((2, 2), 5.0), (0.0, 1.0, 0.0, 1.0))
    low, high = colour_bar(flat, axes, "depth").get_ylim()
    assert low < 5.0 < high, "one value alone still has a scale around it"
    assert flat.get_clim() == (low, high), "and the picture the colours of that scale"
    named = colour_bar(image, axes, "error", ((0.01, 0.1), ("a", "b")))
    assert [label.get_text() for label in named.get_yticklabels()] == ["a", "b"]
