"""Every aperture shape all the way: mapped, written, read back, checked, and its PSF against a direct sum."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from benchmarks.optics.direct_sum import direct_irradiance
from metafab import drc, layout, mask, optics
from metafab.layout import Aperture
from metafab.library import Library
from metafab.optics import Imaging
from metafab.optics.geometry.path import Ray, power_at_aperture
from metafab.phase import LensPhase
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design
from tests import optics_lens
from tests.layout.conftest import sizes_at_sites

SHAPES: dict[str, dict[str, Any]] = {
    "circle": {},
    "square": {},
    "ring": {"inner_um": 12.0},
    "polygon": {"outline_um": ((-12.0, -10.0), (12.0, -7.0), (9.0, 11.5), (0.0, 2.0), (-10.5, 12.0))},
}


def _design(tiny_design: Design, shape: str) -> Design:
    device = replace(tiny_design.device, aperture_shape=shape, aperture_um=24.0, focal_length_mm=0.2, **SHAPES[shape])
    phase = tuple(term for term in tiny_design.phase if term.term == "split_lens")
    return replace(tiny_design, device=device, phase=(replace(phase[0], angle_deg=0.0),))


def _area_um2(design: Design) -> float:
    return {
        "circle": math.pi * 12.0**2,
        "square": 24.0**2,
        "ring": math.pi * (12.0**2 - 6.0**2),
        "polygon": shapely.Polygon(SHAPES["polygon"]["outline_um"]).area,
    }[design.device.aperture_shape]


@pytest.mark.parametrize("shape", SHAPES)
def test_from_phases_to_a_psf(shape: str, smooth_library: Library, tiny_design: Design, tmp_path: Path) -> None:
    design = _design(tiny_design, shape)
    lens = LensPhase(wavelength_um=design.wavelength_um, image_distance_um=200.0)
    assignment = layout.assign(PhaseProfile((lens,)), smooth_library, design)
    assert assignment.figures.pillars == Aperture.of(design).count
    mask.write(assignment.pillars, tmp_path, design)
    for suffix in ("gds", "oas"):
        path = tmp_path / f"layout.{suffix}"
        report = drc.check(path, design)
        assert report.clean, report.violations
        assert report.pillars == assignment.figures.pillars
    pillars = mask.read(path, design).pillars
    assert np.array_equal(sizes_at_sites(pillars), sizes_at_sites(assignment.pillars))

    imaging = Imaging.of(design)
    source = optics.written_field(pillars, smooth_library)
    psf = optics.psf(source, imaging, (0.003,), optics.PsfNumerics(window_px=16, target_error=1e-3))
    points = optics_lens.window_points(imaging, psf.centre_um[0, 0], 16)
    direct = direct_irradiance(source, imaging, 0.003, (0.0, 0.0), *points, 0)
    # The reference counts a polygon's power by cells of the rim, to 2e-3 for this one.
    allowed = psf.error[0] + (2e-3 if shape == "polygon" else 0.0)
    assert optics.relative_l2(psf.psf[0, 0].ravel(), direct) <= allowed


@pytest.mark.parametrize("shape", SHAPES)
def test_a_pillar_outside_and_one_missing_are_found(
    shape: str, smooth_library: Library, tiny_design: Design, tmp_path: Path
) -> None:
    design = _design(tiny_design, shape)
    assignment = layout.assign(
        PhaseProfile((LensPhase(wavelength_um=0.8, image_distance_um=200.0),)), smooth_library, design
    )
    index = assignment.pillars.to_array().copy()
    filled, empty = np.argwhere(index > 0), np.argwhere(index == 0)
    index[tuple(filled[7])] = 0
    added = len(empty) > 0  # a square aperture fills its lattice
    if added:
        index[tuple(empty[3])] = 1
    spoilt = layout.PillarMap.from_array(
        assignment.pillars.lattice, assignment.pillars.size_dbu, index, assignment.pillars.tile_sites
    )
    mask.write(spoilt, tmp_path, design)
    violations = drc.check(tmp_path / "layout.oas", design).violations
    assert violations["missing"] == 1
    assert violations["aperture"] == int(added)


@pytest.mark.parametrize("shape", SHAPES)
def test_power_of_a_distant_object_is_the_apertures_area(shape: str, tiny_design: Design) -> None:
    design = _design(tiny_design, shape)
    ray = Ray.towards_image(Imaging.of(design), 0, math.inf, (0.0, 0.0))
    assert power_at_aperture(Imaging.of(design), ray) == pytest.approx(_area_um2(design), rel=1e-12)


def test_power_of_a_near_object_in_a_polygon_that_is_a_square(tiny_design: Design) -> None:
    """Triangles from the axis and the square's own rule agree to the rounding of their sums."""
    imaging = Imaging.of(_design(tiny_design, "square"))
    corners = ((-12.0, -12.0), (12.0, -12.0), (12.0, 12.0), (-12.0, 12.0))
    polygon = replace(imaging, aperture_shape="polygon", outline_um=corners)
    ray = Ray(1.0 / 60.0, (0.1, -0.05), (0.0, 0.0, 200.0))
    assert power_at_aperture(polygon, ray) == pytest.approx(power_at_aperture(imaging, ray), rel=1e-10)


def test_a_ring_is_the_circle_less_its_hole(tiny_design: Design) -> None:
    imaging = Imaging.of(_design(tiny_design, "ring"))
    ray = Ray(1.0 / 60.0, (0.1, -0.05), (0.0, 0.0, 200.0))
    whole, hole = (replace(imaging, aperture_shape="circle", aperture_um=um, inner_um=0.0) for um in (24.0, 12.0))
    difference = power_at_aperture(whole, ray) - power_at_aperture(hole, ray)
    assert power_at_aperture(imaging, ray) == pytest.approx(difference, rel=1e-12)
