"""Pictures of single results: a library, proposals of a rotating lobe, a comparison of cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from metafab.comparison import Comparison
from metafab.core.conventions import POLARISATIONS
from metafab.library.library import Library
from metafab.phase.studies.propose import Proposal
from metafab.report.figures import library as maps
from metafab.report.figures import study
from metafab.report.render import save_png


def library_figure(library: Library, path: Path) -> Path:
    """Draw phase, transmittance, sensitivity, error and coverage of a library at its first wavelength.

    Args:
        library: the library.
        path: PNG to write.

    Returns:
        ``path``.
    """
    figure = Figure(figsize=(16.4, 6.8))
    grid = figure.subplots(
        2, 4, gridspec_kw={"left": 0.045, "right": 0.945, "bottom": 0.08, "top": 0.94, "wspace": 0.5, "hspace": 0.3}
    )
    for row, draw in enumerate((maps.phase_map, maps.transmittance_map)):
        draw(library, grid[row, 0], "x")
        draw(library, grid[row, 1], "y")
    for row, polarisation in enumerate(POLARISATIONS):
        maps.sensitivity_map(library, grid[row, 2], polarisation)
    maps.coverage(library, grid[0, 3])
    maps.error_map(library, grid[1, 3])
    return save_png(figure, path)


def proposal_figure(choices: Sequence[Proposal], path: Path) -> Path:
    """Draw depth bound and rotation over depth of up to five choices of [L, epsilon].

    Args:
        choices: choices over one range of depths, best first; at least one.
        path: PNG to write.

    Returns:
        ``path``.
    """
    figure = Figure(figsize=(9.6, 3.8))
    left, right = figure.subplots(1, 2, gridspec_kw={"left": 0.08, "right": 0.97, "bottom": 0.15, "wspace": 0.25})
    study.proposed_bounds(choices, left)
    study.proposed_orientation(choices, right)
    return save_png(figure, path)


def comparison_figure(comparison: Comparison, path: Path) -> Path:
    """Draw depth error and sharpness over depth of all cameras.

    Args:
        comparison: the comparison.
        path: PNG to write.

    Returns:
        ``path``.
    """
    figure = Figure(figsize=(9.6, 4.2))
    left, right = figure.subplots(1, 2, gridspec_kw={"left": 0.08, "right": 0.97, "bottom": 0.14, "wspace": 0.25})
    study.rival_depth_errors(comparison, left)
    study.rival_sharpness(comparison, right)
    return save_png(figure, path)
