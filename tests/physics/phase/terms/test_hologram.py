"""Holograms: one bright spot is a grating, pictures are upright, and the light is in the picture."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.phase import GratingPhase, ImagePlane, Pupil, design_hologram
from metafab.phase.terms.hologram import Hologram
from metafab.spec.new import sample_picture

WAVELENGTH_UM, DISTANCE_UM, PITCH_UM, SITES = 0.8, 500.0, 0.5, 120
PLANE = ImagePlane(pitch_um=PITCH_UM, wavelength_um=WAVELENGTH_UM, distance_um=DISTANCE_UM)


def _hologram(picture: FloatArray, width_um: float, iterations: int = 30, sites: int = SITES) -> Hologram:
    inside = Pupil(sites, "square").inside
    return design_hologram(picture, width_um, PLANE, inside=inside, iterations=iterations)


@pytest.mark.parametrize(("row", "column"), [(20, 20), (5, 20), (20, 31), (33, 9)])
def test_one_bright_spot_is_a_grating_towards_it(row: int, column: int) -> None:
    # Points of the picture as fine as those of the plane behind it, so that the spot is one of them.
    step_um = WAVELENGTH_UM * DISTANCE_UM / (1.5 * SITES * PITCH_UM)
    picture = np.zeros((41, 41))
    picture[row, column] = 1.0
    # Two rounds: later ones trade light for black between the spot's side lobes, which no grating has.
    hologram = _hologram(picture, 41 * step_um, iterations=2)
    # First row at the top: y falls with the row. The plane's middle point lies on the axis for odd counts.
    x_um, y_um = (column - 20) * step_um, (20 - row) * step_um
    angle_deg = math.degrees(math.asin(math.hypot(x_um, y_um) / DISTANCE_UM))
    azimuth_deg = math.degrees(math.atan2(y_um, x_um))
    axis_um = PITCH_UM * (np.arange(SITES) - 0.5 * (SITES - 1))
    grating = GratingPhase(wavelength_um=WAVELENGTH_UM, angle_deg=angle_deg, azimuth_deg=azimuth_deg)(
        axis_um, axis_um, "x"
    )
    likeness = np.abs(np.mean(hologram.field * np.exp(-1j * grating)))
    assert likeness > 0.999


def test_a_picture_is_painted_upright_and_bright() -> None:
    picture = np.zeros((40, 60))
    picture[:10, :15] = 1.0  # the top left corner
    picture[30:, 30:] = 0.5  # and a fainter bar at the bottom right
    hologram = _hologram(picture, 120.0, sites=200)
    rows, columns = hologram.image.shape
    total = hologram.image.sum()
    bright = hologram.image[round(0.75 * rows) :, : round(0.25 * columns)].sum()
    faint = hologram.image[: round(0.25 * rows), round(0.5 * columns) :].sum()
    assert bright + faint > 0.85 * total
    # 150 points of 1 against 300 of 0.5: equal light, within what the speckle of the free border moves.
    assert bright / faint == pytest.approx(1.0, abs=0.2)
    assert hologram.correlation > 0.9
    assert 0.5 < hologram.efficiency <= 1.0


def test_more_iterations_never_harm_and_nothing_is_left_to_chance() -> None:
    picture = sample_picture(120)
    short, long = (_hologram(picture, 80.0, iterations) for iterations in (6, 40))
    assert long.correlation > short.correlation
    assert np.array_equal(long.field, _hologram(picture, 80.0, 40).field)


def test_energy_is_conserved_and_the_phase_is_pure() -> None:
    hologram = _hologram(sample_picture(120), 80.0)
    assert np.abs(np.abs(hologram.field) - 1.0).max() < 1e-12
    assert hologram.wanted.sum() == pytest.approx(1.0, abs=1e-12)
    assert hologram.efficiency <= 1.0 + 1e-12


@pytest.mark.parametrize(("shape", "share"), [((40, 60), 1.0), ((60, 40), 40 / 60), ((40, 40), 1.0)])
def test_the_widest_picture_fills_the_period_of_the_image_plane(shape: tuple[int, int], share: float) -> None:
    period_um = WAVELENGTH_UM * DISTANCE_UM / PITCH_UM
    picture = np.ones(shape)
    hologram = _hologram(picture, share * period_um, iterations=1)
    assert max(hologram.image.shape) == math.ceil(1.5 * SITES)  # all of the plane, along the picture's longer side
    with pytest.raises(ValueError, match="`width_um`"):
        _hologram(picture, 1.001 * share * period_um, iterations=1)
    with pytest.raises(ValueError, match="`width_um`"):
        _hologram(picture, 1e9, iterations=1)  # before any memory is asked for
