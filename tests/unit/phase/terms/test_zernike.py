"""Zernike polynomials against tables."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.phase import (
    ZernikePhase,
)
from metafab.phase.terms.zernike import RadialPhase, zernike_number

X_UM = np.linspace(-90.0, 80.0, 23)
Y_UM = np.linspace(-70.0, 95.0, 17)
RADIUS_UM = 100.0


def test_zernike_polynomials_are_those_of_the_tables() -> None:
    x, y = X_UM[None, :] / RADIUS_UM, Y_UM[:, None] / RADIUS_UM
    u2 = x**2 + y**2
    for (degree, order), expected in {
        (1, 1): x + 0 * y,
        (1, -1): y + 0 * x,
        (2, 0): 2 * u2 - 1,
        (2, -2): 2 * x * y,
        (3, 1): (3 * u2 - 2) * x,
        (4, 0): 6 * u2**2 - 6 * u2 + 1,
        (4, 2): (4 * u2 - 3) * (x**2 - y**2),
    }.items():
        phase = ZernikePhase(degree=degree, order=order, amplitude_rad=0.7, radius_um=RADIUS_UM)(X_UM, Y_UM, "x")
        np.testing.assert_allclose(phase, 0.7 * expected, atol=1e-13)


def test_noll_numbers_are_his_table_and_orthonormal() -> None:
    """Table I of Noll (1976), and unit variance by quadrature."""
    table = [
        (0, 0),
        (1, 1),
        (1, -1),
        (2, 0),
        (2, -2),
        (2, 2),
        (3, -1),
        (3, 1),
        (3, -3),
        (3, 3),
        (4, 0),
        (4, 2),
        (4, -2),
    ]
    assert [zernike_number(j, "noll")[:2] for j in range(1, 14)] == table
    axis = np.linspace(-1.0, 1.0, 801)
    inside = np.hypot(axis[None, :], axis[:, None]) <= 1.0
    maps = []
    for number in range(1, 16):
        n, m, norm = zernike_number(number, "noll")
        maps.append(norm * ZernikePhase(degree=n, order=m, amplitude_rad=1.0, radius_um=1.0)(axis, axis, "x")[inside])
    gram = np.array(maps) @ np.array(maps).T / inside.sum()
    # The rim is cut along samples of 1/400.
    assert np.abs(gram - np.eye(15)).max() < 0.01


def test_fringe_numbers_are_those_of_the_handbooks() -> None:
    table = [
        (0, 0),
        (1, 1),
        (1, -1),
        (2, 0),
        (2, 2),
        (2, -2),
        (3, 1),
        (3, -1),
        (4, 0),
        (3, 3),
        (3, -3),
        (4, 2),
        (4, -2),
    ]
    assert [zernike_number(j, "fringe") for j in range(1, 14)] == [(n, m, 1.0) for n, m in table]
    assert zernike_number(16, "fringe")[:2] == (6, 0)
    assert zernike_number(36, "fringe")[:2] == (10, 0)


def test_a_radial_surface_is_a_lens_of_the_focal_length_of_its_first_coefficient() -> None:
    """phase = -pi r^2 / (wavelength f): as Binary 2 coefficient -pi R^2 / (wavelength f), as path -r^2 / (2 f)."""
    wavelength_um, focal_um, radius_um = 0.532, 5000.0, 50.0
    axis = np.linspace(-radius_um, radius_um, 11)
    expected = -np.pi / (wavelength_um * focal_um) * (axis[None, :] ** 2 + axis[:, None] ** 2)
    binary = RadialPhase(coefficients_rad=(-np.pi * radius_um**2 / (wavelength_um * focal_um),), radius_um=radius_um)
    path = RadialPhase(coefficients_rad=(-2e3 * np.pi / wavelength_um * 1e3 / (2.0 * focal_um),), radius_um=1e3)
    for term in (binary, path):
        assert term(axis, axis, "y") == pytest.approx(expected, abs=1e-9)
    assert RadialPhase(coefficients_rad=(0.0, 2.0, 3.0), radius_um=10.0)(np.array([10.0]), np.array([0.0]), "x")[
        0, 0
    ] == pytest.approx(5.0)
