"""Pillars to gdstk and back: the same pillars, wherever the cell was placed in a chip."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gdstk
import numpy as np
import pytest

from metafab import mask
from metafab.layout import Assignment, Outline, PillarMap, lattice_of
from metafab.spec import Design
from tests.layout.conftest import sizes_at_sites


def _random_pillars(design: Design, seed: int = 1) -> PillarMap:
    """Random even sizes at nine of ten sites."""
    lattice, generator = lattice_of(design), np.random.default_rng(seed)
    sides = np.arange(200, 502, 2, dtype=np.int32)
    size_dbu = np.concatenate([[[0, 0]], generator.choice(sides, (400, 2))]).astype(np.int32)
    index = generator.integers(1, 401, lattice.shape).astype(np.uint16)
    index[generator.random(lattice.shape) < 0.1] = 0
    return PillarMap.from_array(lattice, size_dbu, index, 64)


def test_a_hundred_thousand_pillars_survive_gdstk(tiny_design: Design) -> None:
    design = replace(tiny_design, device=replace(tiny_design.device, aperture_um=120.0, aperture_shape="square"))
    pillars = _random_pillars(design)
    assert np.count_nonzero(pillars.to_array()) > 1e5
    cell = pillars.to_gdstk()
    assert len(cell.polygons) <= 400
    back = mask.from_gdstk(cell, design)
    assert (back.off_site.count, back.off_grid.count, back.duplicates.count, back.foreign) == (0, 0, 0, {})
    assert np.array_equal(sizes_at_sites(back.pillars), sizes_at_sites(pillars))


def test_a_lens_within_a_chip_is_found(tiny: Assignment, tiny_design: Design) -> None:
    lens = tiny.pillars.to_gdstk("lens", layer=tiny_design.mask.layer)
    chip = gdstk.Cell("chip")
    chip.add(gdstk.Reference(lens), gdstk.rectangle((500, 500), (600, 600), layer=99))
    back = mask.from_gdstk(chip, tiny_design)
    assert np.array_equal(sizes_at_sites(back.pillars), sizes_at_sites(tiny.pillars))
    assert back.other_layers == {"99/0": 1}


def test_the_area_of_round_pillars_is_that_of_their_outline(tiny: Assignment, tiny_design: Design) -> None:
    outline = Outline("ellipse", tiny_design.mask.database_unit_nm)
    cell = tiny.pillars.to_gdstk(outline=outline)
    index = tiny.pillars.to_array()
    expected_um2 = outline.area(tiny.pillars.size_dbu)[index].sum() * (1e-3 * outline.database_unit_nm) ** 2
    assert cell.area() == pytest.approx(expected_um2, rel=1e-9)


def test_klayout_reads_what_gdstk_writes_of_it(tiny: Assignment, tiny_design: Design, tmp_path: Path) -> None:
    kdb = pytest.importorskip("klayout.db")
    library = gdstk.Library(unit=1e-6, precision=tiny_design.mask.database_unit_nm * 1e-9)
    library.add(tiny.pillars.to_gdstk())
    library.write_oas(tmp_path / "lens.oas")
    layout = kdb.Layout()
    layout.read(str(tmp_path / "lens.oas"))
    region = kdb.Region(layout.top_cell().begin_shapes_rec(layout.layer(1, 0)))
    assert region.count() == np.count_nonzero(tiny.pillars.to_array())


def test_an_empty_map_is_an_empty_cell(tiny: Assignment) -> None:
    lattice = tiny.pillars.lattice
    empty = PillarMap.from_array(lattice, tiny.pillars.size_dbu, np.zeros(lattice.shape, dtype=np.uint16), 64)
    assert empty.to_gdstk().polygons == []
