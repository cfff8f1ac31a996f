"""PSFs for one scene: at its own depths, in its own light, over a field that is sampled as finely as they need.

A frame to judge a decoder by must not contain the decoder's own approximations. The pair is computed at the depths of
the scene, so that nothing is interpolated over depth. Over the field it is computed at points that are refined until a
pair interpolated between them agrees with the computed one. Its window may be wider than the calibration's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from metafab.camera.rendering.motion import Shutter, moved
from metafab.camera.rendering.picture import require_objects
from metafab.camera.rendering.render import step_depths_m
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.optics import Imaging, Psf, PsfNumerics, Source, at_tangent, psf, relative_l2
from metafab.optics.geometry.imaging import Tangent
from metafab.spec.scene import Scene

#: Field points along x and y of the first attempt: even numbers, so that few fall on those of a calibration.
_FIRST_POINTS = (8, 4)
#: Most field points along x or y.
_MOST_POINTS = 64
#: Window and error of PSFs by which decoders are judged.
EXACT = PsfNumerics(window_px=96, target_error=3e-3)
#: Most depths over all frames of a scene.
_MOST_DEPTHS = 256
#: Half side of the computed field over that of the sensor: by the images' distortion, pixels at the rim see directions
#: beyond it.
_BEYOND = 1.03


def scene_depths_m(scene: Scene, pixel_tangent: float, rows: int) -> FloatArray:
    """Every depth at which :func:`metafab.camera.film` needs a pair: shape (n,), ascending, each once.

    ``pixel_tangent`` is a pixel's size as a tangent; ``rows`` are those of the sensor, for a rolling shutter.
    """
    depths: set[float] = set()
    for number in range(scene.frames):
        for time_s in Shutter.of(scene, number * scene.frame_interval_s, rows, pixel_tangent).instants_s.tolist():
            for piece in moved(scene, time_s).objects:
                depths |= set(step_depths_m(piece).tolist())
    return np.array(sorted(depths))


def scene_reach(scene: Scene, imaging: Imaging) -> Tangent:
    """Direction (x/z, y/z) of the farthest corner of the field over which :func:`exact_psf` computes PSFs."""
    x, y = (0.5 * _BEYOND * imaging.pixel_um / imaging.sensor_distance_um * n for n in scene.field_px[::-1])
    return x, y


def exact_psf(
    scene: Scene, source: Source, imaging: Imaging, numerics: PsfNumerics = EXACT, *, work: Work = Work()
) -> Psf:
    """Compute the pair with which :func:`metafab.camera.capture` photographs ``scene`` most exactly.

    Every depth of the scene has its own PSFs, in the light of the whole filter. Over the field they are splines between
    points that are refined until the interpolation error is at most ``target_error``, in the middle of the cells where
    it is largest (at the field's corners and on its axes). The remaining approximations are the layers of occlusion,
    and textures that are constant within a quarter of a pixel.

    A PSF of the lens of Shen 2023 takes some hundredths of a second, in a filter's light some tenths;
    :func:`metafab.optics.save` keeps them.

    Args:
        scene: its depths and its field.
        source: light behind the metasurface (:func:`metafab.optics.written_field`, ``ideal_field``).
        imaging: wavelength, sensor plane, pixel, aperture.
        numerics: window (wider than a calibration's, to hold the light that it cuts off), filter, and relative L2 error
            of the irradiance, over the field as in each PSF.
        work: threads or cluster, and progress over the windows.

    Returns:
        The stack over the scene's depths and its field. ``details`` has ``field_interpolation_error``, the largest
        error of the checked directions.

    Raises:
        InputError: more than 256 depths, or a field that 64 points a side do not resolve.
    """
    require_objects(scene)
    pixel_tangent = imaging.pixel_um / imaging.sensor_distance_um
    depths_m = scene_depths_m(scene, pixel_tangent, scene.field_px[0] + numerics.window_px)
    if depths_m.size > _MOST_DEPTHS:
        expected = f"at most {_MOST_DEPTHS} depths over all frames"
        remedy = "photograph fewer frames, or objects that do not move along the axis"
        raise InputError.single("scene", "objects", expected, f"{depths_m.size}", remedy)
    reach_x, reach_y = scene_reach(scene, imaging)
    points, error, target_error = _FIRST_POINTS, np.inf, numerics.target_error
    ends = np.unique(depths_m[[0, -1]])

    def stack(at_m: FloatArray, field_tangents: tuple[FloatArray, FloatArray]) -> Psf:
        return psf(source, imaging, at_m, numerics, field_tangents=field_tangents, work=work)

    while True:
        tangents = np.linspace(-reach_x, reach_x, points[0]), np.linspace(-reach_y, reach_y, points[1])
        coarse = stack(ends, field_tangents=tangents)
        errors = [_interpolation_error(coarse, partial(stack, ends), axis) for axis in (0, 1)]
        error = max(errors)
        if error <= target_error:
            break
        # Cubic splines: the error falls with the fourth power of the points' distance.
        wanted = [n * max(1.0, 1.1 * (e / target_error) ** 0.25) for n, e in zip(points, errors, strict=True)]
        points = (int(np.ceil(wanted[0])), int(np.ceil(wanted[1])))
        if max(points) > _MOST_POINTS:
            expected = f"a field that {_MOST_POINTS} PSFs a side describe to {target_error:g}"
            remedy = "make the field smaller, or the error larger"
            raise InputError.single("scene", "field_px", expected, f"one that needs {max(points)}", remedy)
    whole = coarse if ends.size == depths_m.size else stack(depths_m, field_tangents=tangents)
    return replace(whole, details=replace(whole.details, field_interpolation_error=error))


def _interpolation_error(coarse: Psf, computed: Callable[..., Psf], axis: int) -> float:
    """Largest relative error of the pair interpolated along one axis, in the middle of an outer and an inner cell."""
    assert coarse.field is not None
    checked = []
    for index, nodes in enumerate((coarse.field.tangent_x, coarse.field.tangent_y)):
        middles = 0.5 * (nodes[1:] + nodes[:-1])
        checked.append(middles[[middles.size // 2, -1]] if index == axis else nodes[[nodes.size // 2, -1]])
    fine = computed(field_tangents=(checked[0], checked[1])).field
    assert fine is not None
    truth, largest = fine.psf.astype(np.float64), 0.0
    for row, column in np.ndindex(2, 2):
        interpolated = at_tangent(coarse, (float(checked[0][column]), float(checked[1][row])))
        for polarisation, depth in np.ndindex(interpolated.shape[:2]):
            error = relative_l2(interpolated[polarisation, depth], truth[polarisation, depth, row, column])
            largest = max(largest, error)
    return largest
