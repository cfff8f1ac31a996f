"""A pair that changes from place to place: filters that know it leave depth where it is."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from benchmarks.decode.decode import window_errors
from metafab.camera import capture
from metafab.camera.geometry import ImageMap
from metafab.core.conventions import FloatArray
from metafab.decode import Decoder, DecoderNumerics, DepthBound
from metafab.decode.matching import filters
from metafab.decode.matching.bias import unbiased, unbiased_places
from metafab.decode.matching.space_variance import FirstMoments, compensated, field_gradient, slope_weights
from metafab.decode.registration.calibration import Calibration
from metafab.information.texture import Texture
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import PIXEL_UM, helix_psf

DEPTHS_M = 1.0 / np.linspace(1 / 0.00245, 1 / 0.0035, 9)
DEPTH_M = 0.0029
#: Of Gaussians that move apart, pixels; their move over the calibrated range; and how much they widen a pixel.
SIGMA_PX, MOVE_PX, WIDENING = 2.0, 2.0, 0.008


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(DEPTHS_M, tangents=(np.linspace(-0.105, 0.105, 7), np.linspace(-0.105, 0.105, 3)))


def decoder_of(psf: Psf) -> Decoder:
    decoder = Decoder.of(psf, (144, 330), (-395.0, -178.0))
    assert decoder is not None
    return decoder


def drifting(psf: Psf) -> Psf:
    """Gaussians that move apart along x with vergence, and widen along the field's x in opposite senses."""
    assert psf.field is not None
    n = psf.psf.shape[-1]
    place = np.arange(n) - n // 2
    share = (1.0 / DEPTHS_M - 1.0 / DEPTH_M) / (1.0 / DEPTHS_M[0] - 1.0 / DEPTHS_M[-1])
    pixels = psf.field.tangent_x * psf.sensor_distance_um / PIXEL_UM
    stack = np.empty_like(psf.field.psf)
    for polarisation, sign in enumerate((-1.0, 1.0)):
        for index, moved in enumerate(sign * MOVE_PX * share):
            for column, width in enumerate(SIGMA_PX + sign * WIDENING * pixels):
                rows, columns = (np.exp(-0.5 * ((place - at) / width) ** 2) for at in (0.0, moved))
                spot = rows[:, None] * columns
                stack[polarisation, index, :, column] = spot / spot.sum() / PIXEL_UM**2
    middle = psf.field.tangent_x.size // 2
    field = dataclasses.replace(psf.field, psf=stack)
    return dataclasses.replace(psf, psf=stack[:, :, 0, middle].astype(np.float64), field=field)


def window_bias(psf: Psf, *, compensate: bool) -> FloatArray:
    """Relative errors of windows of one plane in bright light, where noise is a tenth of them."""
    piece = SceneObject(depth_m=DEPTH_M, size=(0.3, 0.3))
    scene = Scene(objects=(piece,), photons_per_pixel=3e5, field_px=(120, 120))
    frames = [capture(scene, psf, seed=seed) for seed in range(1, 9)]
    decoder = Decoder.of(
        psf,
        frames[0].frame.shape,
        frames[0].origin_um,
        frames[0].x_window,
        DecoderNumerics(compensate_space_variance=compensate),
    )
    assert decoder is not None
    bound = DepthBound.of(decoder.calibration, DEPTH_M, Texture(electrons=3e5, contrast=0.25))
    return window_errors(decoder, frames, bound, 24)[0]


def test_depth_is_where_it_is_although_the_pair_changes(psf: Psf) -> None:
    """Blurs that grow in opposite senses move the depth at which twins agree, all over the field and the same way.

    To first order the pair then leaves F q with q = 4 pi i w (2 - 8 pi^2 s^2 k^2) k_x G^2, w = s ds/dx, against
    D = -4 pi i k_x G^2 a pixel that it moves apart: w times about 1, here 0.3 % of depth.
    """
    pair = drifting(psf)
    compensated_bias, bias = window_bias(pair, compensate=True), window_bias(pair, compensate=False)
    assert float(bias.mean()) == pytest.approx(0.0037, abs=0.0007)
    assert abs(float(compensated_bias.mean())) < 0.2 * float(bias.mean())
    assert np.sqrt(np.mean(compensated_bias**2)) < 0.5 * np.sqrt(np.mean(bias**2))


