"""Rings and polygons: site by site against the rule in words, counts against areas, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from metafab.core.errors import InputError
from metafab.layout import Aperture, Lattice, lattice_of
from metafab.spec import Design
from metafab.steps.preflight import preflight


def _with(design: Design, **device: Any) -> Design:
    return replace(design, device=replace(design.device, **device))


def _cells_um(lattice: Lattice) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Centres (n_y, n_x) of all sites and the half periods, in database units."""
    x, y = np.meshgrid(lattice.x_dbu(), lattice.y_dbu())
    return x, y, lattice.period_dbu[0] / 2, lattice.period_dbu[1] / 2


@given(outer_nm=st.integers(2000, 30_000), share=st.floats(0.01, 0.99))
def test_a_ring_holds_the_cells_between_two_circles(small_design: Design, outer_nm: int, share: float) -> None:
    inner_nm = max(1, int(share * outer_nm))
    design = _with(small_design, aperture_shape="ring", aperture_um=outer_nm * 1e-3, inner_um=inner_nm * 1e-3)
    x, y, half_x, half_y = _cells_um(lattice_of(design))
    far = np.hypot(np.abs(x) + half_x, np.abs(y) + half_y)
    near = np.hypot(np.maximum(np.abs(x) - half_x, 0.0), np.maximum(np.abs(y) - half_y, 0.0))
    # Diameters are 2 dbu a nm, radii 1. Exact sums below 1e10: a root errs by 1e-12 only, squares are compared.
    inside = (np.rint(far**2) <= outer_nm**2) & (np.rint(near**2) >= inner_nm**2)
    if not inside.any():
        with pytest.raises(InputError, match="room for a unit cell"):
            Aperture.of(design)
        return
    aperture = Aperture.of(design)
    assert np.array_equal(aperture.inside(0, 0, aperture.lattice.shape), inside)
    assert aperture.count == np.count_nonzero(inside)


def _star(radii_um: list[float]) -> tuple[tuple[float, float], ...]:
    """A polygon that sees its centre from everywhere, so its edges never cross; vertices on whole nanometres."""
    turns = 2.0 * np.pi * np.arange(len(radii_um)) / len(radii_um)
    return tuple((round(r * math.cos(a), 3), round(r * math.sin(a), 3)) for r, a in zip(radii_um, turns, strict=True))


@settings(max_examples=40)
@given(radii_um=st.lists(st.floats(0.5, 5.9), min_size=3, max_size=9), shift=st.floats(-3.0, 3.0))
def test_a_polygon_holds_the_cells_that_shapely_finds_in_it(
    small_design: Design, radii_um: list[float], shift: float
) -> None:
    outline = tuple((x + round(shift, 3), y) for x, y in _star(radii_um))
    polygon = shapely.Polygon([(2e3 * x, 2e3 * y) for x, y in outline])
    assume(polygon.is_valid and polygon.area > 0.0)
    design = _with(small_design, aperture_shape="polygon", aperture_um=18.0, outline_um=outline)
    x, y, half_x, half_y = _cells_um(lattice_of(design))
    # Shrunk and grown by a thousandth of a unit: shapely decides in floating point.
    surely, perhaps = (
        shapely.covers(polygon, shapely.box(x - half_x + e, y - half_y + e, x + half_x - e, y + half_y - e))
        for e in (-1e-3, 1e-3)
    )
    assume(np.any(surely))  # an aperture without any site is refused
    aperture = Aperture.of(design)
    inside = aperture.inside(0, 0, aperture.lattice.shape)
    assert not np.any(inside & ~perhaps)
    assert not np.any(surely & ~inside)


def test_notches_and_teeth_make_several_runs_a_row(small_design: Design) -> None:
    """A comb with edges along cell borders: the count is exact."""
    comb = [(-3.5, -3.5), (3.5, -3.5), (3.5, 3.5), (2.1, 3.5), (2.1, 0.0), (0.7, 0.0), (0.7, 3.5), (-0.7, 3.5)]
    comb += [(-0.7, 0.0), (-2.1, 0.0), (-2.1, 3.5), (-3.5, 3.5)]
    aperture = Aperture.of(_with(small_design, aperture_shape="polygon", aperture_um=7.0, outline_um=tuple(comb)))
    assert aperture.lattice.shape == (20, 20)
    assert aperture.count == 20 * 10 + 3 * 4 * 10
    assert np.array_equal(aperture.last[:, 15] - aperture.first[:, 15], [4, 4, 4])


