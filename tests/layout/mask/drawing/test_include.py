"""Cells of other files: polygons and texts reach both formats, pillars are read back as before, and nothing touches."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import gdstk
import numpy as np
import pytest

from benchmarks.mask.named_files import LISTS, list_in_a_block, records_in_a_block
from metafab import drc, mask
from metafab.core.errors import InputError
from metafab.layout import Assignment
from metafab.spec import Chip, Copy, Design
from metafab.spec.design import Limits
from metafab.spec.mask import Include
from tests.layout.conftest import sizes_at_sites

FORMATS = ("gds", "oas")


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cell of two marks by reference, a ring of a path, a triangle and a text, in units of 1 nm."""
    library = gdstk.Library(unit=1e-6, precision=1e-9)
    mark = gdstk.Cell("MARK")
    mark.add(gdstk.rectangle((-1.0, -0.25), (1.0, 0.25), layer=20, datatype=3))
    cell = gdstk.Cell("SHOP")
    cell.add(gdstk.Reference(mark, (0.0, 3.0), columns=2, rows=1, spacing=(4.0, 0.0)))
    cell.add(gdstk.Polygon([(0.0, 0.0), (2.001, 0.0), (1.0, 1.5)], layer=21))
    cell.add(gdstk.FlexPath([(0.0, -2.0), (3.0, -2.0), (3.0, -4.0)], 0.2, layer=22))
    cell.add(gdstk.Label("LOT 7", (0.0, 0.0), layer=23))
    library.add(mark, cell)
    path = tmp_path_factory.mktemp("shop") / "shop.gds"
    library.write_gds(path)
    return path


def with_shop(design: Design, *items: Include, **options: object) -> Design:
    return replace(design, mask=replace(design.mask, include=items, **options))  # type: ignore[arg-type]


def test_every_polygon_reaches_both_files_and_pillars_are_read_as_before(
    tiny: Assignment, tiny_design: Design, shop: Path, tmp_path: Path
) -> None:
    """Exclusive or by gdstk, which reads both files; the file's other layers are counted, not judged."""
    half = 0.5 * tiny_design.device.aperture_um
    item = Include(shop, "SHOP", at_um=(half + 10.0, -3.5), layers={"20/3": "40/7", "23/0": "41/2"})
    design = with_shop(tiny_design, item)
    mask.write(tiny.pillars, tmp_path, design)
    expected = gdstk.read_gds(shop).cells
    drawn = next(cell for cell in expected if cell.name == "SHOP").get_polygons()
    for suffix in FORMATS:
        path = tmp_path / f"layout.{suffix}"
        read = gdstk.read_oas(path) if suffix == "oas" else gdstk.read_gds(path)
        (top,) = read.top_level()
        for (layer, datatype), source in {(40, 7): (20, 3), (21, 0): (21, 0), (22, 0): (22, 0)}.items():
            found = top.get_polygons(layer=layer, datatype=datatype)
            wanted = [p.copy().translate(half + 10.0, -3.5) for p in drawn if (p.layer, p.datatype) == source]
            assert len(found) == len(wanted) > 0
            assert sum(p.area() for p in gdstk.boolean(found, wanted, "xor", precision=1e-5)) < 1e-6
        (label,) = top.get_labels()
        assert (label.text, label.layer, label.texttype) == ("LOT 7", 41, 2)
        assert label.origin == pytest.approx((half + 10.0, -3.5))
        back = mask.read(path, design)
        assert np.array_equal(sizes_at_sites(back.pillars), sizes_at_sites(tiny.pillars))
        assert back.other_layers == {"40/7": 2, "21/0": 1, "22/0": 1, "41/2 text": 1}
        assert sum(drc.check(path, design).violations.values()) == 0
    entry = json.loads((tmp_path / "layout.json").read_text(encoding="utf-8"))["include"]
    polygons = {"21/0": 1, "22/0": 1, "40/7": 2}
    assert entry == [{"file": "shop.gds", "cell": "SHOP", "polygons": polygons, "texts": 1}]


