"""Planes of random texture photographed by several cameras: errors of their depth estimates and their sharpness.

Each camera's own PSFs and sensor model make the images; each estimate uses its calibration alone. The compared depths
lie between those of the calibration. Planes fill the view on the axis: no edges, no field.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.texture import make_texture
from metafab.camera.sensor import FixedPattern, expose
from metafab.comparison.rivals import Rival, rivals
from metafab.core.conventions import FloatArray
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import read_json, write_json
from metafab.core.storage.tables import typed
from metafab.information.plane_depth import PlaneEstimator
from metafab.information.texture import Texture, restored_error
from metafab.spec import Design, Scene, SceneObject

KIND = "metafab comparison"
FORMAT = 1
_DEPTHS = 7
_CANDIDATES = 61
_SIDE_PX = 96


@dataclass(frozen=True)
class Comparison:
    """Errors of depth and sharpness of several cameras over depth."""

    depth_m: FloatArray  #: Shape (n_depth,), ascending.
    side_px: int  #: Side of the square window behind each estimate.
    electrons: float  #: Mean of a pixel of either image.
    read_noise_e: float  #: Standard deviation of the read noise, electrons.
    contrast: float  #: Rms over mean of the texture.
    planes: int  #: Photographs a depth.
    methods: tuple[str, ...]  #: Names of camera and estimate.
    error: FloatArray  #: Shape (n_methods, n_depth), rms of (estimated depth - depth) / depth.
    bound: FloatArray  #: Shape (n_methods, n_depth), Cramer-Rao bound over depth for a texture of known spectrum.
    cameras: tuple[str, ...]  #: Names.
    #: Shape (n_cameras, n_depth), relative rms error of the best linear restoration of the texture.
    restored: FloatArray


def compare(design: Design, *, planes: int = 6, contrast: float = 0.25, progress: Progress = silent) -> Comparison:
    """Compare a design with a standard lens and a double helix of equal aperture, light and sensor.

    Args:
        design: its ``verify`` depths span the range, its scene gives light and noise (without one, a scene's defaults).
        planes: photographs a depth, each of another texture.
        contrast: rms over mean of the texture.
        progress: called camera by camera.

    Raises:
        InputError: the design has no split lens, or nothing but a lens.
    """
    nearest, farthest = 1.0 / design.verify.depths_m[0], 1.0 / design.verify.depths_m[-1]
    share = (np.arange(_DEPTHS) + 0.5) / _DEPTHS
    depth_m = np.sort(1.0 / (farthest + share * (nearest - farthest)))
    light = Scene(objects=(SceneObject(depth_m=1.0),)) if design.scene is None else design.scene
    scene = replace(light, objects=(SceneObject(depth_m=1.0, texture_contrast=contrast),))
    texture = Texture(scene.photons_per_pixel * scene.quantum_efficiency, contrast, read_noise_e=scene.read_noise_e)
    names: list[str] = []
    errors: list[FloatArray] = []
    bounds: list[list[float]] = []
    cameras = rivals(design, depth_m, progress=progress)
    for done, rival in enumerate(cameras, start=1):
        estimator = plane_estimator(rival.calibration, _SIDE_PX, texture)
        bound = [estimator.bound_m(z, contrast) / z for z in depth_m.tolist()]
        methods = {"": estimator.likeliest}
        if rival.name == "double helix":
            methods[", cepstrum"] = estimator.by_cepstrum
        error = np.array([[_errors(rival, z, k, scene, methods.values()) for k in range(planes)] for z in depth_m])
        for index, suffix in enumerate(methods):
            names.append(rival.name + suffix)
            errors.append(np.sqrt((error[..., index] ** 2).mean(axis=1)))
            bounds.append(bound)
        progress("planes", done, len(cameras))
    return Comparison(
        depth_m=depth_m,
        side_px=_SIDE_PX,
        electrons=texture.electrons,
        read_noise_e=scene.read_noise_e,
        contrast=contrast,
        planes=planes,
        methods=tuple(names),
        error=np.array(errors),
        bound=np.array(bounds),
        cameras=tuple(rival.name for rival in cameras),
        restored=np.array([[restored_error(_kernels(rival, z), texture) for z in depth_m] for rival in cameras]),
    )


def plane_estimator(calibration: PairKernels, side_px: int, texture: Texture) -> PlaneEstimator:
    """Return the estimator of a calibration, with candidates over all of its depths.

    Args:
        calibration: PSF pair on the axis.
        side_px: side of the windows, at least the kernels'.
        texture: spectrum, electrons and noise.
    """
    depth_m = calibration.psf.depth_m
    vergence = np.linspace(1.0 / depth_m[0], 1.0 / depth_m[-1], _CANDIDATES)
    kernels = np.stack([calibration.at_depth(1.0 / v)[:, 0, 0] for v in vergence])
    return PlaneEstimator.of(1.0 / vergence, kernels, side_px, texture)


def _errors(
    rival: Rival, depth_m: float, number: int, scene: Scene, methods: Iterable[Callable[[FloatArray], float]]
) -> list[float]:
    """Relative errors of depth of all methods for one photograph."""
    images = photographed(_kernels(rival, depth_m), scene, number)
    return [method(images) / depth_m - 1.0 for method in methods]


def _kernels(rival: Rival, depth_m: float) -> FloatArray:
    return rival.truth.at_depth(depth_m)[:, 0, 0]


def photographed(kernels: FloatArray, scene: Scene, number: int) -> FloatArray:
    """Photograph a plane that has the texture of the scene's first object.

    Args:
        kernels: shape (2, k, k), PSFs per pixel of both polarisations.
        scene: texture, light and noise.
        number: seed of texture and noise, from 0; one number gives all cameras the same texture.

    Returns:
        Both images, shape (2, n, n), electrons.
    """
    from scipy.signal import fftconvolve  # Loaded late: reading a comparison does not need it.

    side = _SIDE_PX + kernels.shape[-1] - 1
    draw, noise = (np.random.default_rng([scene.seed, number, part]) for part in (0, 1))
    axis = (np.arange(side) + 0.5) / side
    u, v = np.meshgrid(axis, axis)
    light = make_texture(scene.objects[0], (side, side), draw)(u, v)
    light = scene.photons_per_pixel * scene.quantum_efficiency * light
    mean_e = np.stack([fftconvolve(light, kernel, mode="valid") for kernel in kernels])
    return expose(np.maximum(mean_e, 0.0), scene, FixedPattern.of(scene, mean_e.shape, scene.seed), noise)


@dataclass(frozen=True)
class RestorationRange:
    """Smallest and largest restoration error of a camera over depth."""

    best: float
    worst: float


@dataclass(frozen=True)
class ComparisonFigures:
    """Key figures of a comparison; the names are those of ``metafab compare --json``."""

    depth_error: dict[str, float]  #: Rms relative error over all depths, by method.
    depth_bound: dict[str, float]  #: Rms of the bounds, by method.
    restored_error: dict[str, RestorationRange]  #: Relative rms error of the best restoration, by camera.
    planes: int  #: Photographs a depth.
    side_px: int  #: Side of the window behind each estimate.
    electrons: float  #: Mean of a pixel of either image.


def comparison_figures(comparison: Comparison) -> ComparisonFigures:
    """Return the rms of each method over all depths, and each camera's best and worst restoration."""
    error, bound = (np.sqrt((values**2).mean(axis=1)).tolist() for values in (comparison.error, comparison.bound))
    restored = zip(comparison.restored.min(axis=1), comparison.restored.max(axis=1), strict=True)
    ranges = [RestorationRange(float(best), float(worst)) for best, worst in restored]
    return ComparisonFigures(
        depth_error=dict(zip(comparison.methods, error, strict=True)),
        depth_bound=dict(zip(comparison.methods, bound, strict=True)),
        restored_error=dict(zip(comparison.cameras, ranges, strict=True)),
        planes=comparison.planes,
        side_px=comparison.side_px,
        electrons=comparison.electrons,
    )


def save_comparison(comparison: Comparison, path: Path) -> None:
    """Write ``comparison.json``."""
    write_json(path, {"kind": KIND, "format_version": FORMAT, **vars(comparison)})


def load_comparison(path: Path) -> Comparison | None:
    """Read ``comparison.json``; None if the file is missing, foreign or of a newer format."""
    return read_json(path, KIND, FORMAT, partial(typed, Comparison))
