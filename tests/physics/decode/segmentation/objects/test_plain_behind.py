"""Objects before a plain wall: the wall beside them does not surely have their depth."""

from __future__ import annotations

import numpy as np

from metafab.camera import draws
from metafab.decode import decode
from metafab.decode.evaluation import overlap
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

WALL_M, SEEDS = 0.0034, (1, 2, 3)


def test_a_plain_wall_beside_an_object_does_not_surely_have_its_depth() -> None:
    """The wall is textured at its lower end alone; above, the blur of the object's outline shows the object's depth.

    Of all sure pixels 0.9, 2.4 and 3.1 % were wrong, the wall's within a window of the object.
    """
    psf = helix_psf(1.0 / np.linspace(1 / 0.0038, 1 / 0.0024, 13))
    plain = SceneObject(depth_m=WALL_M, size=(1.5, 1.5), texture="uniform")
    textured = SceneObject(depth_m=0.9999 * WALL_M, size=(1.5, 0.3), centre=(0.0, -0.25), texture_contrast=0.3)
    thing = SceneObject(depth_m=0.0025, size=(0.12, 0.3), centre=(0.05, 0.15), texture_contrast=0.3)
    scene = Scene(objects=(plain, textured, thing), photons_per_pixel=3000.0, field_px=(420, 165))
    for frame in draws(scene, psf, SEEDS):
        image = decode(frame, psf)
        both = overlap(image, frame)
        assert both is not None
        here, truth = both
        error = np.abs(image.depth_m[here] / truth.depth_m - 1.0)
        sure = np.isfinite(error) & (image.confidence[here] > 0.9)
        assert (error[sure] > 0.05).mean() < 0.003  # measured: 0 to 0.0004
        # What shows a texture of its own keeps its depth: 0.88 to 0.99 of the pixels, as before.
        for number in (2, 3):
            assert np.isfinite(error[truth.label == number]).mean() > 0.8
