"""Panels of a window: the same light however it is cut, and the number that the cost model finds cheapest."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.core.parallel.executor import SerialExecutor
from metafab.optics import PsfNumerics, relative_l2
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import Ray
from metafab.optics.propagation.blocks import reduce_to_target
from metafab.optics.propagation.image import Window
from metafab.optics.propagation.pupil import Carrier, Pupil, reduce_field
from tests import optics_lens as lens

OPTICS = lens.imaging()
RAY = Ray.towards_image(OPTICS, 0, 0.9e-3, (0.0, 0.0))


def _pyramid(block: int = 4) -> list[Pupil]:
    source = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    (pupil,) = reduce_field(source, [Carrier(0, RAY, block)], OPTICS.wavenumber)
    return [pupil, pupil.coarsened()]


@pytest.mark.parametrize("panels", [3, 5, 7])
def test_panels_leave_no_trace(panels: int) -> None:
    """Of 50 points, which 3, 5 and 7 panels do not divide: the same light to the kernel's tolerance."""
    pyramid = _pyramid()
    images = [
        Window(OPTICS, 50, 1e-5, panels=count).irradiance(pyramid, 0, (0.0, 0.0), [0.8e-3, 0.9e-3])[0]
        for count in (1, panels)
    ]
    # Blocks refocused on a panel follow its phase to second order, too: the remaining difference is third.
    assert relative_l2(images[1], images[0]) < 3e-4


def test_large_windows_are_cut_and_small_ones_are_not() -> None:
    (pupil, _), target = _pyramid(), RAY.target_um
    assert Window(OPTICS, 32, 1e-4).panels_per_side(pupil, target) == 1
    count = Window(OPTICS, 1024, 1e-4).panels_per_side(pupil, target)
    assert count > 1
    seconds = [Window(OPTICS, 1024, 1e-4).seconds(pupil, target, panels) for panels in (1, count)]
    assert seconds[1] < seconds[0]


def test_blocks_beyond_memory_are_refused() -> None:
    source = lens.written(OPTICS, lens.eq_2(OPTICS), lens.eq_3_and_4(OPTICS))
    window = Window(OPTICS, 16, 1e-4)
    with pytest.raises(InputError, match="block sums"):
        reduce_to_target(source, [window], [0.9e-3], (0.0, 0.0), None, 1e-3, SerialExecutor(), most_blocks=100)


def test_high_numerical_aperture_keeps_the_stated_error() -> None:
    """NA 0.8 without a split, scalar as the direct sum is: the compiled pass uses blocks of few sites."""
    from benchmarks.optics.direct_sum import direct_irradiance
    from metafab.optics import psf

    optics = Imaging(
        wavelength_um=0.8,
        focal_length_mm=0.0225,
        split_angle_deg=0.0,
        sensor_distance_um=22.5,
        pixel_um=0.2,
        aperture_um=60.0,
    )
    f = 22.5
    source = lens.ideal(optics, lambda x, y, p: -optics.wavenumber * (np.hypot(np.hypot(x, y[:, None]), f) - f))
    result = psf(source, optics, [2e-3], PsfNumerics(window_px=24, target_error=1e-3, vectorial=False))
    points = lens.window_points(optics, np.zeros(2), 24)
    true = direct_irradiance(source, optics, 2e-3, (0.0, 0.0), *points, 0)
    assert relative_l2(result.psf[0, 0].ravel(), true) <= result.error[0] <= 1.5e-3


@pytest.mark.parametrize(("pixel_um", "window_px"), [(0.01, 4), (0.01, 16), (0.05, 4), (0.3, 16)])
def test_the_dark_core_of_a_vortex_keeps_the_stated_error(pixel_um: float, window_px: int) -> None:
    """What is left there is a thousandth and less of the ring: errors are of the light that cancels."""
    from benchmarks.optics.direct_sum import direct_irradiance
    from metafab.optics import psf

    optics, f = (
        Imaging(
            wavelength_um=0.8,
            focal_length_mm=0.3,
            split_angle_deg=0.0,
            sensor_distance_um=300.0,
            pixel_um=pixel_um,
            aperture_um=60.0,
        ),
        300.0,
    )
    source = lens.ideal(
        optics,
        lambda x, y, p: np.arctan2(y[:, None], x) - optics.wavenumber * (np.hypot(np.hypot(x, y[:, None]), f) - f),
    )
    result = psf(source, optics, [1e3], PsfNumerics(window_px=window_px, target_error=1e-3))
    points = lens.window_points(optics, np.zeros(2), window_px)
    true = direct_irradiance(source, optics, 1e3, (0.0, 0.0), *points, 0)
    assert relative_l2(result.psf[0, 0].ravel(), true) <= result.error[0] <= 1e-3
