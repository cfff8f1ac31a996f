"""Phases over the aperture."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes

from metafab.core.conventions import FloatArray, Polarisation, wrap_phase
from metafab.report.style import INK, PHASE_MAP, POLARISATION_COLOUR, bare, colour_bar, scale_bar, show_map


def aperture_phase(
    phase_rad: FloatArray, half_side_um: float, axes: Axes, polarisation: Polarisation, title: str
) -> Axes:
    """A phase map of the lens, on a cyclic scale.

    Args:
        phase_rad: shape (n, n), radians, wrapped here; NaN outside the aperture.
        half_side_um: half the side of the square that the map spans.
        axes: where to draw.
        polarisation: whose phase it is.
        title: what the map shows.
    """
    extent = (-half_side_um, half_side_um, -half_side_um, half_side_um)
    image = show_map(axes, wrap_phase(phase_rad), extent, cmap=PHASE_MAP, vmin=-math.pi, vmax=math.pi)
    colour_bar(image, axes, "phase / rad", (-math.pi, 0.0, math.pi), ("−π", "0", "π"))
    bare(axes, title, POLARISATION_COLOUR[polarisation])
    scale_bar(axes, extent, "#ffffff" if np.isfinite(phase_rad[0, 0]) else INK)
    return axes