def test_without_cells_no_byte_changes(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    mask.write(tiny.pillars, tmp_path / "one", tiny_design)
    mask.write(tiny.pillars, tmp_path / "two", with_shop(tiny_design))
    for suffix in FORMATS:
        one, two = (tmp_path / name / f"layout.{suffix}" for name in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()


def test_cells_beyond_the_street_are_stated(tiny: Assignment, tiny_design: Design, shop: Path, tmp_path: Path) -> None:
    half = 0.5 * tiny_design.device.aperture_um
    chip = Chip(margin_um=12.0, mark_um=0.0, frame_um=2.0, street_um=5.0, label="", text_um=4.2, scale_bar_um=0.0)
    outside = Include(shop, "SHOP", at_um=(half + 60.0, 0.0))
    with pytest.raises(InputError, match=r"within the frame.*beyond_street"):
        mask.write(tiny.pillars, tmp_path, with_shop(tiny_design, outside, chip=chip))
    mask.write(tiny.pillars, tmp_path, with_shop(tiny_design, replace(outside, beyond_street=True), chip=chip))


def _nested(kind: str) -> gdstk.Library:
    """Four nested arrays of 100 x 100, of squares, of texts or of nothing, or in a circle; or a chain of cells."""
    library = gdstk.Library()
    below = library.new_cell("A0")
    if kind == "texts":
        below.add(gdstk.rectangle((0, 0), (1, 1), layer=20), gdstk.Label("LOT 7", (0, 0)))
        below.labels[0].repetition = gdstk.Repetition(columns=2000, rows=2000, spacing=(2.0, 2.0))
        return library
    if kind == "corners":
        below.add(gdstk.ellipse((0, 0), 5, tolerance=1e-6, layer=20))
        below.polygons[0].repetition = gdstk.Repetition(columns=300, rows=300, spacing=(20.0, 20.0))
        return library
    if kind != "nothing":
        below.add(gdstk.rectangle((0, 0), (1, 1), layer=20))
    side, levels = (1, 15_000) if kind == "deep" else (100, 4)
    for number in range(1, 1 + levels):
        array = gdstk.Reference(below, columns=side, rows=side, spacing=(2.0, 2.0))
        below = library.new_cell(f"A{number}").add(array)
    if kind == "circle":
        library.cells[0].add(gdstk.Reference(library["A3"]))
    return library


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("squares", r"at most 1e\+06 shapes.*1e\+16.*limits\.shapes"),
        ("nothing", r"at most 1e\+06 shapes.*1e\+16"),
        ("texts", r"at most 1e\+06 shapes and texts.*4e\+06"),
        ("corners", r"at most 1e\+06 shapes.*7\.02e\+06"),
        ("circle", "at most 100 deep.*contains itself"),
        ("deep", r"at most 100 deep.*limits\.depth"),
    ],
)
def test_cells_that_expand_to_too_much_are_refused(
    kind: str, message: str, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    """Before gdstk expands them: a chain of 15 000 cells would overflow its stack and end the process."""
    library, path = _nested(kind), tmp_path / "bomb.oas"
    library.write_oas(path)
    top = library.top_level()[0].name
    with pytest.raises(InputError, match=message):
        mask.write(tiny.pillars, tmp_path, with_shop(tiny_design, Include(path, top, at_um=(100.0, 0.0))))


@pytest.mark.parametrize("kind", [*LISTS, "records"])
def test_compressed_blocks_are_counted_before_gdstk_reads_them(
    kind: str, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    """Files of 20 to 60 kB: gdstk holds 16 bytes a place or corner, and some 250 bytes a record."""
    path = tmp_path / "bomb.oas"
    content = records_in_a_block(6_000_000, 20) if kind == "records" else list_in_a_block(kind, 20_000_000, 20)
    path.write_bytes(content)
    design = with_shop(tiny_design, Include(path, at_um=(100.0, 0.0)))
    limits = Limits(seconds=0.2) if kind == "records" else Limits()
    expected = "records that take about 0.2 s" if kind == "records" else "blocks and lists of at most 256 MB"
    with pytest.raises(InputError, match=expected):
        mask.write(tiny.pillars, tmp_path, replace(design, limits=limits))
    with pytest.raises(InputError, match=r"at most 8 MB.*limits\.memory_mb"):
        mask.write(tiny.pillars, tmp_path, replace(design, limits=Limits(memory_mb=8.0)))


def test_stated_limits_hold_for_included_cells(
    tiny: Assignment, tiny_design: Design, shop: Path, tmp_path: Path
) -> None:
    """SHOP draws four shapes and a text in two levels."""
    design = with_shop(tiny_design, Include(shop, "SHOP", at_um=(100.0, 0.0)))
    mask.write(tiny.pillars, tmp_path, replace(design, limits=Limits(shapes=5, depth=2)))
    for limits, named in ((Limits(shapes=4), "at most 4 shapes"), (Limits(depth=1), "at most 1 deep")):
        with pytest.raises(InputError, match=named):
            mask.write(tiny.pillars, tmp_path, replace(design, limits=limits))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"at_um": (0.0, 0.0)}, "in lens 1"),
        ({"cell": "NONE"}, "one of MARK, SHOP"),
        ({"layers": {"20/3": "1/0"}}, "on which the design draws"),
        ({"layers": {"23/0": "1/0"}}, "on which the design draws"),
        ({"layers": {"99/0": "40/0"}}, "layers of cell SHOP"),
        ({"at_um": (100.0001, 0.0)}, "at_um"),
        ({"file": Path("missing.gds")}, "GDSII or OASIS"),
    ],
)
def test_what_cannot_be_included_is_refused(
    change: dict[str, object], named: str, tiny: Assignment, tiny_design: Design, shop: Path, tmp_path: Path
) -> None:
    item = replace(Include(shop, "SHOP", at_um=(100.0, 0.0)), **change)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=named):
        mask.write(tiny.pillars, tmp_path, with_shop(tiny_design, item))


