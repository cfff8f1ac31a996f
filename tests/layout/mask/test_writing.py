"""Trapezoids and shots against areas and counts by hand; order of the fields; drift between neighbours."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import mask
from metafab.layout import Assignment, Outline
from metafab.mask.writing import field_order, field_times, fracture
from metafab.spec import Copy, Design, Exposure
from tests.layout.conftest import sizes_at_sites

GAUSSIAN = Exposure(1000.0, 2.0, shot_pitch_nm=4.0)
SHAPED = Exposure(1000.0, 2.0, max_shot_um=0.15)


def test_rectangles_crosses_and_circles_are_cut_at_their_corners() -> None:
    """200 nm x 100 nm in half nanometres; a circle has one trapezoid fewer than its corners have heights."""
    size = np.array([[0, 0], [400, 200]])
    assert fracture(Outline("rectangle", 0.5).polygons(size), 0.5, GAUSSIAN).tolist() == [[0, 1], [0, 50 * 25]]
    assert fracture(Outline("rectangle", 0.5).polygons(size), 0.5, SHAPED).tolist() == [[0, 1], [0, 2]]
    trapezoids, _ = fracture(Outline("cross", 0.5).polygons(size), 0.5, GAUSSIAN)
    assert trapezoids.tolist() == [0, 3]
    circle = Outline("ellipse", 0.5)
    trapezoids, shots = fracture(circle.polygons(np.array([[0, 0], [400, 400]])), 0.5, GAUSSIAN)
    corners = circle.vertices(400, 400)
    assert trapezoids[1] == np.unique(corners[:, 1]).size - 1
    # The polygon is drawn around the circle of 200 nm, by at most 1 nm.
    assert math.pi * 100**2 / 16 <= shots[1] <= math.pi * 101**2 / 16 + 1
    _, none = fracture(circle.polygons(size), 0.5, Exposure(1000.0, 2.0))
    assert none.tolist() == [0, 0]


@pytest.mark.parametrize("order", ["rows", "serpentine", "spiral", "inwards"])
def test_each_filled_field_is_written_once(order: str) -> None:
    filled = np.ones((4, 5), dtype=bool)
    filled[0, 0] = filled[3, 4] = False
    places = field_order(filled, order)
    assert sorted(map(tuple, places.tolist())) == sorted(
        zip(*(axis.tolist() for axis in np.nonzero(filled)), strict=True)
    )


def test_orders_are_what_they_are_called() -> None:
    filled = np.ones((3, 3), dtype=bool)
    assert field_order(filled, "rows").tolist() == [[r, c] for r in range(3) for c in range(3)]
    assert field_order(filled, "serpentine")[3:6].tolist() == [[1, 2], [1, 1], [1, 0]]
    assert field_order(filled, "spiral")[0].tolist() == field_order(filled, "inwards")[-1].tolist() == [1, 1]


def test_drift_between_neighbours_by_hand() -> None:
    """Three fields of 60 s in a column at 6 nm a minute: neighbours are 6 nm apart; two columns by rows, 6 and 12."""
    exposure = Exposure(1.0, 1.0, field_order="rows", drift_nm_per_min=6.0)
    column = field_times(exposure, [np.full((3, 1), 60.0)], [np.zeros((3, 1, 2))])
    assert column.drift_nm.tolist() == pytest.approx([3.0, 9.0, 15.0])
    assert column.stitching_nm == pytest.approx((6.0, 6.0))
    square = field_times(exposure, [np.full((2, 2), 60.0)], [np.zeros((2, 2, 2))])
    assert square.stitching_nm == pytest.approx((math.sqrt((6**2 + 6**2 + 12**2 + 12**2) / 4), 12.0))
    two = field_times(exposure, [np.full((1, 1), 60.0)] * 2, [np.zeros((1, 1, 2))] * 2)
    assert two.stitching_nm == (0.0, 0.0)
    assert two.start_s.tolist() == [0.0, 60.0]


def test_times_of_fields_add_up_to_those_of_the_file(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    """Shots, charge and settling from the arrays alone; doses of copies count; ``fields.csv`` sums to the same."""
    exposure = Exposure(
        800.0, 2.0, settle_shape_us=0.5, settle_field_ms=40.0, shot_pitch_nm=2.0, clock_mhz=20.0, drift_nm_per_min=3.0
    )
    copies = (Copy((0.0, 0.0)), Copy((60.0, 0.0), dose=1.5, bias_nm=-10.0, focus_um=0.5))
    options = replace(tiny_design.mask, exposure=exposure, copies=copies, write_field_um=11.9)
    mask.write(tiny.pillars, tmp_path, replace(tiny_design, mask=options))
    told = json.loads((tmp_path / "layout.json").read_text())
    size = sizes_at_sites(tiny.pillars)[..., :] * 0.5
    size = size[size[..., 0] > 0]
    time = told["exposure"]
    shots = int(np.ceil(size.prod(axis=-1) / 4.0).sum())
    areas_um2 = [float((size - bias).prod(axis=-1).sum()) * 1e-6 for bias in (0.0, 10.0)]
    second = round(shots * areas_um2[1] / areas_um2[0])
    assert time["shots"] == shots + second
    assert time["trapezoids"] == time["shapes"] == 2 * len(size)
    charge_s = [800.0 * dose * area * 1e-8 / 2e-3 for dose, area in zip((1.0, 1.5), areas_um2, strict=True)]
    # A shot takes 16 ns at the base dose, less than the clock's 50 ns.
    assert charge_s[0] < shots / 20e6
    beam_s = sum(max(pair) for pair in zip(charge_s, (shots / 20e6, second / 20e6), strict=True))
    assert time["beam_seconds"] == pytest.approx(beam_s, rel=1e-6)
    rows = list(csv.DictReader((tmp_path / "fields.csv").open(encoding="utf-8")))
    assert len(rows) == time["fields"] == 2 * 15  # Four by four, of which one corner lies beyond the circle.
    assert sum(float(row["seconds"]) for row in rows) == pytest.approx(time["seconds"], rel=1e-4)
    starts = [float(row["start_s"]) for row in rows]
    assert starts == sorted(starts)
    assert {row["lens"] for row in rows} == {"1", "2"}
    assert max(float(row["x_um"]) for row in rows) == pytest.approx(60.0 + 15.75, abs=3.0)
    assert 0.0 < time["stitching_rms_nm"] <= time["stitching_max_nm"]
    assert told["copies"][1]["focus_um"] == 0.5
    # Without an exposure the tables of an earlier call go.
    mask.write(tiny.pillars, tmp_path, tiny_design)
    assert not list(tmp_path.glob("*.csv"))


def test_a_machine_has_one_kind_of_beam() -> None:
    with pytest.raises(ValueError, match="not both"):
        Exposure(1.0, 1.0, shot_pitch_nm=4.0, max_shot_um=1.0)
    with pytest.raises(ValueError, match="clock_mhz"):
        Exposure(1.0, 1.0, clock_mhz=20.0)
