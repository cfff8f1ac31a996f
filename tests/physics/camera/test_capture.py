"""What light does between scene and frame: photons are conserved, near hides far, the twins are conjugate."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from metafab.camera import ImageMap, RawFrame, capture, film
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import PIXEL_UM, helix_psf

BRIGHT = 1e7  # photons at which shot noise is far below what is tested


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(np.linspace(0.0025, 0.0034, 7))


@pytest.fixture(scope="module")
def field_psf() -> Psf:
    tangents = np.linspace(-0.09, 0.09, 5), np.linspace(-0.09, 0.09, 3)
    return helix_psf(np.linspace(0.0025, 0.0034, 7), tangents=tangents)


def scene(*objects: SceneObject, **settings: object) -> Scene:
    return Scene(
        objects=objects, **{"photons_per_pixel": BRIGHT, "read_noise_e": 0.0, "field_px": (96, 96), **settings}
    )


def halves(frame: RawFrame) -> tuple[FloatArray, FloatArray]:
    """The frame left and right of the axis."""
    axis = round(-frame.origin_um[0] / frame.pixel_um)
    return frame.frame[:, :axis], frame.frame[:, axis:]


def test_photons_are_conserved_and_split_by_the_polarisation_contrast(psf: Psf) -> None:
    piece = SceneObject(depth_m=0.0029, size=(0.06, 0.06), polarisation_contrast=3.0)
    frame = capture(scene(piece), psf)
    assert frame.truth is not None
    for image, true in zip(halves(frame), (frame.truth.intensity_x, frame.truth.intensity_y), strict=True):
        # The throughput differs from the stack's mean by the light outside of the 48-pixel window: below 0.3 %.
        assert image.sum() == pytest.approx(true.sum(), rel=3e-3)
    assert frame.truth.intensity_x.sum() == pytest.approx(3.0 * frame.truth.intensity_y.sum())


def test_photons_of_a_frame_are_those_that_arrive_whatever_the_sensor_makes_of_them(psf: Psf) -> None:
    piece = SceneObject(depth_m=0.0029, size=(0.06, 0.06))
    frame = capture(scene(piece), psf)
    assert frame.photons == pytest.approx(frame.frame.sum(), rel=1e-4)  # shot noise: 1e-6
    for sensor in ({"quantum_efficiency": 0.5}, {"full_well_e": 0.1 * BRIGHT}, {"dark_e": BRIGHT}):
        assert capture(scene(piece, **sensor), psf).photons == pytest.approx(frame.photons, rel=1e-12)


def test_a_small_object_shows_the_psf_pair_where_the_map_says(psf: Psf) -> None:
    tangent = (0.03, -0.02)
    dot = SceneObject(depth_m=float(psf.depth_m[3]), centre=tangent, size=(3e-3, 3e-3), texture="uniform")
    frame = capture(scene(dot), psf)
    image_map = ImageMap.from_psf(psf)
    for polarisation, image in enumerate(halves(frame)):
        left = 0 if polarisation == 0 else frame.frame.shape[1] - image.shape[1]
        rows, columns = np.indices(image.shape)
        centroid_x = frame.origin_um[0] + PIXEL_UM * (left + (columns * image).sum() / image.sum())
        centroid_y = frame.origin_um[1] + PIXEL_UM * ((rows * image).sum() / image.sum())
        own = psf.psf[polarisation, 3]
        y, x = np.indices(own.shape) - own.shape[0] // 2
        expected = image_map.to_sensor_um(polarisation, np.array(tangent[0]), np.array(tangent[1]))
        # The object is 1.9 pixels wide and rendered on a grid: a twentieth of a pixel.
        assert centroid_x == pytest.approx(
            float(expected[0]) + PIXEL_UM * (x * own).sum() / own.sum(), abs=0.05 * PIXEL_UM
        )
        assert centroid_y == pytest.approx(
            float(expected[1]) + PIXEL_UM * (y * own).sum() / own.sum(), abs=0.05 * PIXEL_UM
        )


def test_images_are_inverted(psf: Psf) -> None:
    """An object at +x, +y has its geometric image at -x, -y of the axis' image."""
    frame = capture(scene(SceneObject(depth_m=0.003, centre=(0.04, 0.05), size=(0.02, 0.02))), psf)
    assert frame.truth is not None
    row, column = np.argwhere(frame.truth.label == 1).mean(axis=0)
    assert row < 48 - 20
    assert column < 48 - 15


