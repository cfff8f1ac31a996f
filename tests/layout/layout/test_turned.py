"""Turned pillars at their sites: rules, apertures and lattices."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.layout.turned import TurnedAssignment, TurnedRectangles, assign_turned, turned_rectangles
from metafab.library.library import Library
from metafab.phase.jones_target import JonesTarget
from metafab.spec import Design
from tests.stokes_lens import ROW_ANGLE_DEG, hexagonal_lens, quarter_lens

ANGLES = 8


def assigned(design: Design, library: Library) -> TurnedAssignment:
    return assign_turned(JonesTarget.of(design, ROW_ANGLE_DEG), library, design, angles=ANGLES, size_step_nm=16.0)


def largest_box_nm(assignment: TurnedAssignment) -> FloatArray:
    """Largest (x, y) sides of the bounding boxes of all sizes."""
    pillars = assignment.pillars
    assert pillars.angle_deg is not None
    width, length = pillars.size_nm().T
    cosine, sine = np.cos(np.radians(pillars.angle_deg)), np.sin(np.radians(pillars.angle_deg))
    return np.array([(width * cosine + length * sine).max(), (width * sine + length * cosine).max()])


@pytest.fixture(scope="module")
def upright_lattice(smooth_library: Library) -> TurnedAssignment:
    return assigned(quarter_lens(), smooth_library)


def test_turned_pillars_keep_the_gap(upright_lattice: TurnedAssignment) -> None:
    assert largest_box_nm(upright_lattice).max() <= 290.0 + 1e-5
    assert upright_lattice.overlap > 0.6
    pillars = upright_lattice.pillars
    assert pillars.angle_deg is not None
    used = np.unique(pillars.angle_deg[pillars.to_array()[pillars.to_array() > 0]])
    assert used.size == ANGLES // 2  # the other half are the same with sides exchanged


def test_the_gap_leaves_room_for_the_bias(smooth_library: Library) -> None:
    """Pillars drawn 20 nm wider and longer keep the gap, as upright pillars do."""
    design = quarter_lens()
    biased = dataclasses.replace(design, mask=dataclasses.replace(design.mask, bias_nm=20.0))
    assert largest_box_nm(assigned(biased, smooth_library)).max() <= 270.0 + 1e-5


def test_a_hexagonal_lattice_carries_a_pillar_at_every_other_site(smooth_library: Library) -> None:
    design = hexagonal_lens()
    assignment = assigned(design, smooth_library)
    pillars = assignment.pillars
    rows, columns = np.nonzero(pillars.to_array())
    assert ((rows + columns) % 2 == 0).all()
    aperture_um2 = math.pi * (0.5 * design.device.aperture_um) ** 2
    # Along the rim, of 450 cells, about half of one may be missing or stand out.
    assert rows.size * pillars.lattice.cell_um2 == pytest.approx(aperture_um2, rel=0.01)
    box_nm, period_nm = largest_box_nm(assignment), np.array(design.unit_cell.cell.period_nm)
    assert (box_nm <= period_nm - design.rules.min_gap_nm + 1e-5).all()


def test_a_gap_without_room_is_refused(smooth_library: Library) -> None:
    design = quarter_lens()
    tight = dataclasses.replace(design, rules=dataclasses.replace(design.rules, min_gap_nm=260.0))
    with pytest.raises(InputError, match="turned pillars"):
        assigned(tight, smooth_library)


def test_sizes_lie_on_the_grid_of_the_library(smooth_library: Library) -> None:
    """A step of 15 nm becomes 16 nm on a grid of 2 nm."""
    design = quarter_lens()
    target = JonesTarget.of(design, ROW_ANGLE_DEG)
    size_nm = assign_turned(target, smooth_library, design, angles=ANGLES, size_step_nm=15.0).pillars.size_nm()[1:]
    assert ((size_nm - design.unit_cell.sweep.width_nm[0]) % 16.0 == 0.0).all()


def test_vertices_are_those_of_the_turned_rectangle() -> None:
    for angle_deg in (0.0, 11.25, 45.0, 78.75):
        ring = turned_rectangles(np.array([[400, 250]]), np.array([angle_deg]))[0]
        turn = np.exp(1j * math.radians(angle_deg))
        corners = turn * np.array([-200 - 125j, 200 - 125j, 200 + 125j, -200 + 125j])
        assert np.abs(ring - np.stack([corners.real, corners.imag], axis=1)).max() <= 0.5
        assert (ring == -np.roll(ring, 2, axis=0)).all()  # centred
    outline = TurnedRectangles("rectangle", 0.5, angle_deg=np.array([0.0, 45.0]))
    area_dbu = outline.area(np.array([[0, 0], [400, 250]], dtype=np.int32))
    assert area_dbu == pytest.approx([0.0, 100_000.0], rel=0.004)