def test_expected_maxima_lie_at_the_true_depths(psf: Psf, monkeypatch: pytest.MonkeyPatch) -> None:
    """Filters of a basis put them beside: a second correction finds less than a third of what the first one took."""
    given: list[Any] = []
    monkeypatch.setattr(filters, "unbiased_places", lambda *one: given.extend(one) or unbiased_places(*one))
    decoder_of(drifting(psf))
    mixed, *others = given
    places = unbiased_places(mixed, *others)
    corrected = unbiased(mixed.reshape(*mixed.shape[:3], -1), places).astype(np.complex64).reshape(mixed.shape)
    own = np.arange(mixed.shape[1])
    first, second = (np.std((one - own)[:, 2:-2]) for one in (places, unbiased_places(corrected, *others)))
    assert second < 0.3 * first


def test_without_a_field_filters_are_as_they_were() -> None:
    one = decoder_of(helix_psf(DEPTHS_M)).calibration
    rng = np.random.default_rng(1)
    even, pair = rng.normal(size=(2, 2, 3, 1, 8, 5)).astype(np.complex64)
    total, weight = np.ones((3, 1, 8, 5), dtype=np.float32), np.ones((8, 5))
    assert not field_gradient(one).any()
    np.testing.assert_array_equal(compensated(even, pair, total, weight, one, 2), even)


def test_the_change_a_pixel_is_that_of_the_field(psf: Psf) -> None:
    """A cubic of the tangents is met by its spline; a pixel changes tangents as the image map says."""
    calibration: Calibration = decoder_of(psf).calibration
    kernels = calibration.kernels
    y, x = (axis.ravel() for axis in np.meshgrid(kernels.tangent_y, kernels.tangent_x, indexing="ij"))
    values, by_x, by_y = 3.0 * x**3 - 2.0 * x * y, 9.0 * x**2 - 2.0 * y, -2.0 * x
    got = field_gradient(calibration) @ values
    image_map: ImageMap = calibration.image_map
    for node in range(x.size):
        inverse = np.linalg.inv(image_map.jacobian_um(0, np.array(x[node]), np.array(y[node])))
        want = PIXEL_UM * np.array([by_x[node], by_y[node]]) @ inverse
        np.testing.assert_allclose(got[:, node], want, rtol=1e-4, atol=1e-9)


def test_slopes_of_few_nodes() -> None:
    assert not slope_weights(np.zeros(1)).any()
    np.testing.assert_allclose(slope_weights(np.array([1.0, 3.0])) @ np.array([2.0, 6.0]), [2.0, 2.0])
    nodes = np.array([0.0, 1.0, 2.5, 3.0, 4.5])
    np.testing.assert_allclose(slope_weights(nodes) @ nodes**3, 3.0 * nodes**2, atol=1e-10)


def test_first_moments_are_products_with_the_offsets_of_pixels() -> None:
    """x times one image plus y times another, between their transforms; the farthest row and column count as 0."""
    rng = np.random.default_rng(5)
    images = rng.normal(size=(2, 3, 8, 10)).astype(np.float32)
    offset_x, offset_y = (2.0 * np.fft.fftfreq(n, 1.0 / n) for n in (10, 8))
    offset_x[5] = offset_y[4] = 0.0
    transforms = np.fft.rfft2(images).astype(np.complex64)
    got = FirstMoments.of(transforms, step=2)(*transforms)
    expected = np.fft.rfft2(images[0] * offset_x + images[1] * offset_y[:, None])
    np.testing.assert_allclose(got, expected, atol=1e-6 * np.abs(expected).max())
