"""What each engine makes of files that other software wrote: foreign units, layers, kinds of shapes, repetitions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gdstk
import pytest

from metafab import drc, layout, mask
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.library import Library
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design

kdb = pytest.importorskip("klayout.db")

ENGINES = ("lattice", "rectangles", "polygons")


def _written(path: Path, draw: Callable[[kdb.Layout, kdb.Cell, kdb.Shapes], object], unit_nm: float = 0.5) -> Path:
    """A file of one top cell in which ``draw`` has drawn."""
    drawn = kdb.Layout()
    drawn.dbu = unit_nm * 1e-3
    top = drawn.create_cell("TOP")
    draw(drawn, top, top.shapes(drawn.layer(1, 0)))
    drawn.write(str(path))
    return path


@pytest.mark.parametrize(
    ("unit_nm", "left", "off"),
    # Edges are on the design's grid of 0.5 nm where they are multiples of 5, 5, 10 and 1 units of the file.
    [(0.2, 1000, 0), (0.2, 1002, 1), (0.4, 1000, 0), (0.4, 1001, 1), (0.35, 1000, 0), (0.35, 1005, 1), (1.0, 1001, 0)],
)
def test_the_grid_is_checked_in_units_that_do_not_divide_the_designs(
    unit_nm: float, left: int, off: int, tiny_design: Design, tmp_path: Path
) -> None:
    path = _written(tmp_path / "units.gds", lambda _1, _2, s: s.insert(kdb.Box(left, 0, left + 1000, 1000)), unit_nm)
    for engine in ("rectangles", "polygons"):
        found = drc.check(path, tiny_design, engine=engine, work=Work(1)).violations["grid"]
        assert bool(found) == bool(off), engine


@pytest.mark.parametrize(("gap", "side", "seen"), [(67, 300, set()), (66, 300, {"min_gap"}), (67, 66, {"min_width"})])
def test_limits_between_two_units_are_those_of_the_next(
    gap: int, side: int, seen: set[str], tiny_design: Design, tmp_path: Path
) -> None:
    """100 nm are 66.7 units of 1.5 nm: 66 are too few, whatever they would be rounded to."""
    coarse = replace(tiny_design.mask, database_unit_nm=1.5)
    design = replace(tiny_design, mask=coarse)

    def draw(_1: kdb.Layout, _2: kdb.Cell, shapes: kdb.Shapes) -> None:
        shapes.insert(kdb.Box(0, 0, side, 300))
        shapes.insert(kdb.Box(side + gap, 0, side + gap + 300, 300))

    path = _written(tmp_path / "limits.gds", draw, 1.5)
    fine = replace(design, rules=replace(design.rules, min_gap_nm=99.9, min_feature_nm=99.9))
    for chosen in (design, fine):
        for engine in ("rectangles", "polygons"):
            report = drc.check(path, chosen, engine=engine, work=Work(1))
            assert {rule for rule, count in report.violations.items() if count} == seen, engine


def test_equal_places_of_a_repetition_are_duplicates_to_every_engine(tiny_design: Design, tmp_path: Path) -> None:
    """KLayout's reader drops those that follow one another; the others overlap."""
    pitch = 0.35
    cell = gdstk.Cell("T")
    square = gdstk.rectangle((0.075, 0.075), (0.275, 0.275), layer=1)
    places = [(pitch * k, 0.0) for k in range(4)]
    square.repetition = gdstk.Repetition(offsets=[*places[1:], places[3]])
    cell.add(square)
    library = gdstk.Library(unit=1e-6, precision=5e-10)
    library.add(cell)
    path = tmp_path / "repeated.oas"
    library.write_oas(str(path))
    for engine in ENGINES:
        report = drc.check(path, tiny_design, engine=engine, work=Work(1))
        assert report.pillars == 5
        assert report.violations["duplicate"] == 1, engine


