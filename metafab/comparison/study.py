"""Planes of random texture photographed by several cameras over depth: who finds their depth, and who sees them sharp.

The cameras' own sensor model and PSFs make the images; each estimate knows only its own calibration. Depths that are
tried lie between those of the calibration. Planes fill the view and stand on the axis; no edge, no field.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from metafab.camera.rendering.texture import make_texture
from metafab.camera.sensor import FixedPattern, expose
from metafab.comparison.estimate import PlaneEstimator
from metafab.comparison.rivals import Rival, rivals
from metafab.core.conventions import FloatArray
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import read_json, write_json
from metafab.information.sharpness import restored_error
from metafab.spec import Design, Scene, SceneObject

KIND = "metafab comparison"
FORMAT = 1
_DEPTHS = 7
_SIDE_PX = 96


@dataclass(frozen=True)
class Comparison:
    """How well several cameras measure depth and show textures, over depth.

    Attributes:
        depth_m: shape (n_depth,), ascending.
        side_px: of the square of texture behind each estimate.
        electrons: mean of a pixel of either image; likewise ``read_noise_e``, and the texture's ``contrast``.
        read_noise_e: see ``electrons``.
        contrast: see ``electrons``.
        planes: photographs a depth.
        methods: names of camera and estimate.
        error: shape (n_methods, n_depth), rms of (found depth - depth) / depth.
        bound: shape (n_methods, n_depth), smallest standard deviation over depth for a texture of known spectrum.
        cameras: names.
        restored: shape (n_cameras, n_depth), relative rms error of the best restoration of the texture.
    """

    depth_m: FloatArray
    side_px: int
    electrons: float
    read_noise_e: float
    contrast: float
    planes: int
    methods: tuple[str, ...]
    error: FloatArray
    bound: FloatArray
    cameras: tuple[str, ...]
    restored: FloatArray


def compare(design: Design, *, planes: int = 6, contrast: float = 0.25, progress: Progress = silent) -> Comparison:
    """Compare a design with a standard lens and a double helix of equal aperture, light and sensor.

    Args:
        design: its ``verify`` depths span the range, its scene gives light and noise (a scene's defaults without one).
        planes: photographs a depth, each of another texture.
        contrast: of the texture, rms over mean.
        progress: called camera by camera.

    Raises:
        InputError: the design has no split lens, or nothing but a lens.
    """
    ends = design.verify.depths_m[0], design.verify.depths_m[-1]
    share = (np.arange(_DEPTHS) + 0.5) / _DEPTHS
    depth_m = np.sort(1.0 / (1.0 / ends[1] + share * (1.0 / ends[0] - 1.0 / ends[1])))
    light = Scene(objects=(SceneObject(depth_m=1.0),)) if design.scene is None else design.scene
    scene = replace(light, objects=(SceneObject(depth_m=1.0, texture_contrast=contrast),))
    electrons = scene.photons_per_pixel * scene.quantum_efficiency
    names: list[str] = []
    errors: list[FloatArray] = []
    bounds: list[list[float]] = []
    found = rivals(design, depth_m, progress=progress)
    for done, rival in enumerate(found, start=1):
        estimator = PlaneEstimator.of(rival.calibration, _SIDE_PX, electrons, scene.read_noise_e)
        bound = [estimator.bound_m(z, contrast) / z for z in depth_m.tolist()]
        methods = {"": estimator.likeliest}
        if rival.name == "double helix":
            methods[", cepstrum"] = estimator.by_cepstrum
        wrong = np.array([[_wrong(rival, z, k, scene, methods.values()) for k in range(planes)] for z in depth_m])
        for index, suffix in enumerate(methods):
            names.append(rival.name + suffix)
            errors.append(np.sqrt((wrong[..., index] ** 2).mean(axis=1)))
            bounds.append(bound)
        progress("planes", done, len(found))
    restored = [
        [restored_error(_kernels(rival, z), electrons, contrast, read_noise_e=scene.read_noise_e) for z in depth_m]
        for rival in found
    ]
    return Comparison(
        depth_m, _SIDE_PX, electrons, scene.read_noise_e, contrast, planes,
        tuple(names), np.array(errors), np.array(bounds), tuple(rival.name for rival in found), np.array(restored),
    )  # fmt: skip


def _wrong(rival: Rival, depth_m: float, number: int, scene: Scene, methods: Any) -> list[float]:
    images = photographed(_kernels(rival, depth_m), scene, number)
    return [method(images) / depth_m - 1.0 for method in methods]


def _kernels(rival: Rival, depth_m: float) -> FloatArray:
    return rival.truth.at_depth(depth_m)[:, 0, 0]


def photographed(kernels: FloatArray, scene: Scene, number: int) -> FloatArray:
    """Both images of a plane with the texture of the scene's first object, shape (2, n, n), electrons.

    Args:
        kernels: shape (2, k, k), of both polarisations.
        scene: texture, light and noise.
        number: of the texture and the noise, from 0; the same for all cameras.
    """
    from scipy.signal import fftconvolve  # Reading a comparison should not load it.

    side = _SIDE_PX + kernels.shape[-1] - 1
    draw, noise = (np.random.default_rng([scene.seed, number, part]) for part in (0, 1))
    axis = (np.arange(side) + 0.5) / side
    u, v = np.meshgrid(axis, axis)
    light = make_texture(scene.objects[0], (side, side), draw)(u, v)
    light = scene.photons_per_pixel * scene.quantum_efficiency * light
    mean_e = np.stack([fftconvolve(light, kernel, mode="valid") for kernel in kernels])
    return expose(np.maximum(mean_e, 0.0), scene, FixedPattern.of(scene, mean_e.shape, scene.seed), noise)


def comparison_figures(comparison: Comparison) -> dict[str, Any]:
    """Each camera's rms over all depths, and its restoration at best and at worst."""
    return {
        "depth_error": dict(zip(comparison.methods, np.sqrt((comparison.error**2).mean(axis=1)), strict=True)),
        "depth_bound": dict(zip(comparison.methods, np.sqrt((comparison.bound**2).mean(axis=1)), strict=True)),
        "restored_error": {
            name: {"best": row.min(), "worst": row.max()}
            for name, row in zip(comparison.cameras, comparison.restored, strict=True)
        },
        "planes": comparison.planes,
        "side_px": comparison.side_px,
        "electrons": comparison.electrons,
    }


def save_comparison(comparison: Comparison, path: Path) -> None:
    """Write ``comparison.json``."""
    write_json(path, {"kind": KIND, "format_version": FORMAT, **asdict(comparison)})


def load_comparison(path: Path) -> Comparison | None:
    """Read ``comparison.json``; None where there is none, or one that is not ours."""
    return read_json(path, KIND, FORMAT, _comparison)


def _comparison(table: dict[str, Any]) -> Comparison:
    for name in ("depth_m", "error", "bound", "restored"):
        table[name] = np.array(table[name], dtype=np.float64)
    for name in ("methods", "cameras"):
        table[name] = tuple(table[name])
    return Comparison(**table)
