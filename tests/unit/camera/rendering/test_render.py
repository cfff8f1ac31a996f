"""Rendered objects: their area and their steps of depth."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.camera.rendering.render import Renderer
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
