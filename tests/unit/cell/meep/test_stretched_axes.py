"""Averages on the walls of stretched axes."""

from __future__ import annotations

import pytest

from metafab.cell.meep.stretched_axes import Axis, stretched_blocks


def test_averages_on_a_wall_keep_a_plane_wave_whole() -> None:
    """Along z alone the stretched cell must be one medium: n^2 = eps~_xx mu~_yy / s_z^2 wherever E_x is sampled."""
    x = Axis((-6.0, -2.0, 2.0, 6.0), (1.1, 0.8, 1.1), (0, 1, 0))
    y = Axis((-6.0, -4.0, 4.0, 6.0), (1.4, 0.8, 1.4), (0, 1, 0))
    z = Axis((0.0, 4.0), (1.0,), (0,))
    uniform = {(i, j, 0): (3.0 + 0j,) * 3 for i in (0, 1) for j in (0, 1)}
    boxes = stretched_blocks((x, y, z), uniform, 1.0)
    assert len(boxes) == 25
    on_x_wall = [box for box in boxes if box.high[0] - box.low[0] == 0.5]
    assert len(on_x_wall) == 10
    for box in boxes:
        # E_x and H_y share their x (half a pixel off every wall), E_y and H_x their y.
        if box not in on_x_wall:
            assert box.epsilon[0] * box.mu[1] == pytest.approx(3.0)
    weight = y.node_stretch()
    assert weight[0] == pytest.approx(1.4)
    assert weight[2] == pytest.approx((1.4 + 0.8) / 2.0)
    assert weight.mean() == pytest.approx(1.0)
