"""One library as one picture, for ``metafab library show``."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from metafab.library.library import Library
from metafab.report import figures
from metafab.report.style import save_png


def library_figure(library: Library, path: Path) -> Path:
    """Draw phase, transmittance, error and reach of a library as a PNG.

    Args:
        library: what to show, at its first wavelength.
        path: PNG to write.

    Returns:
        ``path``.
    """
    figure = Figure(figsize=(12.6, 6.8))
    grid = figure.subplots(2, 3, gridspec_kw={"left": 0.05, "right": 0.93, "wspace": 0.42, "hspace": 0.34})
    for row, draw in enumerate((figures.phase_map, figures.transmittance_map)):
        draw(library, grid[row, 0], "x")
        draw(library, grid[row, 1], "y")
    figures.coverage(library, grid[0, 2])
    figures.error_map(library, grid[1, 2])
    return save_png(figure, path)
