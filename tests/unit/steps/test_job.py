"""Directions of the objects that slanting light comes from."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from metafab.core.errors import InputError
from metafab.spec import Design, Light
from metafab.steps.job import light_tangent


def test_light_refracts_into_the_air_and_its_object_stands_on_the_other_side(small_design: Design) -> None:
    light = Light(800.0, angle_x_deg=20.0)
    n = small_design.unit_cell.materials.substrate.n
    assert n is not None
    angle = math.asin(n * math.sin(math.radians(20.0)))
    assert light_tangent(small_design, light) == pytest.approx((-math.tan(angle), 0.0))
    from_air = replace(small_design.unit_cell.illumination, side="ambient")
    design = replace(small_design, unit_cell=replace(small_design.unit_cell, illumination=from_air))
    assert light_tangent(design, Light(800.0, angle_y_deg=-20.0)) == pytest.approx((0.0, math.tan(math.radians(20.0))))
    with pytest.raises(InputError, match=r"light\.angle_x_deg.*below 34\.\d+ deg in a medium of index 1\.76,"):
        light_tangent(small_design, replace(light, angle_x_deg=40.0))
