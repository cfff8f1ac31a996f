"""A decoded full-Stokes frame as one picture, for ``metafab stokes``."""

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
    """Draw six raw images, and below them decoded S0, the three normalised parameters and depth, as a PNG.

    Args:
        frame: raw images.
        image: decoded from them.
        path: PNG to write.

    Returns:
        ``path``.
    """
    n_y, n_x = image.depth_m.shape
    extent = (0.0, float(n_x), 0.0, float(n_y))
    figure = Figure(figsize=(14.0, 5.4))
    grid = {"left": 0.02, "right": 0.95, "bottom": 0.03, "top": 0.93, "hspace": 0.18, "wspace": 0.62}
    places = figure.subplots(2, 6, gridspec_kw=grid)
    top = float(np.percentile(frame.images, 99.8))
    for axes, state, raw in zip(places[0], STATES, frame.images, strict=True):
        bare(axes, f"raw, {state}".replace("-", "−"))
        show_map(axes, raw, extent, cmap="gray", vmin=0.0, vmax=top)
    lit = image.stokes[0] > 0.2 * np.percentile(image.stokes[0], 99.0)
    bare(places[1, 0], "S0")
    panel = show_map(places[1, 0], image.stokes[0], extent, cmap="gray", vmin=0.0)
    colour_bar(panel, places[1, 0], "electrons")
    for index in (1, 2, 3):
        axes = places[1, index]
        bare(axes, f"S{index} / S0")
        share = np.where(lit, image.stokes[index] / np.where(lit, image.stokes[0], 1.0), np.nan)
        colour_bar(show_map(axes, share, extent, cmap=CONTRAST_MAP, vmin=-1.0, vmax=1.0), axes, "")
    scale, unit = depth_unit(image.depth_m)
    bare(places[1, 4], "Depth")
    # One scale for both: equal colours are equal depths.
    known = scale * np.concatenate([d[np.isfinite(d)] for d in (image.depth_m, frame.depth_m)])
    limits = {"vmin": float(known.min()), "vmax": float(known.max())} if known.size else {}
    depth = show_map(places[1, 4], scale * image.depth_m, extent, cmap=DEPTH_MAP, **limits)
    colour_bar(depth, places[1, 4], f"depth / {unit}")
    bare(places[1, 5], "True depth")
    true = show_map(places[1, 5], scale * frame.depth_m, extent, cmap=DEPTH_MAP, **limits)
    colour_bar(true, places[1, 5], f"depth / {unit}")
    return save_png(figure, path)