def test_marks_frames_and_other_cells_are_never_touched(
    tiny: Assignment, tiny_design: Design, shop: Path, tmp_path: Path
) -> None:
    half = 0.5 * tiny_design.device.aperture_um
    chip = Chip(
        margin_um=12.0, mark_um=8.0, mark_line_um=1.0, frame_um=2.0, street_um=5.0, label="A", text_um=4.2,
        scale_bar_um=0.0,
    )  # fmt: skip
    on_frame = Include(shop, "SHOP", at_um=(half + 12.0, 0.0))
    with pytest.raises(InputError, match="touches: frame"):
        mask.write(tiny.pillars, tmp_path, with_shop(tiny_design, on_frame, chip=chip))
    beside = Include(shop, "SHOP", at_um=(half + 10.0, 0.0))
    with pytest.raises(InputError, match=r"mask.include\[1\].*mask.include\[0\]"):
        mask.write(tiny.pillars, tmp_path, with_shop(tiny_design, beside, beside))
    other_lens = (Copy((0.0, 0.0)), Copy((2.5 * half, 0.0)))
    with pytest.raises(InputError, match="in lens 2"):
        mask.write(
            tiny.pillars, tmp_path, with_shop(tiny_design, Include(shop, "SHOP", (2.5 * half, 0.0)), copies=other_lens)
        )


def _drawn(path: Path, *shapes: gdstk.Polygon | gdstk.FlexPath | gdstk.Label) -> Path:
    gdstk.Library(unit=1e-6, precision=1e-9).add(gdstk.Cell("SHOP").add(*shapes)).write_gds(path)
    return path


