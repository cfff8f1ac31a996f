"""A design's camera beside a standard lens and a double helix: errors of depth, and sharpness, over depth."""

from __future__ import annotations

from matplotlib.axes import Axes

from metafab.comparison import Comparison
from metafab.report.style import GOOD, IDEAL, INK, MUTED, X_COLOUR, Y_COLOUR, depth_unit, dress, legend, logarithmic

_INKS = (X_COLOUR, IDEAL, Y_COLOUR, GOOD, INK)


def rival_depth_errors(comparison: Comparison, axes: Axes) -> Axes:
    """Rms error of depth over depth by each camera and estimate; dotted, the bound of each."""
    scale, unit = depth_unit(comparison.depth_m)
    for name, error, bound, ink in zip(comparison.methods, comparison.error, comparison.bound, _INKS, strict=True):
        axes.plot(scale * comparison.depth_m, 100.0 * error, "o-", color=ink, linewidth=1.4, markersize=3, label=name)
        axes.plot(scale * comparison.depth_m, 100.0 * bound, color=ink, linewidth=1.0, linestyle=":")
    axes.plot([], [], color=MUTED, linewidth=1.0, linestyle=":", label="bound of each")
    dress(axes, f"object depth / {unit}", "rms error of depth, %", "Depth of a textured plane")
    logarithmic(axes, "y")
    axes.set_ylim(top=20.0 * 100.0 * float(comparison.error.max()))
    return _finished(axes)


def rival_sharpness(comparison: Comparison, axes: Axes) -> Axes:
    """What the best linear restoration leaves of a texture over depth, by camera: 0 all of it right, 1 nothing."""
    scale, unit = depth_unit(comparison.depth_m)
    for name, left, ink in zip(comparison.cameras, comparison.restored, _INKS, strict=False):
        axes.plot(scale * comparison.depth_m, left, "o-", color=ink, linewidth=1.4, markersize=3, label=name)
    dress(axes, f"object depth / {unit}", "rms left over rms of the texture", "All in focus: error of the sharp image")
    axes.set_ylim(0.0, 1.7 * float(comparison.restored.max()))
    return _finished(axes)


def _finished(axes: Axes) -> Axes:
    axes.grid(color=MUTED, linewidth=0.4, alpha=0.3)
    legend(axes)
    return axes
