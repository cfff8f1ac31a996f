"""Birefringent substrates: against Berreman's 4 x 4 equations, conservation laws, and the isotropic limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, pillar_cell, solve
from metafab.cell.fresnel import admittance, film_jones
from metafab.cell.rcwa import efficiencies, zero_order
from metafab.cell.rcwa.basis.coordinates import Formulation
from metafab.cell.rcwa.derivatives import derivatives
from metafab.cell.rcwa.jones import distance
from metafab.core.conventions import ComplexArray, Side
from metafab.core.errors import InputError
from metafab.spec import UnitCell
from metafab.spec.cell import CellMaterials, Material

#: Sapphire at 800 nm with its optic axis along y: extraordinary 1.7522, ordinary 1.7601 (Malitson).
SAPPHIRE = PillarCell(
    period_nm=(350.0, 350.0),
    width_nm=150.0,
    length_nm=210.0,
    height_nm=600.0,
    n_pillar=3.6941,
    n_substrate=(1.7601, 1.7522),
    n_ambient=1.0,
    wavelength_nm=800.0,
    n_substrate_z=1.7601,
)
#: As birefringent as rutile, so that nothing hides in a small difference.
RUTILE = replace(SAPPHIRE, n_pillar=2.4, n_substrate=(2.56, 2.87), n_substrate_z=2.56)
ANGLES = [(0.0, 0.0), (20.0, 0.0), (20.0, 90.0), (20.0, 33.0)]
FORMULATIONS: tuple[Formulation, ...] = ("adaptive", "fourier")
ROUNDING = 1e-10


def _berreman(index: tuple[complex, complex, complex], k: tuple[float, float]) -> ComplexArray:
    """The admittance (H_y, -H_x) over (E_x, E_y) of outgoing waves, from the eigenvectors of Berreman's matrix.

    Curl E = i H, curl H = -i eps E (lengths times k0), with E_z = -(k_x H_y - k_y H_x) / eps_z and
    H_z = k_x E_y - k_y E_x put into the other four: d/dz (E_x, E_y, H_x, H_y) = i D (E_x, E_y, H_x, H_y).
    """
    (ex, ey, ez), (kx, ky) = (complex(n) ** 2 for n in index), k
    d = np.array(
        [
            [0.0, 0.0, kx * ky / ez, 1.0 - kx**2 / ez],
            [0.0, 0.0, ky**2 / ez - 1.0, -kx * ky / ez],
            [-kx * ky, kx**2 - ey, 0.0, 0.0],
            [ex - ky**2, kx * ky, 0.0, 0.0],
        ]
    )
    beta, fields = np.linalg.eig(d)
    leaving = np.argsort(-(beta.real + 1e3 * beta.imag))[:2]
    e_x, e_y, h_x, h_y = fields[:, leaving]
    return np.asarray(np.array([h_y, -h_x]) @ np.linalg.inv(np.array([e_x, e_y])))


@pytest.mark.parametrize("index", [(1.7601, 1.7522, 1.7601), (2.56, 2.87, 2.56), (1.5, 1.6, 1.7 + 0.1j)])
@pytest.mark.parametrize("k", [(0.3, 0.0), (0.0, 0.4), (0.3, 0.5), (1.9, 2.3)])
def test_admittance_is_berremans(index: tuple[complex, complex, complex], k: tuple[float, float]) -> None:
    np.testing.assert_allclose(admittance(index, np.array(k)), _berreman(index, k), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("side", ["substrate", "ambient"])
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("size_nm", [0.0, 350.0])
def test_films_equal_the_closed_form(
    formulation: Formulation, side: Side, angle: tuple[float, float], size_nm: float
) -> None:
    cell = replace(RUTILE, width_nm=size_nm, length_nm=size_nm, side=side, angle_deg=angle[0], azimuth_deg=angle[1])
    solved = zero_order(cell, 3, formulation)
    t, r = film_jones(cell, cell.n_pillar if size_nm else cell.n_ambient)
    np.testing.assert_allclose(solved.t, t, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(solved.r, r, rtol=0.0, atol=1e-12)


def test_the_optic_axis_turns_oblique_polarisation() -> None:
    # Across the plane of incidence nothing mixes in an isotropic film; a birefringent half space mixes s and p.
    cell = replace(RUTILE, side="ambient", angle_deg=40.0, azimuth_deg=45.0)
    _, r = film_jones(cell, 1.0)
    s, p = np.array([-1.0, 1.0]) / np.sqrt(2.0), np.array([1.0, 1.0]) / np.sqrt(2.0)
    assert abs(s @ r @ p) > 1e-2
    same = replace(cell, n_substrate=(2.56, 2.56))
    assert abs(s @ film_jones(same, 1.0)[1] @ p) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("side", ["substrate", "ambient"])
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("period_nm", [250.0, 500.0])
def test_power_is_conserved(formulation: Formulation, side: Side, angle: tuple[float, float], period_nm: float) -> None:
    cell = replace(RUTILE, side=side, angle_deg=angle[0], azimuth_deg=angle[1], period_nm=(period_nm, period_nm))
    solved = zero_order(replace(cell, length_nm=180.0), 3, formulation)
    np.testing.assert_allclose(solved.transmitted_power + solved.reflected_power, 1.0, rtol=0.0, atol=ROUNDING)
    sums = [sum(powers.values()) for powers in efficiencies(replace(cell, length_nm=180.0), 3, formulation)]
    np.testing.assert_allclose(sums[0], solved.transmitted_power, rtol=0.0, atol=ROUNDING)
    np.testing.assert_allclose(sums[1], solved.reflected_power, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("side", ["substrate", "ambient"])
@pytest.mark.parametrize("angle", ANGLES)
def test_transmittance_is_the_power_of_a_lone_zero_order(side: Side, angle: tuple[float, float]) -> None:
    cell = replace(SAPPHIRE, side=side, angle_deg=angle[0], azimuth_deg=angle[1])
    response = solve(cell, CellNumerics(target_error=1e-2, max_orders=3))
    powers = [response.details.transmitted_power_x, response.details.transmitted_power_y]
    np.testing.assert_allclose(response.transmittance, powers, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_normal_incidence_is_reciprocal(formulation: Formulation) -> None:
    up, down = (zero_order(replace(RUTILE, side=side), 4, formulation) for side in ("substrate", "ambient"))
    np.testing.assert_allclose(np.diag(up.t), np.array(RUTILE.n_substrate) * np.diag(down.t), rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("angle", [(25.0, 0.0), (25.0, 33.0)])
def test_oblique_transmission_is_reciprocal(angle: tuple[float, float]) -> None:
    # Lorentz for tangential fields, Y the admittances of the two half spaces. With light back along the same plane wave
    # (k to -k; the cell has mirror planes, so -k responds as k does), Y_out t_up = (Y_in t_down)^T.
    up = replace(RUTILE, angle_deg=angle[0] / 3.0, azimuth_deg=angle[1], period_nm=(250.0, 250.0))
    up = replace(up, length_nm=180.0)
    k = up.in_plane
    down_angle = float(np.degrees(np.arcsin(np.hypot(*k))))
    down = replace(up, side="ambient", angle_deg=down_angle, azimuth_deg=angle[1])
    y_in, y_out = admittance((2.56, 2.87, 2.56), np.array(k)), admittance((1.0, 1.0, 1.0), np.array(k))
    t_up, t_down = (zero_order(cell, 3).t for cell in (up, down))
    np.testing.assert_allclose(y_out @ t_up, (y_in @ t_down).T, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("angle", ANGLES)
def test_three_like_indices_are_an_isotropic_substrate(angle: tuple[float, float]) -> None:
    plain = replace(
        SAPPHIRE, n_substrate=(1.7601, 1.7601), n_substrate_z=None, angle_deg=angle[0], azimuth_deg=angle[1]
    )
    assert not replace(plain, n_substrate_z=1.7601).is_birefringent
    # Through the general equations, with a difference that is too small to see.
    nearly = replace(plain, n_substrate_z=1.7601 * (1.0 + 1e-13))
    assert nearly.is_birefringent
    assert distance(zero_order(plain, 3), zero_order(nearly, 3)) < 1e-9


def test_each_polarisation_sees_nearly_its_own_index() -> None:
    # Without n_z the near field of each polarisation sees one index. Sapphire's differ by 0.5 %; that is what is lost.
    effective = replace(SAPPHIRE, n_substrate_z=None)
    assert 1e-6 < distance(zero_order(SAPPHIRE, 5), zero_order(effective, 5)) < 1e-2


def test_turning_cell_and_crystal_swaps_the_polarisations() -> None:
    one = replace(RUTILE, angle_deg=15.0, azimuth_deg=30.0)
    other = replace(one, width_nm=210.0, length_nm=150.0, n_substrate=(2.87, 2.56), azimuth_deg=60.0)
    np.testing.assert_allclose(zero_order(one, 3).t, zero_order(other, 3).t[::-1, ::-1], rtol=0.0, atol=ROUNDING)


def test_what_is_not_treated_is_refused() -> None:
    with pytest.raises(InputError, match="n_z"):
        zero_order(replace(SAPPHIRE, n_substrate_z=None, angle_deg=5.0), 3)
    biaxial = replace(SAPPHIRE, n_substrate_z=1.7)
    with pytest.raises(InputError, match="biaxial"):
        zero_order(replace(biaxial, angle_deg=5.0), 3)
    assert np.isfinite(zero_order(replace(biaxial, angle_deg=5.0, side="ambient"), 3).t).all()
    with pytest.raises(InputError, match="n_substrate_z"):
        derivatives(SAPPHIRE, 3)
    with pytest.raises(InputError, match="n_substrate_z"):
        solve(replace(SAPPHIRE, n_substrate_z=1.7 - 0.1j))
    with pytest.raises(InputError, match="n_substrate_z"):
        solve(SAPPHIRE, CellNumerics(solver="meep"))
    with pytest.raises(ValueError, match="only the substrate"):
        CellMaterials(pillar=Material(n=2.0, n_z=2.1), substrate=Material(n=1.5))


def test_the_file_names_the_index_along_z(unit_cell: UnitCell) -> None:
    materials = replace(unit_cell.materials, substrate=Material(n=1.7601, n_y=1.7522, n_z=1.7601))
    cell = pillar_cell(replace(unit_cell, materials=materials), 150.0, 210.0, angle_deg=10.0)
    assert cell.tensor("substrate") == (1.7601, 1.7522, 1.7601)
    assert cell.tensor("ambient") is None
    assert cell.n_of_angle == 1.7601
