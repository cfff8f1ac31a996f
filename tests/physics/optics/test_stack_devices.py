"""Devices other than the camera: their light lands where the grating law says, and as the window expects."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab.optics import Imaging, Psf
from metafab.spec import Design, load_design, write_new
from metafab.spec.terms import Grating
from metafab.steps import point_spread
from metafab.steps.job import Job


def _device(kind: str, folder: Path, **device: float) -> Design:
    design = load_design(write_new("device", kind, folder)[0])
    return replace(design, device=replace(design.device, **device))


def _ideal(design: Design, folder: Path) -> Psf:
    return point_spread(Job(design, folder), None)[0]


def _centroid_um(psf: Psf, polarisation: int) -> tuple[float, float]:
    image = psf.psf[polarisation, 0]
    n = image.shape[-1]
    axis = (np.arange(n) - n // 2) * psf.pixel_um
    total = image.sum()
    x, y = float((image.sum(axis=0) * axis).sum() / total), float((image.sum(axis=1) * axis).sum() / total)
    return x, y


@pytest.mark.parametrize(("angle_deg", "azimuth_deg"), [(15.0, 0.0), (10.0, 120.0), (-20.0, 45.0)])
def test_a_deflected_beam_lands_where_the_grating_law_says(
    tmp_path: Path, angle_deg: float, azimuth_deg: float
) -> None:
    whole = _device("deflector", tmp_path)
    design = replace(whole, phase=(Grating(angle_deg=angle_deg, azimuth_deg=azimuth_deg),))
    psf = _ideal(design, tmp_path)
    reach_um = Imaging.of(design).sensor_distance_um * math.tan(math.radians(angle_deg))
    azimuth = math.radians(azimuth_deg)
    assert psf.centre_um[0, 0] == pytest.approx((reach_um * math.cos(azimuth), reach_um * math.sin(azimuth)))
    # The whole beam is in the window (40 um wide, in one of 96), about its middle.
    assert psf.efficiency.min() > 0.9
    assert np.hypot(*_centroid_um(psf, 0)) < 1.0


def test_a_grating_of_one_polarisation_moves_that_one_alone(tmp_path: Path) -> None:
    whole = _device("deflector", tmp_path)
    imaging = Imaging.of(replace(whole, phase=(Grating(angle_deg=12.0, polarisation="y"),)))
    assert imaging.image_point_um(0, (0.0, 0.0)) == (0.0, 0.0)
    x_um, y_um = imaging.image_point_um(1, (0.0, 0.0))
    assert x_um == pytest.approx(imaging.sensor_distance_um * math.tan(math.radians(12.0)))
    assert y_um == 0.0


def test_two_gratings_add_their_direction_cosines(tmp_path: Path) -> None:
    whole = _device("deflector", tmp_path)
    imaging = Imaging.of(replace(whole, phase=(Grating(angle_deg=30.0), Grating(angle_deg=30.0, azimuth_deg=90.0))))
    x_um, y_um = imaging.image_point_um(0, (0.0, 0.0))
    slope = 0.5 / math.sqrt(1.0 - 0.5)  # s / sqrt(1 - s_x^2 - s_y^2) with s_x = s_y = 1/2
    assert (x_um, y_um) == pytest.approx((slope * imaging.sensor_distance_um,) * 2)


def test_a_vortex_lens_is_dark_in_the_middle_and_a_lens_bright(tmp_path: Path) -> None:
    ring = _ideal(_device("vortex_lens", tmp_path / "ring", aperture_um=60.0), tmp_path)
    spot = _ideal(_device("metalens", tmp_path / "spot", aperture_um=60.0), tmp_path)
    for psf, bright in ((ring, False), (spot, True)):
        image = psf.psf[0, 0]
        middle = image[image.shape[0] // 2, image.shape[1] // 2]
        # A charge of 2 has a double zero on the axis; a lens has its maximum there.
        assert (middle == image.max()) if bright else (middle < 1e-3 * image.max())
