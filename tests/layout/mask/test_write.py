"""What a process may ask of a mask: bias, dose classes, tone, marks, frame, label, street; none changes the pillars."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import drc, layout, mask
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.layout import Assignment, PillarMap
from metafab.library import Library
from metafab.mask.drawing.surroundings import surroundings
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Chip, Design, Dose, Exposure, Mask
from metafab.spec.mask import Copy
from tests.layout.conftest import sizes_at_sites

kdb = pytest.importorskip("klayout.db")

FORMATS = ("gds", "oas")
CHIP = Chip(
    margin_um=12.0, mark_um=8.0, mark_line_um=1.0, frame_um=2.0, street_um=5.0,
    label="L-1", text_um=4.2, scale_bar_um=5.0,
)  # fmt: skip
UNIT_UM = 5e-4


def _with(design: Design, **options: object) -> Design:
    return replace(design, mask=replace(design.mask, **options))


def _layers(path: Path) -> dict[str, kdb.Region]:
    """Everything in a file by layer, merged semantics off, as KLayout sees it; the layout is kept alive by copies."""
    opened = kdb.Layout()
    opened.read(str(path))
    (top,) = opened.top_cells()
    return {
        str(opened.get_info(index)): kdb.Region([p.dup() for p in kdb.Region(top.begin_shapes_rec(index)).each()])
        for index in opened.layer_indexes()
    }


def test_options_left_out_change_no_byte(
    tiny: Assignment, tiny_design: Design, tiny_files: dict[str, Path], tmp_path: Path
) -> None:
    """An exposure asks for figures and a table of fields only, and a bias of nothing is none."""
    design = _with(tiny_design, bias_nm=0.0, exposure=Exposure(1000.0, 1.0))
    for file in mask.write(tiny.pillars, tmp_path, design):
        if file.path.suffix not in {".json", ".csv"}:
            assert file.path.read_bytes() == (tiny_files["gds"].parent / file.path.name).read_bytes()


@pytest.mark.parametrize("bias_nm", [10.0, -6.0])
@pytest.mark.parametrize("suffix", FORMATS)
def test_drawn_pillars_have_the_bias_and_made_ones_have_not(
    bias_nm: float, suffix: str, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    design = _with(tiny_design, bias_nm=bias_nm)
    mask.write(tiny.pillars, tmp_path, design)
    read_back = mask.read(tmp_path / f"layout.{suffix}", design)
    drawn, stands = sizes_at_sites(read_back.pillars), sizes_at_sites(tiny.pillars)
    filled = stands[..., 0] > 0
    assert np.all(drawn[filled] == stands[filled] + round(bias_nm / 0.5))
    assert np.array_equal(sizes_at_sites(mask.biased(read_back.pillars, -bias_nm)), stands)
    assert json.loads((tmp_path / "layout.json").read_text())["bias_nm"] == bias_nm


@pytest.mark.parametrize("bias_nm", [30.0, -20.0])
def test_the_mapping_leaves_room_for_the_bias(
    bias_nm: float, profile: PhaseProfile, smooth_library: Library, tiny_design: Design, tmp_path: Path
) -> None:
    """Drawn pillars keep the gap of 100 nm and the feature of 100 nm: standing ones 130 and 100, or 80 and 120."""
    design = _with(tiny_design, bias_nm=bias_nm, formats=("oas",))
    pillars = layout.assign(profile, smooth_library, design).pillars
    mask.write(pillars, tmp_path, design)
    report = drc.check(tmp_path / "layout.oas", design)
    assert report.clean
    assert report.min_gap_nm is not None and report.min_gap_nm >= 100.0
    side = pillars.size_nm()[1:]
    assert side.min() >= max(100.0, 100.0 - bias_nm)
    assert side.max() <= min(250.0, 350.0 - (100.0 + bias_nm))


@pytest.mark.parametrize("bias_nm", [0.5, 0.3, -400.0])
def test_a_bias_off_the_grid_or_beyond_the_pillar_is_refused(
    bias_nm: float, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="bias_nm"):
        mask.write(tiny.pillars, tmp_path, _with(tiny_design, bias_nm=bias_nm))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("by", ["size", "density"])
@pytest.mark.parametrize("suffix", FORMATS)
def test_dose_classes_divide_the_pillars_and_are_read_as_one_mask(
    by: str, suffix: str, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    design = _with(tiny_design, dose=Dose(by=by, classes=3, block_um=5.0), datatype=7)
    mask.write(tiny.pillars, tmp_path, design)
    path = tmp_path / f"layout.{suffix}"
    layers = _layers(path)
    assert set(layers) == {"1/7", "1/8", "1/9"}
    assert sum(region.count() for region in layers.values()) == tiny.figures.pillars
    if by == "size":
        # Thirds of the range of areas on the mask: an independent count, from the sizes alone.
        area = np.prod(sizes_at_sites(tiny.pillars), axis=-1, dtype=float)
        area = area[area > 0]
        edges = area.min() + (area.max() - area.min()) * np.array([1, 2]) / 3
        expected = np.bincount(np.digitize(area, edges))
        assert [layers[f"1/{datatype}"].count() for datatype in (7, 8, 9)] == expected.tolist()
    read_back = mask.read(path, design)
    assert np.array_equal(sizes_at_sites(read_back.pillars), sizes_at_sites(tiny.pillars))
    for engine in ("lattice", "polygons"):
        report = drc.check(path, design, engine=engine, work=Work(1))
        assert report.clean
        assert report.pillars == tiny.figures.pillars


def test_density_classes_do_not_depend_on_tiles(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    design = _with(tiny_design, dose=Dose(by="density", classes=3, block_um=5.0), formats=("oas",))
    regions = []
    for sites in (34, 51):
        mask.write(replace(tiny.pillars, tiles=_retiled(tiny, sites), tile_sites=sites), tmp_path, design)
        regions.append(_layers(tmp_path / "layout.oas"))
    assert regions[0].keys() == regions[1].keys()
    assert all((regions[0][layer] ^ regions[1][layer]).is_empty() for layer in regions[0])


def _retiled(tiny: Assignment, sites: int) -> Callable[[], object]:
    pillars = tiny.pillars
    return type(pillars).from_array(pillars.lattice, pillars.size_dbu, pillars.to_array(), sites).tiles


@pytest.mark.parametrize("suffix", FORMATS)
def test_chip_and_field_stand_beside_the_pillars(
    suffix: str, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    design = _with(tiny_design, chip=CHIP, tone="positive")
    files = {file.path.name for file in mask.write(tiny.pillars, tmp_path, design)}
    path = tmp_path / f"layout.{suffix}"
    assert path.name in files
    layers = _layers(path)
    assert set(layers) == {"1/0", "2/0", "10/0", "11/0", "12/0", "13/0"}
    # Areas in closed form; lens 40 um, margin 12, frame 2, street 5: half sides 20, 32, 34, 39.
    area_um2 = {layer: region.area() * UNIT_UM**2 for layer, region in layers.items()}
    assert area_um2["10/0"] == pytest.approx(4 * (2 * 8.0 - 1.0), rel=1e-12)
    assert area_um2["11/0"] == pytest.approx(68.0**2 - 64.0**2, rel=1e-12)
    assert area_um2["13/0"] == pytest.approx(78.0**2 - 68.0**2, rel=1e-12)
    assert area_um2["2/0"] == pytest.approx((114 * 0.35) ** 2, rel=1e-12)
    assert layers["13/0"].bbox() == kdb.Box(-78000, -78000, 78000, 78000)
    # Nothing overlaps anything of its own layer, and only the field touches the pillars.
    for layer, region in layers.items():
        assert region.merged(False, 2).is_empty()
        assert (region & layers["1/0"]).is_empty() == (layer not in {"1/0", "2/0"})
    assert (layers["1/0"] - layers["2/0"]).is_empty()
    read_back = mask.read(path, design)
    assert np.array_equal(sizes_at_sites(read_back.pillars), sizes_at_sites(tiny.pillars))
    assert sum(read_back.other_layers.values()) == sum(len(kind.rectangles) for kind in surroundings(design))
    assert set(read_back.other_layers) == set(layers) - {"1/0"}
    for engine in ("lattice", "polygons"):
        assert drc.check(path, design, engine=engine, work=Work(1)).clean


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_inverted_field_is_the_square_less_the_pillars(
    suffix: str, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    """By KLayout's boolean; the first tile holds no pillar at all, those at the rim not at every site."""
    keep = tiny.pillars.to_array().copy()
    keep[:34, :34] = 0
    pillars = PillarMap.from_array(tiny.pillars.lattice, tiny.pillars.size_dbu, keep, 34)
    copies = (Copy(at_um=(0.0, 0.0)), Copy(at_um=(50.0, 0.0), bias_nm=10.0))
    for option in ({}, {"copies": copies}):
        design = _with(tiny_design, tone="inverted", **option)
        mask.write(pillars, tmp_path, design)
        path = tmp_path / f"layout.{suffix}"
        layers = _layers(path)
        assert set(layers) == {"1/0", "2/0"}
        half = 114 * 350
        square = kdb.Region(kdb.Box(-half, -half, half, half))
        squares = square + square.moved(100_000, 0) if option else square
        assert ((squares - layers["1/0"]) ^ layers["2/0"]).is_empty()
        assert layers["2/0"].merged(False, 2).is_empty()  # nothing is exposed twice
        read_back = mask.read(path, design)
        assert np.array_equal(sizes_at_sites(read_back.pillars), sizes_at_sites(pillars))
        assert read_back.other_layers == {"2/0": layers["2/0"].count()}


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("tone", ["negative", "inverted"])
def test_a_flat_mask_has_one_cell_and_the_same_geometry(
    suffix: str, tone: str, tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    """Copies with and without bias, dose classes and a chip included; each copy is read back as it is drawn."""
    copies = (Copy((0.0, 0.0)), Copy((140.0, 0.0), bias_nm=4.0), Copy((0.0, 140.0)))
    design = _with(tiny_design, formats=(suffix,), tone=tone, copies=copies, chip=CHIP, dose=Dose(classes=3))
    flat = _with(design, flat=True)
    (tree, *_), (one, *_) = (mask.write(tiny.pillars, tmp_path / d.name, d) for d in (design, replace(flat, name="f")))
    expected, found = _layers(tree.path), _layers(one.path)
    assert expected.keys() == found.keys()
    for layer, region in expected.items():
        assert region.count() == found[layer].count()
        assert (region ^ found[layer]).is_empty()
    opened = kdb.Layout()
    opened.read(str(one.path))
    assert opened.cells() == 1
    for number in (1, 3):
        read_back = mask.read(one.path, flat, copy=number)
        assert np.array_equal(sizes_at_sites(read_back.pillars), sizes_at_sites(tiny.pillars))
        assert read_back.off_site.count == read_back.duplicates.count == 0
    assert json.loads((tmp_path / "f" / "layout.json").read_text())["flat"] is True


def test_pillars_beyond_their_cells_are_not_inverted(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    copies = (Copy(at_um=(0.0, 0.0)), Copy(at_um=(50.0, 0.0), bias_nm=200.0))
    with pytest.raises(InputError, match="within their cells"):
        mask.write(tiny.pillars, tmp_path, _with(tiny_design, tone="inverted", copies=copies))
    assert list(tmp_path.iterdir()) == []


def test_the_layer_file_names_what_is_drawn(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    design = _with(tiny_design, chip=CHIP, dose=Dose(classes=2))
    mask.write(tiny.pillars, tmp_path, design)
    lay = pytest.importorskip("klayout.lay")
    view = lay.LayoutView()
    view.load_layer_props(str(tmp_path / "layout.lyp"))
    sources = {node.source: node.name for node in view.each_layer()}
    assert set(sources) == {"1/0@1", "1/1@1", "10/0@1", "11/0@1", "12/0@1", "13/0@1"}
    assert sources["1/1@1"].endswith("dose class 1")


def test_write_time_is_dose_times_area_over_current(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    exposure = Exposure(dose_uc_per_cm2=800.0, beam_current_na=2.0, settle_shape_us=0.5, settle_field_ms=40.0)
    totals = {}
    for tone in ("negative", "positive"):
        mask.write(tiny.pillars, tmp_path, _with(tiny_design, exposure=exposure, tone=tone))
        totals[tone] = json.loads((tmp_path / "layout.json").read_text())
    told, pillars = totals["negative"]["exposure"], tiny.figures.pillars
    # 1 uC/cm2 over 1 um2 is 1e-8 uC; 2 nA is 2e-3 uC/s.
    assert told["beam_seconds"] == pytest.approx(800.0 * totals["negative"]["area_um2"] * 1e-8 / 2e-3, rel=1e-12)
    assert told["settling_seconds"] == pytest.approx(pillars * 0.5e-6 + 0.040, rel=1e-12)
    assert told["fields"] == 1
    whole = totals["positive"]["exposure"]["area_um2"] + told["area_um2"]
    assert whole == pytest.approx((114 * 0.35) ** 2, rel=1e-12)


def test_the_write_time_of_an_inverted_mask_is_that_of_its_field(
    tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    """Against the rectangles that KLayout reads on the field layer, of two lenses with a bias each."""
    kdb = pytest.importorskip("klayout.db")
    exposure = Exposure(
        dose_uc_per_cm2=800.0, beam_current_na=2.0, settle_shape_us=0.5, settle_field_ms=40.0,
        shot_pitch_nm=4.0, clock_mhz=1.0,
    )  # fmt: skip
    copies = (Copy((0.0, 0.0), dose=1.1), Copy((60.0, 0.0), 4.0, dose=1.1))
    design = _with(tiny_design, exposure=exposure, tone="inverted", copies=copies)
    written = mask.write(tiny.pillars, tmp_path, design)
    assert (
        {file.path.name for file in written} >= set(mask.table_names(design)) == {"doses.csv", "doses.jdi", "doses.txt"}
    )
    # Datatype 0 of the field layer is the only one that is exposed.
    assert (tmp_path / "doses.csv").read_text() == "datatype,dose_over_base_dose\n0,1.100000\n"
    told = json.loads((tmp_path / "layout.json").read_text())["exposure"]
    drawn = kdb.Layout()
    drawn.read(str(tmp_path / "layout.gds"))
    field = kdb.Region(drawn.top_cell().begin_shapes_rec(drawn.layer(2, 0)))
    field.merged_semantics = False
    assert told["shapes"] == field.count() > 2 * 4 * tiny.figures.pillars
    assert told["area_um2"] == pytest.approx(field.area() * 0.25e-6, rel=1e-9)
    assert told["settling_seconds"] == pytest.approx(field.count() * 0.5e-6 + 2 * 0.040, rel=1e-12)
    # A shot of 4 nm takes 70 ns of current, so that the clock's 1 us counts.
    assert told["shots"] == pytest.approx(told["area_um2"] / 16e-6, abs=2)
    assert told["beam_seconds"] == pytest.approx(told["shots"] * 1e-6, rel=1e-9)
    mask.write(
        tiny.pillars, tmp_path, replace(design, mask=replace(design.mask, exposure=replace(exposure, clock_mhz=None)))
    )
    slower = json.loads((tmp_path / "layout.json").read_text())["exposure"]
    assert slower["beam_seconds"] == pytest.approx(1.1 * 800.0 * told["area_um2"] * 1e-8 / 2e-3, rel=1e-9)
    with pytest.raises(ValueError, match="max_shot_um"):
        _with(tiny_design, exposure=Exposure(800.0, 2.0, max_shot_um=1.0), tone="inverted")


def test_a_mask_of_an_earlier_design_does_not_stay_beside_the_new_one(
    tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    mask.write(tiny.pillars, tmp_path, tiny_design)
    assert (tmp_path / "layout.gds").exists()
    mask.write(tiny.pillars, tmp_path, _with(tiny_design, formats=("oas",)))
    assert {path.name for path in tmp_path.iterdir()} == {"layout.oas", "layout.lyp", "layout.json"}


def test_the_density_map_is_the_covered_share_of_each_write_field(
    profile: PhaseProfile, smooth_library: Library, tiny_design: Design, tmp_path: Path
) -> None:
    """114 sites a side in fields of 50: three by three, the last of each row cut to 14 sites; from arrays alone."""
    design = _with(tiny_design, write_field_um=17.5)
    pillars = layout.assign(profile, smooth_library, design).pillars
    mask.write(pillars, tmp_path, design)
    told = json.loads((tmp_path / "layout.json").read_text())
    area_um2 = np.prod(sizes_at_sites(pillars) * UNIT_UM, axis=-1)
    expected = [[area_um2[i : i + 50, j : j + 50].sum() / 17.5**2 for j in (0, 50, 100)] for i in (0, 50, 100)]
    # Six decimals are kept.
    assert np.abs(np.array(told["field_density"]) - expected).max() <= 0.5e-6 + 1e-12
    assert np.sum(expected) * 17.5**2 == pytest.approx(told["area_um2"], rel=1e-12)


@pytest.mark.parametrize(
    ("change", "key"),
    [({"mark_um": 13.0}, "mark_um"), ({"mark_line_um": 8.0}, "mark_line_um"), ({"text_um": 12.5}, "text_um"),
     ({"label": "A LABEL THAT IS FAR TOO LONG"}, "label"), ({"label": "50 %"}, "label")],
)  # fmt: skip
def test_what_does_not_fit_is_refused_by_its_key(change: dict[str, object], key: str, tiny_design: Design) -> None:
    with pytest.raises(InputError, match=key):
        surroundings(_with(tiny_design, chip=replace(CHIP, **change)))


def test_texts_fit_below_a_lens_that_is_narrower_than_the_margin(tiny_design: Design) -> None:
    """As far as the lens is wide; a height of 0 draws neither texts nor scale bar, and other texts stay in place."""
    lens_um = tiny_design.device.aperture_um
    wide = replace(CHIP, margin_um=1.5 * lens_um, label="")

    def text(chip: Chip) -> np.ndarray:
        layers = surroundings(_with(tiny_design, chip=chip))
        return np.concatenate([np.empty((0, 4)), *(one.rectangles for one in layers if one.layer == chip.text_layer)])

    assert len(text(replace(wide, scale_bar_um=0.0))) == 0
    assert len(text(replace(CHIP, text_um=0.0))) == 0
    drawn = text(wide) * UNIT_UM
    assert len(drawn)
    assert -0.5 * lens_um < drawn[:, 0].min() < (drawn[:, 0] + drawn[:, 2]).max() < 0.5 * lens_um
    with pytest.raises(InputError, match="shorten it"):
        text(replace(wide, label="A LABEL THAT IS FAR TOO LONG"))


def test_layers_must_differ() -> None:
    with pytest.raises(ValueError, match="layers of their own"):
        Mask(layer=10, chip=Chip())
    with pytest.raises(ValueError, match="layers of their own"):
        Mask(layer=2, tone="positive")
    assert Mask(layer=2).datatypes == (0, 0)


def test_a_layer_beyond_gdsii_is_refused_without_a_word_about_places(
    tiny: Assignment, tiny_design: Design, tmp_path: Path
) -> None:
    design = replace(tiny_design, mask=replace(tiny_design.mask, layer=65535))
    with pytest.raises(InputError, match=r"layers and datatypes of at most 32767 for 'gds', got layer 65535/0"):
        mask.write(tiny.pillars, tmp_path, design)
