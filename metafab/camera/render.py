"""A scene as layers of one depth on a grid of directions: coverage and brightness, before any blur."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from metafab.camera.texture import Texture, make_texture
from metafab.core.conventions import FloatArray
from metafab.spec.scene import Scene, SceneObject

_SUPERSAMPLING = 3
#: A tilted piece is cut into steps of at most this much of its depth.
_TILT_STEP = 0.004


@dataclass(frozen=True)
class Layer:
    """What one depth of one object shows on a crop of a pixel grid.

    Attributes:
        label: number of the object from 1.
        depth_m: depth of the layer.
        rows: rows of the grid that the crop covers; likewise ``columns``.
        coverage: shape of the crop, share of each pixel that the piece covers, before any blur.
        brightness: shape of the crop, coverage times texture times the object's brightness, both polarisations'
            mean.
        share: (x, y) factors of the two polarisations; their mean is 1.
    """

    label: int
    depth_m: float
    rows: slice
    columns: slice
    coverage: FloatArray
    brightness: FloatArray
    share: tuple[float, float]


@dataclass(frozen=True)
class Renderer:
    """A scene whose textures are drawn once, so that both polarisations see the same.

    Attributes:
        scene: what is shown.
        textures: one for each object.
    """

    scene: Scene
    textures: tuple[Texture, ...]

    @classmethod
    def of(cls, scene: Scene, pixel_tangent: float, seed: int) -> Renderer:
        """Draw the textures at a resolution of ``pixel_tangent`` (a pixel's size as a tangent)."""
        sequences = np.random.SeedSequence(seed).spawn(len(scene.objects))
        textures = []
        for spec, sequence in zip(scene.objects, sequences, strict=True):
            width, height = (max(4, math.ceil(side / pixel_tangent)) for side in spec.size)
            textures.append(make_texture(spec, (min(height, 4096), min(width, 4096)), np.random.default_rng(sequence)))
        return cls(scene, tuple(textures))

    def layers(self, tangent_x: FloatArray, tangent_y: FloatArray) -> Iterator[Layer]:
        """All layers, farthest first, on a pixel grid with the directions ``tangent_x``, ``tangent_y`` (n_y, n_x)."""
        pieces: list[tuple[float, int, FloatArray]] = []
        for index, spec in enumerate(self.scene.objects):
            steps = max(1, math.ceil((abs(spec.tilt[0]) + abs(spec.tilt[1])) / _TILT_STEP))
            edges = np.linspace(-0.5, 0.5, steps + 1) * (abs(spec.tilt[0]) + abs(spec.tilt[1]))
            for low, high in pairwise(edges):
                pieces.append((spec.depth_m * (1.0 + 0.5 * (low + high)), index, np.array([low, high])))
        for depth_m, index, relative in sorted(pieces, key=lambda piece: -piece[0]):
            layer = self._layer(index, depth_m, relative, tangent_x, tangent_y)
            if layer is not None:
                yield layer

    def _layer(
        self, index: int, depth_m: float, relative: FloatArray, tangent_x: FloatArray, tangent_y: FloatArray
    ) -> Layer | None:
        spec = self.scene.objects[index]
        slope_x, slope_y = np.gradient(tangent_x), np.gradient(tangent_y)
        margin = 2.0 * max(float(np.abs(s).max(initial=0.0)) for s in (*slope_x, *slope_y))
        near = (np.abs(tangent_x - spec.centre[0]) <= 0.5 * spec.size[0] + margin) & (
            np.abs(tangent_y - spec.centre[1]) <= 0.5 * spec.size[1] + margin
        )
        if not near.any():
            return None
        rows, columns = (_extent(near.any(axis=axis)) for axis in (1, 0))
        crop = (rows, columns)
        fine_x = _supersampled(tangent_x[crop], slope_x[0][crop], slope_x[1][crop])
        fine_y = _supersampled(tangent_y[crop], slope_y[0][crop], slope_y[1][crop])
        u, v = (fine_x - spec.centre[0]) / spec.size[0], (fine_y - spec.centre[1]) / spec.size[1]
        covered = _inside(spec, u, v)
        if any(spec.tilt):
            height = spec.tilt[0] * u + spec.tilt[1] * v
            last = relative[1] >= 0.5 * (abs(spec.tilt[0]) + abs(spec.tilt[1])) * (1 - 1e-9)
            covered &= (height >= relative[0]) & ((height <= relative[1]) if last else (height < relative[1]))
        if not covered.any():
            return None
        lit = np.where(covered, self.textures[index](u + 0.5, v + 0.5), 0.0) * spec.brightness
        contrast = spec.polarisation_contrast
        share = (2.0 * contrast / (1.0 + contrast), 2.0 / (1.0 + contrast))
        return Layer(index + 1, depth_m, rows, columns, _binned(covered.astype(np.float64)), _binned(lit), share)


def _inside(spec: SceneObject, u: FloatArray, v: FloatArray) -> np.ndarray:
    if spec.outline == "ellipse":
        return np.asarray(u * u + v * v <= 0.25)
    return np.asarray((np.abs(u) <= 0.5) & (np.abs(v) <= 0.5))


def _extent(hit: ArrayLike) -> slice:
    where = np.flatnonzero(np.asarray(hit))
    return slice(int(where[0]), int(where[-1]) + 1)


def _supersampled(values: FloatArray, slope_y: FloatArray, slope_x: FloatArray) -> FloatArray:
    """Values at a regular grid of points inside each pixel, linear within it: shape (s n_y, s n_x)."""
    s = _SUPERSAMPLING
    offset = (np.arange(s) + 0.5) / s - 0.5
    fine = (
        values[:, None, :, None]
        + slope_y[:, None, :, None] * offset[None, :, None, None]
        + slope_x[:, None, :, None] * offset[None, None, None, :]
    )
    return np.asarray(fine.reshape(values.shape[0] * s, values.shape[1] * s))


def _binned(fine: FloatArray) -> FloatArray:
    s = _SUPERSAMPLING
    n_y, n_x = fine.shape[0] // s, fine.shape[1] // s
    return np.asarray(fine.reshape(n_y, s, n_x, s).mean(axis=(1, 3)))
