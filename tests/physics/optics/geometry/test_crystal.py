"""The crystal plate: closed forms at normal light, Berreman's 4 x 4 matrices, Fermat's principle, and PSF pairs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import root

from metafab.optics import Imaging, Psf, PsfNumerics, psf
from metafab.optics.geometry.crystal import Crystal
from metafab.spec import Substrate
from tests import optics_lens as lens

R_PLANE = Substrate(thickness_um=460.0, cut="r-plane", azimuth_deg=30.0)
CRYSTAL = Crystal(R_PLANE, 0.8)
NUMERICS = PsfNumerics(window_px=48, target_error=1e-3)


def _plane_wave_jones(crystal: Crystal, kappa_x: float, kappa_y: float) -> np.ndarray:
    """Jones matrix of the plane wave with these direction cosines: light of an object at infinity."""
    along = -math.sqrt(1.0 - kappa_x**2 - kappa_y**2)
    return crystal.jones(np.zeros(1), np.zeros(1), 0.0, (kappa_x / along, kappa_y / along))[..., 0]


def _normal(crystal: Crystal) -> np.ndarray:
    return _plane_wave_jones(crystal, 0.0, 0.0)


def _rotated(substrate: Substrate, azimuth_deg: float) -> Crystal:
    return Crystal(replace(substrate, azimuth_deg=azimuth_deg), 0.8)


def test_retardance_along_the_normal_is_that_of_the_index_ellipsoid() -> None:
    """n_eff of the extraordinary wave: 1/n^2 = cos^2/n_o^2 + sin^2/n_e^2; 460 um are 3.26 waves."""
    n_o, n_e, tilt = CRYSTAL.n_ordinary, CRYSTAL.n_extraordinary, math.radians(R_PLANE.tilt_deg)
    n_eff = 1.0 / math.hypot(math.cos(tilt) / n_o, math.sin(tilt) / n_e)
    assert R_PLANE.tilt_deg == pytest.approx(57.6, abs=0.05)
    assert CRYSTAL.retardance_rad == pytest.approx(2.0 * math.pi / 0.8 * 460.0 * (n_eff - n_o), rel=1e-10)
    assert CRYSTAL.retardance_rad / (2.0 * math.pi) == pytest.approx(-3.2586, abs=1e-3)
    over_filter = [CRYSTAL.at_wavelength(w).retardance_rad / (2.0 * math.pi) for w in (0.795, 0.805)]
    assert over_filter[1] - over_filter[0] == pytest.approx(0.0424, abs=1e-3)


@pytest.mark.parametrize("azimuth_deg", [0.0, 7.0, 45.0, 90.0, -120.0])
def test_light_along_the_normal_meets_a_wave_plate(azimuth_deg: float) -> None:
    """Crossed and parallel light of a wave plate at an angle a: sin^2(2a) sin^2(G/2) and the rest (Yeh and Gu)."""
    crystal = _rotated(replace(R_PLANE, back_face="coated"), azimuth_deg)
    crossed = math.sin(2.0 * math.radians(azimuth_deg)) ** 2 * math.sin(0.5 * crystal.retardance_rad) ** 2
    power = np.abs(_normal(crystal)) ** 2
    np.testing.assert_allclose(power, [[1.0 - crossed, crossed], [crossed, 1.0 - crossed]], atol=1e-12)


def test_a_bare_face_reflects_as_fresnel_says() -> None:
    passed = np.abs(np.diag(_normal(_rotated(R_PLANE, 0.0)))) ** 2
    n_x, n_y = CRYSTAL.n_ordinary + CRYSTAL.retardance_rad / (CRYSTAL.wavenumber * 460.0), CRYSTAL.n_ordinary
    np.testing.assert_allclose(passed, [4.0 * n / (1.0 + n) ** 2 for n in (n_x, n_y)], rtol=2e-5)


@pytest.mark.parametrize("face", ["bare", "coated"])
def test_a_crystal_of_one_index_changes_no_polarisation(face: str) -> None:
    same = {"n": 1.76}
    crystal = Crystal(replace(R_PLANE, ordinary=same, extraordinary=same, back_face=face), 0.8)
    for kappa in ((0.0, 0.0), (0.1, 0.05), (-0.3, 0.2)):
        jones = _plane_wave_jones(crystal, *kappa)
        assert abs(jones[0, 1]) < (1e-9 if face == "coated" else 7e-3)  # s and p pass a bare face unequally
        assert np.abs(jones.imag).max() < 1e-9


def _berreman(crystal: Crystal, k_x: float, k_y: float) -> tuple[np.ndarray, np.ndarray]:
    """Normal components and (E_x, E_y, H_x, H_y) of all four waves, from Maxwell's equations alone."""
    c, o2, e2 = np.array(crystal.axis), crystal.n_ordinary**2, crystal.n_extraordinary**2
    eps = o2 * np.eye(3) + (e2 - o2) * np.outer(c, c)
    # k x E = H, k x H = -eps E; the z components are eliminated.
    e_z = np.array([-eps[2, 0], -eps[2, 1], k_y, -k_x]) / eps[2, 2]
    h_z = np.array([-k_y, k_x, 0.0, 0.0])
    d_x, d_y = ([*eps[i, :2], 0.0, 0.0] + eps[i, 2] * e_z for i in (0, 1))
    # q E_x = H_y + k_x E_z, q E_y = -H_x + k_y E_z, q H_x = -D_y + k_x H_z, q H_y = D_x + k_y H_z.
    rows = [
        np.array([0.0, 0.0, 0.0, 1.0]) + k_x * e_z,
        np.array([0.0, 0.0, -1.0, 0.0]) + k_y * e_z,
        -np.array(d_y) + k_x * h_z,
        np.array(d_x) + k_y * h_z,
    ]
    q, fields = np.linalg.eig(np.array(rows))
    order = np.argsort(-q.real)
    return q[order].real, fields[:, order]


