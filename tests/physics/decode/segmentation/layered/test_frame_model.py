"""Outlines of an object before a wall: the model of the frame against the truth, and against correlation alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from metafab.camera import RawFrame, capture
from metafab.decode.decoder import DecoderNumerics, decode
from metafab.decode.image import Image4D
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

WALL_M, OBJECT_M = 0.0034, 0.0026


def wrong_side(image: Image4D, frame: RawFrame, low_px: float, high_px: float) -> tuple[float, float]:
    """Shares of the wall's and of the object's pixels, at distances from the outline, with the other's depth."""
    truth = frame.truth
    assert truth is not None
    row, column = (round((frame.truth_origin_um[a] - image.origin_um[a]) / image.pixel_um) for a in (1, 0))
    rows, columns = truth.depth_m.shape
    depth_m = image.depth_m[row : row + rows, column : column + columns]
    near = np.abs(truth.depth_m - OBJECT_M) < np.abs(truth.depth_m - WALL_M)
    shares = []
    for mask, own_m, other_m in ((~near, WALL_M, OBJECT_M), (near, OBJECT_M, WALL_M)):
        away = distance_transform_edt(mask)
        band = mask & np.isfinite(truth.depth_m) & (away > low_px) & (away <= high_px)
        wrong = np.abs(depth_m - other_m) < np.abs(depth_m - own_m)
        shares.append(float(wrong[band].mean()))
    return shares[0], shares[1]


@pytest.mark.parametrize("contrast", [1.0, 1.6])
def test_the_outline_of_an_object_before_a_wall(contrast: float) -> None:
    psf = helix_psf(1.0 / np.linspace(1 / 0.0038, 1 / 0.0024, 13))
    wall = SceneObject(depth_m=WALL_M, size=(0.6, 0.6))
    thing = SceneObject(depth_m=OBJECT_M, size=(0.12, 0.22), polarisation_contrast=contrast)
    scene = Scene(objects=(wall, thing), photons_per_pixel=3000.0, field_px=(260, 165), seed=4)
    frame = capture(scene, psf)
    images = [decode(frame, psf, numerics=DecoderNumerics(modelled=modelled)) for modelled in (False, True)]
    (before, _), (wall_wrong, thing_wrong) = (wrong_side(image, frame, 3.0, 6.0) for image in images)
    assert wall_wrong < max(0.08, 0.5 * before)
    assert thing_wrong < 0.15
