"""One library as one picture, for ``metafab library show``."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from metafab.core.conventions import POLARISATIONS
from metafab.library.library import Library
from metafab.report import figures
from metafab.report.render import save_png


def library_figure(library: Library, path: Path) -> Path:
    """Draw phase, transmittance, sensitivity to CD, error and reach of a library as a PNG.

    Args:
        library: what to show, at its first wavelength.
        path: PNG to write.

    Returns:
        ``path``.
    """
    figure = Figure(figsize=(16.4, 6.8))
    grid = figure.subplots(
        2, 4, gridspec_kw={"left": 0.045, "right": 0.945, "bottom": 0.08, "top": 0.94, "wspace": 0.5, "hspace": 0.3}
    )
    for row, draw in enumerate((figures.phase_map, figures.transmittance_map)):
        draw(library, grid[row, 0], "x")
        draw(library, grid[row, 1], "y")
    for row, polarisation in enumerate(POLARISATIONS):
        figures.sensitivity_map(library, grid[row, 2], polarisation)
    figures.coverage(library, grid[0, 3])
    figures.error_map(library, grid[1, 3])
    return save_png(figure, path)
