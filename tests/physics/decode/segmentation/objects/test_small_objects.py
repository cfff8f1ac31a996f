"""Small objects before a wall: found with an honest error, never claimed for the wall, and none where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.camera import RawFrame, capture
from metafab.decode.decoder import decode
from metafab.decode.image import Image4D
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

WALL_M = 0.0034


def decoded(
    *things: SceneObject, wall: SceneObject | None = None, columns: int = 260, seed: int = 4
) -> tuple[Image4D, RawFrame]:
    psf = helix_psf(1.0 / np.linspace(1 / 0.0038, 1 / 0.0024, 13))
    wall = wall or SceneObject(depth_m=WALL_M, size=(0.6, 0.6))
    frame = capture(Scene(objects=(wall, *things), photons_per_pixel=3000.0, field_px=(columns, 165), seed=seed), psf)
    return decode(frame, psf), frame


def errors_of(image: Image4D, frame: RawFrame, number: int) -> np.ndarray:
    """Relative errors of the pixels of an object; NaN where no depth is claimed."""
    truth = frame.truth
    assert truth is not None
    row, column = (round((frame.truth_origin_um[a] - image.origin_um[a]) / image.pixel_um) for a in (1, 0))
    rows, columns = truth.depth_m.shape
    errors = image.depth_m[row : row + rows, column : column + columns] / truth.depth_m - 1.0
    return np.asarray(errors[truth.label == number])


@pytest.mark.parametrize("contrast", [0.5, 2.0])
def test_a_small_object_of_another_contrast_is_found(contrast: float) -> None:
    thing = SceneObject(depth_m=0.0027, size=(0.04, 0.04), polarisation_contrast=contrast)
    image, frame = decoded(thing)
    errors, wall = errors_of(image, frame, 2), errors_of(image, frame, 1)
    small, large = (pick(image.segments, key=lambda one: one.depth_m) for pick in (min, max))
    assert np.isfinite(errors).mean() > 0.5
    # Measured over six draws each: 2.1 % off at most, 1.7 to 3.2 % stated.
    assert abs(np.nanmedian(errors)) < min(3.0 * small.error_m / small.depth_m, 0.1)
    # Measured: rms of twelve draws 0.13 %, stated 0.10 %.
    assert abs(np.nanmedian(wall)) < 3.0 * large.error_m / large.depth_m < 0.004
    assert np.isfinite(wall).mean() > 0.95


@pytest.mark.parametrize("contrast", [0.5, 2.0])
def test_a_small_disc_is_found(contrast: float) -> None:
    """As squares, eight of twelve discs were 1.6 to 6.6 % off, and three had no depth."""
    errors = []
    for seed in (4, 5):
        disc = SceneObject(depth_m=0.0027, size=(0.05, 0.05), outline="ellipse", polarisation_contrast=contrast)
        image, frame = decoded(disc, seed=seed)
        of_disc = errors_of(image, frame, 2)
        assert np.isfinite(of_disc).mean() > 0.9
        errors.append(np.abs(np.nanmedian(of_disc)))
    # Measured over three draws of three sizes: 0.66 % at most, 0.3 % rms.
    assert np.mean(errors) < 0.012


def test_a_patch_of_another_contrast_on_the_wall_is_no_object() -> None:
    patch = SceneObject(depth_m=0.9999 * WALL_M, size=(0.04, 0.04), polarisation_contrast=2.0)
    image, frame = decoded(patch)
    assert all(abs(one.depth_m / WALL_M - 1.0) < 0.02 for one in image.segments)
    assert np.nanmax(np.abs(errors_of(image, frame, 1))) < 0.02


def test_light_from_beyond_the_picture_is_no_object() -> None:
    """Blobs at the border were taken for objects at 0.0025 m."""
    thing = SceneObject(depth_m=0.0027, size=(0.04, 0.04), polarisation_contrast=2.0)
    image, frame = decoded(thing, columns=320, seed=9)
    assert abs(np.nanmedian(errors_of(image, frame, 2))) < 0.02
    assert len(image.segments) == 2


def test_an_object_whose_blob_is_smaller_than_it_is_found() -> None:
    """Of a faint texture, the light at its sides fits the wall: the fitted rectangle reaches beyond its blob."""
    thing = SceneObject(depth_m=0.0028, size=(0.045, 0.045), texture_contrast=0.1)
    image, frame = decoded(thing, seed=7)
    errors, wall = errors_of(image, frame, 2), errors_of(image, frame, 1)
    assert np.isfinite(errors).mean() > 0.5
    # Measured in three of eight draws, which had no depth: 0.3, 1.0 and -0.4 %, 1.1 to 1.6 % stated.
    assert abs(np.nanmedian(errors)) < 0.03
    assert abs(np.nanmedian(wall)) < 0.004