def test_a_ring_may_lie_around_lens_and_cells(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    """A hollow square and an L around the lens hold it in their bounding boxes; touching ones are refused."""
    half = 0.5 * tiny_design.device.aperture_um
    out = half + 5.0
    corner = [(-half, -out), (out, -out), (out, half)]

    def ring(path: Path, side: float) -> Path:
        outer, inner = (gdstk.rectangle((-s, -s), (s, s)) for s in (side + 1.0, side))
        return _drawn(path, *gdstk.boolean(outer, inner, "not", layer=30))

    around = Include(ring(tmp_path / "ring.gds", out))
    within = Include(_drawn(tmp_path / "l.gds", gdstk.FlexPath(corner, 1.0, layer=31)), at_um=(-1.0, 1.0))
    mask.write(tiny.pillars, tmp_path / "kept", with_shop(tiny_design, around, within))
    found = mask.read(tmp_path / "kept" / "layout.oas", tiny_design)
    assert found.other_layers == {"30/0": 1, "31/0": 1}
    # Half a micrometre further out, the L's outer edge lies on the inner edge of the ring; 0.5 nm before it does not.
    touching = with_shop(tiny_design, around, replace(within, at_um=(-0.5, 0.5)))
    with pytest.raises(InputError, match=r"touches: mask.include\[0\]"):
        mask.write(tiny.pillars, tmp_path / "no", touching)
    mask.write(tiny.pillars, tmp_path / "yes", with_shop(tiny_design, around, replace(within, at_um=(-0.5005, 0.5005))))
    near = Include(ring(tmp_path / "near.gds", half - 0.5))
    with pytest.raises(InputError, match="in lens 1"):
        mask.write(tiny.pillars, tmp_path / "no", with_shop(tiny_design, near))
    solid = Include(_drawn(tmp_path / "solid.gds", gdstk.rectangle((-out, -out), (out, out), layer=30)))
    with pytest.raises(InputError, match="in lens 1"):
        mask.write(tiny.pillars, tmp_path / "no", with_shop(tiny_design, solid))


@pytest.mark.parametrize("words", ["Los 7 \u00b5m", "A\tB", "x" * 513])
def test_texts_that_gdsii_cannot_hold_are_refused(
    words: str, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    path = tmp_path / "text.oas"
    cell = gdstk.Cell("SHOP").add(gdstk.rectangle((0, 0), (1, 1), layer=30), gdstk.Label(words, (0, 0), layer=31))
    gdstk.Library(unit=1e-6, precision=1e-9).add(cell).write_oas(path)
    with pytest.raises(InputError, match="printable ASCII"):
        mask.write(tiny.pillars, tmp_path, with_shop(tiny_design, Include(path, at_um=(100.0, 0.0))))


def test_coordinates_off_the_grid_are_refused(
    tiny: Assignment, tiny_design: Design, shop: Path, tmp_path: Path
) -> None:
    """A quarter of a nanometre on a grid of half a nanometre."""
    library = gdstk.read_gds(shop)
    library.precision = 1e-10
    cell = gdstk.Cell("FINE")
    cell.add(gdstk.rectangle((0.0, 0.0), (1.00025, 1.0), layer=30))
    library.add(cell)
    path = tmp_path / "fine.gds"
    library.write_gds(path)
    with pytest.raises(InputError, match=r"on the grid of 0\.5 nm"):
        mask.write(tiny.pillars, tmp_path, with_shop(tiny_design, Include(path, "FINE", at_um=(100.0, 0.0))))


def test_layers_are_pairs() -> None:
    with pytest.raises(ValueError, match="layer/datatype"):
        Include(Path("shop.gds"), layers={"20": "30/0"})
    for pair in ("40/70000", "70000/0"):
        with pytest.raises(ValueError, match=f"at most 65535, got '{pair}'"):
            Include(Path("shop.gds"), layers={"20/0": pair})
    Include(Path("shop.gds"), layers={"20/0": "65535/65535"})
