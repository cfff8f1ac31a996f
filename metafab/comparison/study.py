"""Planes of random texture photographed by several cameras: errors of their depth estimates and their sharpness.

Each camera's own PSFs and sensor model make the images; each estimate uses its calibration alone. The compared depths
lie between those of the calibration. Planes fill the view on the axis: no edges, no field. The cameras share aperture,
split lens and sensor; their phases differ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from metafab.camera.capture import FixedPattern, expose
from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.texture import make_texture
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.spectra import convolved
from metafab.core.parallel.progress import Progress, silent
from metafab.core.parallel.work import Work
from metafab.core.storage.files import read_json, write_json
from metafab.core.storage.tables import typed
from metafab.information.plane_depth import PlaneEstimator
from metafab.information.texture import Texture, restored_error
from metafab.layout import lattice_of
from metafab.optics import Apodisation, Imaging, Psf, PsfNumerics, apodised, depth_nodes, ideal_field, psf
from metafab.optics.interpolation import without_depths
from metafab.phase import profile_of
from metafab.spec import Design, Scene, SceneObject
from metafab.spec.terms import DoubleHelix, Grating, Lens, PhaseTerm, SplitLens

KIND = "metafab comparison"
FORMAT = 1
#: Number of compared depths.
_DEPTHS = 7
#: Number of candidate depths of each estimate, over the calibration.
_CANDIDATES = 61
#: Side of the photographed window, pixels.
_SIDE_PX = 96
#: Terms that bring the light to the sensor; all others shape the PSF.
_CARRIERS = (SplitLens, Lens, Grating)
#: Vergence by which the lens of depth from defocus is focused nearer than the nearest depth, as a share of the compared
#: range of vergence. Near focus the PSF of a lens does not change with depth, and it is alike on both sides of focus.
_BEFORE = 0.25
#: Margin of the calibration beyond the compared depths, as a share of their range of vergence.
_MARGIN = 0.15


@dataclass(frozen=True)
class Rival:
    """One camera of a comparison."""

    name: str  #: Label in figures and files.
    truth: PairKernels  #: PSFs at the compared depths (and at the nodes of the calibration).
    calibration: PairKernels  #: PSFs that the depth estimates use, at other depths; between them they interpolate.


def rivals(design: Design, depth_m: FloatArray, *, progress: Progress = silent) -> tuple[Rival, ...]:
    """Return four cameras: this design, a lens in focus, a lens focused nearer (depth from defocus), a double helix.

    All split the polarisations alike, so that sensor, aperture and light are equal. The compared depths, shape (n,),
    ascend. A design without a split lens, or of nothing but a lens, raises InputError.
    """
    carriers = tuple(term for term in design.phase if isinstance(term, _CARRIERS))
    if design.split_angle_deg == 0.0 or len(carriers) == len(design.phase):
        expected = "a `split_lens` and a term that turns the pair with depth"
        raise InputError.single(design.name, "phase", expected, ", ".join(term.term for term in design.phase))
    vergence = 1.0 / depth_m
    span = float(vergence[0] - vergence[-1])
    nearer = replace(design.sensor, focus_depth_m=1.0 / (float(vergence[0]) + _BEFORE * span))
    cameras: tuple[tuple[str, tuple[PhaseTerm, ...], Design], ...] = (
        ("this design", design.phase, design),
        ("standard lens", carriers, design),
        ("lens, focused nearer", carriers, replace(design, sensor=nearer)),
        ("double helix", (DoubleHelix(), *carriers), design),
    )
    result = []
    for done, (name, phase, base) in enumerate(cameras, start=1):
        stack, nodes = _stack(replace(base, phase=phase), depth_m)
        calibration = without_depths(stack, ~np.isin(stack.depth_m, nodes))
        result.append(Rival(name, PairKernels(stack), PairKernels(calibration)))
        progress("PSFs", done, len(cameras))
    return tuple(result)


def _stack(design: Design, depth_m: FloatArray) -> tuple[Psf, FloatArray]:
    """The PSF pair at the compared depths and at the nodes of a calibration, and these nodes."""
    imaging = Imaging.of(design)
    near, far = 1.0 / float(depth_m[0]), 1.0 / float(depth_m[-1])
    margin = _MARGIN * (near - far)
    numerics = PsfNumerics.of(design)
    nodes = depth_nodes(imaging, 1.0 / (near + margin), 1.0 / max(far - margin, 0.5 * far), numerics.target_error)
    every = np.unique(np.concatenate([nodes, depth_m]))
    source = apodised(ideal_field(profile_of(design), lattice_of(design), design.device), Apodisation.of(design))
    return psf(source, imaging, every, numerics, work=Work(workers=1)), nodes


@dataclass(frozen=True)
class Comparison:
    """Errors of depth and sharpness of several cameras over depth."""

    depth_m: FloatArray  #: Shape (n_depth,), ascending.
    side_px: int  #: Side of the square window behind each estimate.
    electrons: float  #: Mean of a pixel of either image.
    read_noise_e: float  #: Standard deviation of the read noise, electrons.
    contrast: float  #: Rms over mean of the texture.
    planes: int  #: Number of photographs at each depth.
    methods: tuple[str, ...]  #: Names of camera and estimate.
    error: FloatArray  #: Shape (n_methods, n_depth), rms of (estimated depth - depth) / depth.
    bound: FloatArray  #: Shape (n_methods, n_depth), Cramer-Rao bound over depth for a texture of known spectrum.
    cameras: tuple[str, ...]  #: Names.
    #: Shape (n_cameras, n_depth), relative rms error of the best linear restoration of the texture.
    restored: FloatArray

    @property
    def error_scatter(self) -> float:
        """Relative standard error of ``error`` at one depth, an rms over few photographs of normal errors."""
        return 1.0 / math.sqrt(2.0 * self.planes)


def compare(design: Design, *, planes: int = 6, contrast: float = 0.25, progress: Progress = silent) -> Comparison:
    """Compare a design with a standard lens and a double helix of equal aperture, light and sensor.

    Args:
        design: its ``verify`` depths span the range, its scene gives light and noise (without one, a scene's defaults).
            InputError without a split lens, or for nothing but a lens.
        planes: photographs at each depth, each of another texture.
        contrast: rms over mean of the texture.
    """
    nearest, farthest = 1.0 / design.verify.depths_m[0], 1.0 / design.verify.depths_m[-1]
    share = (np.arange(_DEPTHS) + 0.5) / _DEPTHS
    depth_m = np.sort(1.0 / (farthest + share * (nearest - farthest)))
    light = Scene(objects=(SceneObject(depth_m=1.0),)) if design.scene is None else design.scene
    scene = replace(light, objects=(SceneObject(depth_m=1.0, texture_contrast=contrast),))
    texture = Texture(
        electrons=scene.photons_per_pixel * scene.quantum_efficiency, contrast=contrast, read_noise_e=scene.read_noise_e
    )
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
        images = [[photographed(_kernels(rival, z), scene, k) for k in range(planes)] for z in depth_m]
        for suffix, method in methods.items():
            error = np.array([[method(pair) for pair in pairs] for pairs in images]) / depth_m[:, None] - 1.0
            names.append(rival.name + suffix)
            errors.append(np.sqrt((error**2).mean(axis=1)))
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
    """Return the estimator of a pair on the axis, with candidates over all of its depths.

    The windows of ``side_px`` pixels a side are no smaller than the kernels.
    """
    depth_m = calibration.psf.depth_m
    vergence = np.linspace(1.0 / depth_m[0], 1.0 / depth_m[-1], _CANDIDATES)
    kernels = np.stack([calibration.at_depth(1.0 / v)[:, 0, 0] for v in vergence])
    return PlaneEstimator.of(1.0 / vergence, kernels, side_px, texture)


def _kernels(rival: Rival, depth_m: float) -> FloatArray:
    return rival.truth.at_depth(depth_m)[:, 0, 0]


def photographed(kernels: FloatArray, scene: Scene, number: int) -> FloatArray:
    """Photograph a plane that has the texture of the scene's first object: both images, shape (2, n, n), electrons.

    Kernels, shape (2, k, k), are PSFs per pixel of both polarisations. ``number`` is the seed of texture and noise,
    from 0; one number gives all cameras the same texture.
    """
    side = _SIDE_PX + kernels.shape[-1] - 1
    draw, noise = (np.random.default_rng([scene.seed, number, part]) for part in (0, 1))
    axis = (np.arange(side) + 0.5) / side
    u, v = np.meshgrid(axis, axis)
    light = make_texture(scene.objects[0], (side, side), draw)(u, v)
    light = scene.photons_per_pixel * scene.quantum_efficiency * light
    edge = kernels.shape[-1] - 1
    mean_e = convolved(light, kernels)[:, edge:side, edge:side]
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
    error_scatter: float  #: Relative standard error of a depth error at one depth, from the number of photographs.
    restored_error: dict[str, RestorationRange]  #: Relative rms error of the best restoration, by camera.
    planes: int  #: Number of photographs at each depth.
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
        error_scatter=comparison.error_scatter,
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
