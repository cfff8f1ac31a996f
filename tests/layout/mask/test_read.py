"""Written masks: read back exactly by our readers and by two libraries that did not write them."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gdstk
import numpy as np
import pytest

from metafab import drc, mask
from metafab.core.errors import InputError
from metafab.layout import Assignment, PillarMap
from metafab.mask.oasis import reader
from metafab.spec import Design
from metafab.spec.mask.files import Copy
from tests.layout.conftest import sizes_at_sites

kdb = pytest.importorskip("klayout.db")

FORMATS = ("gds", "oas")


def _assert_pure(read_back: mask.ReadBack) -> None:
    assert (read_back.off_site.count, read_back.off_grid.count, read_back.duplicates.count) == (0, 0, 0)
    assert read_back.foreign == {}


def _expected_boxes(pillars: PillarMap) -> np.ndarray:
    """Left, bottom, right, top of every pillar in dbu, sorted; from the lattice's definition."""
    row, column = np.nonzero(pillars.to_array())
    size = sizes_at_sites(pillars)[row, column]
    centre = np.stack([pillars.lattice.x_dbu()[column], pillars.lattice.y_dbu()[row]], axis=1)
    boxes = np.concatenate([centre - size // 2, centre + size // 2], axis=1)
    return boxes[np.lexsort(boxes.T)]


@pytest.mark.parametrize("suffix", FORMATS)
def test_read_back_is_exact(suffix: str, tiny: Assignment, tiny_design: Design, tiny_files: dict[str, Path]) -> None:
    read_back = mask.read(tiny_files[suffix], tiny_design)
    _assert_pure(read_back)
    assert np.array_equal(sizes_at_sites(read_back.pillars), sizes_at_sites(tiny.pillars))
    assert read_back.format == suffix
    assert read_back.top_cells == ("helix_small",)
    assert read_back.database_unit_nm == 0.5


def test_paths_may_be_texts(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    file, *_ = mask.write(tiny.pillars, str(tmp_path), tiny_design)
    read_back = mask.read(str(file.path), tiny_design)
    assert np.array_equal(sizes_at_sites(read_back.pillars), sizes_at_sites(tiny.pillars))
    assert drc.check(str(file.path), tiny_design).pillars == tiny.figures.pillars
    # In a console it states its counts, not its arrays.
    assert repr(read_back).startswith(f"ReadBack(file: {file.path.name}, pillars: {tiny.figures.pillars}, off site: 0,")


def test_windows_that_are_used_again_change_nothing(
    tiny: Assignment, tiny_design: Design, tiny_files: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs of hundreds of elements go through windows of four, on several threads."""
    for module in ("reader", "runs"):
        monkeypatch.setattr(f"metafab.mask.gdsii.{module}.WINDOW", 256)
    read_back = mask.read(tiny_files["gds"], tiny_design)
    _assert_pure(read_back)
    assert np.array_equal(sizes_at_sites(read_back.pillars), sizes_at_sites(tiny.pillars))


def test_the_pass_over_skipped_blocks_gives_their_pages_back(
    tiny_design: Design, tiny_files: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the whole file stays in memory."""
    path, released = tiny_files["oas"], list[int]()
    monkeypatch.setattr(reader, "_RELEASED", path.stat().st_size // 8)
    monkeypatch.setattr(reader, "release", lambda data: released.append(data.size))
    mask.read(path, tiny_design)
    # The checksum goes through the file in nine parts, the index and the shapes in those of its blocks.
    assert len(released) >= 9 + 2 * 4


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_large_lens_is_read_into_a_file(
    suffix: str, tiny_design: Design, tiny_files: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its indices are on disk, and its rules and their hash are those of a lens in memory."""
    held = mask.read(tiny_files[suffix], tiny_design)
    reports = [drc.check(tiny_files[suffix], tiny_design)]
    monkeypatch.setattr("metafab.core.storage.scratch.IN_MEMORY_BYTES", 0)
    monkeypatch.setattr("metafab.mask.shapes.recover._RELEASED", 1000)
    monkeypatch.setattr("metafab.mask.oasis.reader._RELEASED", 1000)
    on_disk = mask.read(tiny_files[suffix], tiny_design)
    reports.append(drc.check(tiny_files[suffix], tiny_design))
    whole = on_disk.pillars.to_array()
    assert np.array_equal(whole, held.pillars.to_array())
    assert isinstance(whole.base, np.ndarray) and not whole.base.flags.owndata
    _assert_pure(on_disk)
    for tile in on_disk.pillars.tiles():
        assert np.array_equal(tile.size_index, whole[tile.window])
    one, other = (replace(report, seconds=0.0) for report in reports)
    assert one == other and one.pillars == np.count_nonzero(whole)


@pytest.mark.parametrize("suffix", FORMATS)
def test_klayout_sees_the_same_geometry(suffix: str, tiny: Assignment, tiny_files: dict[str, Path]) -> None:
    layout = kdb.Layout()
    layout.read(str(tiny_files[suffix]))
    assert [cell.name for cell in layout.top_cells()] == ["helix_small"]
    assert [str(layout.get_info(i)) for i in layout.layer_indexes()] == ["1/0"]
    assert layout.dbu == 0.0005
    region = kdb.Region(layout.top_cell().begin_shapes_rec(layout.layer(1, 0)))
    assert region.non_rectangles().is_empty()
    boxes = np.array([(b.left, b.bottom, b.right, b.top) for b in (p.bbox() for p in region.each())])
    assert np.array_equal(boxes[np.lexsort(boxes.T)], _expected_boxes(tiny.pillars))


@pytest.mark.parametrize("suffix", FORMATS)
def test_gdstk_sees_the_same_geometry(suffix: str, tiny: Assignment, tiny_files: dict[str, Path]) -> None:
    library = (gdstk.read_gds if suffix == "gds" else gdstk.read_oas)(tiny_files[suffix])
    (top,) = library.top_level()
    boxes = np.array([np.concatenate(polygon.bounding_box()) for polygon in top.get_polygons()])
    # gdstk works in float micrometres: 1e-9 um is far below the 5e-4 um of a unit and above float rounding at 20 um.
    dbu = boxes / 5e-4
    assert np.abs(dbu - np.rint(dbu)).max() < 1e-6
    dbu = np.rint(dbu).astype(np.int64)
    assert np.array_equal(dbu[np.lexsort(dbu.T)], _expected_boxes(tiny.pillars))
    if suffix == "oas":
        assert gdstk.oas_validate(tiny_files[suffix])[0]


def test_the_two_formats_hold_the_same_shapes(tiny_files: dict[str, Path]) -> None:
    layouts = [kdb.Layout(), kdb.Layout()]  # regions look into their layouts, which must live on
    for layout, suffix in zip(layouts, FORMATS, strict=True):
        layout.read(str(tiny_files[suffix]))
    one, other = (kdb.Region(layout.top_cell().begin_shapes_rec(layout.layer(1, 0))) for layout in layouts)
    assert one.count() == other.count() > 0
    assert (one ^ other).is_empty()


def test_a_second_run_writes_the_same_bytes(
    tiny: Assignment, tiny_design: Design, tiny_files: dict[str, Path], tmp_path: Path
) -> None:
    for file in mask.write(tiny.pillars, tmp_path, tiny_design):
        assert file.bytes == file.path.stat().st_size
        assert file.path.read_bytes() == (tiny_files["gds"].parent / file.path.name).read_bytes()


def test_sidecar_states_count_area_and_density(tiny: Assignment, tiny_files: dict[str, Path]) -> None:
    sidecar = json.loads(tiny_files["json"].read_text())
    size = sizes_at_sites(tiny.pillars).astype(np.int64)
    area_um2 = int(np.sum(size[..., 0] * size[..., 1])) * 0.25e-6
    assert sidecar["pillars"] == tiny.figures.pillars
    assert sidecar["distinct_sizes"] == tiny.figures.distinct_sizes
    assert sidecar["area_um2"] == pytest.approx(area_um2, rel=1e-12)
    assert sidecar["density"] == pytest.approx(area_um2 / (sidecar["pillars"] * 0.35**2), rel=1e-12)


def test_tile_cells_divide_the_write_field(tiny_files: dict[str, Path]) -> None:
    layout = kdb.Layout()
    layout.read(str(tiny_files["oas"]))
    corners = np.array([(i.trans.disp.x, i.trans.disp.y) for i in layout.top_cell().each_inst()])
    steps = np.unique(corners - corners.min(axis=0))
    assert np.all(steps % (34 * 700) == 0)
    assert 1428 % 34 == 0


def _klayout_flat(source: Path, target: Path) -> None:
    layout = kdb.Layout()
    layout.read(str(source))
    layout.flatten(layout.top_cell().cell_index(), -1, True)
    layout.write(str(target))


def _klayout_renamed_finer(source: Path, target: Path) -> None:
    layout = kdb.Layout()
    layout.read(str(source))
    for cell in layout.each_cell():
        cell.name = f"X${cell.cell_index()}"
    options = kdb.SaveLayoutOptions()
    options.set_format_from_filename(str(target))
    options.dbu = 0.0001
    layout.write(str(target), options)


def _klayout_compressed(source: Path, target: Path) -> None:
    """Flat, with KLayout's own search for repetitions and its CBLOCKs in OASIS; texts and paths beside."""
    layout = kdb.Layout()
    layout.read(str(source))
    top = layout.top_cell()
    top.shapes(layout.layer(63, 1)).insert(kdb.Text("lot 7", kdb.Trans(0, 0)))
    top.shapes(layout.layer(64, 0)).insert(kdb.Path([kdb.Point(0, 0), kdb.Point(900, 0), kdb.Point(900, 900)], 40))
    layout.flatten(top.cell_index(), -1, True)
    options = kdb.SaveLayoutOptions()
    options.set_format_from_filename(str(target))
    options.oasis_compression_level = 10
    options.oasis_write_cblocks = True
    layout.write(str(target), options)


def _gdstk_again(source: Path, target: Path) -> None:
    library = (gdstk.read_gds if source.suffix == ".gds" else gdstk.read_oas)(source)
    library.rename_cell(library.top_level()[0].name, "renamed")
    (library.write_gds if target.suffix == ".gds" else library.write_oas)(target)


def _gdstk_cell_a_size(source: Path, target: Path) -> None:
    """One cell for each size, placed by a repetition (references one by one in GDSII)."""
    (top,) = (gdstk.read_gds if source.suffix == ".gds" else gdstk.read_oas)(source).top_level()
    places: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for polygon in top.get_polygons():
        (left, bottom), (right, upper) = polygon.bounding_box()
        size = round((right - left) / 5e-4), round((upper - bottom) / 5e-4)
        places.setdefault(size, []).append(((left + right) / 2, (bottom + upper) / 2))
    library = gdstk.Library(unit=1e-6, precision=5e-10)
    new_top = library.new_cell("TOP")
    for (width, length), centres in places.items():
        cell = library.new_cell(f"P_{width}_{length}")
        corner = width * 2.5e-4, length * 2.5e-4
        cell.add(gdstk.rectangle((-corner[0], -corner[1]), corner, layer=1, datatype=0))
        first = np.array(centres[0])
        reference = gdstk.Reference(cell, centres[0])
        if len(centres) > 1:
            reference.repetition = gdstk.Repetition(offsets=(np.array(centres) - first)[1:].tolist())
        new_top.add(reference)
    (library.write_gds if target.suffix == ".gds" else library.write_oas)(target)


@pytest.mark.parametrize("target", FORMATS)
@pytest.mark.parametrize("source", FORMATS)
@pytest.mark.parametrize(
    "through",
    [_klayout_flat, _klayout_renamed_finer, _klayout_compressed, _gdstk_again, _gdstk_cell_a_size],
)
def test_read_back_after_other_software(
    through: Callable[[Path, Path], None],
    source: str,
    target: str,
    tiny: Assignment,
    tiny_design: Design,
    tiny_files: dict[str, Path],
    tmp_path: Path,
) -> None:
    path = tmp_path / f"other.{target}"
    through(tiny_files[source], path)
    read_back = mask.read(path, tiny_design)
    _assert_pure(read_back)
    assert np.array_equal(sizes_at_sites(read_back.pillars), sizes_at_sites(tiny.pillars))
    beside = {"63/1 text": 1, "64/0": 1} if through is _klayout_compressed else {}
    assert read_back.other_layers == beside


def test_sizes_that_put_edges_off_the_grid_are_refused(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    """A width of 101 nm centred on a site has its edges at half nanometres: at 1 nm units that is no grid."""
    lattice = replace(tiny.pillars.lattice, period_dbu=(350, 350), database_unit_nm=1.0)
    size_dbu = np.array([[0, 0], [101, 102]], dtype=np.int32)
    index = np.ones(lattice.shape, dtype=np.uint16)
    design = replace(tiny_design, mask=replace(tiny_design.mask, database_unit_nm=1.0))
    with pytest.raises(InputError, match="101 nm x 102 nm"):
        mask.write(PillarMap.from_array(lattice, size_dbu, index, 34), tmp_path, design)
    assert list(tmp_path.iterdir()) == []


def test_odd_nanometres_are_exact_at_half_a_nanometre(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    """The trap of rounding libraries: 101 nm must come back as 101 nm at every site."""
    size_dbu = np.array([[0, 0], *([2 * nm, 2 * (350 - nm)] for nm in range(100, 251))], dtype=np.int32)
    index = np.resize(np.arange(1, 152, dtype=np.uint16), tiny.pillars.lattice.shape)
    pillars = PillarMap.from_array(tiny.pillars.lattice, size_dbu, index, 34)
    mask.write(pillars, tmp_path, tiny_design)
    for suffix in FORMATS:
        read_back = mask.read(tmp_path / f"layout.{suffix}", tiny_design)
        assert np.array_equal(sizes_at_sites(read_back.pillars), size_dbu[index])


def test_a_file_is_read_once_until_it_changes(tiny_design: Design, tiny_files: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "layout.oas"
    path.write_bytes(tiny_files["oas"].read_bytes())
    os.utime(path, ns=(0, 0))
    back = mask.read_shared(path, tiny_design)
    assert mask.read_shared(path, tiny_design) is back
    assert mask.read_shared(path, replace(tiny_design, name="another")) is not back
    path.write_bytes(b"damaged")
    with pytest.raises(InputError):
        mask.read_shared(path, tiny_design)


def test_shapes_that_are_no_pillars_are_refused_with_their_number_and_kind(
    tiny_design: Design, tiny_files: dict[str, Path], tmp_path: Path
) -> None:
    library, other = gdstk.read_gds(tiny_files["gds"]), tmp_path / "other.gds"
    triangle = gdstk.Polygon([(0.0, 0.0), (0.1, 0.0), (0.0, 0.1)], layer=tiny_design.mask.layer)
    library.top_level()[0].add(triangle, triangle.copy().translate(1.0, 0.0))
    library.write_gds(other)
    read_back = mask.read(other, tiny_design)
    (kind,) = read_back.foreign
    with pytest.raises(InputError, match=f"got 2 of the kind {re.escape(kind)}; their light"):
        read_back.require_pillars_alone("their light cannot be simulated")


@pytest.mark.parametrize("copies", [(), (Copy(at_um=(1000.0, 0.0)), Copy(at_um=(3000.0, 0.0)))])
def test_a_lens_that_stands_elsewhere_is_refused_with_its_place(
    tiny_design: Design, tiny_files: dict[str, Path], tmp_path: Path, copies: tuple[Copy, ...]
) -> None:
    """Its place is the one to name by `at_um`, whichever places the design names."""
    tiny_design = replace(tiny_design, mask=replace(tiny_design.mask, copies=copies))
    library, other, place_um = gdstk.read_gds(tiny_files["gds"]), tmp_path / "other.gds", (1234.567, -77.001)
    chip = library.new_cell("chip")
    chip.add(gdstk.Reference(next(cell for cell in library.top_level() if cell is not chip), place_um))
    library.write_gds(other)
    read_back = mask.read(other, tiny_design)
    assert read_back.stands_at_um == pytest.approx(place_um, abs=1e-6)
    with pytest.raises(InputError, match=r"\(1234\.567, -77\.001\) um: name this place by `at_um`"):
        read_back.require_pillars_alone("their light cannot be simulated")
    assert "(1234.567, -77.001) um" in drc.check(other, tiny_design).warnings()[0]
    stated = replace(tiny_design, mask=replace(tiny_design.mask, copies=(Copy(at_um=place_um),)))
    assert mask.read(other, stated).stands_at_um is None
    _assert_pure(mask.read(other, stated))


def test_pillars_on_another_layer_are_named(tiny_design: Design, tiny_files: dict[str, Path]) -> None:
    other = replace(tiny_design, mask=replace(tiny_design.mask, layer=77))
    read_back = mask.read(tiny_files["gds"], other)
    with pytest.raises(InputError, match=r"none on its layer, and \d+ on 1/0.*`mask.layer`"):
        read_back.require_pillars_alone("their light cannot be simulated")
