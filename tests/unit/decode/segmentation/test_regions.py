"""Segments of a frame: bands of tilted ones, and planes across stripes."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.matching.cost_volume import CostVolume
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.fit import Misfit
from metafab.decode.segmentation.planes import Cells, Plane, cell_side
from metafab.decode.segmentation.regions import (
    foreign_light,
    layer_separation_per_m,
    planes_across,
)
from metafab.decode.segmentation.segments import Regions, SegmentDepth

NODES = np.linspace(1.5, 3.5, 13)
SHAPE = (96, 120)


def volume_of(vergence: np.ndarray, noise: float = 0.0) -> CostVolume:
    """Twins whose correlation is 0.9 at the true vergence and falls as a parabola."""
    rho = 0.9 - 0.4 * (NODES[:, None, None] - vergence) ** 2
    rho = rho + noise * np.random.default_rng(1).normal(size=rho.shape)
    return CostVolume(NODES, np.stack([rho, np.ones_like(rho), np.ones_like(rho)]).astype(np.float32), 0.5, 1.0)


def test_bands_of_a_tilted_segment_hold_its_depth() -> None:
    label = np.ones((40, 60), dtype=np.int32)
    label[:, 40:] = 2
    road, wall = Plane(2.4, (5e-3, 0.0), (20.0, 20.0)), Plane(3.0)
    depths = tuple(SegmentDepth(p.vergence_per_m, 1e-3, 0.9, 1.0, p) for p in (road, wall))
    regions = Regions(2, depths, label, label, label)
    bands, vergence = regions.bands(label, 0.04)
    assert np.abs(vergence[bands - 1] - regions.vergence_per_m(label)).max() <= 0.02 + 1e-12
    assert vergence.size == 7  # 0.2 over 40 rows, and the wall
    flat = Regions(1, depths[1:], label, label, label)
    np.testing.assert_array_equal(flat.bands(label, 0.04)[0], label)


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
    planes = planes_across(cells, cell_side(3), volume, pixels, regions)
    assert len(depths) > 4
    assert len(planes) == 2
    assert np.abs(planes[0].over(SHAPE) - surface.over(SHAPE)).max() < 0.3 * step
    assert not planes[1].tilted
    assert planes[1].vergence_per_m == pytest.approx(3.2, abs=step)


def test_only_surfaces_wider_than_a_window_have_outlines_that_excuse_light() -> None:
    """Light of another depth beside a narrow bar stands in the wall; that beside a wide object is the object's."""
    label = np.ones(SHAPE, dtype=np.int32)
    label[:, 20:24], label[:, 80:] = 2, 3
    depths = tuple(SegmentDepth(one, 1e-3, 0.9, 1.0, Plane(one)) for one in (1.7, 3.0, 3.4))
    misfit = Misfit(np.full(SHAPE, 20.0, dtype=np.float32), np.full(SHAPE, 0.2, dtype=np.float32), 0.01)
    foreign = foreign_light(Regions(3, depths, label, label, label), misfit, 3)
    assert foreign[:, :20].all() and foreign[:, 24:70].all()
    assert not foreign[:, 20:24].any() and not foreign[:, 75:85].any()
    assert foreign[:, 90:].all()