@given(k_x=st.floats(-0.5, 0.5), k_y=st.floats(-0.5, 0.5), tilt=st.floats(5.0, 90.0), azimuth=st.floats(0.0, 360.0))
def test_waves_and_face_obey_berremans_equations(k_x: float, k_y: float, tilt: float, azimuth: float) -> None:
    """Flux behind the bare face and both normal components, from eigenvectors of the 4 x 4 matrix."""
    substrate = Substrate(thickness_um=460.0, optic_axis_deg=tilt, azimuth_deg=azimuth)
    crystal = Crystal(substrate, 0.8)
    q, fields = _berreman(crystal, k_x, k_y)
    ours = sorted(float(n[0]) for n in crystal.normal_components(np.array([k_x]), np.array([k_y])))
    np.testing.assert_allclose(sorted(q[:2]), ours, atol=1e-9)
    jones = _plane_wave_jones(crystal, k_x, k_y)
    # Incident light of both polarisations: the sum of their fluxes does not depend on the basis.
    cosine = math.sqrt(1.0 - k_x**2 - k_y**2)
    size = math.hypot(k_x, k_y)
    s = np.array([-k_y, k_x, 0.0]) / size if size > 1e-9 else np.array([0.0, 1.0, 0.0])
    flux = 0.0
    for electric in (s, np.cross(s, [k_x, k_y, cosine])):
        waves = []
        for sign in (1.0, -1.0):
            k = np.array([k_x, k_y, sign * cosine])
            for e in (s, np.cross(s, k)) if sign < 0 else (electric,):
                waves.append(np.concatenate([e[:2], np.cross(k, e)[:2]]))
        incident, reflected = waves[0], np.array(waves[1:]).T
        amplitude = np.linalg.solve(np.concatenate([fields[:, :2], -reflected], axis=1), incident)
        inside = fields[:, :2] @ amplitude[:2]
        flux += float((inside[0] * inside[3].conj() - inside[1] * inside[2].conj()).real) / cosine
    assert float((np.abs(jones) ** 2).sum()) == pytest.approx(flux, rel=3e-3)  # the waves are orthogonal to dn / n


@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.06, -0.03)])
@pytest.mark.parametrize("depth_um", [2500.0, 3e5])
def test_the_extraordinary_path_is_stationary(depth_um: float, tangent: tuple[float, float]) -> None:
    """Fermat, by solving for the direction that joins object and lens point, of both waves."""
    crystal = _rotated(replace(R_PLANE, back_face="coated"), 45.0)
    h, points = 460.0, [(100.0, 0.0), (-70.0, 70.0), (0.0, 0.0)]

    def path_um(which: int, x: float, y: float) -> float:
        offset = np.array([x - tangent[0] * depth_um, y - tangent[1] * depth_um])

        def q(kappa: np.ndarray) -> float:
            return float(crystal.normal_components(kappa[:1], kappa[1:])[which][0])

        def slope(kappa: np.ndarray) -> np.ndarray:
            along = [(q(kappa + d) - q(kappa - d)) / 2e-5 for d in 1e-5 * np.eye(2)]
            return np.asarray(offset - kappa / math.sqrt(1.0 - kappa @ kappa) * (depth_um - h) + h * np.array(along))

        kappa = root(slope, offset / math.hypot(*offset, depth_um), tol=1e-12).x
        return float(kappa @ offset + math.sqrt(1.0 - kappa @ kappa) * (depth_um - h) + q(kappa) * h)

    for x, y in points:
        change = path_um(1, x, y) - path_um(0, x, y)
        jones = crystal.jones(np.array([x]), np.array([y]), 1.0 / depth_um, tangent)[..., 0]
        kappa = crystal.plate.direction_cosines(np.array([x]), np.array([y]), 1.0 / depth_um, tangent)
        at_angle = _plane_wave_jones(crystal, float(kappa[0][0]), float(kappa[1][0]))
        # The two eigenvalues' phases differ by the path, whatever the waves' polarisations.
        ours, plain = (np.angle(np.linalg.det(matrix)) for matrix in (jones, at_angle))
        expected = crystal.wavenumber * change
        assert math.remainder(float(ours) - expected, 2.0 * math.pi) == pytest.approx(0.0, abs=2e-4)
        assert abs(math.remainder(float(plain - ours), 2.0 * math.pi)) < 0.02


