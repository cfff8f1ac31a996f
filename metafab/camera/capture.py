"""Scene and PSF pair -> raw frame with its truth (Eq. 1 of Shen 2023)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from metafab.camera.blur import FieldBlur
from metafab.camera.frame import RawFrame, Truth
from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.camera.render import Renderer
from metafab.camera.sensor import expose
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.progress import Progress, silent
from metafab.optics.point_spread import Psf
from metafab.spec.scene import Scene

_MOST_INSTANTS = 32


@dataclass(frozen=True)
class _Window:
    """A rectangle of sensor pixels, with the direction that each pixel is the geometric image of.

    Attributes:
        column: sensor column (x_um / pixel_um) of the first pixel; likewise ``row``.
        tangent_x: shape (n_y, n_x); likewise ``tangent_y``.
        seen: shape (n_y, n_x), 1 inside the field stop, 0 outside.
        gain: shape (n_y, n_x), electrons at brightness 1: photons times the solid angle behind a pixel.
    """

    column: int
    row: int
    tangent_x: FloatArray
    tangent_y: FloatArray
    seen: FloatArray
    gain: FloatArray


def capture(scene: Scene, psf: Psf, *, seed: int | None = None, progress: Progress = silent) -> RawFrame:
    """One exposure of a scene through the lens, the first frame of a film.

    Each depth is blurred by its own pair, which varies over the field where ``psf.field`` is present. Layers
    are composed from far to near; the blurred coverage of a nearer one hides what lies behind it, so light is
    never counted twice. This is exact for each layer alone; at an occluding edge it takes the share of the
    aperture that the nearer layer blocks as independent of where in the aperture the light passes.

    Args:
        scene: objects, photons, noise. A field stop passes ``scene.field_px`` pixels about the axis.
        psf: the pair over depth; depths of the scene must lie inside its range.
        seed: of textures and noise; ``scene.seed`` if not given.
        progress: called after each layer.

    Returns:
        A frame over both images and the margin that their blur needs, rows and columns on whole multiples of
        ``psf.pixel_um`` from the axis.

    Raises:
        InputError: a depth is outside the calibrated range, or the two images overlap.
    """
    return next(film(dataclasses.replace(scene, frames=1), psf, seed=seed, progress=progress))


def film(scene: Scene, psf: Psf, *, seed: int | None = None, progress: Progress = silent) -> Iterator[RawFrame]:
    """The frames of a scene whose objects move: as :func:`capture`, ``scene.frames`` times.

    An exposure in which something moves is the mean of as many instants as it moves pixels (32 at most); its truth is
    that of the middle of the exposure. Noise differs from frame to frame; textures keep to their objects.
    """
    seed = scene.seed if seed is None else seed
    kernels = PairKernels(psf)
    image_map = ImageMap.from_psf(psf)
    windows = _windows(scene, psf, image_map)
    margin_y, margin_x = kernels.shape
    left = min(window.column for window in windows) - margin_x // 2
    bottom = min(window.row for window in windows) - margin_y // 2
    right = max(window.column + window.seen.shape[1] for window in windows) + margin_x // 2
    top = max(window.row + window.seen.shape[0] for window in windows) + margin_y // 2

    pixel_tangent = psf.pixel_um / psf.sensor_distance_um
    still = Renderer.of(scene, pixel_tangent, seed)
    for number in range(scene.frames):
        start_s = number * scene.frame_interval_s
        instants_s = _instants_s(scene, start_s, pixel_tangent)
        mean_e = np.zeros((top - bottom, right - left))
        blurs: dict[float, tuple[FieldBlur, FieldBlur]] = {}
        steps = len(windows) * len(scene.objects) * len(instants_s)
        for done, time_s in enumerate(instants_s):
            renderer = Renderer(_moved(scene, time_s), still.textures)
            for polarisation, window in enumerate(windows):
                before = (done * len(windows) + polarisation) * len(scene.objects)
                light = _light(renderer, kernels, window, polarisation, blurs, progress, (before, steps))
                row = window.row - bottom - margin_y // 2
                column = window.column - left - margin_x // 2
                part = (slice(row, row + light.shape[0]), slice(column, column + light.shape[1]))
                mean_e[part] += light[: mean_e[part].shape[0], : mean_e[part].shape[1]] / len(instants_s)
        rng = np.random.default_rng(np.random.SeedSequence((seed, 0x0C0FFEE, *((number,) if number else ()))))
        middle = Renderer(_moved(scene, start_s + 0.5 * scene.exposure_s), still.textures)
        yield RawFrame(
            expose(mean_e, scene, rng),
            psf.pixel_um,
            (left * psf.pixel_um, bottom * psf.pixel_um),
            scene.read_noise_e,
            _truth(middle, windows[0]),
            (windows[0].column * psf.pixel_um, windows[0].row * psf.pixel_um),
            (windows[0].row - bottom, windows[0].column - left, *scene.field_px),
            scene.full_well_e,
        )


def _moved(scene: Scene, time_s: float) -> Scene:
    """The scene at a time: what comes nearer looks larger."""
    if time_s == 0.0 or all(piece.velocity_m_per_s == (0.0, 0.0, 0.0) for piece in scene.objects):
        return scene
    objects = []
    for piece in scene.objects:
        v_x, v_y, v_z = piece.velocity_m_per_s
        depth_m = piece.depth_m + v_z * time_s
        centre = (
            (piece.centre[0] * piece.depth_m + v_x * time_s) / depth_m,
            (piece.centre[1] * piece.depth_m + v_y * time_s) / depth_m,
        )
        scale = piece.depth_m / depth_m
        size = (piece.size[0] * scale, piece.size[1] * scale)
        objects.append(dataclasses.replace(piece, depth_m=depth_m, centre=centre, size=size))
    return dataclasses.replace(scene, objects=tuple(objects))


def _instants_s(scene: Scene, start_s: float, pixel_tangent: float) -> list[float]:
    """Times that stand for one exposure, equally spaced in it: one if nothing moves by a pixel."""
    first, last = _moved(scene, start_s), _moved(scene, start_s + scene.exposure_s)
    away = [
        math.dist(a.centre, b.centre) + 0.5 * max(abs(a.size[0] - b.size[0]), abs(a.size[1] - b.size[1]))
        for a, b in zip(first.objects, last.objects, strict=True)
    ]
    count = min(_MOST_INSTANTS, max(1, math.ceil(max(away) / pixel_tangent)))
    return [start_s + scene.exposure_s * (k + 0.5) / count for k in range(count)]


def _windows(scene: Scene, psf: Psf, image_map: ImageMap) -> tuple[_Window, _Window]:
    """The x polarisation's window of ``field_px`` pixels about the axis, and the one that holds its twin."""
    pixel = psf.pixel_um
    n_y, n_x = scene.field_px
    axis_x, axis_y = image_map.coefficients_um[0, :, 0, 0]
    column, row = round(axis_x / pixel) - n_x // 2, round(axis_y / pixel) - n_y // 2
    edges = (np.arange(n_x + 1) - 0.5 + column) * pixel, (np.arange(n_y + 1) - 0.5 + row) * pixel
    outline_x = np.concatenate([edges[0], edges[0], np.full(n_y + 1, edges[0][0]), np.full(n_y + 1, edges[0][-1])])
    outline_y = np.concatenate([np.full(n_x + 1, edges[1][0]), np.full(n_x + 1, edges[1][-1]), edges[1], edges[1]])
    twin_x, twin_y = image_map.to_sensor_um(1, *image_map.to_tangent(0, outline_x, outline_y))
    twin_column, twin_row = math.floor(twin_x.min() / pixel + 0.5), math.floor(twin_y.min() / pixel + 0.5)
    twin_n_x = math.ceil(twin_x.max() / pixel - 0.5) - twin_column + 1
    twin_n_y = math.ceil(twin_y.max() / pixel - 0.5) - twin_row + 1
    apart = abs(twin_column - column) >= (n_x if twin_column > column else twin_n_x) or abs(twin_row - row) >= (
        n_y if twin_row > row else twin_n_y
    )
    if not apart:
        raise InputError.single(
            "scene",
            "field_px",
            "a field whose two images lie side by side",
            f"{n_y} x {n_x} pixels, with the images {abs(twin_column - column)} columns apart",
            "make the field smaller or split by a larger angle",
        )
    first = _window(image_map, 0, pixel, column, row, n_x, n_y, scene.photons_per_pixel, None)
    stop = (edges[0][0], edges[0][-1], edges[1][0], edges[1][-1])
    second = _window(image_map, 1, pixel, twin_column, twin_row, twin_n_x, twin_n_y, scene.photons_per_pixel, stop)
    return first, second


