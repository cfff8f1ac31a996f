"""Quadrics through the depths of pixels, and what is none."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.robust_fits import curved_surface, simplest_surface
from metafab.decode.segmentation.segments import Regions, SegmentDepth


def measured(surface: np.ndarray, label: np.ndarray, depths: list[float]) -> tuple[Regions, PixelDepth]:
    """Segments of one depth each, and pixels at the vergences of a surface with errors of 0.3 %."""
    noise = np.random.default_rng(1).normal(0.0, 3e-3, surface.shape)
    pixels = PixelDepth(surface * (1.0 + noise), np.full(surface.shape, 3e-3), np.ones(surface.shape, dtype=bool))
    segments = tuple(SegmentDepth(v, 1e-3, 0.9, 1.0, Plane(v), 1.0) for v in depths)
    return Regions(len(depths), segments, label, label, label), pixels


@pytest.mark.parametrize("rings", [1, 3])
def test_a_quadric_is_found_whether_layers_cut_it_or_not(rings: int) -> None:
    true = Plane(2.5, (1e-3, -5e-4), (30.0, 45.0), (-8e-5, 3e-5, -6e-5))
    surface = true.over((60, 90))
    label = (
        (1 + np.argsort(np.argsort(surface.ravel())) * rings // surface.size).reshape(surface.shape).astype(np.int32)
    )
    depths = [float(surface[label == number].mean()) for number in range(1, rings + 1)]
    found = curved_surface(*measured(surface, label, depths), list(range(1, rings + 1)))
    assert found is not None and found.curved
    # 1350 fitted pixels of 0.3 %: 0.0002 of 2.5 / m on their mean, three times as much at corners.
    assert np.abs(found.over(surface.shape) - surface).max() < 2.5e-3


@pytest.mark.parametrize("kind", ["flat", "tilted", "stairs"])
def test_planes_and_stairs_are_no_quadric(kind: str) -> None:
    column = np.broadcast_to(np.arange(90.0), (60, 90))
    label = (1 + column // 30).astype(np.int32) if kind == "stairs" else np.ones((60, 90), dtype=np.int32)
    surface = {"flat": 2.5 + 0.0 * column, "tilted": 2.5 + 1e-3 * column, "stairs": 2.5 + 0.05 * (label - 1.0)}[kind]
    depths = [float(surface[label == number].mean()) for number in np.unique(label)]
    assert curved_surface(*measured(surface, label, depths), np.unique(label).tolist()) is None


def test_a_few_pixels_have_no_shape() -> None:
    surface = Plane(2.5, (0.0, 0.0), (5.0, 5.0), (-5e-3, 0.0, -5e-3)).over((10, 10))
    assert curved_surface(*measured(surface, np.ones((10, 10), dtype=np.int32), [2.4]), [1]) is None


def test_a_quadric_moves_with_its_picture() -> None:
    surface = Plane(2.5, (1e-3, -5e-4), (30.0, 45.0), (-8e-5, 3e-5, -6e-5))
    assert surface.moved(-10, -20).over((40, 50)) == pytest.approx(surface.over((60, 90))[10:50, 20:70])
    assert Plane(2.5, curvature_per_m=(1e-5, 0.0, 0.0)).tilted and not Plane(2.5, (1e-3, 0.0)).curved


@pytest.mark.parametrize(
    ("true", "tilted", "curved"),
    [
        (Plane(2.5), False, False),
        (Plane(2.5, (1e-3, 2e-3), (30.0, 45.0)), True, False),
        (Plane(2.5, (1e-3, 0.0), (30.0, 45.0), (-8e-5, 0.0, -6e-5)), True, True),
    ],
)
def test_the_simplest_surface_through_pixels_that_scatter_by_twice_their_error(
    true: Plane, tilted: bool, curved: bool
) -> None:
    surface = true.over((60, 90))
    noise = np.random.default_rng(3).normal(0.0, 6e-3, surface.shape)
    pixels = PixelDepth(surface * (1.0 + noise), np.full(surface.shape, 3e-3), np.ones(surface.shape, dtype=bool))
    found = simplest_surface(pixels, np.ones(surface.shape, dtype=bool))
    assert found is not None and (found.tilted, found.curved) == (tilted, curved)
    assert np.abs(found.over(surface.shape) - surface).max() < 6e-3
    assert simplest_surface(pixels, np.zeros(surface.shape, dtype=bool)) is None
