"""Capture: Scene and PSF pair -> raw frames with their truth (Eq. 1 of Shen 2023); the sensor's noise and counts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from metafab.camera.frames.batch import Draw
from metafab.camera.frames.frame import RawFrame, Truth
from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.blurs import Blurs
from metafab.camera.rendering.lens import Lens, partial_progress
from metafab.camera.rendering.motion import Shutter, moved
from metafab.camera.rendering.occlusion import PINHOLE, Occluder, visible_piece
from metafab.camera.rendering.picture import DepthPicture
from metafab.camera.rendering.render import Renderer, step_depths_m
from metafab.camera.rendering.windows import Window, sensor_windows
from metafab.core.arguments import require_types
from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.optics.point_spread import Psf
from metafab.spec.scene import Scene


@dataclass(frozen=True)
class FixedPattern:
    """Differences between pixels that are the same in all frames."""

    response: FloatArray  #: Shape (n_y, n_x), sensitivity of each pixel over the mean one; mean 1.
    hot: NDArray[np.bool_]  #: Shape (n_y, n_x), whether a pixel is always full.

    @classmethod
    def of(cls, scene: Scene, shape: tuple[int, ...], seed: int) -> FixedPattern:
        """Draw the pattern of a sensor from a seed."""
        rng = np.random.default_rng(np.random.SeedSequence((seed, 0xF1BED)))
        response = np.ones(shape)
        if scene.response_rms > 0.0:
            response = np.maximum(1.0 + scene.response_rms * rng.standard_normal(shape), 0.0)
        hot = rng.random(shape) < scene.hot_pixels if scene.hot_pixels > 0.0 else np.zeros(shape, dtype=np.bool_)
        return cls(response, hot)


def expose(mean_e: FloatArray, scene: Scene, pattern: FixedPattern, rng: np.random.Generator) -> FloatArray:
    """Expose one frame: electrons of each pixel, from their mean if all pixels had mean response; shape (n_y, n_x).

    Poisson arrivals with the dark current, minus its known mean, plus Gaussian read noise; at most ``full_well_e``, and
    in steps of a count where ``bit_depth`` is given.
    """
    mean_e = np.maximum(mean_e, 0.0) * pattern.response + scene.dark_frame_e
    # A mean of 0 would take no random number and one of rounding, 1e-28, would: all later pixels would differ by it.
    arrived = rng.poisson(np.maximum(mean_e, np.finfo(np.float64).tiny)).astype(np.float64)
    if scene.full_well_e is not None:
        arrived[pattern.hot] = scene.full_well_e
        arrived = np.minimum(arrived, scene.full_well_e)
    full = arrived == scene.full_well_e
    value = arrived - scene.dark_frame_e
    if scene.read_noise_e > 0.0:
        value += rng.normal(0.0, scene.read_noise_e, mean_e.shape)
    if scene.full_well_e is None:
        return value
    if scene.bit_depth is not None:
        step = scene.full_well_e / (2**scene.bit_depth - 1)
        value = np.clip(np.round(value / step), 0, 2**scene.bit_depth - 1) * step
    return np.where(full, scene.full_well_e, np.minimum(value, scene.full_well_e))


def capture(scene: Scene, psf: Psf, *, seed: int | None = None, progress: Progress = silent) -> RawFrame:
    """Expose one frame of a scene through the lens: the first frame of its film.

    Each depth is blurred by its own pair, which varies over the field where ``psf.field`` is present. A point sends to
    the aperture the share of its light that nearer surfaces let through, by the geometry of each ray
    (:mod:`metafab.camera.rendering.occlusion`), in the shape of its whole PSF. A partly hidden aperture has another
    PSF in truth: at outlines the mean light is corrected, because radiance does not change along a ray, but not the
    shape (errors: ``tests/physics/camera/test_occlusion.py``). Surfaces of equal depth touch without a seam. A pair
    without ``aperture_um`` is treated as a pinhole.

    Behind a birefringent substrate (``psf.ghost``), each image also holds light of the other polarisation: of a scene
    whose x and y polarised light are uncorrelated.

    Args:
        scene: objects, photons, noise. A field stop passes ``scene.field_px`` pixels about the axis.
        psf: the pair over depth; depths of the scene must lie inside its range.
        seed: of textures and noise; ``scene.seed`` by default.

    Returns:
        A frame of both images and the margin of their blur. Its pixels stand on whole multiples of ``psf.pixel_um``
        from the axis.

    Raises:
        InputError: a depth is outside the calibrated range, or the two images overlap.
    """
    require_types("camera", scene=(scene, Scene), psf=(psf, Psf))
    return next(film(replace(scene, frames=1), psf, seed=seed, progress=progress))


def film(scene: Scene, psf: Psf, *, seed: int | None = None, progress: Progress = silent) -> Iterator[RawFrame]:
    """Expose the ``scene.frames`` frames of a scene whose objects move; see :func:`capture`.

    An exposure in which something moves is the mean of one instant per pixel of motion; with a rolling shutter, each
    row has its own instants. The truth is that of the middle of each row's exposure. Noise differs from frame to frame;
    textures stay with their objects, and hot pixels in their places.
    """
    require_types("camera", scene=(scene, Scene), psf=(psf, Psf))
    lenses = _lenses(scene, psf, _blurs(psf))
    yield from _film(scene, psf, lenses, scene.seed if seed is None else seed, progress)


def draws(scene: Scene, psf: Psf, seeds: Iterable[int]) -> Iterator[RawFrame]:
    """Expose the first frame of a scene once for each seed, which changes textures and noise; see :func:`capture`.

    Blurs are computed once for all seeds, light too if no texture depends on the seed.
    """
    yield from _draws(scene, psf, _blurs(psf), seeds)


def require_fit(scene: Scene, psf: Psf) -> None:
    """Raise the InputError of :func:`capture` for a field or a picture that does not fit the pair, before any blur."""
    sensor_windows(scene, psf, ImageMap.from_psf(psf))
    if scene.rgbd is not None:
        DepthPicture.of(scene, psf.pixel_um / psf.sensor_distance_um).require_inside(psf.depth_m)


def batch(scenes: Iterable[Scene], psf: Psf, count: int, seed: int) -> Iterator[Draw]:
    """Expose the first frames of scenes, ``count`` times each, with one seed after the other from ``seed`` on.

    Blurs are computed once for all scenes; see :func:`draws`.
    """
    blurs = _blurs(psf)
    for index, scene in enumerate(scenes):
        seeds = range(seed + index * count, seed + (index + 1) * count)
        for number, frame in zip(seeds, _draws(scene, psf, blurs, seeds), strict=True):
            yield Draw(index, number, frame)


@contextmanager
def _named_objects(scene: Scene, psf: Psf) -> Iterator[None]:
    """Name, in the InputError of a depth outside the calibration, every object that reaches there in any frame.

    Parts that no image shows may lie anywhere, so that reaching there is no fault by itself.
    """
    try:
        yield
    except InputError as error:
        if not any(fault.field == "depth_m" for fault in error.faults):
            raise
        nearest, farthest = psf.depth_m.min(), psf.depth_m.max()
        expected = f"depths inside the PSF calibration, {nearest:g} to {farthest:g} m"
        remedy = "move the object, or calibrate the PSF over a wider range of depths (`metafab psf --depths-m ...`)"
        faults, slack = [], 1e-9 * farthest
        for number, (low, high) in enumerate(_depth_ranges_m(scene, psf.pixel_um / psf.sensor_distance_um)):
            if low < nearest - slack or high > farthest + slack:
                is_flat = high - low <= 1e-9 * low
                got = f"{low:g} m" if is_flat else f"{low:g} to {high:g} m by its tilt, bulge or motion"
                faults.append(Fault(f"objects[{number}].depth_m", expected, got, remedy))
        raise InputError("scene", faults or error.faults) from error


def _depth_ranges_m(scene: Scene, pixel_tangent: float) -> list[tuple[float, float]]:
    """Nearest and farthest depth of each object in all frames, m."""
    first, last = (
        Shutter.of(scene, number * scene.frame_interval_s, scene.field_px[0], pixel_tangent).instants_s
        for number in (0, scene.frames - 1)
    )
    ends = [[step_depths_m(one) for one in moved(scene, time_s).objects] for time_s in (first[0], last[-1])]
    return [(min(a[0], b[0]), max(a[-1], b[-1])) for a, b in zip(*ends, strict=True)]


def _draws(scene: Scene, psf: Psf, blurs: Sequence[Blurs], seeds: Iterable[int]) -> Iterator[RawFrame]:
    lenses, first = _lenses(scene, psf, blurs), replace(scene, frames=1)
    is_drawn = any(spec.texture == "fractal" for spec in scene.objects)
    for seed in seeds:
        for lens in lenses if is_drawn else ():
            lens.forget_textures()
        yield from _film(first, psf, lenses, seed, silent)


def _blurs(psf: Psf) -> list[Blurs]:
    """Blurs of the pair, and of its ghosts behind a birefringent substrate."""
    pairs = [PairKernels(psf)] if psf.ghost is None else [PairKernels(psf), PairKernels(psf.ghost, psf)]
    return [Blurs(pair) for pair in pairs]


def _lenses(scene: Scene, psf: Psf, blurs: Sequence[Blurs]) -> list[Lens]:
    """The lens, and that of its ghosts."""
    windows = sensor_windows(scene, psf, ImageMap.from_psf(psf))
    picture = None if scene.rgbd is None else DepthPicture.of(scene, psf.pixel_um / psf.sensor_distance_um)
    return [Lens(each, windows, picture=picture, crossed=number == 1) for number, each in enumerate(blurs)]


def _film(scene: Scene, psf: Psf, lenses: Sequence[Lens], seed: int, progress: Progress) -> Iterator[RawFrame]:
    pixel_tangent, lens = psf.pixel_um / psf.sensor_distance_um, lenses[0]
    picture = lens.picture
    still = Renderer.of(scene, pixel_tangent, seed)
    pattern = FixedPattern.of(scene, lens.shape, seed)
    first, pixel_um = lens.windows[0], psf.pixel_um
    for number in range(scene.frames):
        shutter = Shutter.of(scene, number * scene.frame_interval_s, lens.shape[0], pixel_tangent)
        mean_e = np.zeros(lens.shape)
        for each in lenses:
            each.blurs.drop_many()
        for index, time_s in enumerate(shutter.instants_s.tolist()):
            renderer = replace(still, scene=moved(scene, time_s))
            part = partial_progress(progress, index, shutter.instants_s.size)
            with _named_objects(scene, psf):
                mean_e += shutter.weights[:, index, None] * sum(each.light(renderer, part) for each in lenses)
        rng = np.random.default_rng(np.random.SeedSequence((seed, 0x0C0FFEE, *((number,) if number else ()))))
        middle_s = shutter.middle_s[first.row - lens.bottom :][: scene.field_px[0]]
        yield RawFrame(
            expose(mean_e, scene, pattern, rng),
            pixel_um,
            (lens.left * pixel_um, lens.bottom * pixel_um),
            scene.read_noise_e,
            _shutter_truth(still, lens, shutter, middle_s) if picture is None else _picture_truth(picture, first),
            (first.column * pixel_um, first.row * pixel_um),
            (first.row - lens.bottom, first.column - lens.left, *scene.field_px),
            scene.full_well_e,
            photons=float(mean_e.sum()) / scene.quantum_efficiency,
        )


def _shutter_truth(still: Renderer, lens: Lens, shutter: Shutter, middle_s: FloatArray) -> Truth:
    """The truth of each row at the middle of its exposure; of a rolling shutter, at the nearest instant."""

    def at(time_s: float) -> Truth:
        return _truth(replace(still, scene=moved(still.scene, time_s)), lens)

    if middle_s[0] == middle_s[-1] or shutter.instants_s.size == 1:
        return at(float(middle_s[middle_s.size // 2]))
    nearest = np.abs(middle_s[:, None] - shutter.instants_s).argmin(axis=1)
    truths = {index: at(float(shutter.instants_s[index])) for index in np.unique(nearest).tolist()}
    arrays = {}
    for item in fields(Truth):
        rows = [getattr(truths[index], item.name)[row] for row, index in enumerate(nearest.tolist())]
        arrays[item.name] = np.stack(rows)
    return Truth(**arrays)


def _truth(renderer: Renderer, lens: Lens) -> Truth:
    """Depth, label and sharp intensities as a pinhole sees them; depth is of what covers at least half of a pixel."""
    window, pieces = lens.windows[0], list(lens.pieces(renderer))
    shape = window.stop.shape
    masks = [Occluder.of(piece) for piece in pieces]
    depth_m, label = np.full(shape, np.nan), np.zeros(shape, dtype=np.int32)
    uncovered, intensity = np.ones(shape), np.zeros((2, *shape))
    for number, (piece, mask) in enumerate(zip(pieces, masks, strict=True), start=1):
        crop = (piece.rows, piece.columns)
        light = visible_piece(piece, masks[number:], PINHOLE).brightness.sum(axis=0) * window.gain[crop]
        for channel in (0, 1):
            intensity[channel][crop] += light * piece.share[channel]
        uncovered[crop] -= mask.coverage
        piece.write_truth(mask.coverage, depth_m, label)
    intensity += renderer.scene.background * window.gain * np.maximum(uncovered, 0.0)
    return Truth(depth_m, intensity[0], intensity[1], label)


def _picture_truth(picture: DepthPicture, window: Window) -> Truth:
    """The picture itself: depth and label (1) where the depth is known, light nowhere else."""
    light, depth_m, contrast = picture.at(window.tangent_x, window.tangent_y)
    known = np.isfinite(depth_m)
    electrons = np.where(known, light * window.gain * 2.0 / (1.0 + contrast), 0.0)
    return Truth(depth_m, electrons * contrast, electrons, known.astype(np.int32))
