"""Near hides far by what geometry hides from each point of the aperture, against a direct sum over sub-apertures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.camera import ImageMap, PairKernels
from metafab.camera.rendering.blurs import Blurs
from metafab.camera.rendering.lens import Lens
from metafab.camera.rendering.picture import DepthPicture
from metafab.camera.rendering.render import Renderer
from metafab.camera.rendering.windows import sensor_windows
from metafab.core.conventions import FloatArray, sensor_distance_um
from metafab.core.parallel.progress import silent
from metafab.optics.geometry.aperture import sub_apertures_um
from metafab.optics.point_spread import Psf
from metafab.spec import Scene, SceneObject
from tests import sub_apertures
from tests.conjugate_pair import ANGLE_DEG, FOCAL_LENGTH_MM, FOCUS_DEPTH_M, PIXEL_UM, circle_um, helix_psf

PIXEL = PIXEL_UM / sensor_distance_um(FOCAL_LENGTH_MM, ANGLE_DEG, FOCUS_DEPTH_M)
DEPTHS_M = np.array([0.0025, 0.0026, 0.0028, 0.003, 0.0031, 0.0033, 0.0034])


@pytest.fixture(scope="module")
def psf() -> Psf:
    return helix_psf(DEPTHS_M)


def surface(
    depth_m: float, centre_px: tuple[float, float], size_px: tuple[float, float], **fields: object
) -> SceneObject:
    centre, size = (tuple(PIXEL * value for value in pair) for pair in (centre_px, size_px))
    return SceneObject(depth_m=depth_m, centre=centre, size=size, **{"texture": "uniform", **fields})


def rendered(psf: Psf, *objects: SceneObject) -> tuple[FloatArray, Renderer, Lens]:
    """The x image with its margin: the light of each pixel."""
    scene = Scene(objects=objects, field_px=(48, 48), photons_per_pixel=1.0, vignetting="none")
    lens = Lens(Blurs(PairKernels(psf)), sensor_windows(scene, psf, ImageMap.from_psf(psf)))
    renderer = Renderer.of(scene, psf.pixel_um / psf.sensor_distance_um, 1)
    window = lens.windows[0]
    row, column = window.row - lens.bottom - 24, window.column - lens.left - 24
    return lens.light(renderer, silent)[row : row + 96, column : column + 96], renderer, lens


def direct(psf: Psf, renderer: Renderer, lens: Lens) -> FloatArray:
    window, (n_y, n_x) = lens.windows[0], lens.windows[0].stop.shape
    light, objects = [], []
    for index, spec in reversed(renderer.farthest_first()):
        piece = renderer.piece(index, window.tangent_x, window.tangent_y)
        whole = np.zeros((n_y, n_x))
        whole[piece.rows, piece.columns] = piece.brightness.sum(axis=0) * window.gain[piece.rows, piece.columns]
        light.append(whole)
        objects.append(spec)
    image = sub_apertures.image(light, objects, window.tangent_x, window.tangent_y)
    return image / psf.psf[:, psf.depth_m.size // 2].sum(axis=(-2, -1)).mean() / psf.pixel_um**2


def as_picture(psf: Psf, renderer: Renderer) -> DepthPicture:
    """The nearest surface of each pixel, in the same light, as a picture with its depth."""
    axis = (np.arange(49) - 24) * PIXEL
    tangent_x, tangent_y = np.meshgrid(axis, -axis)
    light, depth_m = np.zeros(tangent_x.shape), np.full(tangent_x.shape, np.nan)
    for piece in renderer.pieces(tangent_x, tangent_y):
        covered, here = piece.coverage.sum(axis=0), (piece.rows, piece.columns)
        mine = covered >= 0.5
        light[here][mine] = piece.brightness.sum(axis=0)[mine] / covered[mine]
        depth_m[here][mine] = piece.mean_depth_m[mine]
    return DepthPicture(light, depth_m, np.ones(light.shape), (24.5 * PIXEL, 24.5 * PIXEL))


def errors(psf: Psf, *objects: SceneObject, picture: bool = False) -> tuple[float, float, float]:
    """Largest and rms error over the image's 99th percentile, and relative error of the light, within the field.

    With ``picture``, the camera photographs a picture with depth in place of the objects.
    """
    image, renderer, lens = rendered(psf, *objects)
    true = direct(psf, renderer, lens)
    if picture:
        window, alone = lens.windows[0], replace(lens, still={}, picture=as_picture(psf, renderer))
        row, column = window.row - lens.bottom - 24, window.column - lens.left - 24
        image = alone.light(renderer, silent)[row : row + 96, column : column + 96]
    inner = (slice(28, 68), slice(28, 68))
    off = (image - true)[inner] / np.percentile(true, 99.0)
    return float(np.abs(off).max()), float(off.std()), abs(float(image[inner].sum() / true[inner].sum() - 1.0))


FAR = surface(0.0033, (0, 0), (60, 60), texture="fractal")
#: Scenes, and the camera's own errors: largest, rms, light. The aperture shifts outlines by up to 5.1 pixels between
#: 2.6 and 3.3 mm, and by 0.7 pixels between 3.0 and 3.1 mm. What remains is the PSF of the cut aperture.
SCENES = {
    "alone": ([FAR], (1e-3, 3e-4, 3e-4)),
    "edge": ([FAR, surface(0.0026, (20.3, 0), (40, 60))], (0.08, 0.018, 0.004)),
    "corner": ([FAR, surface(0.0026, (20.3, 19.6), (40, 40))], (0.12, 0.024, 0.002)),
    "hole": ([FAR, *(surface(0.0026, (x, 0), (28, 60)) for x in (20, -20))], (0.095, 0.026, 0.007)),
    "three layers": (
        [FAR, surface(0.003, (6, 3), (26, 26)), surface(0.0026, (0, 0), (14, 14), texture="fractal")],
        (0.165, 0.035, 0.006),
    ),
    "near depths": (
        [surface(0.0031, (0, 0), (60, 60), texture="fractal"), surface(0.003, (12, 5), (24, 31))],
        (0.03, 0.006, 0.002),
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_cameras_error_against_the_direct_sum_is_the_stated_one(psf: Psf, name: str) -> None:
    objects, stated = SCENES[name]
    measured = errors(psf, *objects)
    assert all(error <= bound for error, bound in zip(measured, stated, strict=True)), measured


#: The same scenes, with outlines between pixels, as pictures with depth: largest and rms error, and that of the light.
#: A plain wall, because a picture does not tell what texture goes on behind an outline. Without the balance of radiance
#: at outlines they are 0.19, 0.066 and 0.012; 0.19, 0.051, 0.009; 0.22, 0.093, 0.011; 0.24, 0.055, 0.017; 0.038, 0.0094
#: and 0.001.
WALL = replace(FAR, texture="uniform")
PICTURES = {
    "edge": ([WALL, surface(0.0026, (20.5, 0), (40, 60))], (0.08, 0.02, 0.002)),
    "corner": ([WALL, surface(0.0026, (20.5, 20.5), (40, 40))], (0.13, 0.025, 0.002)),
    "hole": ([WALL, *(surface(0.0026, (x, 0), (27, 60)) for x in (20, -20))], (0.075, 0.024, 0.006)),
    "three layers": (
        [WALL, surface(0.003, (6, 3), (25, 25)), surface(0.0026, (0, 0), (13, 13), texture="fractal")],
        (0.09, 0.025, 0.005),
    ),
    "near depths": (
        [surface(0.0031, (0, 0), (60, 60), texture="fractal"), surface(0.003, (12, 5), (25, 31))],
        (0.03, 0.006, 0.001),
    ),
}


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_with_depth_are_as_near_to_the_direct_sum_as_objects(psf: Psf, name: str) -> None:
    objects, stated = PICTURES[name]
    measured = errors(psf, *objects, picture=True)
    assert all(error <= bound for error, bound in zip(measured, stated, strict=True)), measured


def test_surfaces_of_nearly_one_depth_touch_without_a_seam(psf: Psf) -> None:
    """Two halves at 3 mm and 1 um beyond, which meet inside of a pixel, are one surface."""
    halves = surface(0.003, (-20.3, 0), (40, 60)), surface(0.003001, (19.7, 0), (40, 60))
    inner = (slice(28, 68), slice(28, 68))
    image, whole = rendered(psf, *halves)[0][inner], rendered(psf, surface(0.003, (0, 0), (80, 60)))[0][inner]
    # The helix turns by 0.02 degrees in between, and the last pixels are within the blur of the surfaces' ends.
    assert np.abs(image / whole - 1.0).max() < 3e-3
    # In front of a third surface, nothing shines through between them.
    behind = rendered(psf, *halves, surface(0.0033, (0, 0), (80, 60), brightness=3.0))[0][inner]
    assert np.abs(behind / whole - 1.0).max() < 3e-3


def test_behind_an_opaque_surface_nothing_is_seen_and_a_pinhole_sees_by_directions(psf: Psf) -> None:
    near, far = surface(0.0026, (0, 0), (24, 24)), surface(0.0033, (0, 0), (12, 12), brightness=5.0)
    alone, both = rendered(psf, near)[0], rendered(psf, near, far)[0]
    # Outlines are 6 pixels apart, and shifted by 5.1 at most.
    np.testing.assert_array_equal(alone, both)
    pinhole = replace(psf, aperture_um=None)
    wider = surface(0.0033, (0, 0), (40, 40))
    light = rendered(pinhole, near, wider)[0].sum() / rendered(pinhole, near)[0].sum()
    assert light == pytest.approx(40.0**2 / 24.0**2, rel=5e-3)


def test_points_of_an_aperture_have_the_density_of_its_light() -> None:
    points = circle_um(200.0)
    assert points.shape == (128, 2) and np.hypot(*points.T).max() <= 101.0
    # Moments of a uniform circle: radius / sqrt(2), and none of first order beyond the sequence's discrepancy.
    assert np.sqrt((points**2).sum(axis=1).mean()) == pytest.approx(100.0 / np.sqrt(2.0), rel=0.02)
    assert np.abs(points.mean(axis=0)).max() < 3.0
    axis = np.arange(-1.5, 2.0)
    halves = np.repeat([[1.0, 1.0, 3.0, 3.0]], 4, axis=0)
    lopsided = sub_apertures_um(axis, axis, halves, 400)
    assert (lopsided[:, 0] > 0.0).mean() == pytest.approx(0.75, abs=0.03)
