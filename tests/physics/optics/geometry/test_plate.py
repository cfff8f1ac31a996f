"""The substrate as a plane-parallel plate: closed forms, and PSFs behind it against the direct sum."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from benchmarks.optics.direct_sum import direct_irradiance
from metafab.optics import Imaging, PsfNumerics, psf, relative_l2
from metafab.optics.geometry.path import Ray
from metafab.optics.geometry.plate import Plate, focus_shift_um
from metafab.spec import Design
from metafab.spec.device import Optics
from tests import optics_lens as lens

PLATE = Plate(thickness_um=430.0, index=1.7601)
OPTICS = lens.imaging(aperture_um=40.0)
POINT = (0.0, 0.0, 450.0)


def _lateral_shift_um(plate: Plate, angle_deg: float) -> float:
    """Displacement of a ray along the face of the plate: h (tan a - tan b), sin a = n sin b."""
    angle = math.radians(angle_deg)
    inside = math.asin(math.sin(angle) / plate.index)
    return plate.thickness_um * (math.tan(angle) - math.tan(inside))


def _paths(ray: Ray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return ray.path_um(x, y), ray.in_air.path_um(x, y)


def test_on_the_axis_the_object_comes_nearer_by_h_times_1_less_1_over_n() -> None:
    """Paraxially, the wave is that of a nearer point; the rest is spherical aberration, (r / z)^4 h (n^2-1) / 8 n^3."""
    depth_um, r = 30e3, np.linspace(0.0, 150.0, 7)
    behind = Ray(1.0 / depth_um, (0.0, 0.0), POINT, PLATE)
    nearer = Ray(1.0 / (depth_um - focus_shift_um(PLATE)), (0.0, 0.0), POINT)
    difference = behind.path_um(r, 0.0 * r) - nearer.path_um(r, 0.0 * r)
    reduced = depth_um - focus_shift_um(PLATE)
    aberration = r**4 / reduced**4 * PLATE.thickness_um * (PLATE.index**2 - 1.0) / (8.0 * PLATE.index**3)
    assert np.abs(behind.path_um(r, 0.0 * r) - behind.in_air.path_um(r, 0.0 * r)).max() > 1e-3
    np.testing.assert_allclose(difference, aberration, rtol=1e-4)
    assert np.abs(aberration).max() > 1e-9


@given(
    depth_um=st.floats(2e3, 1e6),
    angle_deg=st.floats(0.0, 60.0),
    index=st.floats(1.0, 4.0),
    share=st.floats(0.0, 0.9),
)
@example(depth_um=3500.0, angle_deg=0.0, index=4.0, share=0.875)
def test_the_path_is_the_shortest_one(depth_um: float, angle_deg: float, index: float, share: float) -> None:
    """Fermat: the sum of the two lengths over all points of the face, by brute force over the crossing point."""
    plate = Plate(thickness_um=share * depth_um, index=index)
    # Nearer than 1.7 times the lens point, the quadrature is off by up to 1e-6 um.
    assume(depth_um - focus_shift_um(plate) > 1200.0)
    offset_um = depth_um * math.tan(math.radians(angle_deg))

    def shortest(x: float) -> float:
        across, air, low, high = abs(x - offset_um), depth_um - plate.thickness_um, 0.0, 1.0
        for _ in range(200):
            third = (high - low) / 3.0
            if length(low + third, across, air) < length(high - third, across, air):
                high -= third
            else:
                low += third
        return length(0.5 * (low + high), across, air)

    def length(part: float, across: float, air: float) -> float:
        return math.hypot(part * across, air) + index * math.hypot((1.0 - part) * across, plate.thickness_um)

    ray = Ray(1.0 / depth_um, (offset_um / depth_um, 0.0), POINT, plate)
    image = Ray(1.0 / depth_um, ray.tangent, POINT).path_um
    straight = math.hypot(700.0 - offset_um, depth_um) - math.hypot(offset_um, depth_um)
    source = float(ray.path_um(np.array(700.0), np.array(0.0)) - image(np.array(700.0), np.array(0.0))) + straight
    # Differences of lengths up to some metres keep 1e-9 um.
    assert source == pytest.approx(shortest(700.0) - shortest(0.0), abs=4e-9)


def test_parallel_light_is_not_changed_and_far_objects_tend_to_it() -> None:
    x = np.array([-300.0, 0.0, 250.0])
    for vergence, largest in ((0.0, 0.0), (1e-10, 1e-6)):
        behind, air = _paths(Ray(vergence, (0.3, -0.2), POINT, PLATE), x, 0.5 * x)
        assert np.abs(behind - air).max() <= largest
        ratio = PLATE.amplitude_ratio(x, 0.5 * x, vergence, (0.3, -0.2))
        assert np.abs(ratio - 1.0).max() <= 1e-6


def test_a_plate_of_index_1_or_without_thickness_is_none() -> None:
    x = np.array([-300.0, 0.0, 250.0])
    for plate in (Plate(thickness_um=430.0, index=1.0), Plate(thickness_um=0.0, index=1.76)):
        behind, air = _paths(Ray(1e-4, (0.3, -0.2), POINT, plate), x, 0.5 * x)
        np.testing.assert_allclose(behind, air, atol=1e-12)
        np.testing.assert_allclose(plate.amplitude_ratio(x, 0.5 * x, 1e-4, (0.3, -0.2)), 1.0, atol=1e-12)


def test_the_ray_to_the_centre_is_moved_aside_by_the_plate() -> None:
    """The slope at the centre is the sine of the ray whose crossing of the face is moved by h (tan a - tan b)."""
    angle_deg, depth_um = 25.0, 5e3
    aside = _lateral_shift_um(PLATE, angle_deg)
    offset_um = depth_um * math.tan(math.radians(angle_deg)) - aside
    ray = Ray(1.0 / depth_um, (0.0, offset_um / depth_um), POINT, PLATE)
    step = 1e-2
    there, back = (float(ray.path_um(np.array(0.0), np.array(s))) for s in (step, -step))
    assert (there - back) / (2.0 * step) == pytest.approx(-math.sin(math.radians(angle_deg)), abs=1e-8)


def test_flux_is_conserved_between_rings_of_rays() -> None:
    """Of an object on the axis: power between two rays' sines is the difference of their cosines."""
    depth_um = 2e3
    sine = np.linspace(0.0, 0.5, 2001)
    radius = (depth_um - PLATE.thickness_um) * sine / np.sqrt(1 - sine**2) + PLATE.thickness_um * sine / np.sqrt(
        PLATE.index**2 - sine**2
    )
    flux = Ray(1.0 / depth_um, (0.0, 0.0), POINT, PLATE).incident_amplitude(radius, 0.0 * radius) ** 2
    power = np.trapezoid(2.0 * np.pi * radius * flux, radius)
    cone = 2.0 * np.pi * (1.0 - math.sqrt(1.0 - 0.25))
    nearer = depth_um - focus_shift_um(PLATE)
    assert power == pytest.approx(cone * nearer**2, rel=1e-5)


