"""Pedestal of a frame: measured at its dark edge, or nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.camera.frames.frame import RawFrame
from metafab.decode.registration.pedestal import pedestal_e, without_pedestal


def frame_of(values: np.ndarray, window: tuple[int, int, int, int] | None = None) -> RawFrame:
    return RawFrame(values, 3.45, (0.0, 0.0), 2.0, x_window=window, saturation_e=9000.0)


def lit(haze_e: float, margin: int = 24) -> np.ndarray:
    rng = np.random.default_rng(1)
    mean = np.full((160, 260), haze_e)
    mean[margin:-margin, margin:-margin] += 3000.0
    return rng.poisson(mean) + rng.normal(0.0, 2.0, mean.shape)


@pytest.mark.parametrize("haze_e", [60.0, 1500.0])
def test_haze_is_measured_beyond_the_field_stop(haze_e: float) -> None:
    error = 5.0 * (haze_e / 3000.0) ** 0.5  # some 3000 pixels of the edge: five standard errors
    assert pedestal_e(frame_of(lit(haze_e), (24, 24, 112, 100))) == pytest.approx(haze_e, abs=error)
    assert pedestal_e(frame_of(lit(haze_e))) == pytest.approx(haze_e, abs=error)


def test_a_dark_edge_has_none() -> None:
    assert pedestal_e(frame_of(lit(0.0), (24, 24, 112, 100))) == 0.0


def test_an_edge_that_is_lit_here_and_there_is_measured_where_it_is_dark() -> None:
    values = lit(400.0)
    values[:, :24] += np.random.default_rng(2).uniform(200.0, 900.0, (160, 24))
    values[3, 40] = np.nan
    assert pedestal_e(frame_of(values, (24, 24, 112, 100))) == pytest.approx(400.0, abs=3.0)


def test_a_frame_within_the_scene_has_none_that_it_could_tell() -> None:
    """A texture up to the edge: its darkest places are scene, not haze."""
    rng = np.random.default_rng(3)
    scene = rng.uniform(500.0, 4000.0, (20, 33)).repeat(8, axis=0).repeat(8, axis=1)
    assert pedestal_e(frame_of(rng.poisson(scene).astype(float))) == 0.0
    assert pedestal_e(frame_of(np.zeros((3, 5)))) == 0.0


def test_its_photon_noise_stays() -> None:
    frame = frame_of(lit(1500.0))
    clear = without_pedestal(frame, 1500.0)
    assert clear.frame.mean() == pytest.approx(frame.frame.mean() - 1500.0)
    assert clear.read_noise_e == pytest.approx((2.0**2 + 1500.0) ** 0.5)
    assert clear.saturation_e == 7500.0
    assert without_pedestal(frame, 0.0) is frame
