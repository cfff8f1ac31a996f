"""Depths of segments that are measured again, and depths that lie in their layers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.assignment import Segmentation, measured_again, measured_depth
from metafab.decode.segmentation.planes import Cells, Plane
from metafab.decode.segmentation.segments import SegmentDepth

NODES = np.linspace(1.5, 3.5, 13)
SHAPE = (48, 48)


def test_a_tilted_segment_keeps_its_tilt_where_no_cell_is_a_quarter_full() -> None:
    """A strip of 3 pixels fills at most a quarter of a cell of 12: its twins summed without a tilt have one depth."""
    tilt = Plane(2.4, (0.0, 0.01), (24.0, 24.0))
    rho = 0.9 - 2.0 * (NODES[:, None, None] - tilt.over(SHAPE)) ** 2
    volume = CostVolume(NODES, np.stack([rho, np.ones_like(rho), np.ones_like(rho)]).astype(np.float32), 0.5, 1.0)
    strip = np.zeros(SHAPE, dtype=bool)
    strip[23:25] = True
    cells = Cells.of(volume, strip, 3)
    assert not cells.pixels.size
    before = SegmentDepth(2.4, 1e-3, 0.9, 1.0, tilt)
    again = measured_again(volume, cells, before, float(strip.sum()), 3)
    assert again.plane == tilt
    assert again.pixels == strip.sum()


@pytest.mark.parametrize("share", [0.2, 0.8])
def test_few_pixels_of_strong_texture_at_another_depth_do_not_move_a_segment_from_its_layer(share: float) -> None:
    """Bars before a wall: where they are few, the wall has its own depth; where they are most, the layer is not its."""
    layer, rng = Plane(2.0), np.random.default_rng(1)
    of_bars = rng.random(SHAPE) < share
    true, power = np.where(of_bars, 3.2, 2.0), np.where(of_bars, 20.0, 1.0)
    rho = power * np.exp(-0.5 * ((NODES[:, None, None] - true) / 0.6) ** 2)
    square = np.broadcast_to(power, rho.shape)
    volume = CostVolume(NODES, np.stack([rho, square, square]).astype(np.float32), 0.5, 1.0)
    pixels = PixelDepth(true, np.full(SHAPE, 3e-3), np.ones(SHAPE, dtype=bool))
    prepared: Any = SimpleNamespace(downsampling=SimpleNamespace(step=3))
    segmentation = Segmentation(prepared, volume, pixels, 0.1)
    whole = measured_depth(volume, Cells.of(volume, np.ones(SHAPE, dtype=bool), 3), layer)
    assert whole is not None and whole.vergence_per_m > 2.5 and not segmentation.holds(layer, whole)
    found = segmentation.in_layer(layer, np.ones(SHAPE, dtype=bool))
    if share > 0.5:
        assert found is None
    else:
        # Nodes stand 0.17 / m apart, and the spline between them is good to a hundredth of that.
        assert found is not None and abs(found.vergence_per_m - 2.0) < 2e-3
        assert segmentation.holds(layer, found)