@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.5, -0.3)])
@pytest.mark.parametrize("target", [1e-2, 1e-4])
def test_psfs_behind_a_plate_keep_the_stated_error(tangent: tuple[float, float], target: float) -> None:
    """Half the way to the object is sapphire, other for x and y: the direct sum finds its rays by bisection."""
    optics = replace(OPTICS, plates=(Plate(thickness_um=450.0, index=1.76), Plate(thickness_um=450.0, index=1.5)))
    source = lens.written(optics, lens.eq_2(optics), lens.eq_3_and_4(optics))
    result = psf(source, optics, [0.7e-3, 0.9e-3], PsfNumerics(window_px=24, target_error=target), tangent=tangent)
    bare = psf(source, OPTICS, [0.7e-3, 0.9e-3], PsfNumerics(window_px=24, target_error=target), tangent=tangent)
    assert relative_l2(result.psf, bare.psf) > 0.1
    for p in (0, 1):
        points = lens.window_points(optics, result.centre_um[p, 1], 24)
        true = direct_irradiance(source, optics, 0.9e-3, tangent, *points, p)
        assert relative_l2(result.psf[p, 1].ravel(), true) <= result.error[1] <= 1.5 * target


def test_a_design_with_a_substrate_sees_it(small_design: Design) -> None:
    """The unit cell's substrate at the design wavelength; light from the air side does not cross it."""
    assert Imaging.of(small_design).plates == ()
    design = replace(small_design, optics=Optics(substrate_um=430.0))
    assert [plate.thickness_um for plate in Imaging.of(design).plates] == [430.0, 430.0]
    assert Imaging.of(design).plates[0].index == pytest.approx(1.7601)
    cell = design.unit_cell
    other_side = replace(cell, illumination=replace(cell.illumination, side="ambient"))
    with pytest.raises(ValueError, match="light from the ambient misses it"):
        replace(design, unit_cell=other_side)
    with pytest.raises(ValueError, match="before the nearest object"):
        replace(design, optics=Optics(substrate_um=1e4), verify=replace(design.verify, depths_m=(0.008, 0.1)))
