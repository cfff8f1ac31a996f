"""Depths of segments that are measured again."""

from __future__ import annotations

import numpy as np

from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.segmentation.assignment import measured_again
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
