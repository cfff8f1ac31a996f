"""The decoder on synthetic pairs: depth, intensities, contrast; silence where there is nothing to know."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import pytest

from metafab.camera import capture
from metafab.decode import Decoder, decode
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

DEPTHS_M = 1.0 / np.linspace(1 / 0.00245, 1 / 0.0035, 9)


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(DEPTHS_M)


@pytest.fixture(scope="module")
def field_psf() -> Psf:
    return helix_psf(DEPTHS_M, tangents=(np.linspace(-0.105, 0.105, 7), np.linspace(-0.105, 0.105, 3)))


def plane(depth_m: float, **settings: object) -> SceneObject:
    return SceneObject(depth_m=depth_m, size=(0.15, 0.15), **settings)


@pytest.mark.parametrize("depth_m", [0.0026, 0.0029, 0.0033])
def test_a_textured_plane_is_where_it_is(psf: Psf, depth_m: float) -> None:
    image = decode(capture(Scene(objects=(plane(depth_m),), seed=3), psf), psf)
    # The pair turns by 1 rad over the range of a third of the depth; 93 x 93 pixels at 3000 electrons leave a
    # standard error near 0.15 %: three of them.
    assert image.nmae == pytest.approx(0.0, abs=5e-3)
    assert image.figures.share_decoded > 0.98


@pytest.mark.parametrize("depth_m", [0.0026, 0.0033])
def test_depth_does_not_depend_on_the_polarisation_contrast(psf: Psf, depth_m: float) -> None:
    for contrast in (0.4, 2.5):
        scene = Scene(objects=(plane(depth_m, polarisation_contrast=contrast),), photons_per_pixel=2e4, seed=4)
        image = decode(capture(scene, psf), psf)
        assert image.nmae == pytest.approx(0.0, abs=5e-3)
        assert image.figures.contrast_error < 0.02


def test_a_pair_that_varies_over_the_field(psf: Psf, field_psf: Psf) -> None:
    """Uncorrected, the channels' opposite drift would turn the pair's members by 13 degrees at the edge."""
    frame = capture(Scene(objects=(plane(0.0029),), seed=5), field_psf)
    image = decode(frame, field_psf)
    assert image.nmae == pytest.approx(0.0, abs=8e-3)
    # Filters that also vary over the field are mixtures of more images than those of one direction.
    assert float(image.figures.basis_images) > float(decode(frame, psf).figures.basis_images) + 5


def test_a_tilted_plane_is_decoded_as_one(psf: Psf) -> None:
    """10 % deeper at one side than at the other: one depth would err by 2.5 % in the mean, layers of 1/24 of the range
    by 0.4 % or more. The camera cuts the plane into steps of 0.4 %, which alone err by 0.1 %.
    """
    tilted = SceneObject(depth_m=0.0029, size=(0.24, 0.34), tilt=(0.0, 0.10), texture_contrast=0.4)
    scene = Scene(objects=(tilted,), photons_per_pixel=2e4, field_px=(220, 150), seed=3)
    image = decode(capture(scene, psf), psf)
    biggest = max(image.segments, key=lambda row: row.pixels)
    # 1/depth changes by 0.10 / 0.0029 over the plane's 0.34 of tangent; images are inverted.
    change = 0.10 / 0.0029 / (0.34 * psf.sensor_distance_um / psf.pixel_um)
    assert biggest.slope_y_per_m == pytest.approx(change, rel=0.1)
    assert abs(biggest.slope_x_per_m) < 0.1 * change
    assert image.nmae == pytest.approx(0.0, abs=3e-3)
    assert image.figures.worst_object_error < 3e-3


def test_intensities_are_sharp_and_in_electrons(psf: Psf) -> None:
    frame = capture(Scene(objects=(plane(0.0028, texture="checker", texture_contrast=0.5),), seed=6), psf)
    image = decode(frame, psf)
    assert frame.truth is not None
    inner = (slice(35, 95), slice(35, 95))
    truth = frame.truth.intensity_x[inner]
    got = image.intensity_x[inner]
    # The aperture passes 0.4 cycles a pixel at most and the helix less still: squares of 11.6 pixels keep edges
    # about 2 pixels soft, which takes some 6 % off the correlation.
    assert np.corrcoef(truth.ravel(), got.ravel())[0, 1] > 0.92
    assert got.mean() == pytest.approx(truth.mean(), rel=0.02)


def test_haze_is_no_signal(psf: Psf) -> None:
    """1500 electrons a pixel on all of the sensor, half of the light: taken as signal, a contrast of 2.5 read 1.7."""
    scene = Scene(objects=(plane(0.0029, polarisation_contrast=2.5),), seed=5)
    frame = capture(scene, psf)
    haze = np.random.default_rng(1).poisson(1500.0, frame.frame.shape)
    hazy, clear = decode(dataclasses.replace(frame, frame=frame.frame + haze), psf), decode(frame, psf)
    assert hazy.figures.contrast_error < clear.figures.contrast_error + 0.01
    assert hazy.nmae == pytest.approx(0.0, abs=5e-3)


def test_an_object_of_a_tenth_of_the_light_is_decoded(psf: Psf) -> None:
    """Dark is what noise, or the blur of what is bright about it, explains: no share of the brightest light."""
    bright, dim = (
        SceneObject(depth_m=z, centre=(0.0, y), size=(0.14, 0.14), brightness=b)
        for z, y, b in ((0.0026, -0.13, 1.0), (0.0031, 0.13, 0.1))
    )
    frame = capture(Scene(objects=(bright, dim), field_px=(260, 130), photons_per_pixel=1e4, seed=5), psf)
    image = decode(frame, psf)
    assert image.figures.share_decoded > 0.97
    assert image.figures.worst_object_error < 1e-2


def test_no_texture_no_depth(psf: Psf) -> None:
    """A uniform plane beyond the field stop on all sides shows no structure but noise: nothing is claimed."""
    flat = SceneObject(depth_m=0.003, size=(0.4, 0.4), texture="uniform")
    image = decode(capture(Scene(objects=(flat,), seed=7, field_px=(128, 128)), psf), psf)
    middle = (slice(48, 80), slice(48, 80))
    assert not np.isfinite(image.depth_m[middle]).any()
    assert (image.confidence[middle] == 0.0).all()


def test_stated_errors_are_the_scatter(psf: Psf) -> None:
    """Over twelve exposures of other textures the segment's errors scatter as stated, within a factor.

    A standard deviation of twelve is known to 20 %: a factor 1.5 in the truth stays inside 0.5 to 2 by 95 %.
    """
    errors = []
    for seed in range(12):
        image = decode(capture(Scene(objects=(plane(0.0029),), seed=seed), psf), psf)
        biggest = max(image.segments, key=lambda row: row.pixels)
        errors.append((biggest.depth_m - 0.0029) / biggest.error_m)
    assert np.abs(errors).max() < 4.0
    assert 0.5 < float(np.sqrt(np.mean(np.square(errors)))) < 2.0


def test_hot_pixels_are_bridged(psf: Psf) -> None:
    scene = Scene(objects=(plane(0.0029),), full_well_e=8000.0, bit_depth=12, hot_pixels=0.002, seed=3)
    image = decode(capture(scene, psf), psf)
    assert image.figures.pixels_broken > 30
    # Between the pixels that are left out, as without them: three standard errors.
    assert image.nmae == pytest.approx(0.0, abs=5e-3)
    assert image.figures.share_decoded > 0.97


@pytest.mark.parametrize("outline", ["ellipse", "rectangle"])
def test_a_plain_object_in_the_dark_has_the_depth_of_its_outline(
    psf: Psf, outline: Literal["ellipse", "rectangle"]
) -> None:
    plain = SceneObject(depth_m=0.0027, size=(0.2, 0.2), texture="uniform", outline=outline)
    frame = capture(Scene(objects=(plain,), seed=7, field_px=(150, 150)), psf)
    image = decode(frame, psf)
    assert frame.truth is not None
    errors = image.depth_m[frame.truth.label == 1] / plain.depth_m - 1.0
    # The outline stands at half the light, which a pair of two lobes moves by up to half a downsampled pixel.
    assert np.isfinite(errors).mean() > 0.95
    (segment,) = image.segments
    # Over 12 draws of noise 0.04 % of a disc, 0.08 % of a square, of which 0.08 % are the calibration's.
    assert np.nanmax(np.abs(errors)) < 2e-3
    assert 0.0 < segment.error_m < 1e-3 * plain.depth_m


@pytest.mark.parametrize(("texture", "brightness"), [("uniform", 0.4), ("fractal", 0.25)])
def test_a_plain_object_before_a_wall_has_the_depth_of_its_outline_and_gives_it_to_nothing_else(
    psf: Psf, texture: Literal["uniform", "fractal"], brightness: float
) -> None:
    wall = SceneObject(depth_m=0.0034, size=(0.6, 0.6), texture=texture, brightness=brightness)
    disc = SceneObject(depth_m=0.0027, size=(0.18, 0.18), texture="uniform", outline="ellipse")
    frame = capture(Scene(objects=(wall, disc), seed=7, field_px=(200, 150)), psf)
    image = decode(frame, psf)
    assert frame.truth is not None
    errors = image.depth_m / frame.truth.depth_m - 1.0
    on_disc, on_wall = errors[frame.truth.label == 2], errors[frame.truth.label == 1]
    assert np.isfinite(on_disc).mean() > 0.95
    assert abs(float(np.nanmedian(on_disc))) < 6e-3
    assert float((np.abs(on_wall) > 0.05).mean()) < 0.03


def test_a_plain_object_whose_outline_has_several_depths_has_none(psf: Psf) -> None:
    tilted = SceneObject(depth_m=0.0029, size=(0.17, 0.17), texture="uniform", tilt=(0.0, 0.1))
    image = decode(capture(Scene(objects=(tilted,), seed=7, field_px=(150, 150)), psf), psf)
    assert not np.isfinite(image.depth_m).any()
    assert image.depth_pixel_m is not None
    assert not np.isfinite(image.depth_pixel_m).any()
    assert "no texture" in str(image.figures.warning)


@pytest.mark.parametrize("dark_px", [100, 500])
def test_a_sensor_much_larger_than_the_field_is_decoded_where_it_is_calibrated(field_psf: Psf, dark_px: int) -> None:
    """As a camera's own frames are, whose field stop nobody knows: no pair is made up beyond the calibrated ones."""
    frame = capture(Scene(objects=(plane(0.0029),), seed=5, field_px=(110, 110)), field_psf)
    wide = dataclasses.replace(
        frame,
        frame=np.pad(frame.frame, dark_px),
        origin_um=tuple(start - dark_px * frame.pixel_um for start in frame.origin_um),
        x_window=None,
    )
    image, own = decode(wide, field_psf), decode(frame, field_psf)
    assert max(image.depth_m.shape) < 210  # of 130 pixels between the outermost directions, and 5 % on either side
    assert image.nmae is not None
    assert own.nmae is not None
    assert image.nmae < own.nmae + 0.004
    assert image.figures.share_decoded > 0.98


