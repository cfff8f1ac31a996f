"""Bars of the loss chain."""

from __future__ import annotations

from metafab.report.accounts import Stage
from metafab.report.figures.accounts import loss_chain
from metafab.report.style import panel


def test_each_stage_names_its_factor_but_the_first() -> None:
    _, axes = panel()
    loss_chain([Stage("at the aperture", 1.0), Stage("through the pillars", 0.8), Stage("in the window", 0.6)], axes)
    texts = [text.get_text() for text in axes.texts]
    assert "100.0 %" in texts
    assert "80.0 %  × 0.800" in texts
    assert "60.0 %  × 0.750" in texts
