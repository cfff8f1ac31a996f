"""Polygons of round and crossed pillars: how near they are to the curve, their symmetry and their gaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from shapely import affinity
from shapely.geometry import Point, Polygon, box

from metafab.layout import Lattice, Outline, smallest_gap
from metafab.layout.outlines import CHORD_NM, canonical_polygon, polygon_area

OUTLINES = [Outline("ellipse", 0.5), Outline("rounded", 0.5, 60.0), Outline("cross", 0.5), Outline("rectangle", 0.5)]
SIDES = st.integers(40, 350).map(lambda half: 2 * half)


def _true(outline: Outline, width: float, length: float) -> Polygon:
    """The curve itself, by shapely, to a hundred thousandth of its size."""
    rectangle = box(-width / 2, -length / 2, width / 2, length / 2)
    if outline.shape == "ellipse":
        return affinity.scale(Point(0, 0).buffer(1.0, quad_segs=400), width / 2, length / 2)
    if outline.shape == "rounded":
        radius = min(outline.radius_dbu, width / 2, length / 2)
        core = box(radius - width / 2, radius - length / 2, width / 2 - radius, length / 2 - radius)
        return core.buffer(radius, quad_segs=400)
    return rectangle.union(affinity.rotate(rectangle, 90)) if outline.shape == "cross" else rectangle


@pytest.mark.parametrize("outline", OUTLINES, ids=lambda outline: outline.shape)
@settings(max_examples=40)
@given(width=SIDES, length=SIDES)
def test_polygons_keep_to_the_curve_on_the_grid(outline: Outline, width: int, length: int) -> None:
    vertices = outline.vertices(width, length)
    polygon, true = Polygon(vertices), _true(outline, width, length)
    assert vertices.dtype.kind == "i"
    assert polygon.is_valid
    largest_dbu = outline.tolerance_nm / outline.database_unit_nm
    # Of shapely's own polygon for the curve.
    slack = 1e-5 * max(width, length)
    assert polygon.exterior.hausdorff_distance(true.exterior) <= largest_dbu + slack
    assert outline.tolerance_nm == 0.0 or CHORD_NM < outline.tolerance_nm < 1.0
    # The box is exact, so that sides, and gaps along the axes, are.
    (reach,) = outline.boxes(np.array([[width, length]], dtype=np.int32)).tolist()
    assert np.array_equal(2 * vertices.max(axis=0), reach)
    assert np.array_equal(-2 * vertices.min(axis=0), reach)
    assert polygon.area == polygon_area(vertices) == outline.area(np.array([[width, length]], dtype=np.int32))[0]


@pytest.mark.parametrize("outline", OUTLINES, ids=lambda outline: outline.shape)
@settings(max_examples=40)
@given(width=SIDES, length=SIDES, turns=st.integers(0, 3), start=st.integers(0, 40), mirrored=st.booleans())
def test_an_outline_is_known_however_it_is_drawn(
    outline: Outline, width: int, length: int, turns: int, start: int, mirrored: bool
) -> None:
    drawn = np.roll(outline.vertices(width, length), start, axis=0) + np.array([12_345, -678])
    # A corner on a straight side, and one twice, change nothing.
    drawn = np.concatenate([drawn[:1], drawn])
    for _ in range(turns):
        drawn = np.stack([-drawn[:, 1], drawn[:, 0]], axis=1)
    drawn = drawn[::-1] * [1, -1] if mirrored else drawn
    expected = (length, width) if turns % 2 else (width, length)
    assert outline.size_of(drawn) == (tuple(sorted(expected, reverse=True)) if outline.shape == "cross" else expected)
    # Moved by one unit, a corner makes it none of ours.
    moved = drawn.copy()
    moved[np.argmax(moved[:, 0] + moved[:, 1])] -= 7
    assert outline.size_of(moved) is None


@pytest.mark.parametrize("ring", [Outline("ring", 0.5, wall_dbu=90), Outline("ring", 0.5, hole_dbu=150)])
@settings(max_examples=40)
@given(width=st.integers(150, 350).map(lambda half: 2 * half), turns=st.integers(0, 3), start=st.integers(0, 40))
@example(width=360, turns=0, start=0)  # its hole has the diameter at which a ring has none
def test_a_ring_is_one_polygon_of_a_circle_less_its_hole(ring: Outline, width: int, turns: int, start: int) -> None:
    hole = width - 180 if ring.wall_dbu else 150
    circle, vertices = Outline("ellipse", 0.5), ring.vertices(width, width)
    area = polygon_area(circle.vertices(width, width)) - polygon_area(circle.vertices(hole, hole))
    assert polygon_area(vertices) == area == ring.area(np.array([[width, width]], dtype=np.int32))[0]
    assert Polygon(vertices).buffer(0).area == pytest.approx(area)
    walls, holes = ring.walls_and_holes(np.array([[width, width]], dtype=np.int32))
    assert holes.tolist() == [hole]
    assert walls.tolist() == [[(width - hole) // 2] * 2]
    drawn = np.roll(vertices, start, axis=0) + np.array([12_345, -678])
    for _ in range(turns):
        drawn = np.stack([-drawn[:, 1], drawn[:, 0]], axis=1)
    assert ring.size_of(np.concatenate([drawn[:1], drawn])) == (width, width)
    assert ring.size_of(drawn[::-1] * [1, -1]) == (width, width)
    # A circle is no ring, and a ring of another hole is none of ours.
    assert ring.size_of(circle.vertices(width, width)) is None
    assert circle.size_of(drawn) is None
    other = Outline("ring", 0.5, hole_dbu=hole + 2).vertices(width, width)
    assert ring.size_of(other) is None
    moved = drawn.copy()
    moved[np.argmax(moved[:, 0] + moved[:, 1])] -= 7
    assert ring.size_of(moved) is None


def test_outlines_of_other_shapes_are_not_known() -> None:
    circle, cross = Outline("ellipse", 0.5), Outline("cross", 0.5)
    square = np.array([[0, 0], [300, 0], [300, 300], [0, 300]])
    assert circle.size_of(square) is None
    assert cross.size_of(square) == (300, 300)
    assert cross.size_of(circle.vertices(300, 300)) is None
    assert circle.size_of(cross.vertices(300, 200)) is None
    assert circle.size_of(circle.vertices(300, 200) * [1, 2]) is None
    assert canonical_polygon(np.array([[0, 0], [10, 0], [20, 0]])).size == 0


@pytest.mark.parametrize("hexagonal", [False, True])
@pytest.mark.parametrize("outline", OUTLINES[:3], ids=lambda outline: outline.shape)
@pytest.mark.parametrize("seed", range(3))
def test_gaps_are_those_of_the_curves(outline: Outline, hexagonal: bool, seed: int) -> None:
    random = np.random.default_rng(seed)
    # Diagonal neighbours are the nearest ones: every other site is empty, or the lattice is hexagonal.
    lattice = Lattice(
        period_dbu=(350, 606) if hexagonal else (700, 700), shape=(7, 7), database_unit_nm=0.5, hexagonal=hexagonal
    )
    size = np.concatenate([[[0, 0]], 2 * random.integers(150, 330, (12, 2))]).astype(np.int32)
    index = random.integers(1, 13, lattice.shape).astype(np.uint16)
    index[(np.add.outer(np.arange(7), np.arange(7)) % 2).astype(bool)] = 0
    limit = 60.5
    found = smallest_gap(index, size, lattice, limit, outline=outline)
    rows, columns = np.nonzero(index)
    x, y = lattice.x_dbu(), lattice.y_dbu()
    pillars = [
        affinity.translate(_true(outline, *size[index[r, c]]), x[c], y[r]) for r, c in zip(rows, columns, strict=True)
    ]
    apart = np.array([a.distance(b) for i, a in enumerate(pillars) for b in pillars[:i]])
    assert not np.any(np.abs(apart - limit) < 0.01)
    assert found.below == np.count_nonzero(apart < limit)
    assert found.overlapping == np.count_nonzero(apart == 0.0)
    if found.overlapping == 0:
        assert found.smallest_dbu == pytest.approx(apart.min(), abs=1e-2)
    boxes = smallest_gap(index, outline.boxes(size), lattice, limit)
    assert boxes.below >= found.below
