"""Rendered objects: their area and their steps of depth."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.camera.rendering.render import Renderer, largest_slope, supersampled
from metafab.core.conventions import FloatArray
from metafab.spec import Scene, SceneObject


def grid(count: int = 64, half: float = 0.05) -> tuple[FloatArray, FloatArray]:
    tangent = -np.linspace(-half, half, count)  # images are inverted
    x, y = np.meshgrid(tangent, tangent)
    return x, y


@pytest.mark.parametrize(("outline", "share"), [("rectangle", 1.0), ("ellipse", np.pi / 4.0)])
def test_coverage_is_the_area(outline: str, share: float) -> None:
    piece = SceneObject(depth_m=1.0, centre=(0.003, -0.002), size=(0.041, 0.0317), outline=outline)
    x, y = grid()
    (rendered,) = Renderer.of(Scene(objects=(piece,)), 0.1 / 63, 1).pieces(x, y)
    area = rendered.coverage.sum() * (0.1 / 63) ** 2
    # Exact for a rectangle; an ellipse's edge is taken as straight across a quarter of a pixel.
    assert area == pytest.approx(share * 0.041 * 0.0317, rel=1e-9 if outline == "rectangle" else 3e-3)


def test_slopes_within_a_part_of_a_grid_are_those_of_the_grid() -> None:
    """Of a distorted one, also at its edges."""
    x, y = grid(12)
    bent = x + 3.0 * x * y + 40.0 * y**3
    slopes = [np.abs(slope).max() for slope in np.gradient(bent)]
    assert [largest_slope(bent), largest_slope(bent.T)] == slopes
    fine = supersampled(bent, (slice(0, 12), slice(0, 12)))
    for rows, columns in ((slice(0, 5), slice(3, 12)), (slice(4, 5), slice(7, 9)), (slice(11, 12), slice(0, 1))):
        part = fine[2 * rows.start : 2 * rows.stop, 2 * columns.start : 2 * columns.stop]
        np.testing.assert_array_equal(supersampled(bent, (rows, columns)), part)


def test_a_tilted_piece_is_made_of_adjoining_steps() -> None:
    flat = SceneObject(depth_m=1.0, size=(0.06, 0.06))
    tilted = SceneObject(depth_m=1.0, size=(0.06, 0.06), tilt=(0.1, 0.0))
    x, y = grid()
    (one,), (many,) = (tuple(Renderer.of(Scene(objects=(o,)), 1e-3, 1).pieces(x, y)) for o in (flat, tilted))
    assert many.depth_m.size == 25
    assert many.depth_m[[0, -1]] == pytest.approx([0.952, 1.048])
    assert many.coverage.sum(axis=0) == pytest.approx(one.coverage[0], abs=1e-12)
    # Depth rises with x/z, and so falls along the columns of the inverted image.
    first = np.flatnonzero(many.coverage[0].sum(axis=0))
    last = np.flatnonzero(many.coverage[-1].sum(axis=0))
    assert first.min() > last.max()