def test_a_near_object_hides_the_far_one(psf: Psf) -> None:
    """A wide near piece before a far one: the frame is the near piece's alone."""
    near = SceneObject(depth_m=0.0026, size=(0.1, 0.1), texture="uniform")
    far = SceneObject(depth_m=0.0033, size=(0.03, 0.03), brightness=5.0)
    alone, both = (capture(scene(*pieces), psf).frame for pieces in ((near,), (near, far)))
    # The far piece ends 24 pixels inside the near one's outline, where blurred coverage is 1 to about 1 %
    # (the pair's wings); five times as bright, it may show by 5 %. Added, its light would be 500 %.
    middle = np.abs(both - alone).max() / BRIGHT
    assert middle < 0.05


def test_light_is_not_counted_twice_at_an_occluding_edge(psf: Psf) -> None:
    """Two pieces of equal brightness side by side at different depths: no bright or dark seam beyond blur's."""
    near = SceneObject(depth_m=0.0026, centre=(-0.05, 0.0), size=(0.1, 0.19), texture="uniform")
    far = SceneObject(depth_m=0.0033, centre=(0.0, 0.0), size=(0.19, 0.19), texture="uniform")
    frame = capture(scene(near, far, vignetting="none"), psf)
    left, _ = halves(frame)
    columns = slice(24 + 20, 24 + 76)
    rows = slice(24 + 20, 24 + 76)
    assert left[rows, columns] == pytest.approx(BRIGHT, rel=0.02)


def test_twins_turn_into_each_other_by_point_reflection(psf: Psf) -> None:
    """A scene and its point mirror image: the y twin of one is the x twin of the other, mirrored."""
    offset = SceneObject(depth_m=0.0028, centre=(0.02, -0.03), size=(0.03, 0.02), texture="uniform")
    mirrored = dataclasses.replace(offset, centre=(-0.02, 0.03))
    frames = [capture(scene(one, photons_per_pixel=1e10), psf) for one in (offset, mirrored)]
    first = frames[0].frame / frames[0].frame.sum()
    second = frames[1].frame / frames[1].frame.sum()
    row, column = (round(-o / PIXEL_UM) for o in frames[0].origin_um[::-1])
    # About the sensor's centre pixel, as far as both reach.
    reach_y, reach_x = min(row, first.shape[0] - 1 - row), min(column, first.shape[1] - 1 - column)
    window = (slice(row - reach_y, row + reach_y + 1), slice(column - reach_x, column + reach_x + 1))
    difference = first[window] - second[window][::-1, ::-1]
    # The axis' image is not on a pixel: edges are sampled differently by up to half a pixel's coverage.
    assert np.abs(difference).max() < 0.05 * first.max()


def test_noise_is_poisson_plus_read_noise(psf: Psf) -> None:
    flat = SceneObject(depth_m=0.0029, size=(0.19, 0.19), texture="uniform")
    settings = {"photons_per_pixel": 400.0, "read_noise_e": 10.0}
    first, second = (capture(scene(flat, **settings), psf, seed=seed) for seed in (1, 2))
    middle = (slice(60, 84), slice(60, 84))
    difference = first.frame[middle] - second.frame[middle]
    # 576 pixels: the variance of a variance is 2/576; four standard deviations are 24 %.
    assert difference.var() / 2.0 == pytest.approx(400.0 + 100.0, rel=0.24)


