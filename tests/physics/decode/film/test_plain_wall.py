"""A film of an object that moves before a plain wall: beside it, the wall does not surely have its depth."""

from __future__ import annotations

import numpy as np

from metafab.camera import film
from metafab.decode import Decoder, VideoDecoder
from metafab.decode.evaluation import overlap
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

WALL_M = 0.0034
#: The wall is textured at its lower end alone; the object rises by 6 px a frame.
SCENE = Scene(
    objects=(
        SceneObject(depth_m=WALL_M, size=(1.5, 1.5), texture="uniform"),
        SceneObject(depth_m=0.9999 * WALL_M, size=(1.5, 0.3), centre=(0.0, -0.25), texture_contrast=0.3),
        SceneObject(
            depth_m=0.0025, size=(0.12, 0.12), centre=(0.05, 0.05), texture_contrast=0.3,
            velocity_m_per_s=(0.0, 0.0003, 0.0),
        ),
    ),
    field_px=(420, 165), frames=5, frame_interval_s=0.1, exposure_s=0.002, photons_per_pixel=3000.0, seed=1,
)  # fmt: skip


def test_a_plain_wall_beside_what_moves_does_not_surely_have_its_depth() -> None:
    """Of the sure pixels of the five frames 2.0 to 3.2 % were wrong; in the fifth the depths are those of a surface."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0038, 1 / 0.0024, 13))
    frames = list(film(SCENE, psf))
    first = Decoder.of(psf, frames[0].frame.shape, frames[0].origin_um, frames[0].x_window)
    assert first is not None
    decoder = VideoDecoder(first, second_looks=())
    for frame in frames:
        image = decoder(frame)
        both = overlap(image, frame)
        assert both is not None
        here, truth = both
        error = np.abs(image.depth_m[here] / truth.depth_m - 1.0)
        sure = np.isfinite(error) & (image.confidence[here] > 0.9)
        assert (error[sure] > 0.05).mean() < 0.002  # measured: 0 to 0.0001
        # What shows a texture of its own keeps its depth: 0.83 to 0.98 of the pixels, as before.
        for number in (2, 3):
            assert np.isfinite(error[truth.label == number]).mean() > 0.75
    assert decoder.changed_share < 0.5
