"""Planted faults of every kind are found in the written file, by both engines where both can see them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from metafab import drc
from metafab.core.parallel.work import Work
from metafab.drc.polygons import check_polygons
from metafab.layout import Assignment
from metafab.spec import Design

kdb = pytest.importorskip("klayout.db")

FORMATS = ("gds", "oas")
PERIOD = 700  # dbu


@dataclass
class Plant:
    """A flat copy of the tiny lens in which shapes can be moved about."""

    layout: kdb.Layout
    shapes: kdb.Shapes
    x_dbu: np.ndarray
    y_dbu: np.ndarray

    def at(self, row: int, column: int) -> kdb.Shape:
        """The pillar at a site."""
        x, y = int(self.x_dbu[column]), int(self.y_dbu[row])
        (shape,) = self.shapes.each_touching(kdb.Box(x, y, x, y))
        return shape

    def resize(self, row: int, column: int, width: int, length: int) -> None:
        x, y = int(self.x_dbu[column]), int(self.y_dbu[row])
        self.at(row, column).box = kdb.Box(x - width // 2, y - length // 2, x + width // 2, y + length // 2)


@pytest.fixture
def plant(tiny: Assignment, tiny_files: dict[str, Path]) -> Plant:
    layout = kdb.Layout()
    layout.read(str(tiny_files["oas"]))
    layout.flatten(layout.top_cell().cell_index(), -1, True)
    shapes = layout.top_cell().shapes(layout.layer(1, 0))
    for row in (40, 41):  # the sites that faults are planted at start from one calm size
        for column in (40, 41, 42):
            Plant(layout, shapes, tiny.pillars.lattice.x_dbu(), tiny.pillars.lattice.y_dbu()).resize(
                row, column, 300, 300
            )
    return Plant(layout, shapes, tiny.pillars.lattice.x_dbu(), tiny.pillars.lattice.y_dbu())


def _narrow(plant: Plant) -> None:
    plant.resize(40, 40, 198, 300)


def _short(plant: Plant) -> None:
    plant.resize(40, 40, 300, 198)


def _near_beside(plant: Plant) -> None:
    plant.resize(40, 40, 502, 300)
    plant.resize(40, 41, 502, 300)


def _near_above(plant: Plant) -> None:
    plant.resize(40, 40, 300, 502)
    plant.resize(41, 40, 300, 502)


def _near_diagonal(plant: Plant) -> None:
    # Corners at (138, 140): 196.6 units apart, less than 200, while beside and above there is room.
    for row, column, width, length in ((40, 40, 562, 560), (41, 41, 562, 560)):
        plant.resize(row, column, width, length)
    for row, column in (
        (39, 39),
        (39, 40),
        (39, 41),
        (40, 39),
        (41, 40),
        (40, 41),
        (41, 42),
        (42, 40),
        (42, 41),
        (42, 42),
    ):
        plant.resize(row, column, 200, 200)
    plant.resize(42, 40, 200, 200)


def _overlapping(plant: Plant) -> None:
    plant.resize(40, 40, 700, 300)
    plant.resize(40, 41, 700, 300)


def _twice(plant: Plant) -> None:
    plant.shapes.insert(plant.at(40, 40).box)


def _gone(plant: Plant) -> None:
    plant.at(40, 40).delete()


def _shifted(plant: Plant) -> None:
    plant.at(40, 40).transform(kdb.Trans(2, 0))


def _too_large(plant: Plant) -> None:
    plant.resize(40, 40, 720, 300)


def _outside(plant: Plant) -> None:
    x, y = int(plant.x_dbu[0]), int(plant.y_dbu[0])
    plant.shapes.insert(kdb.Box(x - 150, y - 150, x + 150, y + 150))


def _polygon(plant: Plant) -> None:
    box = plant.at(40, 40).box
    plant.at(40, 40).delete()
    corners = [kdb.Point(box.left, box.bottom), kdb.Point(box.left, box.top), kdb.Point(box.right, box.bottom)]
    plant.shapes.insert(kdb.Polygon(corners))


# Fault -> what the lattice engine must count, and what KLayout's engine must at least see.
FAULTS: dict[str, tuple[Callable[[Plant], None], dict[str, int], set[str]]] = {
    "narrow": (_narrow, {"min_width": 1}, {"min_width"}),
    "short": (_short, {"min_length": 1}, {"min_length"}),
    "near beside": (_near_beside, {"min_gap": 1}, {"min_gap"}),
    "near above": (_near_above, {"min_gap": 1}, {"min_gap"}),
    "near diagonal": (_near_diagonal, {"min_gap": 1}, {"min_gap"}),
    "overlapping": (_overlapping, {"min_gap": 3, "overlap": 1}, set()),
    "twice": (_twice, {"duplicate": 1, "overlap": 1}, {"overlap"}),
    "gone": (_gone, {"missing": 1}, set()),
    "shifted": (_shifted, {"lattice_site": 1, "missing": 1}, set()),
    "too large": (_too_large, {"lattice_site": 1, "missing": 1}, {"min_gap"}),
    "outside": (_outside, {"aperture": 1}, set()),
    "polygon": (_polygon, {"foreign": 1, "missing": 1}, {"foreign"}),
}


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_found(fault: str, suffix: str, plant: Plant, tiny_design: Design, tmp_path: Path) -> None:
    act, expected, _ = FAULTS[fault]
    act(plant)
    path = tmp_path / f"planted.{suffix}"
    plant.layout.write(str(path))
    report = drc.check(path, tiny_design)
    found = {rule: count for rule, count in report.violations.items() if count}
    if fault == "overlapping":  # touching neighbours are also too near to others
        assert found["overlap"] == 1
        assert found["min_gap"] >= 1
    else:
        assert found == expected
    assert set(report.markers) == set(found)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("fault", FAULTS)
def test_the_rectangles_engine_counts_what_needs_no_lattice(
    fault: str, suffix: str, plant: Plant, tiny_design: Design, tmp_path: Path
) -> None:
    """What stands on sites is counted as the lattice engine counts it."""
    act, _, _ = FAULTS[fault]
    act(plant)
    path = tmp_path / f"planted.{suffix}"
    plant.layout.write(str(path))
    report = drc.check(path, tiny_design, engine="rectangles", work=Work(2))
    on_lattice = drc.check(path, tiny_design)
    assert report.pillars == on_lattice.pillars
    found = {rule: count for rule, count in report.violations.items() if count}
    needs_lattice = {"missing", "lattice_site", "aperture"}
    # Off its site, a rectangle is no pillar that has neighbours to the lattice engine.
    if fault == "twice":
        assert found == {"min_gap": 1, "overlap": 1, "duplicate": 1}
    elif fault == "shifted":
        assert found == {}
    elif fault == "too large":
        assert set(found) == {"min_gap"}
    else:
        on_sites = {rule: count for rule, count in on_lattice.violations.items() if count}
        assert found == {rule: count for rule, count in on_sites.items() if rule not in needs_lattice}
        assert report.min_gap_nm == pytest.approx(on_lattice.min_gap_nm, abs=1e-9)
    assert set(report.markers) == set(found)


def test_rectangles_of_any_lattice_against_all_pairs(tiny_design: Design, tmp_path: Path) -> None:
    """Random rectangles in no order, some larger than a row, against a plain comparison of all pairs."""
    rng = np.random.default_rng(3)
    corner, size = rng.integers(-9000, 9000, (400, 2)), rng.integers(150, 600, (400, 2))
    size[:3] = [[5000, 210], [300, 4000], [1500, 1500]]
    corner[10], size[10] = corner[11], size[11]
    layout = kdb.Layout()
    layout.dbu = 0.0005
    shapes = layout.create_cell("ANY").shapes(layout.layer(1, 0))
    for (x, y), (width, length) in zip(corner.tolist(), size.tolist(), strict=True):
        shapes.insert(kdb.Box(x, y, x + width, y + length))
    path = tmp_path / "any.gds"
    layout.write(str(path))
    report = drc.check(path, tiny_design, engine="rectangles", work=Work(2))
    low, high = corner, corner + size
    gap = np.maximum(low[:, None] - high[None, :], low[None, :] - high[:, None])
    distance = np.sqrt(np.sum(np.maximum(gap, 0) ** 2, axis=-1))
    pair = np.triu(np.ones((400, 400), dtype=bool), 1)
    assert report.violations["min_gap"] == np.count_nonzero(pair & (distance < 200))
    assert report.violations["overlap"] == np.count_nonzero(pair & (gap.max(axis=-1) <= 0))
    assert report.violations["duplicate"] == 1
    assert report.violations["min_width"] == np.count_nonzero(size[:, 0] < 200)
    assert report.violations["min_length"] == np.count_nonzero(size[:, 1] < 200)


@pytest.mark.parametrize("fault", [name for name, (_, _, seen) in FAULTS.items() if seen])
def test_klayout_agrees_where_it_can_see(fault: str, plant: Plant, tiny_design: Design, tmp_path: Path) -> None:
    act, _, seen = FAULTS[fault]
    act(plant)
    path = tmp_path / "planted.gds"  # from OASIS, KLayout reads two copies at one place of a repetition as one
    plant.layout.write(str(path))
    report = drc.check(path, tiny_design, engine="polygons", work=Work(2))
    assert seen <= {rule for rule, count in report.violations.items() if count}


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_mask_itself_is_clean(
    suffix: str, tiny: Assignment, tiny_design: Design, tiny_files: dict[str, Path]
) -> None:
    for engine in ("lattice", "rectangles", "polygons"):
        report = drc.check(tiny_files[suffix], tiny_design, engine=engine, work=Work(2))
        assert report.clean
        assert report.violations.keys() <= drc.RULES.keys()
        assert report.pillars == tiny.figures.pillars
    assert drc.check(tiny_files[suffix], tiny_design).min_gap_nm == tiny.figures.min_gap_nm


def test_edges_off_the_grid_are_found(plant: Plant, tiny_design: Design, tmp_path: Path) -> None:
    """A file in units of 0.1 nm, in which one pillar is 0.1 nm too wide to either side."""
    options = kdb.SaveLayoutOptions()
    options.format = "OASIS"
    options.dbu = 0.0001
    fine, path = tmp_path / "fine.oas", tmp_path / "off.oas"
    plant.layout.write(str(fine), options)
    layout = kdb.Layout()
    layout.read(str(fine))
    shapes = layout.top_cell().shapes(layout.layer(1, 0))
    x, y = 5 * int(plant.x_dbu[40]), 5 * int(plant.y_dbu[40])
    (shape,) = shapes.each_touching(kdb.Box(x, y, x, y))
    shape.box = shape.box.enlarged(1, 0)
    layout.write(str(path))
    for engine in ("lattice", "rectangles", "polygons"):
        assert drc.check(fine, tiny_design, engine=engine, work=Work(2)).clean
        assert drc.check(path, tiny_design, engine=engine, work=Work(2)).violations["grid"] >= 1


def test_slender_pillars_are_found_where_the_rule_is_set(plant: Plant, tiny_design: Design, tmp_path: Path) -> None:
    """600 nm high: 6 to 1 allows sides of 100 nm. 99 nm stand at 6.06 to 1; drawn with 10 nm more, at 6.74 to 1."""
    plant.resize(40, 40, 300, 198)
    path = tmp_path / "slender.oas"
    plant.layout.write(str(path))
    assert "aspect_ratio" not in drc.check(path, tiny_design).violations
    rules = replace(tiny_design.rules, min_feature_nm=90.0, max_aspect_ratio=6.0)
    for engine in ("lattice", "rectangles", "polygons"):
        found = drc.check(path, replace(tiny_design, rules=rules), engine=engine, work=Work(2))
        assert {rule: count for rule, count in found.violations.items() if count} == {"aspect_ratio": 1}
        assert found.markers["aspect_ratio"][0].height_nm == 99.0
    biased = replace(tiny_design, rules=rules, mask=replace(tiny_design.mask, bias_nm=10.0))
    narrow = sum(min(size) < 220 for size in _drawn_sizes(plant))
    assert drc.check(path, biased).violations["aspect_ratio"] == narrow > 1


def _drawn_sizes(plant: Plant) -> list[tuple[int, int]]:
    return [(shape.box.width(), shape.box.height()) for shape in plant.shapes.each()]


def test_markers_stand_at_the_violation(plant: Plant, tiny_design: Design, tmp_path: Path) -> None:
    _narrow(plant)
    path = tmp_path / "planted.oas"
    plant.layout.write(str(path))
    lattice = drc.check(path, tiny_design)
    polygons = drc.check(path, tiny_design, engine="polygons", work=Work(1))
    (marker,) = lattice.markers["min_width"]
    expected = (plant.x_dbu[40] / 2 - 49.5, plant.y_dbu[40] / 2 - 75.0, 99.0, 150.0)
    assert (marker.x_nm, marker.y_nm, marker.width_nm, marker.height_nm) == pytest.approx(expected, abs=1e-9)
    assert polygons.markers["min_width"] == (marker,)


def test_reports_are_written_and_klayout_opens_them(plant: Plant, tiny_design: Design, tmp_path: Path) -> None:
    _near_beside(plant)
    path = tmp_path / "planted.oas"
    plant.layout.write(str(path))
    report = drc.check(path, tiny_design)
    json_path, database_path = drc.save([report], tmp_path, "helix_small")
    stored = json.loads(json_path.read_text())
    assert stored["planted.oas"]["violations"]["min_gap"] == 1
    rdb = pytest.importorskip("klayout.rdb")
    database = rdb.ReportDatabase("drc")
    database.load(str(database_path))
    assert database.num_items() == 1
    (item,) = database.each_item()
    assert database.category_by_id(item.category_id()).name() == "min_gap"
    (value,) = item.each_value()
    box = value.box()
    # The box spans both pillars: 350 nm from centre to centre and half a width of 251 nm at either end.
    assert box.width() == pytest.approx(0.601, abs=1e-9)


@pytest.mark.parametrize(("rule", "along_x"), [("min_gap", True), ("min_gap", False), ("overlap", True)])
def test_a_violation_on_a_seam_of_klayouts_tiles_is_counted_once(
    rule: str, along_x: bool, tiny_design: Design, tmp_path: Path
) -> None:
    """The same fault in the middle of a tile, on a seam and on a corner of four: one violation each time."""
    sites = 34
    counts = []
    for row, column in ((sites // 2, sites // 2), (sites - 1, sites - 1), (2 * sites - 1, sites - 1)):
        layout = kdb.Layout()
        layout.dbu = 0.5e-3
        shapes = layout.create_cell("TOP").shapes(layout.layer(1, 0))
        for i in range(3 * sites):
            for j in range(3 * sites):
                # Edges at the edges of cells, so that the engine's tiles begin at the first pillar's cell.
                shapes.insert(kdb.Box(j * PERIOD, i * PERIOD, j * PERIOD + 300, i * PERIOD + 300))
        here = kdb.Box(column * PERIOD, row * PERIOD, column * PERIOD + 300, row * PERIOD + 300)
        (shape,) = [s for s in shapes.each_touching(here) if s.bbox() == here]
        grown = {"min_gap": PERIOD - 150, "overlap": PERIOD + 50}[rule]
        across, along = (grown, 300) if along_x else (300, grown)
        shape.box = kdb.Box(here.left, here.bottom, here.left + across, here.bottom + along)
        layout.write(str(tmp_path / "seam.oas"))
        report = check_polygons(tmp_path / "seam.oas", tiny_design, Work(1), tile_um=sites * PERIOD * 0.5e-3)
        counts.append({name: count for name, count in report.violations.items() if count})
    assert counts[0][rule] == 1
    assert counts == [counts[0]] * 3
