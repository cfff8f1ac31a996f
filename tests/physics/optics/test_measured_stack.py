"""A stack made from a known pair comes back as that pair, and decodes frames of its camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.fft

from metafab.camera import RawFrame, capture
from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.decode import decode
from metafab.optics.measured_stack import psf_of_stack
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.closed_form_run import DEPTHS_M, turning_psf
from tests.conjugate_pair import PIXEL_UM, helix_psf


def _moved(pictures: FloatArray, x_px: float, y_px: float) -> FloatArray:
    """Pictures moved by a Fourier shift."""
    n_y, n_x = pictures.shape[-2:]
    ky, kx = scipy.fft.fftfreq(n_y)[:, None], scipy.fft.rfftfreq(n_x)
    turn = np.exp(-2j * np.pi * (kx * x_px + ky * y_px))
    return np.asarray(scipy.fft.irfft2(scipy.fft.rfft2(pictures) * turn, (n_y, n_x)))


def _relative_l2(value: FloatArray, wanted: FloatArray) -> float:
    return float(np.linalg.norm(value - wanted) / np.linalg.norm(wanted))


@pytest.mark.parametrize("channels", [1, 2])
def test_a_shifted_stack_on_a_background_comes_back_centred(channels: int) -> None:
    truth = turning_psf()
    seen = 4000.0 * _moved(truth.psf[:channels], 1.7, -2.4) + 130.0
    psf, figures = psf_of_stack(seen, DEPTHS_M, 1.0, integrated=False)
    # The lobes' tails at the border are 1e-5 of their peaks.
    assert figures.background == pytest.approx(130.0, abs=0.05)
    assert figures.centring == "turn"
    np.testing.assert_allclose(figures.centre_px, [(1.7, -2.4)] * channels, atol=0.01)
    assert _relative_l2(psf.psf, truth.psf) < 0.01
    np.testing.assert_allclose((psf.phi_deg - truth.phi_deg + 180.0) % 360.0, 180.0, atol=0.1)
    np.testing.assert_allclose(psf.efficiency.mean(axis=0), 1.0)


def test_noise_is_stated_as_the_error() -> None:
    truth, rng = turning_psf(), np.random.default_rng(3)
    seen = 4000.0 * truth.psf + 130.0 + rng.normal(0.0, 0.5, truth.psf.shape)
    psf, figures = psf_of_stack(seen, DEPTHS_M, 1.0, centring="none", integrated=False)
    assert figures.noise == pytest.approx(0.5, rel=0.15)
    assert 0.01 < _relative_l2(psf.psf, truth.psf) < figures.error < 0.1


def test_counts_of_a_border_without_noise_have_the_error_of_rounding() -> None:
    """Eight bits: the border is one count, and each pixel is rounded by 0.29 (rms)."""
    y, x = np.mgrid[:48, :48]
    angle = np.radians([20.0, 60.0, 100.0, 140.0])[:, None, None]
    lobe = np.exp(-((x - 24.0 - 6.0 * np.cos(angle)) ** 2 + (y - 24.0 - 6.0 * np.sin(angle)) ** 2) / 5.0)
    for stack, is_rounded in ((np.round(7.0 + 230.0 * lobe)[None], True), (7.0 + 230.5 * lobe[None], False)):
        _, figures = psf_of_stack(stack, np.array([0.2, 0.25, 0.3, 0.35]), 3.45)
        assert (figures.error > 1e-3) == is_rounded
        assert figures.error < 0.03


def test_levels_in_the_upper_bits_of_a_count_have_the_same_error() -> None:
    """A camera's 12 bits times 16."""
    truth = turning_psf()
    counts = np.round(7.0 + 230.0 * truth.psf / truth.psf.max())
    one, upper = (psf_of_stack(times * counts, DEPTHS_M, 1.0, centring="none")[1].error for times in (1.0, 16.0))
    assert upper == pytest.approx(one)
    assert one > 1e-3


def test_integrated_pixels_become_samples() -> None:
    """The kernels of a stack of integrals are the stack itself; those of samples are integrated once more."""
    truth = turning_psf()
    seen = PairKernels(truth).nodes[:, :, 0, 0].astype(np.float64)
    psf, _ = psf_of_stack(seen, DEPTHS_M, 1.0, centring="none")
    assert _relative_l2(psf.psf, truth.psf) < 1e-3
    again = PairKernels(psf).nodes[:, :, 0, 0]
    assert _relative_l2(again, seen) < 1e-3
    twice, _ = psf_of_stack(seen, DEPTHS_M, 1.0, centring="none", integrated=False)
    assert _relative_l2(PairKernels(twice).nodes[:, :, 0, 0], seen) > 0.01


