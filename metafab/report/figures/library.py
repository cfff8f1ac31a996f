"""Maps of the library over pillar width and length, and coverage of both phases."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.figures import Quality
from metafab.library.library import Library
from metafab.library.use.amplitudes import power_transmittance
from metafab.library.use.lookup import phase_slope_per_nm
from metafab.library.use.quality import CD_BIAS_NM, quality
from metafab.report.style import (
    ERROR_MAP,
    INK,
    PHASE_MAP,
    POLARISATION_COLOUR,
    SHARE_MAP,
    X_COLOUR,
    Extent,
    colour_bar,
    dress,
    finished,
    map_with_bar,
)

_PI_TICKS = ((-math.pi, -math.pi / 2, 0.0, math.pi / 2, math.pi), ("−π", "−π/2", "0", "π/2", "π"))
#: Transmittance on the lines that enclose the guided-mode resonances.
_RIDGE_TRANSMITTANCE = 0.5


def phase_map(library: Library, axes: Axes, polarisation: Polarisation) -> Axes:
    """Draw the transmission phase over width and length; lines enclose the resonances."""
    scale: dict[str, Any] = {"cmap": PHASE_MAP, "vmin": -math.pi, "vmax": math.pi, "ticks": _PI_TICKS}
    _ridges(library, axes, polarisation)
    phase, title = np.angle(_t(library, polarisation)), f"Phase of t, {polarisation} polarisation"
    return _size_map(library, axes, phase, "phase / rad", title, POLARISATION_COLOUR[polarisation], **scale)


def transmittance_map(library: Library, axes: Axes, polarisation: Polarisation) -> Axes:
    """Draw the zero-order power transmittance over width and length; lines enclose the resonances."""
    scale: dict[str, Any] = {"cmap": SHARE_MAP, "vmin": 0.0, "vmax": 1.0}
    _ridges(library, axes, polarisation)
    share, title = transmittance(library, polarisation), f"Transmittance, {polarisation} polarisation"
    return _size_map(library, axes, share, "transmittance", title, POLARISATION_COLOUR[polarisation], **scale)


def error_map(library: Library, axes: Axes) -> Axes:
    """Draw the error of complex t over width and length, on a logarithmic scale."""
    error = library.error_of_sizes
    positive = error[error > 0.0]
    high = float(positive.max()) if positive.size else 1e-6
    low = min(float(positive.min()) if positive.size else high, 0.1 * high)  # at least a decade, for readable ticks
    scale: dict[str, Any] = {"cmap": ERROR_MAP, "norm": LogNorm(low, high)}
    return _size_map(library, axes, np.maximum(error, low), "absolute error of t", "Error of every size", **scale)


def sensitivity_map(library: Library, axes: Axes, polarisation: Polarisation) -> Axes:
    """Draw the phase change when width and length both grow by 5 nm, to first order; clipped at pi."""
    slope = phase_slope_per_nm(library)[..., 0 if polarisation == "x" else 1]
    turn = np.minimum(np.abs(CD_BIAS_NM * slope), math.pi)
    ticks = (0.0, math.pi / 2, math.pi), ("0", "π/2", "≥ π")
    scale: dict[str, Any] = {"cmap": ERROR_MAP, "vmin": 0.0, "vmax": math.pi, "ticks": ticks}
    title = f"Turn by ±{CD_BIAS_NM:g} nm of CD, {polarisation} polarisation"
    return _size_map(library, axes, turn, "phase turn / rad", title, POLARISATION_COLOUR[polarisation], **scale)


def coverage(library: Library, axes: Axes, reached: Quality | None = None) -> Axes:
    """Draw every size at its pair of phases, coloured by the smaller transmittance; a ring marks the largest hole.

    ``reached`` are the figures of merit of the library, where they are known already.
    """
    phase_x, phase_y = (np.angle(_t(library, p)).ravel() for p in ("x", "y"))
    share = np.minimum(transmittance(library, "x"), transmittance(library, "y")).ravel()
    order = np.argsort(share)  # well transmitting sizes on top
    points = axes.scatter(
        phase_x[order], phase_y[order], c=share[order], s=5, cmap=SHARE_MAP, vmin=0.0, vmax=1.0, lw=0, rasterized=True
    )
    colour_bar(points, axes, "smaller transmittance")
    reached = reached or quality(library)
    hole = (reached.worst_hole_phase_x_rad, reached.worst_hole_phase_y_rad)
    axes.plot(*hole, "o", mfc="none", mec=X_COLOUR, mew=1.4, ms=11)
    dress(axes, "phase of x / rad", "phase of y / rad", "Coverage, and its largest hole")
    axes.set_xticks(*_PI_TICKS)
    axes.set_yticks(*_PI_TICKS)
    axes.set(xlim=(-math.pi, math.pi), ylim=(-math.pi, math.pi), aspect="equal")
    return finished(axes)


def transmittance(library: Library, polarisation: Polarisation) -> FloatArray:
    """Zero-order power transmittance at the design wavelength, shape (n_length, n_width)."""
    return power_transmittance(library)[..., 0 if polarisation == "x" else 1]


def _t(library: Library, polarisation: Polarisation) -> ComplexArray:
    t = library.t_xx if polarisation == "x" else library.t_yy
    return np.asarray(t[0])


def _extent(library: Library) -> Extent:
    """Extent of a map whose pixels are centred on the sizes."""
    width, length = library.width_nm, library.length_nm
    half_w, half_l = (0.5 * (g[1] - g[0]) if g.size > 1 else 1.0 for g in (width, length))
    return (width[0] - half_w, width[-1] + half_w, length[0] - half_l, length[-1] + half_l)


def _ridges(library: Library, axes: Axes, polarisation: Polarisation) -> None:
    share = transmittance(library, polarisation)
    if share.min() < _RIDGE_TRANSMITTANCE < share.max() and min(share.shape) > 1:
        line: dict[str, Any] = {"colors": "#ffffff", "linewidths": 0.8, "alpha": 0.9}
        axes.contour(library.width_nm, library.length_nm, share, [_RIDGE_TRANSMITTANCE], **line)


def _size_map(
    library: Library,
    axes: Axes,
    values: FloatArray,
    label: str,
    title: str,
    ink: str = INK,
    **options: Any,
) -> Axes:
    """Draw a quantity over width and length; that of a library of circles over the diameter."""
    if not library.known.all():
        axes.plot(library.width_nm, values.diagonal(), ".-", color=INK, lw=1.0, ms=4)
        return dress(axes, "diameter / nm", label, title)
    map_with_bar(axes, values, _extent(library), label, **options)
    return dress(axes, "width W / nm", "length L / nm", title, ink)
