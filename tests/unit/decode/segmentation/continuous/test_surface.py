"""Surface of twins whose energies are known, and prices of jumps of depth by the sharp light."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.continuous.surface import (
    gradient_coherence,
    jump_prices,
    matched_surface,
)

NODES = np.linspace(1.5, 4.0, 13)
SHAPE = (50, 70)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)


def twins(vergence: np.ndarray, energy: np.ndarray, chance: np.ndarray) -> tuple[Any, CostVolume]:
    """Twins of an energy in variances of noise that are equal at a vergence, and unlike 0.4 / m away.

    ``chance``, shape (13, n_y, n_x), is added to their product.
    """
    rho = np.exp(-0.5 * ((NODES[:, None, None] - vergence) / 0.4) ** 2)
    square = np.broadcast_to(energy + 1.0, rho.shape)
    prepared: Any = SimpleNamespace(downsampling=SimpleNamespace(step=3), variance=np.ones((2, *vergence.shape)))
    return prepared, CostVolume(NODES, np.stack([energy * rho + chance, square, square]).astype(np.float32), 0.5, 1.0)


def test_a_steep_surface_with_a_jump_has_its_depths() -> None:
    true = np.where(COLUMN < 40, 2.0 + 0.02 * ROW, 3.4)
    chance = 0.3 * np.random.default_rng(1).normal(size=(13, *SHAPE))
    found = matched_surface(*twins(true, np.full(SHAPE, 40.0), chance))
    # Levels stand 0.052 / m apart: half a one at most is lost, as by rounding, and half of that in the median.
    away = np.abs(found.vergence_per_m - true)
    inside = (np.abs(COLUMN - 39.5) > 3) & (ROW > 3) & (ROW < 46)
    assert away[inside].max() < 0.026 and np.median(away) < 0.013
    assert (away > 0.1).mean() < 0.02  # within a pixel of the outline
    assert not found.plain.any() and found.margin[inside].min() > 0.0
    # The window at the outline holds both sides, the best window one.
    beside = np.abs(COLUMN - 39.5) < 1
    assert found.best_misfit[beside].mean() < found.misfit[beside].mean() - 0.5


def test_a_plain_part_takes_the_depth_around_it_though_chance_prefers_another() -> None:
    energy = np.where((np.abs(ROW - 25) < 10) & (np.abs(COLUMN - 35) < 10), 0.0, 40.0)
    chance = 0.3 * np.random.default_rng(1).normal(size=(13, *SHAPE))
    chance[0] += np.where(energy > 0.0, 0.0, 0.5)  # at the farthest depth, noise is half as large
    found = matched_surface(*twins(np.full(SHAPE, 2.9), energy, chance))
    np.testing.assert_allclose(found.vergence_per_m, 2.9, rtol=0.03)
    inner = (np.abs(ROW - 25) < 7) & (np.abs(COLUMN - 35) < 7)
    assert found.plain[inner].all() and not found.plain[energy > 0.0].any()


def test_jumps_are_cheap_across_edges_of_the_light_alone() -> None:
    light = np.full((2, 12, 16), 1000.0, dtype=np.float32)
    light[:, :, 9:] = 3000.0
    prices = jump_prices(light)
    along_y, along_x = prices
    even = float(along_y[0, 0])
    assert (along_y == even).all() and (np.delete(along_x, 8, axis=1) == even).all()
    # A change of the logarithm by 1 leaves the least price.
    assert along_x[:, 8] == pytest.approx(0.1 * even, rel=0.1)
    # An edge is one whatever the brightness, and fainter where one image alone has it.
    assert jump_prices(10.0 * light) == pytest.approx(prices, rel=1e-5)
    light[1] = 1000.0
    assert (along_x[:, 8] < jump_prices(light)[1, :, 8]).all() and (jump_prices(light)[1, :, 8] < even).all()


def test_dark_pixels_have_no_infinite_edges() -> None:
    light = np.zeros((2, 6, 6), dtype=np.float32)
    assert np.isfinite(jump_prices(light)).all()
    light[:, 3:] = 100.0
    assert np.isfinite(jump_prices(light)).all()


def test_coherence_is_that_of_texture_in_both_images() -> None:
    rng = np.random.default_rng(3)
    texture, noise = 300.0 * rng.normal(size=SHAPE), 30.0 * rng.normal(size=(2, *SHAPE))
    # The left half shows a texture, twice as bright in one image; the right half noise alone.
    light = np.array([2.0, 1.0])[:, None, None] * (2000.0 + np.where(COLUMN < 35, texture, 0.0)) + noise
    coherence = gradient_coherence(light.astype(np.float32))
    left, right = coherence[:, :32], coherence[:, 38:]
    # Noise has a hundredth of the texture's variance in one image, a four-hundredth in the other: 1 - 0.006.
    assert left.mean() == pytest.approx(0.994, abs=0.003)
    # Two gradients at nine pixels that overlap: fewer than 18 independent samples.
    assert abs(right.mean()) < 0.03 and right.std() < 0.4
    assert np.isfinite(gradient_coherence(np.zeros((2, 6, 6), dtype=np.float32))).all()
