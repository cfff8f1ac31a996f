"""Planes across the stripes that layers cut a tilted surface into."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.planes import Cells, Plane, cell_side
from metafab.decode.segmentation.segments import Regions, SegmentDepth
from metafab.decode.segmentation.surfaces import layer_separation_per_m, planes_across

NODES = np.linspace(1.5, 3.5, 13)
SHAPE = (96, 120)


def volume_of(vergence: np.ndarray, noise: float = 0.0) -> CostVolume:
    """Twins whose correlation is 0.9 at the true vergence and falls as a parabola."""
    rho = 0.9 - 0.4 * (NODES[:, None, None] - vergence) ** 2
    rho = rho + noise * np.random.default_rng(1).normal(size=rho.shape)
    return CostVolume(NODES, np.stack([rho, np.ones_like(rho), np.ones_like(rho)]).astype(np.float32), 0.5, 1.0)


def test_stripes_of_one_surface_become_a_plane_and_what_stands_before_it_stays() -> None:
    surface = Plane(2.4, (6e-3, 1e-3), (48.0, 60.0))
    picture = surface.over(SHAPE).copy()
    picture[30:70, 70:100] = 3.2
    volume = volume_of(picture, noise=1e-3)
    step = layer_separation_per_m(volume)
    stripes = np.unique(np.round(picture / (2.0 * step)), return_inverse=True)
    label = (stripes[1].reshape(SHAPE) + 1).astype(np.int32)
    depths = tuple(
        SegmentDepth(float(at), 1e-3, 0.9, 1.0, Plane(float(at))) for at in stripes[0].astype(float) * 2.0 * step
    )
    everywhere = np.ones(SHAPE, dtype=bool)
    pixels = PixelDepth(picture, np.full(SHAPE, 2e-3), everywhere)
    cells, regions = Cells.of(volume, everywhere, 3), Regions(len(depths), depths, label, label, label)
    planes = planes_across(cells, cell_side(3), step, pixels, regions)
    assert len(depths) > 4
    assert len(planes) == 2
    assert np.abs(planes[0].over(SHAPE) - surface.over(SHAPE)).max() < 0.3 * step
    assert not planes[1].tilted
    assert planes[1].vergence_per_m == pytest.approx(3.2, abs=step)
