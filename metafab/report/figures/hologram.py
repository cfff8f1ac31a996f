"""A hologram's picture: as it was wanted, and as the written file paints it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from metafab.core.conventions import POLARISATIONS, FloatArray, Polarisation
from metafab.optics.point_spread import Psf
from metafab.report.style import LIGHT_MAP, Extent, bare, colour_bar, scale_bar, show_map


def wanted_picture(picture: FloatArray, width_um: float, reach_um: float, axes: Axes) -> Axes:
    """The file's picture at its size on the sensor.

    Args:
        picture: shape (rows, columns), first row at the top.
        width_um: its width.
        reach_um: half the side of the square about the axis that is shown.
        axes: where to draw.
    """
    half_x = 0.5 * width_um
    half_y = half_x * picture.shape[0] / picture.shape[1]
    brightest = float(picture.max()) or 1.0
    return _shown(picture[::-1] / brightest, (-half_x, half_x, -half_y, half_y), reach_um, axes, "As wanted")


def painted_picture(psf: Psf, axes: Axes, polarisation: Polarisation) -> Axes:
    """The irradiance on the sensor at the farthest depth, over its 99.8th percentile: speckle is brighter still."""
    values = psf.psf[POLARISATIONS.index(polarisation), -1]
    half_y, half_x = (0.5 * count * psf.pixel_um for count in values.shape)
    top = float(np.percentile(values, 99.8)) or 1.0
    extent = (-half_x, half_x, -half_y, half_y)
    return _shown(values / top, extent, max(half_x, half_y), axes, f"As painted, {polarisation} polarisation")


def _shown(share: FloatArray, extent: Extent, reach_um: float, axes: Axes, title: str) -> Axes:
    whole = (-reach_um, reach_um, -reach_um, reach_um)
    show_map(axes, np.zeros((1, 1)), whole, cmap=LIGHT_MAP, vmin=0.0, vmax=1.0)  # dark beside a smaller picture
    image = show_map(axes, share, extent, cmap=LIGHT_MAP, vmin=0.0, vmax=1.0)
    colour_bar(image, axes, "relative irradiance")
    bare(axes, title)
    axes.set(xlim=(-reach_um, reach_um), ylim=(-reach_um, reach_um))
    scale_bar(axes, whole)
    return axes