def _window(
    image_map: ImageMap,
    polarisation: int,
    pixel: float,
    column: int,
    row: int,
    n_x: int,
    n_y: int,
    photons: float,
    stop: tuple[float, float, float, float] | None,
) -> _Window:
    x_um, y_um = np.meshgrid((column + np.arange(n_x)) * pixel, (row + np.arange(n_y)) * pixel)
    tangent_x, tangent_y = image_map.to_tangent(polarisation, x_um, y_um)
    axis = np.zeros(1)
    # Irradiance falls where the image is stretched; brightness 1 gives ``photons`` on the axis.
    gain = photons * image_map.area_um2(0, axis, axis) / image_map.area_um2(polarisation, tangent_x, tangent_y)
    if stop is None:
        return _Window(column, row, tangent_x, tangent_y, np.ones((n_y, n_x)), gain)
    in_x, in_y = image_map.to_sensor_um(0, tangent_x, tangent_y)
    seen_x = np.clip(np.minimum(in_x - stop[0], stop[1] - in_x) / pixel + 0.5, 0.0, 1.0)
    seen_y = np.clip(np.minimum(in_y - stop[2], stop[3] - in_y) / pixel + 0.5, 0.0, 1.0)
    return _Window(column, row, tangent_x, tangent_y, seen_x * seen_y, gain)


