"""A patch of the mask: the field by Meep, the one stitched from the library, and their difference."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.report.style import INK, PHASE_MAP, SHARE_MAP, Extent, bare, colour_bar, scale_bar, show_map


def patch_phase(field: ComplexArray, x_um: FloatArray, y_um: FloatArray, axes: Axes, title: str) -> Axes:
    """Phase of a field at the sites of a patch, on a cyclic scale.

    Args:
        field: shape (n_y, n_x).
        x_um: shape (n_x,), sites.
        y_um: shape (n_y,).
        axes: where to draw.
        title: whose field it is.
    """
    extent = _extent(x_um, y_um)
    image = show_map(axes, np.angle(field), extent, cmap=PHASE_MAP, vmin=-math.pi, vmax=math.pi)
    colour_bar(image, axes, "phase / rad", (-math.pi, 0.0, math.pi), ("−π", "0", "π"))
    bare(axes, title)
    scale_bar(axes, extent, INK)
    return axes


def patch_amplitude(
    field: ComplexArray, x_um: FloatArray, y_um: FloatArray, axes: Axes, title: str, largest: float
) -> Axes:
    """Amplitude of a field at the sites of a patch, from 0 to ``largest``; arguments as in :func:`patch_phase`."""
    extent = _extent(x_um, y_um)
    image = show_map(axes, np.abs(field), extent, cmap=SHARE_MAP, vmin=0.0, vmax=largest)
    colour_bar(image, axes, "field over incident field")
    bare(axes, title)
    # Ink that shows on the dark end of the scale.
    scale_bar(axes, extent, "#ffffff")
    return axes


def _extent(x_um: FloatArray, y_um: FloatArray) -> Extent:
    """The patch with a half site around its outermost sites."""
    half_x, half_y = (0.5 * (axis[-1] - axis[0]) / max(1, axis.size - 1) for axis in (x_um, y_um))
    return (x_um[0] - half_x, x_um[-1] + half_x, y_um[0] - half_y, y_um[-1] + half_y)