@pytest.mark.parametrize(
    ("device", "area_um2", "rim_um"),
    [
        ({"aperture_shape": "circle"}, math.pi * 1e4, 200.0 * math.pi),
        ({"aperture_shape": "square"}, 4e4, 800.0),
        ({"aperture_shape": "ring", "inner_um": 100.0}, math.pi * 0.75e4, 300.0 * math.pi),
        ({"aperture_shape": "polygon", "outline_um": ((-90.0, -80.0), (95.0, -70.0), (10.0, 99.0))}, None, None),
    ],
)
def test_counts_are_areas_less_the_rim(
    small_design: Design, device: dict[str, Any], area_um2: float | None, rim_um: float | None
) -> None:
    """A rim of length s loses between none and all of the cells that it cuts, at most s sqrt(2) p of area."""
    design = _with(small_design, aperture_um=200.0, **device)
    if area_um2 is None:
        polygon = shapely.Polygon(design.device.outline_um)
        area_um2, rim_um = polygon.area, polygon.length
    covered_um2 = Aperture.of(design).count * 0.35**2
    assert rim_um is not None
    assert area_um2 - rim_um * math.sqrt(2.0) * 0.35 < covered_um2 <= area_um2
    # Cell centres inside the aperture are at least as many as whole cells.
    lattice = Aperture.of(design).lattice
    assert np.count_nonzero(design.device.encloses(lattice.x_um(), lattice.y_um())) >= Aperture.of(design).count


@given(row=st.integers(0, 50), column=st.integers(0, 50), sites=st.integers(1, 9))
def test_blocks_and_tiles_are_parts_of_the_whole(small_design: Design, row: int, column: int, sites: int) -> None:
    aperture = Aperture.of(_with(small_design, aperture_shape="ring", aperture_um=20.0, inner_um=12.0))
    whole = aperture.inside(0, 0, aperture.lattice.shape)
    rows, columns = np.minimum([row, column], np.array(whole.shape) - sites)
    block = whole[rows : rows + sites, columns : columns + sites]
    assert np.array_equal(aperture.inside(int(rows), int(columns), block.shape), block)
    assert aperture.meets(int(rows), int(columns), sites) == block.any()


@pytest.mark.parametrize(
    ("device", "message"),
    [
        ({"aperture_shape": "ring"}, "`inner_um`"),
        ({"aperture_shape": "ring", "inner_um": 300.0}, "`inner_um`"),
        ({"inner_um": 10.0}, "`inner_um`"),
        ({"aperture_shape": "polygon"}, "`outline_um`"),
        ({"outline_um": ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))}, "`outline_um`"),
        ({"aperture_shape": "polygon", "outline_um": ((0.0, 0.0), (1.0, 0.0))}, "do not cross"),
        ({"aperture_shape": "polygon", "outline_um": ((0.0, 0.0), (1.0, 1.0), (2.0, 2.0))}, "do not cross"),
        ({"aperture_shape": "polygon", "outline_um": ((0.0, 0.0), (9.0, 9.0), (9.0, 0.0), (0.0, 9.0))}, "do not cross"),
        ({"aperture_shape": "polygon", "outline_um": ((0.0, 0.0), (101.0, 0.0), (0.0, 9.0))}, "within the square"),
    ],
)
def test_outlines_that_make_no_aperture_are_refused(small_design: Design, device: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        _with(small_design, **device)


@pytest.mark.parametrize(
    "device",
    [
        {"aperture_um": 0.4},  # a circle about the one cell whose corners it cuts off
        {"aperture_shape": "ring", "aperture_um": 21.3, "inner_um": 21.2},
        {"aperture_shape": "polygon", "aperture_um": 21.3, "outline_um": ((-5.0, 0.0), (5.0, 0.1), (5.0, 0.0))},
    ],
)
def test_an_aperture_without_a_site_is_refused_before_any_step(small_design: Design, device: dict[str, Any]) -> None:
    empty = _with(small_design, **device)
    with pytest.raises(InputError, match="room for a unit cell of 350 x 350 nm"):
        Aperture.of(empty)
    with pytest.raises(InputError, match="room for a unit cell"):
        preflight(empty)


@pytest.mark.parametrize(
    ("aperture_um", "unit_nm", "message"),
    [
        (2000.0, 0.001, "at most 32768 units across the unit cell"),
        (150_000.0, 0.05, "at most 2147483648 units across the aperture"),
    ],
)
def test_units_too_small_for_the_numbers_of_a_mask_are_refused(
    small_design: Design, aperture_um: float, unit_nm: float, message: str
) -> None:
    fine = replace(small_design, mask=replace(small_design.mask, database_unit_nm=unit_nm))
    with pytest.raises(InputError, match=message):
        Aperture.of(_with(fine, aperture_um=aperture_um))


def test_the_largest_aperture_in_units_is_counted(small_design: Design) -> None:
    """2^31 units across: squares of 64 bits still hold."""
    fine = replace(small_design, mask=replace(small_design.mask, database_unit_nm=0.05))
    largest_um = 2**31 * 0.05e-3
    aperture = Aperture.of(_with(fine, aperture_um=largest_um))
    # pi R^2 over the cell's area, less half a ring of cells along the rim.
    assert aperture.count == pytest.approx(math.pi / 4 * (largest_um / 0.35) ** 2, rel=2e-5)