@pytest.mark.parametrize("engine", ["rectangles", "polygons"])
def test_a_file_without_pillars_is_refused_where_no_lattice_misses_them(
    engine: str, tiny_design: Design, tmp_path: Path
) -> None:
    def draw(drawn: kdb.Layout, top: kdb.Cell, shapes: kdb.Shapes) -> None:
        top.shapes(drawn.layer(7, 0)).insert(kdb.Box(0, 0, 300, 300))
        shapes.insert(kdb.Text("P", 0, 0))

    path = _written(tmp_path / "empty.gds", draw)
    with pytest.raises(InputError, match="shapes on layer 1/0"):
        drc.check(path, tiny_design, engine=engine)


def test_notes_of_klayout_are_no_top_cell(tiny_design: Design, tmp_path: Path) -> None:
    """As gdsfactory writes its chips."""

    def draw(drawn: kdb.Layout, _: kdb.Cell, shapes: kdb.Shapes) -> None:
        shapes.insert(kdb.Box(0, 0, 300, 300))
        drawn.add_meta_info(kdb.LayoutMetaInfo("author", "gdsfactory", persisted=True))

    path = _written(tmp_path / "chip.gds", draw)
    assert b"$$$CONTEXT_INFO$$$" in path.read_bytes()
    for engine in ENGINES:
        assert drc.check(path, tiny_design, engine=engine, work=Work(1)).pillars == 1, engine


@pytest.mark.parametrize("engine", ENGINES)
def test_two_top_cells_are_refused(engine: str, tiny_design: Design, tmp_path: Path) -> None:
    def draw(drawn: kdb.Layout, _: kdb.Cell, shapes: kdb.Shapes) -> None:
        shapes.insert(kdb.Box(0, 0, 300, 300))
        drawn.create_cell("MORE").shapes(drawn.layer(1, 0)).insert(kdb.Box(0, 0, 300, 300))

    path = _written(tmp_path / "two.gds", draw)
    with pytest.raises(InputError, match="2: 'MORE', 'TOP'"):
        drc.check(path, tiny_design, engine=engine)


@pytest.mark.parametrize("suffix", ["gds", "oas"])
@pytest.mark.parametrize("magnification", [1.0, 2.0])
def test_shapes_of_a_magnified_cell_are_counted_in_both_formats(
    magnification: float, suffix: str, tiny_design: Design, tmp_path: Path
) -> None:
    """Equal rectangles, which gdstk packs into one block of OASIS."""
    library, cell, top = gdstk.Library(unit=1e-6, precision=5e-10), gdstk.Cell("T"), gdstk.Cell("U")
    for x, y in ((0.0, 0.0), (0.35, 0.0), (0.7, 0.0), (1.05, 0.35)):
        cell.add(gdstk.rectangle((x + 0.125, y + 0.125), (x + 0.225, y + 0.225), layer=tiny_design.mask.layer))
    top.add(gdstk.Reference(cell, magnification=magnification))
    library.add(cell, top)
    path = tmp_path / f"magnified.{suffix}"
    (library.write_gds if suffix == "gds" else library.write_oas)(path)
    report = drc.check(path, tiny_design)
    assert report.violations["foreign"] == (0 if magnification == 1.0 else 4)


def test_a_mask_of_one_site_a_cell_is_checked_by_every_engine(
    profile: PhaseProfile, smooth_library: Library, tiny_design: Design, tmp_path: Path
) -> None:
    """Write fields of one period: thirteen thousand cells, which the time that a file may take counts."""
    period_um = 1e-3 * tiny_design.unit_cell.cell.period_nm[0]
    design = replace(tiny_design, mask=replace(tiny_design.mask, write_field_um=period_um))
    pillars = layout.assign(profile, smooth_library, design).pillars
    (path,) = (one.path for one in mask.write(pillars, tmp_path, design) if one.path.suffix == ".oas")
    assert not any(drc.check(path, design, engine="rectangles").violations.values())


def test_texts_and_other_layers_are_told_from_pillars_and_edges_are_foreign(
    tiny_design: Design, tmp_path: Path
) -> None:
    def draw(drawn: kdb.Layout, top: kdb.Cell, shapes: kdb.Shapes) -> None:
        shapes.insert(kdb.Box(50, 50, 650, 450))
        shapes.insert(kdb.Text("P", 0, 0))
        shapes.insert(kdb.Edge(5000, 0, 5400, 0))
        top.shapes(drawn.layer(7, 0)).insert(kdb.Box(0, 0, 300, 300))

    path = _written(tmp_path / "kinds.gds", draw)
    for engine in ENGINES:
        report = drc.check(path, tiny_design, engine=engine, work=Work(1))
        assert report.other_layers == {"1/0 text": 1, "7/0": 1}, engine
        assert report.violations["foreign"] == 1, engine
        assert report.violations["overlap"] == 0


