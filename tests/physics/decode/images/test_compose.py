"""Surfaces without texture beside textured ones: no depth is claimed for them, and theirs stays right."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from metafab.camera import capture
from metafab.decode import Decoder, Image4D, decode
from metafab.decode.images.compose import depth_maps, power_without_noise
from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.segments import Regions, SegmentDepth
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

WALL = SceneObject(depth_m=0.0032, size=(0.6, 0.6))
DISC = SceneObject(depth_m=0.0027, size=(0.2, 0.2), outline="ellipse")


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(1.0 / np.linspace(1 / 0.00245, 1 / 0.0036, 9))


def shares(image: Image4D, label: np.ndarray, truth: np.ndarray) -> list[tuple[float, float]]:
    """Of each object: pixels with a depth, and with one that is off by more than 5 %."""
    found = []
    for number in (1, 2):
        depth = image.depth_m[label == number] / truth[label == number]
        found.append((float(np.isfinite(depth).mean()), float((np.abs(depth - 1.0) > 0.05).mean())))
    return found


@pytest.mark.parametrize(
    ("index", "size", "seed"),
    [(0, 0.08, 1), (0, 0.08, 2), (1, 0.2, 1), (1, 0.2, 2)],
    ids=["wall-1", "wall-2", "disc-1", "disc-2"],
)
def test_a_plain_surface_does_not_take_its_neighbours_depth(psf: Psf, index: int, size: float, seed: int) -> None:
    objects = [WALL, dataclasses.replace(DISC, size=(size, size))]
    objects[index] = dataclasses.replace(objects[index], texture="uniform")
    scene = Scene(objects=tuple(objects), field_px=(220, 144), photons_per_pixel=3000.0, seed=seed)
    frame = capture(scene, psf, seed=seed)
    image = decode(frame, psf)
    assert frame.truth is not None
    of_objects = shares(image, frame.truth.label, frame.truth.depth_m)
    # Outlines of the textured one, a blur wide, stay with it.
    assert of_objects[index][1] < 0.06
    assert of_objects[1 - index][0] > 0.5
    assert of_objects[1 - index][1] < 0.03


def test_a_decoder_refuses_frames_from_elsewhere_on_the_sensor(psf: Psf) -> None:
    frame = capture(Scene(objects=(WALL,), field_px=(96, 96)), psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    assert np.isfinite(decoder(frame).depth_m).any()
    x_um, y_um = frame.origin_um
    for wrong, word in (
        (dataclasses.replace(frame, origin_um=(x_um + 15 * frame.pixel_um, y_um)), "starts at"),
        (dataclasses.replace(frame, pixel_um=2.0 * frame.pixel_um), "pixels of"),
    ):
        image = decoder(wrong)
        assert not np.isfinite(image.depth_m).any()
        assert word in str(image.figures.reason)


def test_no_depth_is_claimed_where_it_is_more_likely_wrong() -> None:
    shape = (20, 30)
    right = np.ones(shape)
    right[:, 10:20], right[:, 20:] = 0.6, 0.3
    everywhere, one = np.ones(shape, dtype=bool), np.ones(shape, dtype=np.int32)
    regions = Regions(1, (SegmentDepth(2.0, 1e-3, 0.9, 1.0, Plane(2.0)),), one, one, one, right)
    maps = depth_maps(PixelDepth(np.full(shape, 2.0), np.full(shape, 5e-3), everywhere), regions, 1, shape)
    assert (maps.depth_m[:, :20] == 0.5).all() and np.isnan(maps.depth_m[:, 20:]).all()
    # A standard error of 0.1 % is never off by 5 %: what remains is the probability of the segment.
    np.testing.assert_allclose(maps.confidence[:, :10], 1.0)
    np.testing.assert_allclose(maps.confidence[:, 10:20], 0.6)
    assert (maps.confidence[:, 20:] == 0.0).all()


def test_a_segment_of_a_large_error_is_not_sure() -> None:
    """Depths of segments scatter by 1.45 times what they state: 5 % is 1.4 such errors of 2.5 %, not twice as many."""
    shape = (20, 30)
    everywhere, one = np.ones(shape, dtype=bool), np.ones(shape, dtype=np.int32)
    regions = Regions(1, (SegmentDepth(2.0, 0.025, 0.9, 1.0, Plane(2.0)),), one, one, one, np.ones(shape))
    maps = depth_maps(PixelDepth(np.full(shape, 2.0), np.full(shape, 0.06), everywhere), regions, 1, shape)
    np.testing.assert_allclose(maps.confidence, 0.832, atol=1e-3)


@pytest.mark.parametrize("ratio", [0.1, 1.0, 5.0])
@pytest.mark.parametrize("signal", [0.0, 2.0, 50.0])
def test_power_without_noise_is_that_of_the_texture(ratio: float, signal: float) -> None:
    light = np.array([[ratio * 900.0], [900.0]])
    noise = 0.01 * (light + 4.0)
    power = np.sqrt((ratio**2 * signal + noise[0]) * (signal + noise[1]))
    assert power_without_noise(power, light, noise) == pytest.approx(ratio * signal, abs=1e-6)
