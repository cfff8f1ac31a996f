"""Test structures: their geometry by KLayout, pillars read as before, nothing touches, and refusals by name."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Literal

import gdstk
import numpy as np
import pytest

from metafab import drc, mask
from metafab.core.errors import InputError
from metafab.layout import Assignment
from metafab.spec import Chip, Copy, Design
from metafab.spec.mask import CdBars, Grating, Include, Kit, Overlay, Vernier
from metafab.steps.preflight import preflight
from tests.layout.conftest import sizes_at_sites

kdb = pytest.importorskip("klayout.db")

UM = 2000  # database units
CHIP = Chip(
    margin_um=60.0, mark_um=20.0, mark_line_um=2.0, frame_um=2.0, street_um=5.0,
    label="K-1", text_um=4.2, scale_bar_um=5.0,
)  # fmt: skip
KIT = Kit(
    cd_bars=(CdBars((-40.0, 0.0), (100.0, 151.0), length_um=6.0, lines=3, spacing_um=1.0),),
    verniers=(Vernier((0.0, 45.0), pitch_um=2.0, step_nm=25.0, teeth=5, tooth_um=(0.8, 4.0)),),
    gratings=(
        Grating((0.0, -33.0), (700.0,), (300.0,), (20.0, 10.0)),
        Grating((-45.0, -30.0), (350.0, 400.0), (150.0, 200.0), (7.0, 3.6)),
    ),
    overlays=(Overlay((45.0, 0.0), 20.0, 10.0, 2.0),),
    clear_um=1.5,
)
COPIES = (Copy((0.0, 0.0)), Copy((150.0, 0.0), dose=1.1))


@pytest.fixture(scope="module")
def chip(tiny_design: Design) -> Design:
    """Two lenses of different dose with all kinds of structures."""
    return replace(tiny_design, mask=replace(tiny_design.mask, chip=CHIP, kit=KIT, copies=COPIES))


@pytest.fixture(scope="module")
def files(tiny: Assignment, chip: Design, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("kit")
    return {file.path.suffix[1:]: file.path for file in mask.write(tiny.pillars, folder, chip)}


def _region(path: Path, *layers: tuple[int, int]) -> kdb.Region:
    opened = kdb.Layout()
    opened.read(str(path))
    (top,) = opened.top_cells()
    region = kdb.Region(kdb.RecursiveShapeIterator(opened, top, [opened.layer(*layer) for layer in layers]))
    return region.flatten()  # outlives the layout


def _within(region: kdb.Region, x_um: float, y_um: float, half_um: float) -> kdb.Region:
    box = [round(value * UM) for value in (x_um - half_um, y_um - half_um, x_um + half_um, y_um + half_um)]
    return region & kdb.Region(kdb.Box(*box))


@pytest.mark.parametrize("suffix", ["gds", "oas"])
def test_pillars_are_read_as_before_and_nothing_touches(
    suffix: str, files: dict[str, Path], tiny: Assignment, chip: Design
) -> None:
    for number in (1, 2):
        back = mask.read(files[suffix], chip, copy=number)
        assert np.array_equal(sizes_at_sites(back.pillars), sizes_at_sites(tiny.pillars))
        assert back.off_site.count == back.duplicates.count == 0
        assert sum(drc.check(files[suffix], chip, copy=number).violations.values()) == 0
    lenses = _region(files[suffix], (1, 0), (1, 1))
    assert lenses.count() == 2 * tiny.figures.pillars
    named = json.loads((files["gds"].parent / "layout.json").read_text())["beside"]
    layers = {name: _region(files[suffix], (int(key.split("/")[0]), 0)) for key, name in named.items()}
    windows = layers.pop("windows around marks")
    around = list(layers.items())
    # Both exposures meet in verniers, and the street begins at the frame.
    meeting = {("test structures of the first exposure", "test structures"), ("frame", "dicing street")}
    for here, (kind, region) in enumerate(around):
        # Shapes that touch along an edge or a corner interact, so that these do not even touch.
        assert region.interacting(lenses).is_empty()
        for name, other in around[here + 1 :]:
            assert (kind, name) in meeting or region.interacting(other).is_empty()
    assert windows.interacting(lenses).is_empty()
    first = layers["alignment marks"] + layers["test structures of the first exposure"]
    assert (first.sized(round(1.4 * UM)) - windows).is_empty()


def test_bars_have_their_widths_along_both_axes(files: dict[str, Path]) -> None:
    bars = _within(_region(files["gds"], (15, 0)), -40.0, 0.0, 12.0)
    sizes = sorted((p.bbox().width(), p.bbox().height()) for p in bars.each())
    expected = [(width, 6 * UM) for width in (200, 302) for _ in range(4)]
    assert sizes == sorted(expected + [(length, width) for width, length in expected])
    # Dense bars are as far apart as they are wide: growing by half a gap joins groups of three, not the single bar.
    joined = bars.sized(101).merged()
    assert joined.count() < bars.count()
    assert bars.space_check(199).count() == 0 and bars.space_check(201).count() > 0
    box = bars.bbox()
    assert abs(box.center().x + 40 * UM) <= 2 and abs(box.center().y) <= 2


def test_verniers_shift_by_one_step_a_tooth(files: dict[str, Path]) -> None:
    combs = [_within(_region(files["oas"], (layer, 0)), 0.0, 45.0, 16.0) for layer in (14, 15)]
    assert [comb.count() for comb in combs] == [10, 10]
    centres = []
    for comb in combs:
        upright = [p.bbox() for p in comb.each() if p.bbox().height() > p.bbox().width()]
        centres.append(sorted(box.center().x for box in upright))
    assert (np.array(centres[1]) - np.array(centres[0])).tolist() == [50 * k for k in (-2, -1, 0, 1, 2)]
    longest = max(p.bbox().height() for p in combs[0].each())
    assert longest == 6 * UM


def test_gratings_hold_whole_periods(files: dict[str, Path]) -> None:
    lines = _within(_region(files["gds"], (15, 0)), 0.0, -33.0, 11.0)
    assert lines.count() == 28
    assert {(p.bbox().width(), p.bbox().height()) for p in lines.each()} == {(600, 10 * UM)}
    pillars = _within(_region(files["gds"], (15, 0)), -45.0, -30.0, 5.0)
    assert pillars.count() == 20 * 9
    assert pillars.area() == 180 * 300 * 400
    lefts = sorted({p.bbox().left for p in pillars.each()})
    assert set(np.diff(lefts)) == {700}


def test_frames_of_two_exposures_are_concentric(files: dict[str, Path]) -> None:
    outer, inner = (_within(_region(files["oas"], (layer, 0)), 45.0, 0.0, 12.0).merged() for layer in (14, 15))
    assert outer.area() == (20**2 - 16**2) * UM**2
    assert inner.area() == (10**2 - 6**2) * UM**2
    assert outer.bbox().center() == inner.bbox().center() == kdb.Point(45 * UM, 0)


def test_exposures_and_doses_are_listed(files: dict[str, Path], chip: Design) -> None:
    """Marks first, pillars second; the second lens has a datatype of its own with its dose, seen by gdstk."""
    folder = files["gds"].parent
    told = json.loads((folder / "layout.json").read_text())
    assert told["exposures"] == [["10/0", "14/0"], ["1/0", "1/1", "11/0", "12/0", "13/0", "15/0"]]
    assert [(copy["dose"], copy["datatypes"]) for copy in told["copies"]] == [(1.0, [0, 0]), (1.1, [1, 1])]
    assert (folder / "doses.csv").read_text() == "datatype,dose_over_base_dose\n0,1.000000\n1,1.100000\n"
    percent = re.findall(r"\( *(\d+), +([-0-9.]+) \)", (folder / "doses.jdi").read_text())
    assert [(int(rank), float(change)) for rank, change in percent] == [(0, 0.0), (1, 10.0)]
    (top,) = gdstk.read_oas(files["oas"]).top_level()
    boxes = np.array([p.bounding_box() for p in top.get_polygons(layer=1, datatype=1)])
    assert boxes[:, 0, 0].min() > 129.0


@pytest.mark.parametrize(
    ("kit", "named"),
    [
        (Kit(overlays=(Overlay((20.0, 0.0)),)), r"overlays\[0\].*lens 1"),
        (Kit(overlays=(Overlay((45.0, 0.0)), Overlay((58.0, 0.0)))), r"overlays\[1\].*overlays\[0\]"),
        (Kit(gratings=(Grating((-55.0, 55.0), (500.0,), (250.0,), (5.0, 5.0)),)), r"gratings\[0\].*alignment marks"),
        (Kit(gratings=(Grating((230.0, 0.0), (500.0,), (250.0,), (5.0, 5.0)),)), r"gratings\[0\].*frame"),
        (
            Kit(gratings=(Grating((900.0, 0.0), (500.0,), (250.0,), (5.0, 5.0)),)),
            "within the frame, x from -80 to 230 um",
        ),
        (Kit(cd_bars=(CdBars((-45.0, 0.0), (100.3,)),)), r"cd_bars\[0\].width_nm"),
        (Kit(gratings=(Grating((-45.0, 0.0), (500.0,), (250.0,), (0.4, 5.0)),)), "size_um"),
        (Kit(gratings=(Grating((-900.0, 0.0), (500.0, 500.0), (250.0, 250.0), (700.0, 700.0)),)), "1960000"),
        (Kit(overlays=(Overlay((-45.0, 0.0)),), distance_um=30.0, clear_um=20.0), "clear_um"),
    ],
)
def test_structures_that_cannot_be_are_refused_before_anything_is_written(
    kit: Kit, named: str, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    design = replace(tiny_design, mask=replace(tiny_design.mask, chip=CHIP, kit=kit, copies=COPIES))
    with pytest.raises(InputError, match=named):
        preflight(design)
    with pytest.raises(InputError, match=named):
        mask.write(tiny.pillars, tmp_path, design)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("tone", ["positive", "inverted"])
def test_bars_are_not_drawn_where_they_would_be_trenches(
    tone: Literal["positive", "inverted"], tiny_design: Design
) -> None:
    options = replace(tiny_design.mask, kit=KIT, tone=tone, field_layer=9)
    with pytest.raises(InputError, match="trenches"):
        preflight(replace(tiny_design, mask=options))


def test_included_cells_and_structures_never_touch(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    library = gdstk.Library(unit=1e-6, precision=1e-9)
    library.add(gdstk.Cell("SHOP").add(gdstk.rectangle((0.0, 0.0), (5.0, 5.0), layer=40)))
    library.write_gds(tmp_path / "shop.gds")
    items = (Include(tmp_path / "shop.gds", at_um=(42.0, 0.0)),)
    design = replace(tiny_design, mask=replace(tiny_design.mask, kit=KIT, include=items))
    with pytest.raises(InputError, match="test structures"):
        mask.write(tiny.pillars, tmp_path, design)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Vernier((0.0, 0.0), teeth=4), "odd"),
        (lambda: Grating((0.0, 0.0), pitch_nm=(500.0, 500.0), line_nm=(250.0,)), "equally many"),
        (lambda: Overlay((0.0, 0.0), outer_um=12.0, inner_um=10.0), "inner_um"),
        (lambda: Kit(distance_um=2.0, clear_um=2.0), "distance_um"),
    ],
)
def test_specs_refuse_what_has_no_shape(make: object, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        make()  # type: ignore[operator]
