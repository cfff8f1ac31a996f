"""Round, rounded and crossed pillars: drawn as polygons, read back as their sizes, and checked by the rules."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import gdstk
import numpy as np
import pytest

from metafab import drc, layout, mask
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.layout import Assignment, Outline
from metafab.library import Library
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Copy, Design, Dose, UnitCell
from tests.layout.conftest import sizes_at_sites

SHAPES: dict[str, dict[str, Any]] = {
    "ellipse": {"shape": "ellipse"},
    "cross": {"shape": "cross"},
    "rounded": {"corner_radius_nm": 30.0},
}


@pytest.fixture(scope="module", params=SHAPES)
def shaped(
    request: pytest.FixtureRequest, tiny_design: Design, smooth_library: Library, profile: PhaseProfile
) -> tuple[Design, Assignment]:
    """A design of ten micrometres with pillars of another shape, mapped."""
    cell = replace(tiny_design.unit_cell.cell, **SHAPES[request.param])
    unit_cell = replace(tiny_design.unit_cell, cell=cell)
    device = replace(tiny_design.device, aperture_um=10.0)
    mask_ = replace(tiny_design.mask, write_field_um=11.9, draw_corners=True)
    numerics = replace(tiny_design.numerics, tile_sites=17)
    design = replace(tiny_design, unit_cell=unit_cell, device=device, mask=mask_, numerics=numerics)
    return design, layout.assign(profile, _coarse(smooth_library, unit_cell), design)


def _coarse(library: Library, unit_cell: UnitCell) -> Library:
    """Every fifth width and length."""
    fields = ("t_xx", "t_yy", "r_xx", "r_yy", "error")
    return replace(
        library,
        unit_cell=unit_cell,
        width_nm=library.width_nm[::5],
        length_nm=library.length_nm[::5],
        **{name: getattr(library, name)[:, ::5, ::5] for name in fields},
    )


@pytest.fixture(scope="module")
def files(shaped: tuple[Design, Assignment], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    design, mapped = shaped
    written = mask.write(mapped.pillars, tmp_path_factory.mktemp("shaped"), design)
    return {file.path.suffix[1:]: file.path for file in written[:2]}


def _same(read_back: mask.ReadBack, mapped: Assignment) -> bool:
    leftovers = (read_back.off_site, read_back.off_grid, read_back.duplicates, *read_back.foreign.values())
    found, expected = sizes_at_sites(read_back.pillars), sizes_at_sites(mapped.pillars)
    return not any(one.count for one in leftovers) and np.array_equal(found, expected)


@pytest.mark.parametrize("suffix", ["gds", "oas"])
def test_sizes_are_read_back(suffix: str, shaped: tuple[Design, Assignment], files: dict[str, Path]) -> None:
    design, mapped = shaped
    assert mapped.figures.distinct_sizes > 10
    assert _same(mask.read(files[suffix], design), mapped)


@pytest.mark.parametrize("suffix", ["gds", "oas"])
def test_other_readers_see_the_polygons(
    suffix: str, shaped: tuple[Design, Assignment], files: dict[str, Path], tmp_path: Path
) -> None:
    design, mapped = shaped
    library = gdstk.read_gds(str(files[suffix])) if suffix == "gds" else gdstk.read_oas(str(files[suffix]))
    (top,) = library.top_level()
    assert top.name == mask.top_name(design.name)
    polygons = top.get_polygons(layer=design.mask.layer, datatype=design.mask.datatype)
    index = mapped.pillars.to_array()
    assert len(polygons) == np.count_nonzero(index)
    area = Outline.of(design).area(mapped.pillars.size_dbu)[index].sum()
    unit_um = design.mask.database_unit_nm * 1e-3
    # Each in micrometres, rounded to about 1e-10 of themselves when subtracted far from the origin.
    assert sum(polygon.area() for polygon in polygons) == pytest.approx(area * unit_um**2, rel=1e-8)
    # As a user's software might hand them on: flat, another unit, other first corners.
    kdb = pytest.importorskip("klayout.db")
    opened = kdb.Layout()
    opened.read(str(files[suffix]))
    opened.flatten(opened.top_cell().cell_index(), -1, True)
    fine = kdb.Layout()
    fine.dbu = opened.dbu / 4.0
    cell = fine.create_cell("OTHER")
    region = kdb.Region(opened.top_cell().begin_shapes_rec(opened.layer(1, 0)))
    region.transform(kdb.ICplxTrans(4.0))
    cell.shapes(fine.layer(1, 0)).insert(region)
    fine.write(str(tmp_path / f"other.{suffix}"))
    assert _same(mask.read(tmp_path / f"other.{suffix}", design), mapped)


def test_the_rules_are_kept_and_faults_are_found(
    shaped: tuple[Design, Assignment], files: dict[str, Path], tmp_path: Path
) -> None:
    pytest.importorskip("klayout.db")
    design, mapped = shaped
    for suffix, path in files.items():
        report = drc.check(path, design)
        assert report.clean, (suffix, report.violations)
        assert report.min_gap_nm == mapped.figures.min_gap_nm >= design.rules.min_gap_nm
    assert drc.check(files["oas"], design, engine="polygons", work=Work(1)).clean
    with pytest.raises(InputError, match="pillars of another shape"):
        drc.check(files["oas"], design, engine="rectangles")
    # KLayout lists each pair of sides that are too near, of which two round pillars have several.
    near = replace(design, rules=replace(design.rules, min_gap_nm=mapped.figures.min_gap_nm + 6.0))
    found = drc.check(files["oas"], near).violations["min_gap"]
    assert drc.check(files["oas"], near, engine="polygons", work=Work(1)).violations["min_gap"] >= found > 0

    # Two more shapes: a rectangle, which is no pillar here, and a pentagon.
    library = gdstk.read_oas(str(files["oas"]))
    (top,) = library.top_level()
    (box,) = {tuple(np.round(corner, 6)) for corner in [top.bounding_box()[1]]}
    top.add(gdstk.rectangle((0.0, 0.0), (0.11, 0.13), layer=1))
    top.add(gdstk.regular_polygon((box[0] + 1.0, 0.0), 0.1, 5, layer=1))
    library.write_oas(str(tmp_path / "faults.oas"), compression_level=6)
    read_back = mask.read(tmp_path / "faults.oas", design)
    assert sum(shapes.count for shapes in read_back.foreign.values()) == 2
    assert drc.check(tmp_path / "faults.oas", design).violations["foreign"] == 2


@pytest.mark.parametrize("suffix", ["gds", "oas"])
def test_options_draw_them_too(suffix: str, shaped: tuple[Design, Assignment], tmp_path: Path) -> None:
    """Dose classes, a bias, two copies, and all of it in one cell."""
    design, mapped = shaped
    copies = (Copy(at_um=(-20.0, 0.0)), Copy(at_um=(20.0, 0.0), bias_nm=-4.0))
    drawn = replace(design.mask, copies=copies, dose=Dose(by="size", classes=3), bias_nm=2.0, formats=(suffix,))
    for flat in (False, True):
        changed = replace(design, mask=replace(drawn, flat=flat))
        folder = tmp_path / str(flat)
        (file, *_) = mask.write(mapped.pillars, folder, changed)
        again = mask.write(mapped.pillars, tmp_path / "again", changed)[0]
        assert file.path.read_bytes() == again.path.read_bytes()
        for number, bias_nm in ((1, 2.0), (2, -2.0)):
            read_back = mask.read(file.path, changed, copy=number)
            count = np.count_nonzero(mapped.pillars.to_array())
            assert list(read_back.other_copies.values()) == [count]
            expected = sizes_at_sites(mask.biased(mapped.pillars, bias_nm))
            assert np.array_equal(sizes_at_sites(read_back.pillars), expected)
            assert not read_back.foreign


def test_the_field_around_them_is_no_sum_of_rectangles(shaped: tuple[Design, Assignment], tmp_path: Path) -> None:
    design, mapped = shaped
    with pytest.raises(InputError, match=r"rectangular pillars|rectangular lattice"):
        mask.write(mapped.pillars, tmp_path, replace(design, mask=replace(design.mask, tone="inverted")))


@pytest.mark.parametrize("suffix", ["gds", "oas"])
def test_rings_keep_their_rules_and_are_read_back(
    suffix: str, tiny_design: Design, smooth_library: Library, profile: PhaseProfile, tmp_path: Path
) -> None:
    """Walls of 60 nm, drawn 4 nm thicker; a rule of 90 nm finds each hole that is narrower."""
    geometry = replace(tiny_design.unit_cell.cell, shape="ring", wall_nm=60.0)
    unit_cell = replace(
        tiny_design.unit_cell,
        cell=geometry,
        sweep=replace(tiny_design.unit_cell.sweep, width_nm=(150.0, 250.0), length_nm=(150.0, 250.0)),
    )
    design = replace(
        tiny_design,
        unit_cell=unit_cell,
        device=replace(tiny_design.device, aperture_um=10.0),
        rules=replace(tiny_design.rules, min_gap_nm=40.0, min_feature_nm=62.0),
        mask=replace(tiny_design.mask, write_field_um=11.9, bias_nm=4.0, formats=(suffix,)),
    )
    library = _coarse(smooth_library, unit_cell)
    diagonal = library.width_nm == library.length_nm[:, None]
    mapped = layout.assign(profile, replace(library, error=np.where(diagonal, library.error, np.nan)), design)
    drawn = mask.biased(mapped.pillars, 4.0)
    path = mask.write(mapped.pillars, tmp_path, design)[0].path
    read_back = mask.read(path, design)
    assert np.array_equal(sizes_at_sites(read_back.pillars), sizes_at_sites(drawn))
    assert not read_back.foreign
    used = sizes_at_sites(drawn)[..., 0] * design.mask.database_unit_nm
    assert used[used > 0].min() >= 40.0 + 2 * 64.0
    near = replace(design, rules=replace(design.rules, min_gap_nm=90.0))
    holes = np.count_nonzero((used > 0) & (used - 2 * 64.0 < 90.0))
    assert 0 < holes < np.count_nonzero(used)
    report = drc.check(path, design)
    assert report.clean
    # The mapping states the gap of the standing pillars, the check that of the drawn ones, which are 4 nm larger.
    assert report.min_gap_nm is not None and mapped.figures.min_gap_nm is not None
    assert report.min_gap_nm == pytest.approx(mapped.figures.min_gap_nm - 4.0, abs=1e-6)
    assert drc.check(path, near).violations["min_gap"] == holes
    library_ = gdstk.read_gds(str(path)) if suffix == "gds" else gdstk.read_oas(str(path))
    area = sum(polygon.area() for polygon in library_.top_level()[0].get_polygons(layer=1, datatype=0))
    walls_um2 = np.pi * 0.064 * (used[used > 0] - 64.0).sum() * 1e-3
    assert area == pytest.approx(walls_um2, rel=0.02)
    pytest.importorskip("klayout.db")
    assert drc.check(path, design, engine="polygons", work=Work(1)).clean
    assert drc.check(path, near, engine="polygons", work=Work(1)).violations["min_gap"] >= holes
    for change, message in (
        ({"rules": replace(design.rules, min_feature_nm=70.0)}, "rules.min_feature_nm"),
        ({"mask": replace(design.mask, bias_nm=3.75)}, "multiple of 0.5 nm"),
        ({"mask": replace(design.mask, bias_nm=-60.0)}, "must be above 0, got 0 nm"),
        ({"mask": replace(design.mask, copies=(Copy(at_um=(0.0, 0.0), bias_nm=2.0),))}, "mask.copies"),
        ({"rules": replace(design.rules, cd_sigma_nm=3.0)}, "rules.cd_sigma_nm"),
        ({"rules": replace(design.rules, max_aspect_ratio=9.9)}, "rules.max_aspect_ratio.*at least 10,"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(design, **change)


def test_a_turned_cross_is_the_same_cross(tiny_design: Design, smooth_library: Library, profile: PhaseProfile) -> None:
    cell = replace(tiny_design.unit_cell, cell=replace(tiny_design.unit_cell.cell, shape="cross"))
    design = replace(tiny_design, unit_cell=cell, device=replace(tiny_design.device, aperture_um=8.0))
    mapped = layout.assign(profile, replace(smooth_library, unit_cell=cell), design)
    size = mapped.pillars.size_dbu
    assert np.all(size[:, 0] >= size[:, 1])
    assert np.any(size[:, 0] > size[:, 1])


def test_corners_that_fabrication_rounds_are_not_drawn(tiny_design: Design) -> None:
    cell = replace(tiny_design.unit_cell.cell, corner_radius_nm=30.0)
    printed = replace(tiny_design, unit_cell=replace(tiny_design.unit_cell, cell=cell))
    drawn = replace(printed, mask=replace(printed.mask, draw_corners=True))
    assert Outline.of(printed).is_rectangle
    assert Outline.of(drawn).shape == "rounded"


@pytest.mark.parametrize("flat", [False, True])
def test_a_layer_that_gdsii_cannot_hold_is_refused(
    flat: bool, shaped: tuple[Design, Assignment], tmp_path: Path
) -> None:
    design, mapped = shaped
    beyond = replace(design, mask=replace(design.mask, layer=2**15, flat=flat, formats=("gds",)))
    with pytest.raises(InputError, match="32768/"):
        mask.write(mapped.pillars, tmp_path, beyond)
    assert not list(tmp_path.iterdir())
