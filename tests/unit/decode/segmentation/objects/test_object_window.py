"""Windows about small objects: light blurred by the pair of its own place, and the contrast of a surface's texture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.camera import capture
from metafab.decode.decoder import Decoder
from metafab.decode.segmentation.layered.layer_light import LayerOptics, at_depth
from metafab.decode.segmentation.objects.object_scene import DepthOptics, WindowScene
from metafab.decode.segmentation.objects.object_window import ObjectStart, ObjectWindow, blurred
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

WALL_M, OBJECT_M = 0.0034, 0.0029


@pytest.fixture(scope="module")
def psf() -> Psf:
    """The pair's focus drifts along x."""
    tangents = np.linspace(-0.2, 0.2, 7), np.linspace(-0.15, 0.15, 3)
    return helix_psf(1.0 / np.linspace(1 / 0.0038, 1 / 0.0024, 13), tangents=tangents)


def prepared_wall(psf: Psf, contrast: float, seed: int = 1) -> tuple[PreparedFrame, LayerOptics]:
    wall = SceneObject(depth_m=WALL_M, size=(0.6, 0.6), texture_contrast=contrast)
    frame = capture(Scene(objects=(wall,), photons_per_pixel=3000.0, field_px=(150, 150), seed=seed), psf)
    decoder = Decoder.of(psf, frame.frame.shape, frame.origin_um, frame.x_window)
    assert decoder is not None
    prepared = decoder.prepare(replace(frame, truth=None))
    assert isinstance(prepared, PreparedFrame)
    return prepared, decoder.layer_optics


def window_of(prepared: PreparedFrame, optics: LayerOptics) -> ObjectWindow:
    middle = prepared.downsampling.shape[0] // 2, prepared.downsampling.shape[1] // 2
    rectangle = np.array([0.0, 0.0, 3.0, 3.0])
    return ObjectWindow.of(
        prepared, optics, [ObjectStart(middle, 12, 1.0 / WALL_M, np.ones(2), 1.0 / OBJECT_M, rectangle)]
    )


def test_light_is_blurred_by_the_pair_of_its_own_place(psf: Psf) -> None:
    prepared, optics = prepared_wall(psf, 0.25)
    window = window_of(prepared, optics)
    middle = prepared.downsampling.shape[0] // 2, prepared.downsampling.shape[1] // 2
    n, away = window.side, (4, -9)
    light = np.zeros((1, n, n), dtype=np.float32)
    light[0, n // 2 + away[0], n // 2 + away[1]] = 1.0
    pair = at_depth(optics, window.pair[0], 1.0 / OBJECT_M)
    there = at_depth(optics, optics.pair_about((middle[0] + away[0], middle[1] + away[1]), n), 1.0 / OBJECT_M)
    exact = window.pictures(there * window.spectra(light))
    by_changes = window.pictures(blurred(pair[None], window.moments(light))[0])
    by_middle = window.pictures(pair[0] * window.spectra(light))
    error, of_middle = (np.linalg.norm(one - exact) / np.linalg.norm(exact) for one in (by_changes, by_middle))
    # 0.013 here: the second differences of the field.
    assert error < 0.02
    assert of_middle > 0.1


def test_the_adjoint_is_that_of_the_images(psf: Psf) -> None:
    window = window_of(*prepared_wall(psf, 0.25))
    n = window.side
    unknowns = np.array([[-np.log(OBJECT_M), n / 2, n / 2, 3.0, 3.0, 1.0, 1.1, 0.9, 1.2]])
    scene = WindowScene.of(window, DepthOptics.of(window, unknowns[:, 0]), unknowns)
    textures, images = np.random.default_rng(1).normal(size=(2, 1, 2, n, n)).astype(np.float32)
    there = float((scene.textured(window.spectra(textures)) * images).sum(dtype=np.float64))
    back = float((window.pictures(scene.adjoint(images)) * textures).sum(dtype=np.float64))
    assert there == pytest.approx(back, rel=1e-4)


def test_the_contrast_of_a_surface_is_measured(psf: Psf) -> None:
    """Textures of a tenth and of three tenths; the model's spectrum reaches less far down than the scene's."""
    faint, strong = (
        np.mean(
            [
                float((one.amplitude / one.light).max())
                for one in (window_of(*prepared_wall(psf, contrast, seed)) for seed in (1, 2, 3))
            ]
        )
        for contrast in (0.1, 0.3)
    )
    assert strong / faint == pytest.approx(3.0, rel=0.15)
