"""Pictures of single results: a library, proposals of a rotating lobe, a comparison of cameras, a full-Stokes frame.

Each function writes a PNG and returns its path.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from metafab.camera.stokes import StokesFrame
from metafab.comparison import Comparison
from metafab.core.conventions import POLARISATIONS
from metafab.core.polarisation import STATES
from metafab.decode.stokes import StokesImage
from metafab.library.library import Library
from metafab.phase.studies.propose import Proposal
from metafab.report.figures import library as maps
from metafab.report.figures import study
from metafab.report.render import save_png
from metafab.report.style import CONTRAST_MAP, DEPTH_MAP, bare, depth_unit, map_with_bar, show_map


def library_figure(library: Library, path: Path) -> Path:
    """Draw phase, transmittance, sensitivity, error and coverage of a library at its first wavelength."""
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
    """Draw depth bound and rotation over depth of up to five choices of [L, epsilon] for one range, best first."""
    figure = Figure(figsize=(9.6, 3.8))
    left, right = figure.subplots(1, 2, gridspec_kw={"left": 0.08, "right": 0.97, "bottom": 0.15, "wspace": 0.25})
    study.proposed_bounds(choices, left)
    study.proposed_orientation(choices, right)
    return save_png(figure, path)


def comparison_figure(comparison: Comparison, path: Path) -> Path:
    """Draw depth error and sharpness over depth of all cameras."""
    figure = Figure(figsize=(9.6, 4.2))
    left, right = figure.subplots(1, 2, gridspec_kw={"left": 0.08, "right": 0.97, "bottom": 0.14, "wspace": 0.25})
    study.rival_depth_errors(comparison, left)
    study.rival_sharpness(comparison, right)
    return save_png(figure, path)


def stokes_figure(frame: StokesFrame, image: StokesImage, path: Path) -> Path:
    """Draw the six raw images of a frame and, below, decoded S0, three normalised parameters and both depths."""
    n_y, n_x = image.depth_m.shape
    extent = (0.0, float(n_x), 0.0, float(n_y))
    figure = Figure(figsize=(14.0, 5.4))
    grid = {"left": 0.02, "right": 0.95, "bottom": 0.03, "top": 0.93, "hspace": 0.18, "wspace": 0.62}
    raw_axes, decoded_axes = figure.subplots(2, 6, gridspec_kw=grid)
    brightest = float(np.percentile(frame.images, 99.8))
    for axes, state, raw in zip(raw_axes, STATES, frame.images, strict=True):
        bare(axes, f"raw, {state}".replace("-", "−"))
        show_map(axes, raw, extent, cmap="gray", vmin=0.0, vmax=brightest)
    s0 = image.stokes[0]
    bare(decoded_axes[0], "S0")
    map_with_bar(decoded_axes[0], s0, extent, "electrons", cmap="gray", vmin=0.0)
    lit = s0 > 0.2 * np.percentile(s0, 99.0)
    for index in (1, 2, 3):
        axes = decoded_axes[index]
        bare(axes, f"S{index} / S0")
        share = np.where(lit, image.stokes[index] / np.where(lit, s0, 1.0), np.nan)
        map_with_bar(axes, share, extent, "", cmap=CONTRAST_MAP, vmin=-1.0, vmax=1.0)
    scale, unit = depth_unit(image.depth_m)
    depths = (("Depth", scale * image.depth_m), ("True depth", scale * frame.depth_m))
    # One scale for both: equal colours are equal depths.
    known = np.concatenate([depth[np.isfinite(depth)] for _, depth in depths])
    limits: dict[str, Any] = {"vmin": float(known.min()), "vmax": float(known.max())} if known.size else {}
    for axes, (title, depth) in zip(decoded_axes[4:], depths, strict=True):
        bare(axes, title)
        map_with_bar(axes, depth, extent, f"depth / {unit}", cmap=DEPTH_MAP, **limits)
    return save_png(figure, path)
