"""Hexagonal lattices: sites, gaps and mapping against plain geometry; mask, rules and reading back; their optics."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import STRtree
from shapely.geometry import box

from metafab import drc, layout, mask
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.layout import Aperture, Assignment, Lattice, field_sites, lattice_of, smallest_gap, tile_sites
from metafab.library import Library
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design, load_design
from metafab.spec.cell import CellGeometry
from tests.conftest import ROOT
from tests.gaps_by_numpy import gaps_by_numpy
from tests.layout.conftest import sizes_at_sites

SIZES = np.array([[0, 0], [20, 20], [50, 20], [20, 50], [50, 50], [80, 60]], dtype=np.int32)


def _hexagonal(design: Design, **changes: object) -> Design:
    cell = replace(design.unit_cell.cell, lattice="hexagonal", period_nm=350.0)
    return replace(design, unit_cell=replace(design.unit_cell, cell=cell), **changes)


@pytest.fixture(scope="module")
def design(tiny_design: Design) -> Design:
    return _hexagonal(tiny_design)


@pytest.fixture(scope="module")
def library(smooth_library: Library, design: Design) -> Library:
    return replace(smooth_library, unit_cell=design.unit_cell)


@pytest.fixture(scope="module")
def mapped(profile: PhaseProfile, library: Library, design: Design) -> Assignment:
    return layout.assign(profile, library, design)


@pytest.fixture(scope="module")
def files(mapped: Assignment, design: Design, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("hexagonal")
    return {file.path.suffix[1:]: file.path for file in mask.write(mapped.pillars, folder, design)}


def test_rows_are_a_whole_nanometre_and_nearly_regular() -> None:
    cell = CellGeometry(period_nm=350.0, height_nm=600.0, lattice="hexagonal")  # type: ignore[arg-type]
    assert cell.period_nm == (350.0, 303.0)
    assert abs(303.0 / (350.0 * math.sqrt(3.0) / 2.0) - 1.0) < 4e-4
    assert CellGeometry(period_nm=(350.0, 303.5), height_nm=600.0, lattice="hexagonal").period_nm == (350.0, 303.5)
    with pytest.raises(InputError, match="within 1 %"):
        CellGeometry(period_nm=(350.0, 330.0), height_nm=600.0, lattice="hexagonal")


def test_every_site_has_six_neighbours_a_period_away(design: Design) -> None:
    lattice = lattice_of(design)
    rows, columns = np.nonzero(lattice.carries(np.arange(lattice.shape[0]), np.arange(lattice.shape[1])))
    places = np.stack([lattice.x_um()[columns], lattice.y_um()[rows]], axis=1)
    middle = places[np.argmin(np.hypot(*places.T))]
    distance = np.sort(np.hypot(*(places - middle).T))
    # The rows' rounding moves four of the six by less than 0.1 nm.
    assert distance[1:7] == pytest.approx(0.35, abs=1e-4)
    assert distance[7] > 0.6
    # The lattice is its own point mirror image: the y polarisation's phase is the mirror of x.
    assert {tuple(p) for p in np.round(places, 4).tolist()} == {tuple(p) for p in np.round(0.0 - places, 4).tolist()}


@pytest.mark.parametrize(
    "device",
    [
        {"aperture_shape": "circle"},
        {"aperture_shape": "square"},
        {"aperture_shape": "ring", "inner_um": 11.0},
        {"aperture_shape": "polygon", "outline_um": ((-19.0, -18.0), (17.5, -16.0), (3.0, 19.9))},
    ],
)
def test_a_site_is_inside_exactly_if_its_whole_cell_is(design: Design, device: dict[str, object]) -> None:
    cut = replace(design, device=replace(design.device, **device))
    aperture = Aperture.of(cut)
    lattice = aperture.lattice
    inside = aperture.inside(0, 0, lattice.shape)
    assert aperture.count == np.count_nonzero(inside)
    assert not np.any(inside & ~lattice.carries(*map(np.arange, lattice.shape)))
    cell_um = np.multiply(lattice.cell_dbu, 0.5e-3)
    whole = np.array(
        [[_holds(cut, x, y, cell_um) for x in lattice.x_um()] for y in lattice.y_um()[::9]]
    ) & lattice.carries(np.arange(lattice.shape[0])[::9], np.arange(lattice.shape[1]))
    assert np.array_equal(inside[::9], whole)


def _holds(design: Design, x: float, y: float, cell_um: np.ndarray) -> bool:
    """Whether the cell about a place lies in the aperture, by plain geometry."""
    device, cell = design.device, box(*(np.array([x, y]) - cell_um / 2), *(np.array([x, y]) + cell_um / 2))
    far = np.hypot(abs(x) + cell_um[0] / 2, abs(y) + cell_um[1] / 2)
    near = np.hypot(*np.maximum(np.abs([x, y]) - cell_um / 2, 0.0))
    if device.aperture_shape == "square":
        return bool(max(np.abs([x, y]) + cell_um / 2) <= device.aperture_um / 2 + 1e-9)
    if device.aperture_shape == "polygon":
        from shapely import Polygon

        return bool(Polygon(device.outline_um).buffer(1e-9).contains(cell))
    return bool(far <= device.aperture_um / 2 + 1e-9 and near >= device.inner_um / 2 - 1e-9)


def test_fields_are_whole_tiles(design: Design) -> None:
    across, along = field_sites(design)
    assert across == 2 * 1428
    assert along * 303.0 <= 499_800.0 < 2 * along * 303.0
    assert across % tile_sites(design) == along % tile_sites(design) == 0


def test_an_odd_period_is_refused(design: Design) -> None:
    cell = replace(design.unit_cell.cell, period_nm=(350.5, 303.5))
    with pytest.raises(InputError, match="even number of database units"):
        lattice_of(replace(design, unit_cell=replace(design.unit_cell, cell=cell)))


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), limit=st.sampled_from([15.0, 20.0, 31.0, 40.0]), rows=st.integers(1, 7))
def test_all_pairs_are_judged_as_by_plain_geometry(seed: int, limit: float, rows: int) -> None:
    lattice = Lattice(period_dbu=(40, 60), shape=(7, 9), database_unit_nm=5.0, hexagonal=True)
    carries = lattice.carries(np.arange(7), np.arange(9))
    block = (np.random.default_rng(seed).integers(0, len(SIZES), (7, 9)) * carries).astype(np.uint16)
    found = smallest_gap(block, SIZES, lattice, limit)
    at = list(zip(*np.nonzero(block), strict=True))
    pillars = [
        box(40 * c - w / 2, 60 * r - h / 2, 40 * c + w / 2, 60 * r + h / 2)
        for r, c in at
        for w, h in [SIZES[block[r, c]]]
    ]
    distances = [a.distance(b) for i, a in enumerate(pillars) for b in pillars[:i]]
    assert found.below == sum(d < limit for d in distances)
    assert found.overlapping == sum(d == 0.0 for d in distances)
    plain = gaps_by_numpy(block, SIZES, lattice, limit, rows)
    compiled = smallest_gap(block, SIZES, lattice, limit, rows)
    assert compiled.smallest_dbu == plain.smallest_dbu
    assert np.array_equal(compiled.too_small, plain.too_small)
    assert np.array_equal(compiled.neighbour, plain.neighbour)


def test_mapping_fills_the_aperture_and_keeps_the_gap(mapped: Assignment, design: Design) -> None:
    aperture = Aperture.of(design)
    assert np.array_equal(mapped.pillars.to_array() > 0, aperture.inside(0, 0, aperture.lattice.shape))
    # A circle of 40 um less half a ring of cells along the rim: within 2 %.
    area_um2 = aperture.lattice.cell_um2 * mapped.figures.pillars
    assert area_um2 == pytest.approx(math.pi * 19.8**2, rel=0.02)
    assert mapped.figures.min_gap_nm >= 100.0
    assert _smallest_distance_nm(mapped) == pytest.approx(mapped.figures.min_gap_nm, abs=1e-6)


def _smallest_distance_nm(mapped: Assignment) -> float:
    """Over all pairs of rectangles, by Shapely."""
    lattice, index = mapped.pillars.lattice, mapped.pillars.to_array()
    row, column = np.nonzero(index)
    half = mapped.pillars.size_nm()[index[row, column]] / 2.0
    centre = 1e3 * np.stack([lattice.x_um()[column], lattice.y_um()[row]], axis=1)
    boxes = np.array([box(*low, *high) for low, high in zip(centre - half, centre + half, strict=True)])
    tree = STRtree(boxes)
    near = tree.query(boxes, predicate="dwithin", distance=250.0)
    near = near[:, near[0] < near[1]]
    return float(min(boxes[i].distance(boxes[j]) for i, j in near.T))


@pytest.mark.parametrize("tile_sites", [17, 51, 476])
def test_tiling_changes_nothing(
    tile_sites: int, mapped: Assignment, profile: PhaseProfile, library: Library, design: Design
) -> None:
    tiled = replace(design, numerics=replace(design.numerics, tile_sites=tile_sites))
    other = layout.assign(profile, library, tiled)
    assert np.array_equal(other.pillars.to_array(), mapped.pillars.to_array())
    assert other.figures.min_gap_nm == mapped.figures.min_gap_nm


def test_pairs_chosen_jointly_keep_the_gap_and_gain(profile: PhaseProfile, library: Library, design: Design) -> None:
    rules = replace(design.rules, min_gap_nm=130.0, gap_rule="pairs")
    joint = layout.assign(profile, library, replace(design, rules=rules))
    assert joint.gap_rule_each is not None
    assert joint.figures.min_gap_nm >= 130.0
    assert _smallest_distance_nm(joint) >= 130.0 - 1e-6
    assert joint.figures.efficiency > joint.gap_rule_each.efficiency
    assert joint.pillars.size_dbu[joint.pillars.to_array()].max(axis=(0, 1)).max() > 2 * (303.0 - 130.0)
    tiled = replace(design, rules=rules, numerics=replace(design.numerics, tile_sites=17))
    assert np.array_equal(layout.assign(profile, library, tiled).pillars.to_array(), joint.pillars.to_array())


@pytest.mark.parametrize("suffix", ["gds", "oas"])
def test_the_written_file_reads_back_and_is_clean(
    suffix: str, mapped: Assignment, design: Design, files: dict[str, Path]
) -> None:
    back = mask.read(files[suffix], design)
    assert np.array_equal(sizes_at_sites(back.pillars), sizes_at_sites(mapped.pillars))
    assert back.off_site.count == back.duplicates.count == back.off_grid.count == 0
    for engine in ("lattice", "rectangles"):
        report = drc.check(files[suffix], design, engine=engine)
        assert report.clean
        assert report.pillars == mapped.figures.pillars
        assert report.min_gap_nm == mapped.figures.min_gap_nm


def test_klayout_sees_the_same(mapped: Assignment, design: Design, files: dict[str, Path]) -> None:
    pytest.importorskip("klayout.db")
    report = drc.check(files["oas"], design, engine="polygons", work=Work(1))
    assert report.clean
    assert report.pillars == mapped.figures.pillars


def test_planted_faults_are_found(mapped: Assignment, design: Design, tmp_path: Path) -> None:
    """Between the sites, gone, and too near across a diagonal."""
    kdb = pytest.importorskip("klayout.db")
    (oasis,) = (file.path for file in mask.write(mapped.pillars, tmp_path, design) if file.path.suffix == ".oas")
    drawn = kdb.Layout()
    drawn.read(str(oasis))
    drawn.flatten(drawn.top_cell().cell_index(), -1, True)
    shapes = drawn.top_cell().shapes(drawn.layer(1, 0))
    x, y = mapped.pillars.lattice.x_dbu(), mapped.pillars.lattice.y_dbu()

    def pillar(row: int, column: int) -> object:
        (found,) = shapes.each_touching(kdb.Box(int(x[column]), int(y[row]), int(x[column]), int(y[row])))
        return found

    for row, column in ((60, 100), (61, 101)):
        centre = kdb.Vector(int(x[column]), int(y[row]))
        pillar(row, column).box = kdb.Box(-170, -210, 170, 210).moved(centre)  # 186 units apart along y
    pillar(80, 80).delete()
    aside = pillar(90, 90)
    aside.transform(kdb.Trans(int(x[91] - x[90]), 0))  # a site of the grid, but none of the lattice
    path = tmp_path / "planted.oas"
    drawn.write(str(path))
    found = {rule: count for rule, count in drc.check(path, design).violations.items() if count}
    assert found == {"min_gap": 1, "missing": 2, "lattice_site": 1}
    assert drc.check(path, design, engine="rectangles").violations["min_gap"] >= 1


def test_the_example_is_ready_to_be_mapped() -> None:
    """Its library takes a solver: here only what the mapping asks of the design."""
    design = load_design(ROOT / "layouts" / "hexagonal_metalens.toml")
    lattice, (across, along), tile = lattice_of(design), field_sites(design), tile_sites(design)
    assert lattice.hexagonal
    assert lattice.cell_dbu == (760, 658)
    assert across % tile == along % tile == 0
    assert across == 260  # 130 periods
    assert Aperture.of(design).count == pytest.approx(np.pi * 50.0**2 / lattice.cell_um2, rel=0.02)
