"""Image points by the grating law; nodes over depth and field."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metafab.core.errors import InputError
from metafab.optics import Imaging, depth_nodes, field_tangents
from metafab.optics.geometry.imaging import field_corner
from metafab.spec import Design, load_design
from metafab.spec.terms import UserArray
from tests.main_job import ROOT


def test_the_papers_sensor_plane_and_image_points() -> None:
    """DESIGN.md, section 2: z = 21220.03 um, x = -2982.28 um for x polarisation, +2982.28 um for y."""
    imaging = Imaging.of(load_design(ROOT / "layouts" / "helix_2mm.toml"))
    assert imaging.sensor_distance_um == pytest.approx(21220.03, abs=0.005)
    assert imaging.image_point_um(0, (0.0, 0.0)) == pytest.approx((-2982.28, 0.0), abs=0.005)
    assert imaging.image_point_um(1, (0.0, 0.0)) == pytest.approx((2982.28, 0.0), abs=0.005)


def test_without_a_split_the_image_is_that_of_a_pinhole() -> None:
    imaging = Imaging(
        wavelength_um=0.8,
        focal_length_mm=1.0,
        split_angle_deg=0.0,
        sensor_distance_um=1500.0,
        pixel_um=2.4,
        aperture_um=200.0,
    )
    for polarisation in (0, 1):
        assert imaging.image_point_um(polarisation, (0.1, -0.2)) == pytest.approx((-150.0, 300.0))


@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_the_two_images_are_mirrored_in_opposite_directions(t_x: float, t_y: float) -> None:
    """Eq. 4 is Eq. 3 at -x: y's image of (t_x, t_y) is the mirror image in x of x's image of (-t_x, t_y)."""
    imaging = Imaging(
        wavelength_um=0.8,
        focal_length_mm=1.0,
        split_angle_deg=8.0,
        sensor_distance_um=1485.0,
        pixel_um=2.4,
        aperture_um=200.0,
    )
    x, y = imaging.image_point_um(0, (-t_x, t_y))
    assert imaging.image_point_um(1, (t_x, t_y)) == pytest.approx((-x, y), abs=1e-9)


@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.075, -0.05)])
@pytest.mark.parametrize("split_deg", [0.0, 8.0])
def test_a_window_stands_at_its_centre_whatever_the_direction_of_the_object(
    tangent: tuple[float, float], split_deg: float
) -> None:
    optics = Imaging(
        wavelength_um=0.8,
        focal_length_mm=0.16,
        split_angle_deg=split_deg,
        sensor_distance_um=166.7,
        pixel_um=0.3,
        aperture_um=80.0,
        deflection=((0.1, 0.0), (0.1, 0.0)),
    )
    aimed = optics.aimed_at((10.0, -12.0), tangent)
    for polarisation in (0, 1):
        assert aimed.image_point_um(polarisation, tangent) == pytest.approx((10.0, -12.0))


def test_light_that_cannot_leave_is_refused() -> None:
    with pytest.raises(InputError, match="tangent"):
        Imaging(
            wavelength_um=0.8,
            focal_length_mm=1.0,
            split_angle_deg=30.0,
            sensor_distance_um=1485.0,
            pixel_um=2.4,
            aperture_um=200.0,
        ).image_point_um(0, (1.0, 0.0))


@pytest.mark.parametrize("azimuth", [0, 1])
def test_the_window_of_a_binary_splitter_lies_on_the_axis(small_design: Design, tmp_path: Path, azimuth: int) -> None:
    """Its steps of half a turn point both ways, so that the mean slope is 0: the beams lie on both sides."""
    bars = np.broadcast_to(np.pi * (np.arange(700) // 5 % 2), (700, 700))
    np.save(tmp_path / "bars.npy", bars if azimuth == 0 else bars.T)
    splitter = replace(small_design, phase=(UserArray(file=tmp_path / "bars.npy", pitch_um=0.35),))
    for x, y in Imaging.of(splitter).deflection:
        assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-12)


def test_a_focus_inside_the_focal_length_is_refused(small_design: Design) -> None:
    sensor = replace(small_design.sensor, focus_depth_m=0.0005)
    with pytest.raises(InputError, match="focus_depth_m"):
        Imaging.of(replace(small_design, sensor=sensor))


def test_depth_nodes_are_uniform_in_vergence_and_end_where_asked() -> None:
    imaging = Imaging(
        wavelength_um=0.8,
        focal_length_mm=20.0,
        split_angle_deg=8.0,
        sensor_distance_um=21220.0,
        pixel_um=3.45,
        aperture_um=2000.0,
    )
    nodes = depth_nodes(imaging, 0.25, 0.60, 1e-3)
    assert nodes[0] == 0.25 and nodes[-1] == 0.60
    assert np.ptp(np.diff(1.0 / nodes)) < 1e-12
    # A sixteenth of the error asks for half the step.
    finer = depth_nodes(imaging, 0.25, 0.60, 1e-3 / 16)
    assert finer.size == pytest.approx(2 * nodes.size, abs=2)


def test_depth_nodes_reach_infinity() -> None:
    nodes = depth_nodes(
        Imaging(
            wavelength_um=0.8,
            focal_length_mm=20.0,
            split_angle_deg=8.0,
            sensor_distance_um=21220.0,
            pixel_um=3.45,
            aperture_um=2000.0,
        ),
        1.0,
        math.inf,
        1e-3,
    )
    assert math.isinf(nodes[-1]) and np.all(np.diff(nodes[:-1]) > 0.0)


@pytest.mark.parametrize("bounds", [(0.3, 0.2), (0.0, 1.0), (math.nan, 1.0)])
def test_a_depth_range_must_be_one(bounds: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="depth"):
        depth_nodes(
            Imaging(
                wavelength_um=0.8,
                focal_length_mm=20.0,
                split_angle_deg=8.0,
                sensor_distance_um=21220.0,
                pixel_um=3.45,
                aperture_um=2000.0,
            ),
            *bounds,
            1e-3,
        )


def test_field_tangents_span_the_images_rows_and_columns(small_design: Design) -> None:
    imaging = Imaging.of(small_design)
    t_x, t_y = field_tangents(small_design, imaging)
    rows, columns = small_design.scene.field_px
    assert (t_x.size, t_y.size) == small_design.verify.field_points
    assert np.ptp(t_x) * imaging.sensor_distance_um == pytest.approx(columns * imaging.pixel_um)
    assert np.ptp(t_y) * imaging.sensor_distance_um == pytest.approx(rows * imaging.pixel_um)


def test_the_corner_of_the_field_does_not_depend_on_the_field_points(small_design: Design) -> None:
    imaging = Imaging.of(small_design)
    t_x, t_y = field_tangents(small_design, imaging)
    single = replace(small_design, verify=replace(small_design.verify, field_points=(1, 1)))
    assert field_corner(small_design, imaging) == field_corner(single, imaging) == (t_x[-1], t_y[-1])
    assert field_corner(replace(small_design, scene=None), imaging) is None
