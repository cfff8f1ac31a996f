"""Target phases over the aperture, and the picture of a hologram."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from metafab.core.conventions import POLARISATIONS, FloatArray, Polarisation, wrap_phase
from metafab.optics.point_spread import Psf
from metafab.report.style import (
    INK,
    LIGHT_MAP,
    PHASE_MAP,
    PHASE_TICKS,
    POLARISATION_COLOUR,
    Extent,
    bare,
    colour_bar,
    picture,
    scale_bar,
    show_map,
)


def aperture_phase(
    phase_rad: FloatArray, half_side_um: float, axes: Axes, polarisation: Polarisation, title: str
) -> Axes:
    """Draw a phase over the aperture, a square of twice ``half_side_um``, on a cyclic scale.

    The phase, shape (n, n), has any number of turns, and is NaN outside the aperture.
    """
    extent = (-half_side_um, half_side_um, -half_side_um, half_side_um)
    bar, ink = "#ffffff" if np.isfinite(phase_rad[0, 0]) else INK, POLARISATION_COLOUR[polarisation]
    scale: dict[str, Any] = {"cmap": PHASE_MAP, "vmin": -math.pi, "vmax": math.pi, "ticks": PHASE_TICKS}
    return picture(axes, wrap_phase(phase_rad), extent, "phase / rad", title, bar=bar, title_ink=ink, **scale)


def wanted_picture(target: FloatArray, width_um: float, reach_um: float, axes: Axes) -> Axes:
    """Draw the target picture, shape (rows, columns) from the top, at its size on the sensor.

    ``reach_um`` is half the side of the drawn square about the axis.
    """
    half_x = 0.5 * width_um
    half_y = half_x * target.shape[0] / target.shape[1]
    brightest = float(target.max()) or 1.0
    return _light(target[::-1] / brightest, (-half_x, half_x, -half_y, half_y), reach_um, axes, "Target picture")


def painted_picture(psf: Psf, axes: Axes, polarisation: Polarisation) -> Axes:
    """Draw the irradiance on the sensor at the farthest depth, relative to its 99.8th percentile."""
    values = psf.psf[POLARISATIONS.index(polarisation), -1]
    half_y, half_x = (0.5 * count * psf.pixel_um for count in values.shape)
    top = float(np.percentile(values, 99.8)) or 1.0
    extent = (-half_x, half_x, -half_y, half_y)
    return _light(values / top, extent, max(half_x, half_y), axes, f"Written file, {polarisation} polarisation")


def _light(share: FloatArray, extent: Extent, reach_um: float, axes: Axes, title: str) -> Axes:
    whole = (-reach_um, reach_um, -reach_um, reach_um)
    show_map(axes, np.zeros((1, 1)), whole, cmap=LIGHT_MAP, vmin=0.0, vmax=1.0)  # dark surroundings
    image = show_map(axes, share, extent, cmap=LIGHT_MAP, vmin=0.0, vmax=1.0)
    colour_bar(image, axes, "relative irradiance")
    bare(axes, title)
    axes.set(xlim=(-reach_um, reach_um), ylim=(-reach_um, reach_um))
    scale_bar(axes, whole)
    return axes
