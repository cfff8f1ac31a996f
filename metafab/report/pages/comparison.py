"""A design beside other cameras as one picture, for ``metafab compare``."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from metafab.comparison import Comparison
from metafab.report import figures
from metafab.report.render import save_png


def comparison_figure(comparison: Comparison, path: Path) -> Path:
    """Draw errors of depth and sharpness over depth side by side as a PNG; returns ``path``."""
    figure = Figure(figsize=(9.6, 4.2))
    left, right = figure.subplots(1, 2, gridspec_kw={"left": 0.08, "right": 0.97, "bottom": 0.14, "wspace": 0.25})
    figures.rival_depth_errors(comparison, left)
    figures.rival_sharpness(comparison, right)
    return save_png(figure, path)