def _light(
    renderer: Renderer,
    kernels: PairKernels,
    window: _Window,
    polarisation: int,
    blurs: dict[float, tuple[FieldBlur, FieldBlur]],
    progress: Progress,
    counted: tuple[int, int],
) -> FloatArray:
    """Mean electrons of one image with its blur's margin all around: window shape plus kernel shape."""
    scene = renderer.scene
    k_y, k_x = kernels.shape
    n_y, n_x = window.seen.shape
    light = np.zeros((n_y + k_y, n_x + k_x))
    if scene.background > 0.0:
        # Without structure, depth does not matter: the mean of all depths' throughputs is 1.
        inner = (slice(k_y // 2, k_y // 2 + n_y), slice(k_x // 2, k_x // 2 + n_x))
        light[inner] = scene.background * window.gain * window.seen
    for done, piece in enumerate(renderer.pieces(window.tangent_x, window.tangent_y), start=1):
        crop = (piece.rows, piece.columns)
        tangents = window.tangent_x[crop], window.tangent_y[crop]
        flux = piece.share[polarisation] * window.gain[crop] * window.seen[crop]
        n_y, n_x = flux.shape
        spread, hidden = np.zeros((2, n_y + k_y - 1, n_x + k_x - 1))
        # The steps of one piece lie beside each other: their light adds up, and so does what they hide.
        for depth_m, coverage, brightness in zip(piece.depth_m, piece.coverage, piece.brightness, strict=True):
            if not coverage.any():
                continue
            if depth_m not in blurs:
                blurs[depth_m] = FieldBlur.at_depth(kernels, float(depth_m))
            blur = blurs[depth_m][polarisation]
            lit, covered = blur(brightness * flux, coverage * window.seen[crop], *tangents)
            spread += lit
            hidden += covered
        part = (
            slice(piece.rows.start, piece.rows.start + spread.shape[0]),
            slice(piece.columns.start, piece.columns.start + spread.shape[1]),
        )
        light[part] = light[part] * (1.0 - np.clip(hidden, 0.0, 1.0)) + spread
        progress("capture", min(counted[1], counted[0] + done), counted[1])
    return light


def _truth(renderer: Renderer, window: _Window) -> Truth:
    """Depths, labels and sharp intensities of the nearest piece at each pixel; a pixel is whose half it is."""
    scene = renderer.scene
    shape = window.seen.shape
    depth_m, label = np.full(shape, np.nan), np.zeros(shape, dtype=np.int32)
    intensity = np.stack([scene.background * window.gain] * 2)
    for piece in renderer.pieces(window.tangent_x, window.tangent_y):
        crop = (piece.rows, piece.columns)
        coverage = piece.coverage.sum(axis=0)
        for channel in (0, 1):
            lit = piece.brightness.sum(axis=0) * piece.share[channel] * window.gain[crop]
            intensity[channel][crop] = intensity[channel][crop] * (1.0 - coverage) + lit
        owned = coverage >= 0.5
        mean_m = np.tensordot(piece.depth_m, piece.coverage, axes=(0, 0)) / np.maximum(coverage, 1e-12)
        depth_m[crop] = np.where(owned, mean_m, depth_m[crop])
        label[crop] = np.where(owned, piece.label, label[crop])
    return Truth(depth_m, intensity[0], intensity[1], label)
