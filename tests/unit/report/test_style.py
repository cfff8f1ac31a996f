"""Units of depths."""

from __future__ import annotations

import math

import pytest

from metafab.report.style import depth_text, depth_unit


@pytest.mark.parametrize(("depth_m", "unit"), [(0.0034, "mm"), (0.34, "cm"), (200.0, "m")])
def test_depths_are_shown_in_a_unit_that_suits_them(depth_m: float, unit: str) -> None:
    scale, name = depth_unit(depth_m)
    assert name == unit
    assert 1.0 <= scale * depth_m < 1000.0


def test_an_infinite_depth_has_a_sign_and_sets_no_unit() -> None:
    assert depth_text(math.inf) == "∞"
    assert depth_text(0.003) == "3 mm" and depth_unit([0.003, math.inf]) == (1e3, "mm")
