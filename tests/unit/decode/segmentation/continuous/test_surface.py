"""Prices of jumps of depth by the sharp light."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.segmentation.continuous.surface import jump_prices


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
