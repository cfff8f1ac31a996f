"""Several lenses on one chip: each is found again, corner variants are drawn with their bias, and nothing is lost."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import gdstk
import numpy as np
import pytest
from pydantic import TypeAdapter

from metafab import drc, mask
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.layout import Assignment
from metafab.mask.drawing.copies import lens_copies
from metafab.mask.drawing.surroundings import surroundings
from metafab.spec import Chip, Copy, Design, Dose, Exposure, Mask
from metafab.spec.toml import canonical_toml
from tests.layout.conftest import sizes_at_sites

kdb = pytest.importorskip("klayout.db")

FORMATS = ("gds", "oas")
COPIES = (
    Copy((0.0, 0.0), label="A"),
    Copy((60.0, 0.0), bias_nm=10.0, label="B"),
    Copy((0.0, 60.5), bias_nm=-10.0),
    Copy((60.0, 60.5)),
)
CHIP = Chip(
    margin_um=12.0, mark_um=8.0, mark_line_um=1.0, frame_um=2.0, street_um=5.0,
    label="L-1", text_um=4.2, scale_bar_um=5.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def chip(tiny_design: Design) -> Design:
    """Everything at once: a bias, dose classes, a field, a chip and four copies in three biases."""
    options = replace(
        tiny_design.mask,
        bias_nm=4.0,
        tone="positive",
        dose=Dose(by="density", classes=3, block_um=5.0),
        chip=CHIP,
        copies=COPIES,
        exposure=Exposure(800.0, 2.0, settle_shape_us=0.5, settle_field_ms=40.0),
    )
    return replace(tiny_design, mask=options)


@pytest.fixture(scope="module")
def files(tiny: Assignment, chip: Design, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("chip")
    return {file.path.suffix[1:]: file.path for file in mask.write(tiny.pillars, folder, chip)}


def _expected_rectangles(tiny: Assignment) -> np.ndarray:
    """x, y, width, height of every pillar of the chip, in database units, from the arrays and `COPIES` alone."""
    size = sizes_at_sites(tiny.pillars)
    row, column = np.nonzero(size[..., 0])
    lattice, size = tiny.pillars.lattice, size[row, column]
    centre = np.stack([lattice.x_dbu()[column], lattice.y_dbu()[row]], axis=1)
    found = []
    for copy in COPIES:
        drawn = size + round((4.0 + copy.bias_nm) / 0.5)
        at = np.array(copy.at_um) * 2000
        found.append(np.concatenate([centre + at - drawn / 2, drawn], axis=1))
    return np.concatenate(found).astype(np.int64)


@pytest.mark.parametrize("suffix", FORMATS)
def test_klayout_and_gdstk_see_every_copy_where_it_belongs(
    suffix: str, tiny: Assignment, chip: Design, files: dict[str, Path]
) -> None:
    expected = _expected_rectangles(tiny)
    drawn = kdb.Region([kdb.Box(x, y, x + w, y + h) for x, y, w, h in expected.tolist()])
    opened = kdb.Layout()
    opened.read(str(files[suffix]))
    (top,) = opened.top_cells()
    layers = [opened.layer(1, datatype) for datatype in (0, 1, 2)]
    seen = kdb.Region(kdb.RecursiveShapeIterator(opened, top, layers))
    assert seen.count() == len(expected)
    assert (seen ^ drawn).is_empty()
    library = gdstk.read_gds(files["gds"]) if suffix == "gds" else gdstk.read_oas(files["oas"])
    (gdstk_top,) = library.top_level()
    assert isinstance(gdstk_top, gdstk.Cell)
    boxes = np.array([p.bounding_box() for p in gdstk_top.get_polygons() if p.layer == 1])
    corners = np.rint(boxes.reshape(-1, 4) * (library.unit / 0.5e-9)).astype(np.int64)
    corners[:, 2:] -= corners[:, :2]
    assert np.array_equal(corners[np.lexsort(corners.T)], expected[np.lexsort(expected.T)])


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_each_copy_is_read_back_and_the_others_are_counted(
    number: int, suffix: str, tiny: Assignment, chip: Design, files: dict[str, Path]
) -> None:
    back = mask.read(files[suffix], chip, copy=number)
    bias_nm = 4.0 + COPIES[number - 1].bias_nm
    assert np.array_equal(sizes_at_sites(mask.biased(back.pillars, -bias_nm)), sizes_at_sites(tiny.pillars))
    count = tiny.figures.pillars
    assert back.other_copies == {other: count for other in (1, 2, 3, 4) if other != number}
    assert back.off_site.count == back.off_grid.count == back.duplicates.count == 0
    assert back.at_nm == tuple(1e3 * at for at in COPIES[number - 1].at_um)


def test_a_flattened_file_in_units_of_another_tool_tells_its_copies_apart(
    tiny: Assignment, chip: Design, files: dict[str, Path], tmp_path: Path
) -> None:
    opened = kdb.Layout()
    opened.read(str(files["oas"]))
    opened.top_cells()[0].flatten(True)
    options = kdb.SaveLayoutOptions()
    options.dbu = 0.25e-3
    opened.write(str(tmp_path / "flat.gds"), options)
    back = mask.read(tmp_path / "flat.gds", chip, copy=2)
    assert np.array_equal(sizes_at_sites(mask.biased(back.pillars, -14.0)), sizes_at_sites(tiny.pillars))
    assert set(back.other_copies.values()) == {tiny.figures.pillars}


@pytest.mark.parametrize("suffix", FORMATS)
def test_equal_copies_share_their_cells(suffix: str, tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    """Eight copies cost one lens and eight references: 512 bytes are plenty, a lens is some hundred thousand."""
    one, eight = (replace(tiny_design.mask, copies=tuple(Copy((50.0 * k, 0.0)) for k in range(n))) for n in (1, 8))
    sizes = []
    for options in (one, eight):
        mask.write(tiny.pillars, tmp_path, replace(tiny_design, mask=options))
        sizes.append((tmp_path / f"layout.{suffix}").stat().st_size)
    assert 0 < sizes[1] - sizes[0] < 512


def test_figures_count_one_lens_and_the_write_time_all(tiny: Assignment, chip: Design, files: dict[str, Path]) -> None:
    told = json.loads((files["gds"].parent / "layout.json").read_text())
    assert told["pillars"] == tiny.figures.pillars
    rectangles = _expected_rectangles(tiny)
    area_um2 = float((rectangles[:, 2] * rectangles[:, 3]).sum()) * 0.25e-6
    assert sum(copy["area_um2"] for copy in told["copies"]) == pytest.approx(area_um2, rel=1e-12)
    assert [copy["label"] for copy in told["copies"]] == ["A", "B", None, None]
    assert told["exposure"]["area_um2"] == pytest.approx(4 * (114 * 0.35) ** 2 - area_um2, rel=1e-12)
    assert told["exposure"]["shapes"] == len(rectangles)
    assert told["exposure"]["fields"] == 4


def test_the_chip_grows_around_all_copies(chip: Design) -> None:
    """Lenses span -20..80 by -20..80.5 um; margin 12, frame 2, street 5."""
    kinds = {kind.name: kind.rectangles for kind in surroundings(chip)}
    for name, grown in (("frame", 14.0), ("dicing street", 19.0)):
        low = kinds[name][:, :2].min(axis=0)
        high = (kinds[name][:, :2] + kinds[name][:, 2:]).max(axis=0)
        assert low.tolist() == [2000 * (-20.0 - grown)] * 2
        assert high.tolist() == [2000 * (80.0 + grown), 2000 * (80.5 + grown)]
    squares = kdb.Region([kdb.Box(x - 40000, y - 40000, x + 40000, y + 40000)
                          for x, y in ((c.x_dbu, c.y_dbu) for c in lens_copies(chip))])  # fmt: skip
    regions = {
        name: kdb.Region([kdb.Box(x, y, x + w, y + h) for x, y, w, h in rectangles.tolist()])
        for name, rectangles in kinds.items()
    }
    names = list(regions)
    for here, name in enumerate(names):
        assert (regions[name] & squares).is_empty() == name.startswith(("align", "frame", "label", "dicing"))
        for other in names[here + 1 :]:
            assert (regions[name] & regions[other]).is_empty()


@pytest.mark.parametrize("suffix", FORMATS)
def test_lattice_rules_look_at_one_copy_and_miss_no_other(
    suffix: str, tiny: Assignment, chip: Design, files: dict[str, Path], tmp_path: Path
) -> None:
    """A pillar taken from copy 4 is counted from copy 1 and has its place from copy 4, in the file's coordinates."""
    loose = replace(chip, rules=replace(chip.rules, min_gap_nm=50.0, min_feature_nm=50.0))
    report = drc.check(files[suffix], loose)
    assert report.clean
    assert report.other_copies == dict.fromkeys((2, 3, 4), tiny.figures.pillars)
    opened = kdb.Layout()
    opened.read(str(files[suffix]))
    opened.top_cells()[0].flatten(True)
    shapes = opened.top_cells()[0].shapes(opened.layer(1, 1))
    target = next(s for s in shapes.each() if s.bbox().left > 80000 and s.bbox().bottom > 81000)
    place = target.bbox().center()
    target.delete()
    opened.write(str(tmp_path / f"less.{suffix}"))
    assert drc.check(tmp_path / f"less.{suffix}", loose).violations["missing"] == 1
    found = drc.check(tmp_path / f"less.{suffix}", loose, copy=4)
    (marker,) = found.markers["missing"]
    assert marker.x_nm + marker.width_nm / 2 == pytest.approx(place.x * 0.5)
    assert marker.y_nm + marker.height_nm / 2 == pytest.approx(place.y * 0.5)