def test_a_wrong_calibration_is_said(psf: Psf, field_psf: Psf) -> None:
    """The right one leaves noise; kernels moved by 2 pixels, or of unequal sharpness, leave more or no agreement."""
    frame = capture(Scene(objects=(plane(0.0029),), seed=5), psf)
    assert decode(frame, psf).figures.warning is None
    assert decode(frame, psf).figures.twin_mismatch < 0.02
    swapped = dataclasses.replace(psf, psf=psf.psf[::-1].copy())
    turned = dataclasses.replace(psf, psf=np.swapaxes(psf.psf, 2, 3).copy())
    for wrong in (swapped, turned):
        assert "calibration" in str(decode(frame, wrong).figures.warning)


def test_squares_of_one_mixture_are_small_where_the_pair_changes_fast(psf: Psf, field_psf: Psf) -> None:
    """Half a square may change the pair by a twentieth: over the field of a millimetre's focal length 12 px do."""
    sides = []
    for each in (psf, field_psf):
        decoder = Decoder.of(each, (144, 330), (-395.0, -178.0))
        assert decoder is not None
        sides.append(decoder.filters.block_px)
        assert min(decoder.calibration.core_px(0.05)) >= sides[-1]
    assert sides == [24, 12]


def test_the_filters_say_what_they_hold(psf: Psf) -> None:
    frame = capture(Scene(objects=(plane(0.0029),), seed=5), psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    before = decoder.nbytes
    first, second = decoder(frame), decoder(frame)
    np.testing.assert_array_equal(first.depth_m, second.depth_m)  # a decoder has no memory of frames
    assert decoder.nbytes > before  # but of the transfer functions that it sharpened with
    depth_m = decoder.depth_map(frame)
    both = np.isfinite(depth_m) & np.isfinite(np.asarray(first.depth_pixel_m))
    assert both.sum() > 5000
    np.testing.assert_array_equal(depth_m[both], np.asarray(first.depth_pixel_m)[both])
