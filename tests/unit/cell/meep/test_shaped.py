"""Curved, sloped and layered cells on the plain grid: volumes, order of the materials, and what fits no grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from metafab.cell import PillarCell
from metafab.cell.meep import solve
from metafab.cell.meep.protocol import Block
from metafab.cell.meep.shaped import base_pixels, is_shaped, shaped_plan
from metafab.cell.pillar import Slice
from metafab.cell.response import CellNumerics
from metafab.core.errors import InputError
from tests.paper_cell import SILICON

CIRCLE = replace(SILICON, shape="ellipse", width_nm=180.0, length_nm=180.0)


def blocks_of(cell: PillarCell, member: int = 1) -> tuple[Block, ...]:
    return shaped_plan(cell, "x", member, decay=1e-3, longest_time=1.0).job.blocks


def outline_of(block: Block) -> shapely.Polygon:
    return shapely.Polygon(block.outline) if block.outline else shapely.box(*block.low[:2], *block.high[:2])


def pillar_blocks(cell: PillarCell, member: int = 1) -> list[Block]:
    inside = complex(cell.n_pillar) ** 2
    return [block for block in blocks_of(cell, member) if block.epsilon[0] == pytest.approx(inside)]


@pytest.mark.parametrize(
    ("cell", "area_nm2"),
    [
        (CIRCLE, np.pi * 90.0**2),
        (replace(CIRCLE, length_nm=120.0), np.pi * 90.0 * 60.0),
        (replace(SILICON, width_nm=200.0, length_nm=120.0, corner_radius_nm=40.0), 24000.0 - (4 - np.pi) * 1600.0),
        (replace(SILICON, shape="cross", width_nm=200.0, length_nm=80.0), 2 * 16000.0 - 6400.0),
    ],
)
def test_outlines_have_the_area_and_extent_of_the_shape(cell: PillarCell, area_nm2: float) -> None:
    assert is_shaped(cell)
    union = shapely.union_all([outline_of(block) for block in pillar_blocks(cell)])
    # The straight sides of rounded rectangles are 2e-4 of the radius inside.
    assert 1e6 * union.area == pytest.approx(area_nm2, rel=2e-4 if cell.corner_radius_nm else 1e-9)
    extent = (cell.width_nm, cell.width_nm if cell.shape == "cross" else cell.length_nm)
    reach = 1e3 * np.array(union.bounds).reshape(2, 2)
    np.testing.assert_allclose(reach[1] - reach[0], extent, rtol=6e-4)
    np.testing.assert_allclose(reach.sum(axis=0), 0.0, atol=1e-9)


@pytest.mark.parametrize("angle_deg", [90.0, 86.0])
def test_a_ring_is_a_circle_with_a_block_of_the_ambient_in_it(angle_deg: float) -> None:
    """Both sides of a sloped wall recede alike, so that hole and outer diameter add up to the same at every height."""
    ring = replace(CIRCLE, shape="ring", hole_nm=70.0, sidewall_angle_deg=angle_deg)
    circles = [block for block in blocks_of(ring) if block.outline]
    assert len(circles) >= 2
    for outer, hole in zip(circles[::2], circles[1::2], strict=True):
        assert outer.epsilon[0] == pytest.approx(complex(ring.n_pillar) ** 2)
        assert hole.epsilon[0] == pytest.approx(complex(ring.n_ambient) ** 2)
        assert (hole.low[2], hole.high[2]) == (outer.low[2], outer.high[2])
        assert 1e3 * 2.0 * (hole.high[0] + outer.high[0]) == pytest.approx(250.0)
    middle = circles[len(circles) // 4 * 2]
    assert 2e3 * middle.high[0] == pytest.approx(180.0, abs=0.0 if angle_deg == 90.0 else 5.0)


def test_a_hole_that_a_sloped_wall_closes_has_no_block() -> None:
    """The hole of 20 nm at half height closes where the wall stands out by 10 nm."""
    ring = replace(CIRCLE, shape="ring", hole_nm=20.0, sidewall_angle_deg=86.0)
    circles = [block for block in blocks_of(ring) if block.outline]
    assert all(block.low[0] < 0.0 < block.high[0] for block in circles)
    holes = [block for block in circles if block.epsilon[0] == pytest.approx(complex(ring.n_ambient) ** 2)]
    assert 0 < len(holes) < len(circles) - len(holes)


def test_a_sloped_pillar_has_a_step_for_each_pixel_of_its_height() -> None:
    cell = replace(CIRCLE, sidewall_angle_deg=85.0)
    for member in (1, 2):
        run = shaped_plan(cell, "x", member, decay=1e-3, longest_time=1.0)
        steps = pillar_blocks(cell, member)
        assert len(steps) == round(0.6 / run.job.pixel_um)
        widths_nm = 1e3 * np.array([2.0 * block.high[0] for block in steps])
        heights = (np.arange(len(steps)) + 0.5) / len(steps)
        np.testing.assert_allclose(widths_nm, [cell.sizes_nm(share)[0] for share in heights])
        assert np.all(np.diff(widths_nm) < 0.0), "narrower upwards"
        tops = [block.high[2] for block in steps]
        assert tops[-1] - tops[0] + 0.6 / len(steps) == pytest.approx(0.6)


@pytest.mark.parametrize("side", ["substrate", "ambient"])
def test_layers_stack_in_the_order_of_the_light(side: str) -> None:
    """The permittivity along z through the axis and beside the pillar, later blocks first."""
    film, cap = Slice(50.0, 1.9 + 0j, 1.9 + 0j), Slice(40.0, 1.5 + 0j, 1.0 + 0j)
    cell = replace(CIRCLE, under=(film,), over=(cap,), side=side)  # type: ignore[arg-type]
    run = shaped_plan(cell, "x", 2, decay=1e-3, longest_time=1.0)
    start = run.near_um * -1.0 + (run.job.monitor_nodes[0] - run.job.n_z / 2) * run.job.pixel_um

    def index_at(x: float, z: float) -> float:
        for block in reversed(run.job.blocks):
            if block.low[2] < z < block.high[2] and outline_of(block).covers(shapely.Point(x, 0.0)):
                return float(np.sqrt(block.epsilon[0].real))
        return float(np.sqrt(run.job.epsilon_in[0].real))

    heights = np.array([-0.1, 0.025, 0.35, 0.67, 0.8])
    heights = heights if side == "substrate" else 0.69 - heights
    found = [[index_at(x, start + z) for z in heights] for x in (0.0, 0.15)]
    np.testing.assert_allclose(found[0], [1.7601, 1.9, complex(cell.n_pillar).real, 1.5, 1.0], rtol=1e-5)
    np.testing.assert_allclose(found[1], [1.7601, 1.9, 1.0, 1.0, 1.0], rtol=1e-5)
    assert (run.job.monitor_nodes[1] - run.job.monitor_nodes[0]) * run.job.pixel_um == pytest.approx(
        run.far_um - run.near_um + 0.69
    )


def test_periods_that_fit_no_grid_are_refused() -> None:
    assert base_pixels(CIRCLE) == (12, 12)
    assert base_pixels(replace(CIRCLE, period_nm=(300.0, 400.0))) == (12, 16)
    with pytest.raises(InputError, match="ratio is that of even numbers"):
        base_pixels(replace(CIRCLE, period_nm=(350.0, 351.0)))
    with pytest.raises(InputError, match="rectangular lattice"):
        solve(replace(CIRCLE, is_staggered=True), CellNumerics(solver="meep"))
    with pytest.raises(InputError, match=r"over\[0\]\.n"):
        solve(replace(CIRCLE, over=(Slice(20.0, 0.2 + 6.0j, 1.0 + 0j),)), CellNumerics(solver="meep"))
