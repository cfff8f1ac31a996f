"""Numerical targets of the PSFs from the depth error that a design asks for (``verify.target_depth_error``).

Depth enters a PSF through the defocus of its aperture. The relative L2 change of the PSFs per relative change of depth
is the standard deviation of that defocus over the aperture, k std(r^2) / (2 z): within 4 % of the measured change for
the pair of ``layouts/helix_small.toml``. PSFs with a relative error e therefore shift depth by at most about e over
that slope. A third of the wanted depth error is left to the numerics; added in quadrature to the error by the noise of
the light, it raises the sum by 5 %.

The cheapest allocation follows from the laws of interpolation. The number of depths grows as the inverse fourth root of
their error, and so does the number of directions along each of the two axes of the field. Their product is smallest if
the field has twice the error of the depths. The library keeps its own target: errors of unlike sizes average out over
the pillars (``metafab benchmark targets``).
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np

from metafab.core.errors import InputError
from metafab.optics.geometry.imaging import Imaging, field_corner
from metafab.optics.measures.space_variance import wavefront_change_rad
from metafab.optics.numerics import SMALLEST_TARGET_IN_BAND
from metafab.optics.propagation.blocks import COARSEST_TARGET
from metafab.spec import Design
from metafab.spec.design import MOST_FIELD_POINTS

#: Share of the wanted depth error that the numerics may take.
NUMERICAL_SHARE = 1.0 / 3.0
#: Shares of the PSFs' error: blocks and depths have one each, the two axes of the field one each.
_PARTS = 4
#: Mean relative L2 error over the field of cubic interpolation between directions whose wavefronts differ by 1 rad rms
#: in its corners; it grows with the fourth power. In an outermost cell it is twice as large: measured 0.6 to 0.88 for
#: the small lens with 4 to 8 points a side, 0.27 for the lens of Shen 2023.
_FIELD_ERROR_PER_RAD4 = 0.45
#: Fewest points along an axis that carry a cubic.
_FEWEST_POINTS = 4
#: Samples along a side of the square in which the aperture lies.
_SAMPLES = 256


def with_depth_target(design: Design) -> Design:
    """Return the design with the PSF error and the field points that ``verify.target_depth_error`` needs.

    A design without that key or without a scene is returned as it is. InputError if no numerics reach the error.
    """
    target = design.verify.target_depth_error
    if target is None or design.scene is None:
        return design
    # PSFs change least with depth at the farthest object.
    slope = depth_slope(design, design.scene.depths_m[-1])
    part = NUMERICAL_SHARE * target * slope / _PARTS
    points = field_points(design, part) if part >= SMALLEST_TARGET_IN_BAND else None
    if points is None:
        expected = "a depth error that the numerics can reach"
        raise InputError.single(
            design.name, "verify.target_depth_error", expected, f"{target:g}", "allow more; the light's noise is larger"
        )
    return replace(design, verify=replace(design.verify, target_error=min(part, COARSEST_TARGET), field_points=points))


def depth_slope(design: Design, depth_m: float) -> float:
    """Return the relative L2 change of the PSFs per relative change of the object's depth."""
    half_um = 0.5 * design.device.aperture_um
    axis_um = np.asarray(half_um * ((np.arange(_SAMPLES) + 0.5) / (0.5 * _SAMPLES) - 1.0), dtype=np.float64)
    square_um2 = np.add.outer(axis_um**2, axis_um**2)[design.device.encloses(axis_um, axis_um)]
    return float(math.pi / design.wavelength_um * square_um2.std() / (1e6 * depth_m))


def field_points(design: Design, error: float) -> tuple[int, int] | None:
    """Return the field points along x and y between which interpolation errs by ``error`` along either axis.

    The error is a mean over the field. Wavefronts of neighbouring directions differ most in the corners of the field.
    None if more points than a design may have are needed; those of the design if it has no scene.
    """
    imaging, depth_m = Imaging.of(design), design.sensor.focus_depth_m
    corner = field_corner(design, imaging)
    if corner is None:
        return design.verify.field_points
    largest_rad = (error / _FIELD_ERROR_PER_RAD4) ** 0.25

    def step_rad(axis: int, points: int) -> float:
        """Largest difference of the wavefronts of the two outermost of ``points`` directions."""
        steps = []
        for outer in product(*((-reach, reach) for reach in corner)):
            inner = list(outer)
            inner[axis] *= 1.0 - 2.0 / (points - 1)
            tangents = ((inner[0], inner[1]), (outer[0], outer[1]))
            steps += [wavefront_change_rad(imaging, p, tangents, depth_m) for p in (0, 1)]
        return max(steps)

    counts = range(_FEWEST_POINTS, MOST_FIELD_POINTS + 1)
    along_x, along_y = (next((n for n in counts if step_rad(axis, n) <= largest_rad), None) for axis in (0, 1))
    return None if along_x is None or along_y is None else (along_x, along_y)
