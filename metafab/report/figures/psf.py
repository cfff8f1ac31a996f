"""The PSF pair: its pictures over depth, its orientation, its peak."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from metafab.core.conventions import POLARISATIONS
from metafab.optics.point_spread import Psf
from metafab.report.style import (
    IDEAL,
    INK,
    LIGHT_MAP,
    MUTED,
    POLARISATION_COLOUR,
    X_COLOUR,
    bare,
    dress,
    legend,
    scale_bar,
    show_map,
)

_MOST_COLUMNS = 8


def shown_depths(psf: Psf) -> NDArray[np.int64]:
    """Indices of the depths that :func:`pair_over_depth` shows: all, or eight spread over the stack."""
    count = psf.depth_m.size
    return np.unique(np.linspace(0, count - 1, min(count, _MOST_COLUMNS)).round().astype(np.int64))


def pair_over_depth(psf: Psf, axes: Axes) -> Axes:
    """Both PSFs over depth, one scale for all (Fig. 2h of Shen 2023), on a grid in place of ``axes``.

    Crosshairs meet in the geometric image point; arrows run from there to the maximum.
    """
    chosen = shown_depths(psf)
    axes.set_axis_off()
    _, _, n_y, n_x = psf.psf.shape
    left, low = -(n_x // 2 + 0.5) * psf.pixel_um, -(n_y // 2 + 0.5) * psf.pixel_um
    extent = (left, left + n_x * psf.pixel_um, low, low + n_y * psf.pixel_um)
    brightest = float(psf.psf.max()) or 1.0
    for row, polarisation in enumerate(POLARISATIONS):
        for column, depth in enumerate(chosen):
            place = (column / chosen.size, 0.5 * (1 - row), 0.96 / chosen.size, 0.48)
            cell = axes.inset_axes(place)
            picture = psf.psf[row, depth]
            show_map(cell, picture, extent, cmap=LIGHT_MAP, vmin=0.0, vmax=brightest, interpolation="bilinear")
            cell.axhline(0.0, color="#ffffff", linewidth=0.6, alpha=0.55)
            cell.axvline(0.0, color="#ffffff", linewidth=0.6, alpha=0.55)
            peak_y, peak_x = np.unravel_index(int(np.argmax(picture)), picture.shape)
            tip = ((peak_x - n_x // 2) * psf.pixel_um, (peak_y - n_y // 2) * psf.pixel_um)
            arrow = {"arrowstyle": "->", "color": "#7fe3c4", "linewidth": 1.3, "shrinkA": 0, "shrinkB": 0}
            cell.annotate("", tip, (0.0, 0.0), arrowprops=arrow)
            bare(cell, depth_text(float(psf.depth_m[depth])) if row == 0 else "")
            if column == 0:
                cell.set_ylabel(f"PSF of {polarisation}", fontsize=9, color=POLARISATION_COLOUR[polarisation])
                if row == 0:
                    scale_bar(cell, extent)
    return axes


def orientation(psf: Psf, axes: Axes, ideal: Psf | None = None) -> Axes:
    """Orientation of the pair over depth, unwrapped (Fig. 2g): written file, and target phases where known."""
    if ideal is not None:
        axes.plot(ideal.depth_m, _unwrapped(ideal), color=IDEAL, linewidth=3.5, alpha=0.6, label="target phases")
    line = {"color": X_COLOUR, "linewidth": 1.4, "marker": "o", "markersize": 4}
    axes.plot(psf.depth_m, _unwrapped(psf), label="written file", **line)  # type: ignore[arg-type]
    dress(axes, "object depth / m", "orientation φ / °", "The pair turns with depth")
    axes.grid(color=MUTED, linewidth=0.4, alpha=0.3)
    if ideal is not None:
        legend(axes)
    return axes


def peak(psf: Psf, axes: Axes, ideal: Psf | None = None) -> Axes:
    """Peak irradiance of both PSFs over depth: what the written pillars keep of the target phases' peak."""
    for row, polarisation in enumerate(POLARISATIONS):
        colour = POLARISATION_COLOUR[polarisation]
        line = {"color": colour, "linewidth": 1.4, "marker": "o", "markersize": 4}
        values = psf.psf[row].max(axis=(1, 2))
        axes.plot(psf.depth_m, values, label=f"{polarisation}, written file", **line)  # type: ignore[arg-type]
        if ideal is not None:
            values = ideal.psf[row].max(axis=(1, 2))
            axes.plot(ideal.depth_m, values, color=colour, linewidth=1.0, linestyle=(0, (4, 3)), alpha=0.8)
    if ideal is not None:
        axes.plot([], [], color=INK, linewidth=1.0, linestyle=(0, (4, 3)), label="target phases")
    dress(axes, "object depth / m", "peak irradiance / µm⁻²", "Peak, per unit power at the aperture")
    axes.set_ylim(bottom=0.0)
    axes.grid(color=MUTED, linewidth=0.4, alpha=0.3)
    legend(axes)
    return axes


def depth_text(depth_m: float) -> str:
    """A depth in the unit that suits it: millimetres, centimetres or metres."""
    if depth_m < 0.02:
        return f"{1e3 * depth_m:.4g} mm"
    return f"{1e2 * depth_m:.4g} cm" if depth_m < 1.0 else f"{depth_m:.4g} m"


def _unwrapped(psf: Psf) -> np.ndarray:
    return np.unwrap(psf.phi_deg, period=360.0)
