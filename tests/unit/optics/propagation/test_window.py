"""The window transform alone: against the kernel's own sum, and its adjoint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.optics.geometry.path import Ray, path_and_slopes
from metafab.optics.propagation.image import bounding_box
from metafab.optics.propagation.kernel import KernelSpec, WindowKernel
from metafab.optics.propagation.pupil import Carrier, Pupil
from metafab.optics.propagation.refocus import refocus
from metafab.optics.propagation.window import WindowTransform, window_fields
from tests import optics_lens as lens

OPTICS = lens.imaging()
K = OPTICS.wavenumber
COUNT = 24


def _random_pupil(block: int = 1) -> Pupil:
    random = np.random.default_rng(3)
    axis = np.linspace(-29.0, 29.0, 31)
    sums = random.normal(size=(3, 31, 29)) + 1j * random.normal(size=(3, 31, 29))
    ray = Ray.towards_image(OPTICS, 0, 0.9e-3, (0.02, 0.05))
    return Pupil(Carrier(0, ray, block), K, (0.35, 0.35), 0.35**2, axis[1:-1], axis, sums, np.abs(sums[0]) ** 2)


def _transform(pupil: Pupil, tolerance: float) -> WindowTransform:
    spec = KernelSpec(K, pupil.carrier.ray.target_um, bounding_box([pupil]), COUNT, OPTICS.pixel_um, tolerance)
    kernel = WindowKernel.build(spec)
    return WindowTransform.build(pupil, kernel)


def _direct(pupil: Pupil) -> ComplexArray:
    """Sum of h(R) exp(ik [R - R to the centre]) over the blocks, without any expansion."""
    c_x, c_y, c_z = pupil.carrier.ray.target_um
    offset = (np.arange(COUNT) - COUNT // 2) * OPTICS.pixel_um

    def distance(u: FloatArray, v: FloatArray) -> FloatArray:
        along_x, along_y = c_x + u - pupil.x_um[None, :], c_y + v - pupil.y_um[:, None]
        return np.asarray(np.sqrt(along_x**2 + along_y**2 + c_z**2))

    centre = distance(0.0, 0.0)
    field = np.empty((COUNT, COUNT), dtype=np.complex128)
    for row, column in np.ndindex(field.shape):
        r = distance(offset[column], offset[row])
        h = c_z / (2.0 * np.pi * r**2) * (1.0 / r - 1j * K)
        field[row, column] = np.sum(pupil.sums[0] * h * np.exp(1j * K * (r - centre)))
    return field


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
def test_the_low_rank_kernel_keeps_its_tolerance(tolerance: float) -> None:
    """On random light, which fills the window evenly: the tolerance is that of the kernel's Frobenius norm."""
    pupil = _random_pupil()
    field = _transform(pupil, tolerance).field(pupil.sums[:1].astype(np.complex64))
    exact = _direct(pupil)
    # The two carry another phase on the window, R(0, u); irradiance does not see it.
    error = np.linalg.norm(np.abs(field) - np.abs(exact)) / np.linalg.norm(exact)
    assert error < 2.0 * tolerance + 1e-6


def test_the_adjoint_is_one() -> None:
    """<F b, f> = <b, F* f> to single precision."""
    pupil = _random_pupil(block=4)
    transform = _transform(pupil, 1e-5)
    random = np.random.default_rng(4)
    blocks = pupil.sums.astype(np.complex64)
    image = (random.normal(size=(COUNT, COUNT)) + 1j * random.normal(size=(COUNT, COUNT))).astype(np.complex64)
    forward = np.vdot(image, transform.field(blocks))
    backward = np.vdot(transform.adjoint(image), blocks)
    scale = np.linalg.norm(image) * np.linalg.norm(transform.field(blocks))
    assert abs(forward - backward) < 1e-5 * scale


