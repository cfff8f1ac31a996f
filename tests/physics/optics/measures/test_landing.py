"""A device by the user's own phase: the window follows its light, or the light is found."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.layout.pillars import Lattice
from metafab.optics.measures import landing
from metafab.spec import Design, load_design, write_new
from metafab.spec.terms import Grating, UserArray, Zernike
from metafab.steps.job import Job
from metafab.steps.optics import PairFigures, point_spread

#: Distance of the sensor of a new deflector, and half its aperture.
SENSOR_UM, HALF_UM, PITCH_UM = 500.0, 20.0, 0.25
WAVELENGTH_UM = 0.8


def _device(folder: Path, phase_rad: FloatArray, **verify: object) -> Design:
    """A square of 40 um without a lens whose phase is a user's array."""
    design = load_design(write_new("own", "deflector", folder)[0])
    np.save(folder / "own.npy", phase_rad)
    term = UserArray(file=folder / "own.npy", pitch_um=PITCH_UM)
    return replace(design, phase=(term,), verify=replace(design.verify, **verify))


def _x_um() -> FloatArray:
    return np.asarray((np.arange(162) - 80.5) * PITCH_UM, dtype=np.float64)


def _figures(design: Design, folder: Path, **options: object) -> PairFigures:
    asked = {"target_error": 1e-3, **options}
    pair = point_spread(Job(design, folder), None, **asked)  # type: ignore[arg-type]
    return PairFigures.of(*pair)


def test_the_window_follows_the_mean_slope_of_an_own_phase(tmp_path: Path) -> None:
    """A blazed array, wrapped: 176 um from the axis, where the run used to say an efficiency of 0.5 %."""
    sine = 176.0 / math.hypot(176.0, SENSOR_UM)
    blazed = np.mod(2.0 * np.pi / WAVELENGTH_UM * sine * _x_um(), 2.0 * np.pi)
    design = _device(tmp_path, np.tile(blazed, (162, 1)))
    figures = _figures(design, tmp_path)
    assert min(figures.efficiency_x) > 0.9
    assert figures.light_at_um is None
    assert figures.warnings() == []


def test_a_zernike_tilt_counts_with_its_slope(tmp_path: Path) -> None:
    design = replace(_device(tmp_path, np.zeros((162, 162))), phase=(Zernike(amplitude_rad=20.0, degree=1, order=1),))
    # 20 rad over the half side of 20 um: a sine of 20 / (20 k), 62 um aside.
    assert min(_figures(design, tmp_path).efficiency_x) > 0.9


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_light_that_misses_the_window_is_found(tmp_path: Path, side: float) -> None:
    """A splitter with 80 % to one side and the rest to the other: no window on the mean slope holds a beam."""
    sine = 200.0 / math.hypot(200.0, SENSOR_UM)
    carrier = 2.0 * np.pi / WAVELENGTH_UM * sine * _x_um()
    phase = np.angle(np.exp(1j * side * carrier) + 0.5 * np.exp(-1j * side * carrier))
    design = _device(tmp_path, np.tile(phase, (162, 1)), centre_um=(0.0, 0.0))
    figures = _figures(design, tmp_path)
    assert figures.light_at_um is not None
    for place in figures.light_at_um:
        # The beam is 40 um wide, blocks and their diffraction are sqrt(0.8 x 500) = 20 um.
        assert place == pytest.approx((200.0 * side, 0.0), abs=10.0)
    (sentence,) = figures.warnings()
    assert "misses the light" in sentence
    assert "verify.centre_um" in sentence
    # The remedy works.
    there = _figures(design, tmp_path, centre_um=figures.light_at_um[0])
    assert min(there.efficiency_x) > 0.6
    assert there.light_at_um is None


@pytest.mark.parametrize("angle_deg", [30.0, 70.0])
def test_a_steep_beam_lands_at_the_tangent_of_its_angle(tmp_path: Path, angle_deg: float) -> None:
    """Bins of the transform would put the beam of 70 degrees 180 um beside its place."""
    design = load_design(write_new("own", "deflector", tmp_path)[0])
    design = replace(design, phase=(Grating(angle_deg=angle_deg, azimuth_deg=0.0),))
    design = replace(design, sensor=replace(design.sensor, pixel_um=0.4))
    figures = _figures(design, tmp_path, centre_um=(-100.0, 0.0))
    assert figures.light_at_um is not None
    expected = (SENSOR_UM * math.tan(math.radians(angle_deg)), 0.0)
    assert figures.light_at_um[0] == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("cosines", [(0.3, -0.2), (0.85, 0.1), (0.1, 0.9)])
def test_beams_of_a_hexagonal_lattice_keep_their_direction(cosines: tuple[float, float]) -> None:
    """Its grid carries a pillar at every other site, so that no pillar has one beside it on the grid."""
    lattice = Lattice(period_dbu=(200, 346), shape=(32, 32), database_unit_nm=1.0, hexagonal=True)
    slope_x, slope_y = 2.0 * np.pi / 0.66 * np.array(cosines)
    field = np.exp(1j * (slope_x * lattice.x_um() + slope_y * lattice.y_um()[:, None]))
    field *= lattice.carries(np.arange(32), np.arange(32))
    found, power = landing.plane_waves(field, 32, 0.66 / np.array([0.2, 0.346]), lattice)
    bright = power > 1e-3 * power.max()
    assert bright.any()
    np.testing.assert_allclose(found[:, bright].T, np.broadcast_to(cosines, (int(bright.sum()), 2)), atol=1e-9)


@pytest.mark.parametrize("amplitude_rad", [None, 30.0])
def test_a_window_that_cuts_the_image_is_told_of(tmp_path: Path, amplitude_rad: float | None) -> None:
    """The cubic phase of a new design fits its window; of twice its amplitude, the brightest corner is cut off."""
    design = load_design(write_new("own", "own_phase", tmp_path)[0])
    if amplitude_rad is not None:
        axis = np.linspace(-1.0, 1.0, 202)
        np.save(tmp_path / "own.npy", amplitude_rad * (axis[:, None] ** 3 + axis**3))
    figures = _figures(design, tmp_path, target_error=1e-2, depths_m=(0.010,))
    if amplitude_rad is None:
        assert figures.warnings() == [] and figures.is_whole
        assert min(figures.efficiency_x) > 0.85
        return
    assert figures.light_at_um is None and figures.peak_on_edge and not figures.is_whole
    (sentence,) = figures.warnings()
    assert "edge of the window, which holds 26 % of" in sentence and "verify.window_px" in sentence


def test_one_window_for_both_polarisations_has_no_extinction(tmp_path: Path) -> None:
    figures = _figures(_device(tmp_path, np.zeros((162, 162))), tmp_path)
    assert all(math.isnan(ratio) for ratio in figures.extinction_ratio)


def test_a_slope_beyond_ninety_degrees_is_refused(tmp_path: Path) -> None:
    steep = np.mod(2.0 * np.pi / WAVELENGTH_UM * 1.05 * _x_um(), 2.0 * np.pi)
    with pytest.raises(InputError, match=r"1\.05"):
        _figures(_device(tmp_path, np.tile(steep, (162, 1))), tmp_path)
