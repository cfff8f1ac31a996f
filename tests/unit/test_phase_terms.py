"""Every phase term against its closed form, on unequal axes so that x and y cannot be swapped unseen."""

from __future__ import annotations

import math
import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.core.conventions import POLARISATIONS, wrap_phase
from metafab.core.errors import InputError
from metafab.phase import (
    AxiconPhase,
    DoubleHelixPhase,
    GratingPhase,
    LensPhase,
    PhaseProfile,
    SampledPhase,
    SpiralZonesPhase,
    SplitLensPhase,
    VortexPhase,
    WaveSumPhase,
    ZernikePhase,
    load_array,
)
from metafab.phase.terms import carriers
from metafab.phase.terms.profile import Term

X_UM = np.linspace(-90.0, 80.0, 23)
Y_UM = np.linspace(-70.0, 95.0, 17)
RADIUS_UM = 100.0
K = 2.0 * math.pi / 0.8
ANGLE_RAD = 1e-11  # stated error of the compiled arctangent
WAVES = WaveSumPhase(
    RADIUS_UM,
    np.array([1.0 + 0.5j, -0.3j, 0.7]),
    np.array([-2.0, 1.0, 4.0]),
    np.array([[1.0, 2.0], [-3.0, 0.5], [0.2, -1.5]]),
)
TERMS: list[Term] = [
    LensPhase(0.8, 1000.0),
    LensPhase(0.8, 1000.0, 3000.0),
    SplitLensPhase(0.8, 1000.0, 8.0),
    SplitLensPhase(0.8, 1000.0, 8.0, 3000.0),
    GratingPhase(0.8, 5.0, 30.0),
    AxiconPhase(0.8, 3.0),
    SpiralZonesPhase(4, 0.5, RADIUS_UM),
    WAVES,
    VortexPhase(-3),
    DoubleHelixPhase(RADIUS_UM, 0.35, 5),
    ZernikePhase(4, -2, 1.5, RADIUS_UM),
    SampledPhase(np.exp(1j * np.arange(50.0).reshape(2, 5, 5)), 40.0),
]


@pytest.mark.parametrize("term", TERMS, ids=lambda term: type(term).__name__)
def test_terms_are_finite_everywhere_frozen_and_travel_between_processes(term: Term) -> None:
    x_um, y_um = np.linspace(-300.0, 300.0, 9), np.linspace(-200.0, 200.0, 7)  # beyond the aperture, and the axis
    copy = pickle.loads(pickle.dumps(term))
    for polarisation in POLARISATIONS:
        phase = term(x_um, y_um, polarisation)
        assert phase.shape == (7, 9)
        assert phase.dtype == np.float64
        assert np.isfinite(phase).all()
        np.testing.assert_array_equal(copy(x_um, y_um, polarisation), phase)
    with pytest.raises(AttributeError):
        term.polarisation = "x"  # type: ignore[attr-defined, misc]


@pytest.mark.parametrize("term", TERMS, ids=lambda term: type(term).__name__)
def test_a_tile_is_a_cut_of_the_whole(term: Term) -> None:
    whole = term(X_UM, Y_UM, "y")
    tile = term(X_UM[5:14], Y_UM[2:9], "y")
    # Sums of waves go through a matrix product, whose rounding may depend on the shape; compare on the circle.
    np.testing.assert_allclose(wrap_phase(tile - whole[2:9, 5:14]), 0.0, atol=2 * ANGLE_RAD)


def test_a_term_is_zero_for_the_polarisation_that_it_does_not_act_on() -> None:
    for term in (
        LensPhase(0.8, 1000.0, polarisation="x"),
        SplitLensPhase(0.8, 1000.0, 8.0, polarisation="x"),
        GratingPhase(0.8, 5.0, polarisation="x"),
        AxiconPhase(0.8, 3.0, polarisation="x"),
        SpiralZonesPhase(4, 0.5, RADIUS_UM, polarisation="x"),
        WaveSumPhase(RADIUS_UM, WAVES.amplitude, WAVES.defocus_rad, WAVES.tilt_rad, polarisation="x"),
        VortexPhase(2, polarisation="x"),
        DoubleHelixPhase(RADIUS_UM, 0.35, 5, polarisation="x"),
        ZernikePhase(3, 1, 1.0, RADIUS_UM, polarisation="x"),
        SampledPhase(np.exp(1j * np.arange(50.0).reshape(2, 5, 5)), 40.0, polarisation="x"),
    ):
        assert not term(X_UM, Y_UM, "y").any()
        assert np.abs(term(X_UM, Y_UM, "x")).max() > 0.1