def test_engines_without_a_lattice_check_all_copies(tiny: Assignment, chip: Design, files: dict[str, Path]) -> None:
    loose = replace(chip, rules=replace(chip.rules, min_gap_nm=50.0, min_feature_nm=50.0))
    for engine in ("rectangles", "polygons"):
        report = drc.check(files["oas"], loose, engine=engine, work=Work(1))
        assert report.clean
        assert report.pillars == 4 * tiny.figures.pillars


@pytest.mark.parametrize(
    ("copies", "key"),
    [
        ((Copy((0.0, 0.0)), Copy((39.9, 39.9))), "at_um"),
        ((Copy((0.0002, 0.0)),), "at_um"),
        ((Copy((0.0, 0.0), bias_nm=0.5),), "bias_nm"),
        ((Copy((0.0, 0.0), bias_nm=-400.0),), "bias_nm"),
        ((Copy((0.0, 0.0), label="FAR TOO LONG A LABEL"),), "label"),
        ((Copy((0.0, 0.0), label="A"), Copy((0.0, 41.0))), "label"),
    ],
)
def test_copies_that_cannot_be_are_refused_before_anything_is_written(
    copies: tuple[Copy, ...], key: str, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    design = replace(tiny_design, mask=replace(tiny_design.mask, chip=CHIP, copies=copies))
    with pytest.raises(InputError, match=key):
        mask.write(tiny.pillars, tmp_path, design)
    assert list(tmp_path.iterdir()) == []


def test_a_copy_may_stand_beside_the_middle_and_alone(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    """One copy aside is the plain lens moved: the same rectangles, shifted."""
    design = replace(tiny_design, mask=replace(tiny_design.mask, copies=(Copy((123.0, -45.5)),)))
    mask.write(tiny.pillars, tmp_path, design)
    for suffix in FORMATS:
        back = mask.read(tmp_path / f"layout.{suffix}", design)
        assert np.array_equal(sizes_at_sites(back.pillars), sizes_at_sites(tiny.pillars))
        assert back.other_copies == {}
        # Without the table the same file holds nothing where the lens should be, and says so.
        lost = mask.read(tmp_path / f"layout.{suffix}", tiny_design)
        assert lost.off_site.count == tiny.figures.pillars


def test_the_table_survives_the_canonical_design_file(chip: Design) -> None:
    table = tomllib.loads(canonical_toml(chip.mask))
    assert TypeAdapter(Mask).validate_python(_tuples(table)) == chip.mask


def _tuples(value: object) -> object:
    """Arrays of a TOML table as the tuples of a spec."""
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def test_a_large_gdsii_is_announced_once_for_each_bias(tiny_design: Design) -> None:
    """1.7 mm hold 18.5 million pillars: one bias is 1.2 GB, two are 2.4 GB, however many copies there are."""

    def of(*biases_nm: float) -> list[str]:
        copies = tuple(Copy((1800.0 * k, 0.0), bias_nm=bias) for k, bias in enumerate(biases_nm))
        device = replace(tiny_design.device, aperture_um=1700.0)
        return mask.announcement(replace(tiny_design, device=device, mask=replace(tiny_design.mask, copies=copies)))

    assert of() == of(0.0, 0.0, 0.0) == []
    (sentence,) = of(0.0, 10.0, 10.0)
    assert "2.4 GB" in sentence


def test_labels_need_a_chip_and_numbers_a_copy(chip: Design, files: dict[str, Path]) -> None:
    with pytest.raises(ValueError, match=r"\[mask.chip\]"):
        Mask(copies=(Copy((0.0, 0.0), label="A"),))
    for number in (0, 5):
        with pytest.raises(InputError, match="1 to 4"):
            mask.read(files["oas"], chip, copy=number)