def test_walk_off_by_the_slope_of_the_extraordinary_surface() -> None:
    """tan of the angle between ray and wave vector in an r-plane: 4.1e-3, 1.9 um over 460 um."""
    step = 1e-4
    q = _rotated(R_PLANE, 0.0).normal_components(np.array([-step, step]), np.zeros(2))[1]
    assert 460.0 * abs(float(q[1] - q[0])) / (2.0 * step) == pytest.approx(1.876, abs=2e-3)


def _pair(imaging: Imaging, substrate: Substrate | None, fwhm_nm: float | None = None) -> Psf:
    crystal = None if substrate is None else Crystal(substrate, imaging.wavelength_um)
    plates = () if crystal is None else (crystal.plate, crystal.plate)
    there = replace(imaging, crystal=crystal, plates=plates)
    source = lens.ideal(imaging, lens.eq_2(imaging), lens.eq_3_and_4(imaging))
    return psf(source, there, [0.9e-3, 1.2e-3], replace(NUMERICS, filter_fwhm_nm=fwhm_nm))


THIN = Substrate(thickness_um=46.0, cut="r-plane", azimuth_deg=0.0, back_face="coated")


def test_a_turned_wafer_moves_light_into_the_other_image_and_loses_none() -> None:
    imaging = lens.imaging()
    aligned, turned = (_pair(imaging, replace(THIN, azimuth_deg=a)) for a in (0.0, 20.0))
    crystal = Crystal(THIN, 0.8)
    crossed = math.sin(math.radians(40.0)) ** 2 * math.sin(0.5 * crystal.retardance_rad) ** 2
    assert aligned.ghost is not None and turned.ghost is not None
    assert aligned.ghost.efficiency.max() < 2e-3
    np.testing.assert_allclose(turned.ghost.efficiency / aligned.efficiency, crossed, rtol=0.03)
    np.testing.assert_allclose(turned.efficiency + turned.ghost.efficiency, aligned.efficiency, rtol=3e-3)
    np.testing.assert_allclose(turned.details.transmitted, aligned.details.transmitted, rtol=1e-6)
    assert turned.extinction_ratio == pytest.approx(turned.efficiency[0] / turned.ghost.efficiency[0], rel=0.02)
    # The ghost lies on the image of its window and turns with it.
    np.testing.assert_allclose(turned.ghost.phi_deg, turned.phi_deg, atol=3.0)


def test_behind_c_plane_sapphire_there_are_no_ghosts() -> None:
    pair = _pair(lens.imaging(), Substrate(thickness_um=46.0, cut="c-plane", azimuth_deg=45.0))
    assert pair.ghost is not None and pair.ghost.efficiency.max() < 1e-5 * pair.efficiency.min()


def test_over_a_filter_the_ghost_is_the_mean_of_its_wavelengths() -> None:
    """Mean power of both ghosts against the closed form; field angles over the pupil change the two oppositely."""
    thick = Substrate(thickness_um=300.0, cut="r-plane", azimuth_deg=45.0, back_face="coated")
    imaging = lens.imaging(aperture_um=40.0)
    pair = _pair(imaging, thick, fwhm_nm=20.0)
    crystal = Crystal(thick, 0.8)
    band = [crystal.at_wavelength(w).retardance_rad for w in np.linspace(0.79, 0.81, 101)]
    crossed = float(np.mean(np.sin(0.5 * np.array(band)) ** 2))
    assert pair.ghost is not None
    share = pair.ghost.efficiency / (pair.ghost.efficiency + pair.efficiency)
    np.testing.assert_allclose(share.mean(axis=0), crossed, rtol=0.01)