def test_a_lens_equalises_the_optical_paths() -> None:
    x, y = X_UM[None, :], Y_UM[:, None]
    phase = LensPhase(0.8, 1200.0, 3000.0)(X_UM, Y_UM, "x")
    path = np.sqrt(x**2 + y**2 + 1200.0**2) + np.sqrt(x**2 + y**2 + 3000.0**2) - 4200.0
    # The plain difference of paths has lost eps * 4200 um; times k that is 8e-12 rad.
    np.testing.assert_allclose(phase, -K * path, atol=3e-11)


def test_a_finite_split_lens_focuses_its_object_on_the_tilted_image_sphere() -> None:
    x, y, z_um, s_um, angle = X_UM[None, :], Y_UM[:, None], 3000.0, 1500.0, math.radians(8.0)
    for polarisation, sign in (("x", -1.0), ("y", 1.0)):
        phase = SplitLensPhase(0.8, s_um, 8.0, z_um)(X_UM, Y_UM, polarisation)  # type: ignore[arg-type]
        focus_x, focus_z = sign * s_um * math.sin(angle), s_um * math.cos(angle)
        path = np.sqrt((x - focus_x) ** 2 + y**2 + focus_z**2) + np.sqrt(x**2 + y**2 + z_um**2)
        total = phase + K * path
        np.testing.assert_allclose(total - total[0, 0], 0.0, atol=3e-11)


def test_no_digits_are_lost_near_the_axis_of_a_long_lens() -> None:
    x_um = np.array([1e-3, 0.0, 2e-3])
    phase = LensPhase(0.8, 1e6)(x_um, np.zeros(1), "x")
    np.testing.assert_allclose(phase[0], -K * x_um**2 / 2e6, rtol=1e-12)


def test_a_grating_and_an_axicon_have_the_slope_of_their_angle() -> None:
    grating = GratingPhase(0.8, 5.0, 30.0)(X_UM, Y_UM, "x")
    slope = K * math.sin(math.radians(5.0))
    expected = slope * (X_UM[None, :] * math.cos(math.pi / 6) + Y_UM[:, None] * math.sin(math.pi / 6))
    np.testing.assert_allclose(grating, expected, atol=1e-10)
    axicon = AxiconPhase(0.8, 3.0)(X_UM, Y_UM, "y")
    expected = -K * math.sin(math.radians(3.0)) * np.sqrt(X_UM[None, :] ** 2 + Y_UM[:, None] ** 2)
    np.testing.assert_allclose(axicon, expected, atol=1e-10)


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
        phase = ZernikePhase(degree, order, 0.7, RADIUS_UM)(X_UM, Y_UM, "x")
        np.testing.assert_allclose(phase, 0.7 * expected, atol=1e-13)


def test_a_sum_of_waves_has_the_phase_of_the_written_sum() -> None:
    x, y = X_UM[None, :] / RADIUS_UM, Y_UM[:, None] / RADIUS_UM
    total = sum(
        c * np.exp(1j * (-w * (x**2 + y**2) + v[0] * x + v[1] * y))
        for c, w, v in zip(WAVES.amplitude, WAVES.defocus_rad, WAVES.tilt_rad, strict=True)
    )
    np.testing.assert_allclose(wrap_phase(WAVES(X_UM, Y_UM, "x") - np.angle(total)), 0.0, atol=ANGLE_RAD)


def test_a_double_helix_is_its_gauss_laguerre_modes_and_the_same_for_both_polarisations_up_to_pi() -> None:
    from scipy.special import eval_genlaguerre

    term = DoubleHelixPhase(RADIUS_UM, 0.35, 4)
    x, y = X_UM[None, :] / 35.0, Y_UM[:, None] / 35.0
    rho2, phi = x**2 + y**2, np.arctan2(y, x)
    total = np.zeros(rho2.shape, dtype=complex)
    for j in range(4):
        m = 2 * j + 1
        norm = math.sqrt(math.factorial(j) / math.factorial(j + m))
        radial = norm * (2 * rho2) ** (m / 2) * eval_genlaguerre(j, m, 2 * rho2)
        total += radial * np.exp(1j * m * phi)
    # The series loses digits where its terms cancel: relative to the largest term, not to the sum.
    error = np.abs(np.exp(1j * (term(X_UM, Y_UM, "x") - np.angle(total))) - 1.0) * np.abs(total)
    assert error.max() < 1e-9 * np.abs(total).max()
    half_turn = wrap_phase(term(X_UM, Y_UM, "x") - term(X_UM, Y_UM, "y"))
    np.testing.assert_allclose(np.abs(half_turn), math.pi, atol=1e-9)


@given(st.floats(-99.0, 99.0), st.floats(-99.0, 99.0))
def test_helices_of_the_two_polarisations_are_point_mirrors(x_um: float, y_um: float) -> None:
    x, y = np.array([x_um]), np.array([y_um])
    mirrored = SampledPhase(np.exp(1j * np.arange(49.0).reshape(1, 7, 7)), 30.0)
    for term in (SpiralZonesPhase(5, 0.5, RADIUS_UM), WAVES, mirrored):
        assert term(x, y, "y") == term(-x, -y, "x")