def test_what_is_no_pillar_of_a_shaped_design_is_foreign(
    profile: PhaseProfile, smooth_library: Library, tiny_design: Design, tmp_path: Path
) -> None:
    """A triangle and a square among ellipses; both engines that know shapes count them alike."""
    cell = replace(tiny_design.unit_cell.cell, shape="ellipse")
    design = replace(
        tiny_design,
        unit_cell=replace(tiny_design.unit_cell, cell=cell),
        device=replace(tiny_design.device, aperture_um=5.0),
    )
    pillars = layout.assign(profile, replace(smooth_library, unit_cell=design.unit_cell), design).pillars
    mask.write(pillars, tmp_path, design)
    path = tmp_path / "layout.oas"
    assert drc.check(path, design, engine="polygons", work=Work(1)).violations["foreign"] == 0
    drawn = kdb.Layout()
    drawn.read(str(path))
    shapes = drawn.top_cell().shapes(drawn.layer(1, 0))
    shapes.insert(kdb.Box(20000, 0, 20300, 300))
    shapes.insert(kdb.Polygon([kdb.Point(30000, 0), kdb.Point(30000, 600), kdb.Point(30600, 0)]))
    drawn.write(str(path))
    for engine in ("lattice", "polygons"):
        report = drc.check(path, design, engine=engine, work=Work(1))
        assert report.violations["foreign"] == 2, engine


def test_the_smallest_gap_is_not_claimed_where_it_is_not_known(tiny_design: Design, tmp_path: Path) -> None:
    """Beyond the rule pairs are not looked for; beside a pillar off its site the lattice engine looks for none."""
    pair = _written(
        tmp_path / "pair.gds",
        lambda _1, _2, s: [s.insert(kdb.Box(x, y, x + 300, y + 300)) for x, y in ((0, 0), (510, 0), (0, 505))],
    )
    assert drc.check(pair, tiny_design, engine="rectangles").min_gap_nm is None
    assert drc.check(pair, tiny_design).min_gap_nm is None
    at_limit = _written(
        tmp_path / "limit.gds", lambda _1, _2, s: [s.insert(kdb.Box(x, 0, x + 300, 300)) for x in (0, 500, 1100)]
    )
    assert drc.check(at_limit, tiny_design, engine="rectangles").min_gap_nm == 100.0


@pytest.mark.parametrize(
    ("x", "y", "near", "overlapping"),
    # Beside, at the corner, and 100 nm less a unit along both axes; the first touch, the next overlap.
    [
        *((300, 0, 1, 1), (300, 300, 1, 1), (250, 100, 0, 1), (250, 250, 0, 1)),
        *((440, 440, 1, 0), (499, 40, 1, 0), (500, 0, 0, 0), (442, 442, 0, 0)),
    ],
)
def test_klayout_counts_a_pair_once_and_what_touches_overlaps(
    x: int, y: int, near: int, overlapping: int, tiny_design: Design, tmp_path: Path
) -> None:
    """Two squares of 300 units, 200 of which must lie between them; 142 each way are 200.8."""
    path = _written(
        tmp_path / "pair.gds",
        lambda _1, _2, s: [s.insert(kdb.Box(*a, a[0] + 300, a[1] + 300)) for a in ((0, 0), (x, y))],
    )
    found = {engine: drc.check(path, tiny_design, engine=engine, work=Work(1)) for engine in ("polygons", "rectangles")}
    assert found["polygons"].violations["overlap"] == found["rectangles"].violations["overlap"] == overlapping
    assert found["polygons"].violations["min_gap"] == near
    # What overlaps is too near to the other engine, too.
    assert found["rectangles"].violations["min_gap"] == max(near, overlapping)
