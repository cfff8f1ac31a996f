"""What does not move is blurred once in a film, and looks the same as if it were blurred again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.blurs import Blurs
from metafab.camera.rendering.lens import Lens
from metafab.camera.rendering.motion import moved
from metafab.camera.rendering.render import Renderer
from metafab.camera.rendering.windows import sensor_windows
from metafab.core.parallel.progress import silent
from metafab.spec import Scene, SceneObject
from tests.conjugate_pair import helix_psf

WALL = SceneObject(depth_m=0.0033, size=(0.1, 0.1))
CAR = SceneObject(depth_m=0.0028, size=(0.03, 0.03), velocity_m_per_s=(0.001, 0.0, -0.001))
POST = SceneObject(depth_m=0.0026, size=(0.01, 0.08))
SCENE = Scene(objects=(CAR, WALL, POST), field_px=(48, 48), frames=2)


def test_a_lens_that_remembers_what_stands_still_sees_what_a_new_one_sees() -> None:
    psf = helix_psf(np.linspace(0.0025, 0.0034, 7), window_px=32)

    def lens() -> Lens:
        return Lens(Blurs(PairKernels(psf)), sensor_windows(SCENE, psf, ImageMap.from_psf(psf)))

    first = Renderer.of(SCENE, psf.pixel_um / psf.sensor_distance_um, 1)
    later = Renderer(moved(SCENE, 0.04), first.textures)
    used = lens()
    before = used.light(first, silent)
    assert set(used.still) == {(p, index) for p in (0, 1) for index in (1, 2)}
    after = used.light(later, silent)
    np.testing.assert_array_equal(after, lens().light(later, silent))
    assert np.abs(after - before).max() > 10.0


def test_objects_that_the_image_drew_are_those_of_the_truth() -> None:
    """Objects at rest are kept, moving ones drawn at their new places, tilted ones drawn again for their memory."""
    psf, lamp = helix_psf(np.linspace(0.0025, 0.0034, 7), window_px=32), replace(POST, depth_m=0.003, tilt=(0.05, 0.0))
    scene = replace(SCENE, objects=(CAR, WALL, POST, lamp))
    used = Lens(Blurs(PairKernels(psf)), sensor_windows(scene, psf, ImageMap.from_psf(psf)))
    first = Renderer.of(scene, psf.pixel_um / psf.sensor_distance_um, 1)
    used.light(first, silent)
    later, window = Renderer(moved(scene, 0.04), first.textures), used.windows[0]
    got, drawn = list(used.pieces(later)), list(later.pieces(window.tangent_x, window.tangent_y))
    assert [piece.label for piece in got] == [piece.label for piece in drawn] == [2, 4, 1, 3]
    for one, other in zip(got, drawn, strict=True):
        np.testing.assert_array_equal(one.brightness, other.brightness)
        assert (one.rows, one.columns) == (other.rows, other.columns)
    assert [piece.label for piece in got if any(piece is layer.piece for layer in used.still.values())] == [2, 3]


def test_a_scene_at_rest_is_rendered_once() -> None:
    psf = helix_psf(np.linspace(0.0025, 0.0034, 7), window_px=32)
    scene = replace(SCENE, objects=(WALL, POST))
    used = Lens(Blurs(PairKernels(psf)), sensor_windows(scene, psf, ImageMap.from_psf(psf)))
    renderer = Renderer.of(scene, psf.pixel_um / psf.sensor_distance_um, 1)
    first = used.light(renderer, silent)
    used.blurs.of_depths.clear()
    np.testing.assert_array_equal(used.light(renderer, silent), first)
    assert not used.blurs.of_depths  # nothing was blurred again
    used.forget_textures()
    other = used.light(Renderer.of(scene, psf.pixel_um / psf.sensor_distance_um, 2), silent)
    assert np.abs(other - first).max() > 10.0


def test_what_moves_hides_what_stands_still_as_if_it_stood_there() -> None:
    psf = helix_psf(np.linspace(0.0025, 0.0034, 7), window_px=32)

    def light(scene: Scene, *earlier: Scene) -> np.ndarray:
        lens = Lens(Blurs(PairKernels(psf)), sensor_windows(scene, psf, ImageMap.from_psf(psf)))
        first = Renderer.of(scene, psf.pixel_um / psf.sensor_distance_um, 1)
        for one in earlier:
            lens.light(Renderer(one, first.textures), silent)
        return lens.light(Renderer(scene, first.textures), silent)

    later = moved(SCENE, 0.04)
    parked = replace(later, objects=tuple(replace(o, velocity_m_per_s=(0.0, 0.0, 0.0)) for o in later.objects))
    standing, moving = light(parked), light(later, SCENE)
    # Slopes of the grid's directions are one-sided at the edge of the part that is drawn again.
    assert np.abs(moving - standing).max() < 1e-3 * standing.max()


def test_objects_at_rest_are_not_touched_by_time() -> None:
    """Not even by rounding: what stands still is known by staying equal."""
    objects = moved(SCENE, 0.0371).objects
    assert objects[1] is SCENE.objects[1]
    assert objects[0].depth_m < CAR.depth_m