def test_the_field_dependent_pair_reduces_to_the_plain_one_on_the_axis(psf: Psf, field_psf: Psf) -> None:
    dot = SceneObject(depth_m=0.0029, size=(0.012, 0.012), texture="uniform")
    plain, varied = capture(scene(dot), psf), capture(scene(dot), field_psf)
    x0, y0 = plain.truth_origin_um, varied.truth_origin_um
    assert x0 == y0
    assert plain.truth is not None
    assert varied.truth is not None
    image = halves(plain)[0]
    row = round((plain.origin_um[1] - varied.origin_um[1]) / PIXEL_UM)
    column = round((plain.origin_um[0] - varied.origin_um[0]) / PIXEL_UM)
    other = varied.frame[max(row, 0) :, max(column, 0) :][: image.shape[0], : image.shape[1]]
    mine = image[max(-row, 0) :, max(-column, 0) :][: other.shape[0], : other.shape[1]]
    # The field map stretches the image by 3 % along x (1 / cos^3 of 8 degrees), 0.2 pixels at the piece's edge.
    assert mine == pytest.approx(other, abs=0.08 * image.max())


def test_depths_outside_the_calibration_are_refused(psf: Psf) -> None:
    with pytest.raises(InputError, match="inside the PSF calibration"):
        capture(scene(SceneObject(depth_m=0.01)), psf)


def test_every_object_outside_the_calibration_is_named_with_its_depths(psf: Psf) -> None:
    inside = SceneObject(depth_m=0.003)
    objects = SceneObject(depth_m=0.01), inside, dataclasses.replace(inside, tilt=(0.9, 0.0))
    with pytest.raises(InputError) as refused:
        capture(scene(*objects), psf)
    far, tilted = refused.value.faults
    assert (far.field, far.got) == ("objects[0].depth_m", "0.01 m")
    assert tilted.field == "objects[2].depth_m" and "by its tilt" in tilted.got
    drifting = dataclasses.replace(inside, velocity_m_per_s=(0.0, 0.0, 0.1))
    with pytest.raises(InputError, match=r"objects\[1\].*0.003\d* to 0.013\d* m by its tilt, bulge or motion"):
        list(film(scene(inside, drifting, frames=3, frame_interval_s=0.05, exposure_s=0.001), psf))


def test_overlapping_images_are_refused(psf: Psf) -> None:
    with pytest.raises(InputError, match="side by side"):
        capture(scene(SceneObject(depth_m=0.003), field_px=(64, 512)), psf)


def test_full_wells_hot_pixels_and_whole_counts(psf: Psf) -> None:
    flat = SceneObject(depth_m=0.0029, size=(0.19, 0.19), texture="uniform")
    settings = {"photons_per_pixel": 3000.0, "full_well_e": 4095.0, "bit_depth": 12, "hot_pixels": 0.01, "dark_e": 50.0}
    frame = capture(scene(flat, **settings), psf)
    assert frame.saturation_e == 4095.0
    assert (frame.frame == np.round(frame.frame)).all()  # a count is one electron here
    assert frame.frame.max() == 4095.0
    # 60 000 pixels of which 1 % are hot: a standard deviation of 24 pixels.
    assert (frame.frame == 4095.0).mean() == pytest.approx(0.01, abs=0.002)
    # The dark current's mean is taken off; 576 pixels leave 2.3 electrons of uncertainty.
    assert np.median(frame.frame[60:84, 60:84]) == pytest.approx(3000.0, abs=10.0)


def test_an_object_whose_visible_part_is_calibrated_is_exposed(psf: Psf) -> None:
    """The corners of an ellipse's box, and what lies outside the field, may be at any depth."""
    round_one = SceneObject(depth_m=0.003, tilt=(0.16, 0.16), size=(0.08, 0.08), outline="ellipse")
    outside = SceneObject(depth_m=0.0041, centre=(0.6, 0.0), size=(0.05, 0.05))
    assert capture(scene(round_one, outside), psf).frame.max() > 0.0