def test_blocks_of_light_that_rises_along_y_are_the_sum_of_their_sites() -> None:
    """Blocks of 7 sites of 0.9 um, whose edges are up to 0.9 rad from their middles at the window's corners."""
    random, offsets = np.random.default_rng(5), np.arange(-3, 4) * 0.9
    values = random.normal(size=(2, 9, 9)) + 1j * random.normal(size=(2, 9, 9))
    centres = 6.3 * np.arange(-4, 5)
    sites = (centres[:, None] + offsets).ravel()
    light = np.kron(values[0], np.ones((7, 7))) + np.kron(values[1], np.outer(offsets, np.ones(7)))
    sums = 49.0 * np.array([values[0], 0.0 * values[1], np.mean(offsets**2) * values[1]])
    ray = Ray.towards_image(OPTICS, 0, 0.9e-3, (0.02, 0.05))
    blocks = Pupil(Carrier(0, ray, 7), K, (0.9, 0.9), 0.81, centres, centres, sums, np.abs(sums[0]) ** 2)
    each = replace(blocks, carrier=Carrier(0, ray, 1), x_um=sites, y_um=sites, sums=light[None])
    field, exact = (_transform(p, 1e-6).field(p.sums.astype(np.complex64)) for p in (blocks, each))
    assert np.linalg.norm(field - exact) < 1e-4 * np.linalg.norm(exact)


def _refocused(pupil: Pupil, ray: Ray) -> ComplexArray:
    """Second-order refocusing by NumPy: the oracle of the compiled kernel."""
    x, y = pupil.x_um[None, :], pupil.y_um[:, None]
    path, *slopes = path_and_slopes(x, y, ray.numbers)
    carrier_path, *carrier_slopes = path_and_slopes(x, y, pupil.carrier.ray.numbers)
    slope_x, slope_y = (K * (new - old) for new, old in zip(slopes, carrier_slopes, strict=True))
    wave = np.exp(1j * K * (path - carrier_path)) * ray.incident_amplitude(x, y)
    spread_x, spread_y = pupil.spread_um2
    total, moment_x, moment_y = pupil.sums
    second = 1.0 - 0.5 * (slope_x**2 * spread_x + slope_y**2 * spread_y)
    return wave * np.array(
        [
            second * total + 1j * (slope_x * moment_x + slope_y * moment_y),
            moment_x + 1j * slope_x * spread_x * total,
            moment_y + 1j * slope_y * spread_y * total,
        ]
    )


def test_the_compiled_refocusing_is_the_plain_one() -> None:
    pupil = _random_pupil(block=4)
    ray = Ray.towards_image(OPTICS, 0, 0.8e-3, (-0.03, 0.06))
    assert refocus(pupil, ray, K) == pytest.approx(_refocused(pupil, ray), abs=1e-5)


def test_kernels_of_usual_windows_are_kept_until_forgotten() -> None:
    """Another depth or mask finds the same object; large windows, which would fill memory, are built anew."""
    box, target_um = ((-20.0, 20.0), (-20.0, 20.0)), OPTICS.image_point_um(0, (0.0, 0.0))

    def kernel(side_px: int) -> WindowKernel:
        return WindowKernel.build(KernelSpec(K, (*target_um, OPTICS.sensor_distance_um), box, side_px, 0.3, 1e-3))

    first = kernel(COUNT)
    assert kernel(COUNT) is first
    assert kernel(160) is not kernel(160)
    WindowKernel.clear_cache()
    again = kernel(COUNT)
    assert again is not first
    for name in ("left", "right", "over_window", "over_lens"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))


def test_the_field_of_bands_is_that_of_the_whole() -> None:
    """A pupil of 360 000 blocks, in two bands and at once, behind another ray than its carrier."""
    random, axis = np.random.default_rng(6), np.linspace(-29.0, 29.0, 600)
    sums = random.normal(size=(3, 600, 600)) + 1j * random.normal(size=(3, 600, 600))
    ray = Ray.towards_image(OPTICS, 0, 0.9e-3, (0.02, 0.05))
    pupil = Pupil(Carrier(0, ray, 4), K, (0.35, 0.35), 0.35**2, axis, axis, sums, np.abs(sums[0]) ** 2)
    assert len(list(pupil.bands())) == 2
    transform, other = _transform(pupil, 1e-5), Ray.towards_image(OPTICS, 0, 0.8e-3, (-0.03, 0.06))
    moved = replace(other, target_um=transform.kernel.spec.target_um)
    whole = transform.field(refocus(pupil, moved, K))
    (field,) = window_fields(pupil, transform.kernel, [other])
    assert np.abs(field - whole).max() < 2e-6 * np.abs(whole).max()