def test_a_profile_adds_its_terms() -> None:
    profile = PhaseProfile((VortexPhase(2), GratingPhase(0.8, 3.0, polarisation="y")), {})
    phase = profile(X_UM, Y_UM)
    spiral = 2.0 * np.arctan2(Y_UM[:, None], X_UM[None, :])
    np.testing.assert_array_equal(phase[0], spiral)
    np.testing.assert_allclose(phase[1] - spiral, GratingPhase(0.8, 3.0)(X_UM, Y_UM, "y"), atol=1e-12)


def test_samples_are_met_exactly_and_jumps_of_two_pi_are_none(tmp_path: Path) -> None:
    positions = (np.arange(81) - 40.0) * 5.0
    smooth = 0.13 * positions[None, :] + 0.07 * positions[:, None]  # many turns, 0.65 rad a sample
    np.save(tmp_path / "wrapped.npy", wrap_phase(smooth))
    term = load_array(tmp_path / "wrapped.npy", 5.0, "phase_rad", RADIUS_UM)
    np.testing.assert_allclose(wrap_phase(term(positions, positions, "x") - smooth), 0.0, atol=ANGLE_RAD)
    between = term(X_UM, Y_UM, "y")
    expected = 0.13 * X_UM[None, :] + 0.07 * Y_UM[:, None]
    # Of a linear phase, the angle of the mean of two phasors 0.65 rad apart errs by at most theta^3 / 72 sqrt(3).
    np.testing.assert_allclose(wrap_phase(between - expected), 0.0, atol=2 * 0.65**3 / (72 * math.sqrt(3)) * 1.2)


def test_arrays_are_read_from_all_three_kinds_of_file(tmp_path: Path) -> None:
    phase = np.arange(12.0).reshape(3, 4) / 7.0
    np.save(tmp_path / "a.npy", phase)
    np.savetxt(tmp_path / "a.csv", phase, delimiter=",", fmt="%.17g")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["mine"] = np.stack([phase, -phase])
    x_um, y_um = np.array([-3.0, -1.0, 1.0, 3.0]), np.array([-2.0, 0.0, 2.0])
    for name in ("a.npy", "a.csv", "a.h5"):
        term = load_array(tmp_path / name, 2.0, "mine", 3.0)
        np.testing.assert_allclose(term(x_um, y_um, "x"), phase, atol=ANGLE_RAD)
        sign = -1.0 if name == "a.h5" else 1.0
        np.testing.assert_allclose(term(x_um, y_um, "y"), sign * phase, atol=ANGLE_RAD)


def test_arrays_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "small.npy", np.zeros((4, 4)))
    np.save(tmp_path / "hole.npy", np.full((4, 4), np.nan))
    np.save(tmp_path / "flat.npy", np.zeros(4))
    np.save(tmp_path / "complex.npy", np.ones((4, 4), dtype=complex))
    (tmp_path / "broken.h5").write_bytes(b"not HDF5")
    (tmp_path / "phase.txt").write_text("0")
    with pytest.raises(InputError, match="cover the aperture"):
        load_array(tmp_path / "small.npy", 1.0, "phase_rad", 10.0)
    for name in ("hole.npy", "flat.npy", "complex.npy"):
        with pytest.raises(InputError, match="finite real numbers"):
            load_array(tmp_path / name, 10.0, "phase_rad", 10.0)
    with pytest.raises(InputError, match="got NaN or infinity at 16 of 16 places"):
        load_array(tmp_path / "hole.npy", 10.0, "phase_rad", 10.0)
    for name in ("broken.h5", "phase.txt", "missing.csv"):
        with pytest.raises(InputError, match=r"\.npy, \.csv or \.h5"):
            load_array(tmp_path / name, 10.0, "phase_rad", 10.0)


@pytest.mark.parametrize("object_um", [math.inf, 3e5])
@pytest.mark.parametrize("sine", [0.0, 0.139, -0.139])
def test_compiled_and_vectorised_paths_are_the_same(object_um: float, sine: float) -> None:
    """To the last bit: the same operations in the same order."""
    x_um, y_um = np.linspace(-900.0, 1000.0, 37), np.linspace(-1000.0, 700.0, 23)
    vectorised = carriers.path_vectorised(2e4, object_um, sine, x_um, y_um)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(carriers, "HAS_NUMBA", False)
        plain = carriers.SplitLensPhase(0.8, 2e4, math.degrees(math.asin(sine)), object_um)(x_um, y_um, "x")
    compiled = carriers.SplitLensPhase(0.8, 2e4, math.degrees(math.asin(sine)), object_um)(x_um, y_um, "x")
    assert np.array_equal(compiled, plain)
    assert compiled == pytest.approx(-2.0 * math.pi / 0.8 * vectorised, rel=1e-12)
