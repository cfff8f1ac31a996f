"""How well nodes over depth carry the stack between them, and how the field bends it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.optics import Imaging, PsfNumerics, at_depths, depth_nodes, psf, relative_l2
from tests import optics_lens as lens

OPTICS = lens.imaging()


@pytest.mark.parametrize("target", [1e-2, 1e-3])
def test_nodes_carry_the_stack_to_the_target(target: float) -> None:
    """Between all nodes, the first and last interval (where a spline is worst) included."""
    source = lens.ideal(OPTICS, lens.eq_2(OPTICS, zones=4), lens.eq_3_and_4(OPTICS))
    nodes = depth_nodes(OPTICS, 0.65e-3, 1.3e-3, target)
    between = 2.0 / (1.0 / nodes[1:] + 1.0 / nodes[:-1])
    stack = psf(source, OPTICS, nodes, PsfNumerics(window_px=40, target_error=0.1 * target))
    true = psf(source, OPTICS, between, PsfNumerics(window_px=40, target_error=0.1 * target))
    errors = [relative_l2(at_depths(stack, [z])[:, 0], true.psf[:, i]) for i, z in enumerate(between)]
    assert max(errors) <= target


def test_the_field_biases_the_depth_of_the_two_channels_oppositely() -> None:
    """Best focus of a plain split lens drifts by -+sin(theta) (1 + 3 cos^2(theta)) / (2 d) of vergence a radian.

    The sensor at d is reached after R = d / cos; the lens' curvature at its centre is fixed, and the wave needs
    1/R = cos/d across the plane of incidence and cos^2/R = cos^3/d in it. Between the two foci the lobe is
    brightest: the mean of both derivatives. For the paper's lens that is 0.23 dioptre a degree. The highest
    maximum is found by a quartic through 13 depths; 2 % covers it.
    """
    f_mm = 0.3
    optics = Imaging(
        wavelength_um=0.8,
        focal_length_mm=f_mm,
        split_angle_deg=lens.ANGLE_DEG,
        sensor_distance_um=450.0 * math.cos(math.radians(lens.ANGLE_DEG)),
        pixel_um=0.8,
        aperture_um=60.0,
    )
    source = lens.ideal(optics, lens.eq_3_and_4(optics))
    vergence = 1e3 / 0.9 + np.linspace(-150.0, 150.0, 13)
    depths = np.sort(1.0 / vergence)
    degrees = 2.0
    best = np.empty((2, 2))
    for column, sign in enumerate((-1.0, 1.0)):
        tangent = (sign * math.tan(math.radians(degrees)), 0.0)
        peaks = psf(source, optics, depths, PsfNumerics(window_px=24), tangent=tangent).psf.max(axis=(2, 3))
        for polarisation in (0, 1):
            curve = np.polynomial.Polynomial.fit(1.0 / depths, peaks[polarisation], 4)
            grid = np.linspace(vergence[0], vergence[-1], 4001)
            best[polarisation, column] = grid[np.argmax(curve(grid))]
    drift = (best[:, 1] - best[:, 0]) / (2.0 * degrees)
    assert drift[0] == pytest.approx(-drift[1], rel=0.02)
    cos, sin = math.cos(math.radians(lens.ANGLE_DEG)), lens.SINE
    per_radian = sin * (1.0 + 3.0 * cos**2) / (2e-6 * optics.sensor_distance_um)
    assert abs(drift[0]) == pytest.approx(math.radians(per_radian), rel=0.02)
