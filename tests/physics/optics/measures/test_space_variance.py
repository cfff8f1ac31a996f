"""Depth bias, astigmatism and distortion over the field of the paper's 2 mm lens: geometry, PSFs, direct sum."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.optics.direct_sum import direct_irradiance
from metafab import phase
from metafab.camera.geometry import ImageMap
from metafab.layout.pillars import Lattice
from metafab.optics import Imaging, Psf, PsfNumerics, depth_nodes, ideal_field, psf
from metafab.optics.measures.space_variance import aberration_dioptre, depth_bias_dioptre, space_variance
from metafab.optics.sources.source import IdealField
from metafab.spec import load_design
from tests.main_job import ROOT

DESIGN = load_design(ROOT / "layouts" / "helix_2mm.toml")
IMAGING = Imaging.of(DESIGN)
DEGREE = math.tan(math.radians(1.0))
#: A phase is a function: on every fifth site of the mask, 1.75 um, Eq. 3 is still well sampled.
COUNT = 1142


@pytest.fixture(scope="module")
def source() -> IdealField:
    return ideal_field(
        phase.profile_of(DESIGN),
        Lattice(period_dbu=(3500, 3500), shape=(COUNT, COUNT), database_unit_nm=0.5),
        DESIGN.device,
    )


@pytest.fixture(scope="module")
def stack(source: IdealField) -> Psf:
    depths = depth_nodes(IMAGING, 0.24, 0.36, 1e-3)
    tangents = (np.array([-DEGREE, 0.0, DEGREE]), np.array([0.0, DEGREE]))
    return psf(source, IMAGING, depths, PsfNumerics(window_px=48), field_tangents=tangents)


def test_the_bias_is_opposite_in_the_two_channels(stack: Psf) -> None:
    """About 0.30 dioptre a degree along the split, as found before the first line of code; none on the axis."""
    bias = depth_bias_dioptre(stack)
    assert bias[:, 0, 1] == pytest.approx([0.0, 0.0], abs=1e-3)
    slope = 0.5 * (bias[:, 0, 2] - bias[:, 0, 0])
    assert slope[0] == pytest.approx(-0.30, abs=0.04)
    assert slope[1] == pytest.approx(-slope[0], rel=0.02)
    # Across the split they err by an order less, for skew astigmatism.
    assert np.abs(bias[:, 1, 1]).max() < 0.15 * abs(slope[0])


def test_geometry_tells_defocus_and_astigmatism(stack: Psf) -> None:
    """Along the split the curvature changes by three times what it changes across: 2 : 1 in mean and half difference.

    Of a ray at angle a, the vergence z along the plane of incidence goes with cos^3 a, across it with cos a.
    """
    defocus, astigmatism = aberration_dioptre(IMAGING, 0, (1e-3, 0.0), 0.3)
    assert astigmatism / defocus == pytest.approx(0.5, abs=0.02)
    a = math.radians(8.0)
    across = -math.sin(a) * 1e-3 / (1e-6 * IMAGING.sensor_distance_um)  # d(cos a) / z
    assert defocus - astigmatism == pytest.approx(across, rel=0.02)
    ratio = depth_bias_dioptre(stack)[0, 0, 2] / aberration_dioptre(IMAGING, 0, (DEGREE, 0.0), 0.3)[0]
    assert 1.2 < ratio < 1.6


@pytest.mark.slow
@pytest.mark.parametrize(("polarisation", "degrees"), [(1, 1.0)])
def test_the_direct_sum_shows_the_same_bias(stack: Psf, source: IdealField, polarisation: int, degrees: float) -> None:
    """A million sites summed one by one, on 14 x 14 points about the geometric image point."""
    depth_m = float(stack.depth_m[stack.depth_m.size // 2])
    tangent = (math.tan(math.radians(degrees)), 0.0)
    step = (np.arange(14) - 7) * IMAGING.pixel_um
    x, y = np.meshgrid(*(c + step for c in IMAGING.image_point_um(polarisation, tangent)))
    image = direct_irradiance(source, IMAGING, depth_m, tangent, x.ravel(), y.ravel(), polarisation)
    cut = stack.psf[:, :, 17:31, 17:31]
    assert stack.field is not None
    alone = replace(stack.field, tangent_x=np.zeros(1), tangent_y=np.zeros(1))
    alone = replace(alone, psf=np.tile(image.reshape(14, 14), (2, stack.depth_m.size, 1, 1, 1, 1)).astype(np.float32))
    bias = depth_bias_dioptre(replace(stack, psf=cut, field=alone))[polarisation, 0, 0]
    sign = -1.0 if polarisation == 0 else 1.0
    assert bias == pytest.approx(sign * 0.30 * degrees, abs=0.05)


def test_distortion_is_what_the_decoder_corrects() -> None:
    """The decoder's map of image points goes through those of the geometry, some 15 pixels off a pinhole's."""
    t_x, t_y = np.linspace(-0.075, 0.075, 9), np.linspace(-0.04, 0.04, 5)
    field = space_variance(IMAGING, t_x, t_y, 0.3)
    on_axis = field.distortion_um[:, 2, 4]
    assert np.abs(on_axis).max() < 1e-9
    # x and y polarisation are mirror images of each other.
    assert field.distortion_um[0, :, :, 0] == pytest.approx(-field.distortion_um[1, :, ::-1, 0], abs=1e-9)
    assert 5.0 < np.abs(field.distortion_um).max() / IMAGING.pixel_um < 40.0


def test_the_decoders_map_goes_through_the_image_points(stack: Psf) -> None:
    assert stack.field is not None
    image_map = ImageMap.from_psf(stack)
    t_x, t_y = np.meshgrid(stack.field.tangent_x, stack.field.tangent_y)
    for p in (0, 1):
        x_um, y_um = image_map.to_sensor_um(p, t_x, t_y)
        points_um = [IMAGING.image_point_um(p, t) for t in zip(t_x.flat, t_y.flat, strict=True)]
        assert np.stack([x_um, y_um], axis=-1).reshape(-1, 2) == pytest.approx(np.array(points_um), abs=1e-6)


def test_a_stack_without_a_field_is_refused(stack: Psf) -> None:
    with pytest.raises(ValueError, match="field"):
        depth_bias_dioptre(replace(stack, field=None))
