"""Picture of a decoded full-Stokes frame, for ``metafab stokes``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from metafab.camera.stokes import StokesFrame
from metafab.core.polarisation import STATES
from metafab.decode.stokes import StokesImage
from metafab.report.render import save_png
from metafab.report.style import CONTRAST_MAP, DEPTH_MAP, bare, colour_bar, depth_unit, show_map


def stokes_figure(frame: StokesFrame, image: StokesImage, path: Path) -> Path:
    """Draw six raw images and, below them, decoded S0, the three normalised parameters and both depths.

    Args:
        frame: raw images and their truth.
        image: decoded from them.
        path: PNG to write.

    Returns:
        ``path``.
    """
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
    colour_bar(show_map(decoded_axes[0], s0, extent, cmap="gray", vmin=0.0), decoded_axes[0], "electrons")
    lit = s0 > 0.2 * np.percentile(s0, 99.0)
    for index in (1, 2, 3):
        axes = decoded_axes[index]
        bare(axes, f"S{index} / S0")
        share = np.where(lit, image.stokes[index] / np.where(lit, s0, 1.0), np.nan)
        colour_bar(show_map(axes, share, extent, cmap=CONTRAST_MAP, vmin=-1.0, vmax=1.0), axes, "")
    scale, unit = depth_unit(image.depth_m)
    depths = (("Depth", scale * image.depth_m), ("True depth", scale * frame.depth_m))
    # One scale for both: equal colours are equal depths.
    known = np.concatenate([depth[np.isfinite(depth)] for _, depth in depths])
    limits = {"vmin": float(known.min()), "vmax": float(known.max())} if known.size else {}
    for axes, (title, depth) in zip(decoded_axes[4:], depths, strict=True):
        bare(axes, title)
        colour_bar(show_map(axes, depth, extent, cmap=DEPTH_MAP, **limits), axes, f"depth / {unit}")
    return save_png(figure, path)
