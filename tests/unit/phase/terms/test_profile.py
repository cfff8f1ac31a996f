"""Properties of all phase terms, and their sum."""

from __future__ import annotations

import pickle

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
)
from metafab.phase.terms.profile import Term

X_UM = np.linspace(-90.0, 80.0, 23)
Y_UM = np.linspace(-70.0, 95.0, 17)
RADIUS_UM = 100.0
ANGLE_RAD = 1e-11  # stated error of the compiled arctangent
WAVES = WaveSumPhase(
    RADIUS_UM,
    np.array([1.0 + 0.5j, -0.3j, 0.7]),
    np.array([-2.0, 1.0, 4.0]),
    np.array([[1.0, 2.0], [-3.0, 0.5], [0.2, -1.5]]),
)
TERMS: list[Term] = [
    LensPhase(wavelength_um=0.8, image_distance_um=1000.0),
    LensPhase(wavelength_um=0.8, image_distance_um=1000.0, object_distance_um=3000.0),
    SplitLensPhase(wavelength_um=0.8, image_distance_um=1000.0, angle_deg=8.0),
    SplitLensPhase(wavelength_um=0.8, image_distance_um=1000.0, angle_deg=8.0, object_distance_um=3000.0),
    GratingPhase(wavelength_um=0.8, angle_deg=5.0, azimuth_deg=30.0),
    AxiconPhase(wavelength_um=0.8, angle_deg=3.0),
    SpiralZonesPhase(zones=4, exponent=0.5, radius_um=RADIUS_UM),
    WAVES,
    VortexPhase(charge=-3),
    DoubleHelixPhase(radius_um=RADIUS_UM, waist=0.35, modes=5),
    ZernikePhase(degree=4, order=-2, amplitude_rad=1.5, radius_um=RADIUS_UM),
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


def test_places_in_single_precision_give_the_phases_of_the_same_places() -> None:
    x_um, y_um = X_UM.astype(np.float32), np.linspace(-64.0, 64.0, 17, dtype=np.float32)
    single, double = (WAVES(x_um.astype(kind), y_um.astype(kind), "x") for kind in (np.float32, np.float64))
    np.testing.assert_allclose(wrap_phase(single - double), 0.0, atol=1e-5)


@pytest.mark.parametrize("term", TERMS, ids=lambda term: type(term).__name__)
def test_a_tile_is_a_cut_of_the_whole(term: Term) -> None:
    whole = term(X_UM, Y_UM, "y")
    tile = term(X_UM[5:14], Y_UM[2:9], "y")
    # Sums of waves go through a matrix product, whose rounding may depend on the shape; compare on the circle.
    np.testing.assert_allclose(wrap_phase(tile - whole[2:9, 5:14]), 0.0, atol=2 * ANGLE_RAD)


def test_a_term_is_zero_for_the_polarisation_that_it_does_not_act_on() -> None:
    for term in (
        LensPhase(wavelength_um=0.8, image_distance_um=1000.0, polarisation="x"),
        SplitLensPhase(wavelength_um=0.8, image_distance_um=1000.0, angle_deg=8.0, polarisation="x"),
        GratingPhase(wavelength_um=0.8, angle_deg=5.0, polarisation="x"),
        AxiconPhase(wavelength_um=0.8, angle_deg=3.0, polarisation="x"),
        SpiralZonesPhase(zones=4, exponent=0.5, radius_um=RADIUS_UM, polarisation="x"),
        WaveSumPhase(RADIUS_UM, WAVES.amplitude, WAVES.defocus_rad, WAVES.tilt_rad, polarisation="x"),
        VortexPhase(charge=2, polarisation="x"),
        DoubleHelixPhase(radius_um=RADIUS_UM, waist=0.35, modes=5, polarisation="x"),
        ZernikePhase(degree=3, order=1, amplitude_rad=1.0, radius_um=RADIUS_UM, polarisation="x"),
        SampledPhase(np.exp(1j * np.arange(50.0).reshape(2, 5, 5)), 40.0, polarisation="x"),
    ):
        assert not term(X_UM, Y_UM, "y").any()
        assert np.abs(term(X_UM, Y_UM, "x")).max() > 0.1


@given(st.floats(-99.0, 99.0), st.floats(-99.0, 99.0))
def test_helices_of_the_two_polarisations_are_point_mirrors(x_um: float, y_um: float) -> None:
    x, y = np.array([x_um]), np.array([y_um])
    mirrored = SampledPhase(np.exp(1j * np.arange(49.0).reshape(1, 7, 7)), 30.0)
    for term in (SpiralZonesPhase(zones=5, exponent=0.5, radius_um=RADIUS_UM), WAVES, mirrored):
        assert term(x, y, "y") == term(-x, -y, "x")


def test_a_profile_adds_its_terms() -> None:
    profile = PhaseProfile((VortexPhase(charge=2), GratingPhase(wavelength_um=0.8, angle_deg=3.0, polarisation="y")))
    phase = profile(X_UM, Y_UM)
    spiral = 2.0 * np.arctan2(Y_UM[:, None], X_UM[None, :])
    np.testing.assert_array_equal(phase[0], spiral)
    np.testing.assert_allclose(
        phase[1] - spiral, GratingPhase(wavelength_um=0.8, angle_deg=3.0)(X_UM, Y_UM, "y"), atol=1e-12
    )


def _transposed(x_um: np.ndarray, y_um: np.ndarray, polarisation: str) -> np.ndarray:
    x, y = np.meshgrid(x_um, y_um, indexing="ij")
    return np.asarray(x**2 + y)


def test_terms_of_another_shape_are_refused_before_they_draw_a_turned_lens() -> None:
    """On square tiles an exchange of the axes would pass unseen. What broadcasts, as a function of x alone, serves."""
    assert PhaseProfile((lambda x, y, p: x,))(X_UM, Y_UM).shape == (2, Y_UM.size, X_UM.size)
    for term, got in (
        (_transposed, r"float64 of shape \(3, 2\)"),
        (lambda x, y, p: y, r"float64 of shape \(2,\)"),
        (lambda x, y, p: np.exp(1j * x), r"complex128 of shape \(3,\)"),
    ):
        with pytest.raises(InputError, match=rf"`terms\[1\]`: expected real radians of shape \(n_y, n_x\).*got {got}"):
            PhaseProfile((VortexPhase(charge=1), term))
    with pytest.raises(InputError, match=r"`terms`: expected a sequence of terms, got one VortexPhase"):
        PhaseProfile(VortexPhase(charge=1))  # type: ignore[arg-type]


def test_phases_in_place_of_a_field_are_refused() -> None:
    """Their angles would be 0 and pi."""
    for samples in (np.ones((2, 5, 5)), np.ones((5, 5), dtype=complex), np.ones((3, 5, 5), dtype=complex)):
        with pytest.raises(
            InputError, match=r"`field`: expected a complex field of shape .*numpy.exp\(1j \* phase_rad\)"
        ):
            SampledPhase(samples, 1.0)


def test_phases_that_are_not_finite_are_refused() -> None:
    """As the root of a sphere's sagitta is beyond its radius: one such place spoils the figures of a whole layout."""

    def sagitta(x_um: np.ndarray, y_um: np.ndarray, polarisation: str) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(4.0 - x_um**2 - y_um[:, None] ** 2))

    sphere = PhaseProfile((sagitta,))
    assert sphere(np.ones(2), np.ones(2)).max() == np.sqrt(2.0)
    with pytest.raises(
        InputError, match=r"`terms`: expected finite radians .*got NaN or infinity at 2 of 12; .*nan_to_num"
    ):
        sphere(np.array([0.0, 1.0, 1.9]), np.array([0.0, 1.0]))
