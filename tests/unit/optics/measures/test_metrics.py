"""Figures of merit on PSFs that are known in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics import Psf
from metafab.optics.measures import metrics
from tests.conjugate_pair import helix_psf

PIXEL_UM = 2.0
SIGMA_UM = 12.0


def _gaussian(power: FloatArray, *, aside_um: float = 0.0, count: int = 96) -> Psf:
    """One Gaussian a depth, of the given powers, some way beside the centre."""
    axis = (np.arange(count) - count // 2) * PIXEL_UM
    spot = np.exp(-((axis - aside_um) ** 2)[None, :] / (2 * SIGMA_UM**2) - axis[:, None] ** 2 / (2 * SIGMA_UM**2))
    images = power[:, None, None] * spot / (2.0 * math.pi * SIGMA_UM**2)
    base = helix_psf(1.0 / np.linspace(4.0, 2.0, power.size), window_px=8)
    return replace(base, psf=np.array([images, images]), pixel_um=PIXEL_UM)


@pytest.mark.parametrize("aside_um", [0.0, 30.0])
def test_a_pinhole_finds_the_spot(aside_um: float) -> None:
    """1 - exp(-r^2 / 2 sigma^2) of a Gaussian passes; the disc's ragged rim is worth its share of that density."""
    stack = _gaussian(np.array([0.9, 0.5]), aside_um=aside_um)
    expected = np.array([0.9, 0.5]) * (1.0 - math.exp(-(25.0**2) / (2.0 * SIGMA_UM**2)))
    assert metrics.pinhole_efficiency(stack, 50.0) == pytest.approx(np.array([expected, expected]), rel=0.01)


def test_the_share_in_a_frame_counts_pixels_on_its_rim_by_their_area() -> None:
    """Erf of a Gaussian over a rectangle whose rim lies within pixels; a window smaller than it knows nothing."""
    stack = _gaussian(np.array([0.9, 0.5]))
    share = math.erf(0.5 * 31.0 / (SIGMA_UM * math.sqrt(2.0))) * math.erf(0.5 * 22.4 / (SIGMA_UM * math.sqrt(2.0)))
    expected = share * np.array([0.9, 0.5])
    assert metrics.frame_efficiency(stack, 31.0, 22.4) == pytest.approx(np.array([expected, expected]), rel=3e-3)
    assert np.isnan(metrics.frame_efficiency(stack, 31.0, 200.0)).all()


def test_a_pinhole_larger_than_the_window_is_refused() -> None:
    with pytest.raises(InputError, match="pinhole"):
        metrics.pinhole_efficiency(_gaussian(np.ones(1)), 500.0)


def test_peaks_and_their_ratio() -> None:
    stack, ideal = _gaussian(np.array([0.6, 0.3])), _gaussian(np.array([0.8, 0.6]))
    assert metrics.relative_peak(stack, ideal) == pytest.approx(np.tile([0.75, 0.5], (2, 1)), rel=1e-6)
    with pytest.raises(InputError, match="depths"):
        metrics.relative_peak(stack, _gaussian(np.ones(3)))


def test_the_depth_of_field_is_read_between_depths() -> None:
    """Vergences 4, 3.5, 3, 2.5, 2 dioptre; 0.8 is crossed half way to either neighbour of the brightest."""
    stack = _gaussian(np.array([0.2, 0.6, 1.0, 0.6, 0.2]))
    assert metrics.depth_of_field_dioptre(stack) == pytest.approx([0.5, 0.5], rel=1e-6)


def test_rotation_counts_whole_turns() -> None:
    stack = replace(_gaussian(np.ones(4)), phi_deg=np.array([100.0, -160.0, -50.0, 80.0]))
    assert metrics.rotation_deg(stack) == pytest.approx(340.0)