@pytest.mark.parametrize(("n_y", "n_x"), [(32, 33), (33, 32)])
def test_the_twin_is_a_point_reflection_about_the_middle_pixel(n_y: int, n_x: int) -> None:
    one = np.zeros((1, 3, n_y, n_x))
    one[:, :, n_y // 2 + 3, n_x // 2 - 5] = 1.0
    psf, figures = psf_of_stack(one, np.array([1.0, 2.0, 3.0]), 1.0, centring="none", integrated=False)
    assert (psf.psf[1, :, n_y // 2 - 3, n_x // 2 + 5] == 1.0).all()
    assert any("point reflection" in sentence for sentence in figures.made)


def test_relative_depths_get_a_zero() -> None:
    depth_m = np.linspace(-0.002, 0.002, 9)
    psf, figures = psf_of_stack(turning_psf().psf, depth_m, 1.0)
    np.testing.assert_allclose(psf.depth_m - figures.zero_m, depth_m, atol=1e-15)
    np.testing.assert_allclose(psf.depth_m[[0, -1]], [0.004, 0.008])
    assert any("subtract it" in sentence for sentence in figures.made)
    given, figures = psf_of_stack(turning_psf().psf, depth_m, 1.0, zero_m=0.3)
    np.testing.assert_allclose(given.depth_m, depth_m + 0.3)
    with pytest.raises(InputError, match="zero_m"):
        psf_of_stack(turning_psf().psf, depth_m, 1.0, zero_m=0.001)


def test_light_in_the_border_is_told() -> None:
    _, figures = psf_of_stack(np.roll(turning_psf().psf, 9, axis=-1), DEPTHS_M, 1.0, centring="none")
    assert figures.border_light > 0.01
    assert any("larger window" in sentence for sentence in figures.warnings)


def test_saturated_pictures_are_told() -> None:
    stack = 1000.0 * turning_psf().psf
    _, sound = psf_of_stack(stack, np.array(DEPTHS_M), 1.0, integrated=False)
    assert sound.warnings == ()
    _, figures = psf_of_stack(np.minimum(stack, 0.3 * stack.max()), np.array(DEPTHS_M), 1.0, integrated=False)
    assert "share exactly its largest value: is it saturated?" in figures.warnings[-1]


def test_a_picture_of_noise_alone_is_refused() -> None:
    """Noise reaches above three of its standard deviations, but not above six."""
    rng = np.random.default_rng(1)
    stack = 1000.0 * turning_psf().psf + rng.normal(0.0, 1.0, turning_psf().psf.shape)
    stack[1, 2] = rng.normal(100.0, 1.0, stack.shape[2:])
    with pytest.raises(InputError, match=f"none in channel 2 at {DEPTHS_M[2]:g} m"):
        psf_of_stack(stack, np.array(DEPTHS_M), 1.0)


@pytest.mark.parametrize(
    ("scale", "pixel_um", "depth_scale", "zero_m", "message"),
    [
        (1e300, 1.0, 1.0, None, "largest lies between"),
        (1e-300, 1.0, 1.0, None, "largest lies between"),
        (1.0, 1e300, 1.0, None, "pixel_um"),
        (1.0, 1.0, 1e300, None, "depths in metres, at most"),
        (1.0, 1.0, 1.0, 1e300, "zero_m"),
        (1.0, 1.0, 1.0, 1e15, "zero_m"),  # depths that are one in double precision
    ],
)
def test_numbers_beyond_all_optics_are_refused(
    scale: float, pixel_um: float, depth_scale: float, zero_m: float | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        psf_of_stack(scale * turning_psf().psf, depth_scale * np.array(DEPTHS_M), pixel_um, zero_m=zero_m)


def test_images_that_coincide_and_a_sensor_at_the_lens_are_refused_at_once() -> None:
    with pytest.raises(InputError) as caught:
        psf_of_stack(turning_psf().psf, np.array(DEPTHS_M), 1.0, split_um=(0.0, 0.5), distance_mm=1e-30)
    assert [fault.field for fault in caught.value.faults] == ["split_um", "distance_mm"]


def _bad(index: tuple[int, ...] | None = None, value: float = np.nan) -> FloatArray:
    stack = turning_psf().psf.copy()
    if index is not None:
        stack[index] = value
    return stack


@pytest.mark.parametrize(
    ("stack", "depth_m", "message"),
    [
        (_bad((0, 1, 2, 3)), DEPTHS_M, "1 values NaN or infinite"),
        (_bad((1, 0, 0, 0), np.inf), DEPTHS_M, "finite values"),
        (-_bad(), DEPTHS_M, "light above the background"),
        (0.0 * _bad(), DEPTHS_M, "light above the background"),
        (_bad(), DEPTHS_M[:8], "one for each of 9 pictures"),
        (_bad(), DEPTHS_M[::-1], "increasing"),
        (_bad(), np.full(9, 0.3), "increasing"),
        (_bad(), DEPTHS_M * np.nan, "finite, increasing"),
        (_bad()[:, :1], DEPTHS_M[:1], "3 or more"),
        (_bad()[:, :0], DEPTHS_M[:0], "3 or more"),
        (_bad()[..., :4], DEPTHS_M, "8 pixels a side"),
    ],
)
def test_unfit_stacks_are_refused(stack: FloatArray, depth_m: FloatArray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        psf_of_stack(stack, depth_m, 1.0)


@pytest.fixture(scope="module")
def lens() -> Psf:
    """A small helix lens whose lobe turns by a third of a turn."""
    return helix_psf(np.linspace(0.0025, 0.0034, 9))


@pytest.fixture(scope="module")
def frame(lens: Psf) -> RawFrame:
    scene = Scene(objects=(SceneObject(depth_m=0.0029, size=(0.08, 0.08)),), field_px=(64, 64), seed=1)
    return replace(capture(scene, lens), x_window=None)


@pytest.mark.parametrize("channels", [1, 2])
def test_a_frame_decodes_with_the_imported_stack(lens: Psf, frame: RawFrame, channels: int) -> None:
    """Photographs of a point, moved, on a background: as deep as with the lens' own pair."""
    middle = lens.depth_m.size // 2
    split_um = lens.centre_um[1, middle] - lens.centre_um[0, middle]
    photographs = 5000.0 * PairKernels(lens).nodes[:, :, 0, 0].astype(np.float64)
    seen = photographs + 100.0 + np.random.default_rng(5).normal(0.0, 1.0, photographs.shape)
    centring = "none"
    if channels == 2:
        # The crop of the y image was taken elsewhere: its middle pixel lies off the image point by as much.
        seen[1], centring = _moved(seen[1], 1.5, -1.0), "auto"
        split_um = split_um - PIXEL_UM * np.array([1.5, -1.0])
    psf, _ = psf_of_stack(
        seen[:channels], lens.depth_m, PIXEL_UM, split_um=(float(split_um[0]), float(split_um[1])), centring=centring
    )
    image = decode(frame, psf)
    assert image.figures.reason is None
    own = decode(frame, lens)
    depth, by_own = (np.nanmedian(each.depth_m) for each in (image, own))
    assert depth == pytest.approx(0.0029, rel=0.005)  # of a frame of 41 x 40 pixels, 0 to 0.3 % off by either pair
    assert depth == pytest.approx(by_own, rel=0.003)
    assert np.isfinite(image.depth_m).mean() > 0.95


def test_a_split_lens_distorts_its_images() -> None:
    """The chief rays of both images by the grating law: direction cosines -t / sqrt(1 + t^2) -+ sin theta."""
    distance_um, split_um = 1500.0, 417.6
    psf, _ = psf_of_stack(
        turning_psf().psf, DEPTHS_M, 1.0, centring="none", integrated=False,
        split_um=(split_um, 0.0), distance_mm=1e-3 * distance_um, split_lens=True,
    )  # fmt: skip
    assert psf.field is not None
    sine = np.sin(np.arctan(0.5 * split_um / distance_um))
    y, x = np.meshgrid(psf.field.tangent_y, psf.field.tangent_x, indexing="ij")
    for polarisation, sign in enumerate((-1.0, 1.0)):
        secant = np.sqrt(1.0 + x**2 + y**2)
        cosines = sign * sine - x / secant, -y / secant
        along = np.sqrt(1.0 - cosines[0] ** 2 - cosines[1] ** 2)
        for axis in (0, 1):
            places = psf.field.centre_um[polarisation, 0, :, :, axis]
            np.testing.assert_allclose(places, distance_um * cosines[axis] / along, atol=1e-9)
    with pytest.raises(InputError, match="split_lens"):
        psf_of_stack(turning_psf().psf, DEPTHS_M, 1.0, split_lens=True)
