"""Pillars on the page have the outlines of the file."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.layout.outlines import Outline, Shape
from metafab.report.figures import mask as figures
from metafab.report.style import panel


@pytest.mark.parametrize("shape", ["rectangle", "ellipse", "cross"])
def test_mask_zoom_draws_the_outlines_of_the_file(shape: Shape) -> None:
    outline = Outline(shape, 0.5)
    pillars = np.array([[0.0, 0.0, 0.2, 0.1], [0.35, -0.35, 0.12, 0.12]])
    _, axes = panel((3.0, 3.0))
    figures.pillar_outlines(pillars, axes, "Single pillars", outline=outline, label_nearest=True)
    drawn, *_ = (patch.get_path() for patch in axes.patches)
    expected = [outline.vertices(400, 200) * 5e-4, outline.vertices(240, 240) * 5e-4 + [0.35, -0.35]]
    assert np.allclose(drawn.vertices, np.concatenate(expected), atol=1e-12)
    assert axes.get_title(loc="right") in {"200 × 100 nm", "Ø 120 nm" if shape == "ellipse" else "120 × 120 nm"}
