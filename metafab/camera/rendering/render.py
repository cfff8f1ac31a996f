"""Objects of a scene on a grid of directions: coverage and brightness at each depth, before any blur."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metafab.camera.rendering.texture import Texture, make_texture
from metafab.core.conventions import FloatArray
from metafab.spec.scene import Scene, SceneObject

#: Samples of a pixel along each axis.
_SUPERSAMPLING = 2
#: Largest step of depth, relative, into which a tilted or curved object is cut.
_TILT_STEP = 0.004


@dataclass(frozen=True)
class Piece:
    """One object on a part of a pixel grid, before any blur."""

    label: int  #: Number of the object from 1.
    depth_m: FloatArray  #: Shape (n_steps,), depths of its steps; one for a flat object.
    rows: slice  #: Rows of the grid that the part covers.
    columns: slice  #: Columns of the grid that the part covers.
    coverage: FloatArray  #: Shape (n_steps, n_y, n_x), share of each pixel that each step covers.
    #: Shape (n_steps, n_y, n_x), coverage times texture times the object's brightness, mean of both polarisations.
    brightness: FloatArray
    share: tuple[float, float]  #: (x, y) factors of the two polarisations; their mean is 1.

    @property
    def mean_depth_m(self) -> FloatArray:
        """Mean depth over the covered part of each pixel, shape (n_y, n_x); 0 where nothing is."""
        covered = np.maximum(self.coverage.sum(axis=0), 1e-12)
        return np.asarray(np.tensordot(self.depth_m, self.coverage, axes=(0, 0)) / covered)

    def write_truth(self, coverage: FloatArray, depth_m: FloatArray, label: NDArray[np.int32]) -> None:
        """Write depth and number of the object to maps of the grid where it covers at least half of a pixel.

        ``coverage`` is the covered share of each pixel of the part; the maps have the shape (n_y, n_x) of the grid.
        """
        crop, covers = (self.rows, self.columns), coverage >= 0.5
        depth_m[crop] = np.where(covers, self.mean_depth_m, depth_m[crop])
        label[crop] = np.where(covers, self.label, label[crop])


@dataclass(frozen=True)
class Renderer:
    """A scene with its textures, which are drawn once for both polarisations and all frames."""

    scene: Scene  #: Objects and light.
    textures: tuple[Texture, ...]  #: Texture of each object.

    @classmethod
    def of(cls, scene: Scene, pixel_tangent: float, seed: int) -> Renderer:
        """Draw the textures at a resolution of ``pixel_tangent`` (a pixel's size as a tangent)."""
        sequences = np.random.SeedSequence(seed).spawn(len(scene.objects))
        textures = []
        for spec, sequence in zip(scene.objects, sequences, strict=True):
            width, height = (max(4, math.ceil(side / pixel_tangent)) for side in spec.size)
            textures.append(make_texture(spec, (min(height, 4096), min(width, 4096)), np.random.default_rng(sequence)))
        return cls(scene, tuple(textures))

    def pieces(self, tangent_x: FloatArray, tangent_y: FloatArray) -> Iterator[Piece]:
        """Yield all objects in sight of a grid of directions x/z and y/z, shape (n_y, n_x) each, farthest first."""
        for index, _ in self.farthest_first():
            piece = self.piece(index, tangent_x, tangent_y)
            if piece is not None:
                yield piece

    def farthest_first(self) -> list[tuple[int, SceneObject]]:
        """The objects with their numbers from 0, each hiding those before it."""
        return sorted(enumerate(self.scene.objects), key=lambda numbered: -numbered[1].depth_m)

    def piece(self, index: int, tangent_x: FloatArray, tangent_y: FloatArray) -> Piece | None:
        """Object number ``index`` on a grid of directions x/z and y/z, shape (n_y, n_x); None if it is out of sight."""
        spec = self.scene.objects[index]
        pixel = max(largest_slope(each) for each in (tangent_x, tangent_x.T, tangent_y, tangent_y.T))
        near = (np.abs(tangent_x - spec.centre[0]) <= 0.5 * spec.size[0] + 2.0 * pixel) & (
            np.abs(tangent_y - spec.centre[1]) <= 0.5 * spec.size[1] + 2.0 * pixel
        )
        if not near.any():
            return None
        rows, columns = (extent(near.any(axis=axis)) for axis in (1, 0))
        crop = (rows, columns)
        fine_x, fine_y = supersampled(tangent_x, crop), supersampled(tangent_y, crop)
        u, v = (fine_x - spec.centre[0]) / spec.size[0], (fine_y - spec.centre[1]) / spec.size[1]
        covered = _covered(spec, u, v, pixel / _SUPERSAMPLING)
        lit = covered * self.textures[index](u + 0.5, v + 0.5) * spec.brightness
        depth_m, step = _steps(spec, u, v)
        coverage = np.stack([_binned(np.where(step == k, covered, 0.0)) for k in range(depth_m.size)])
        brightness = np.stack([_binned(np.where(step == k, lit, 0.0)) for k in range(depth_m.size)])
        contrast = spec.polarisation_contrast
        share = (2.0 * contrast / (1.0 + contrast), 2.0 / (1.0 + contrast))
        return Piece(index + 1, depth_m, rows, columns, coverage, brightness, share)


def _covered(spec: SceneObject, u: FloatArray, v: FloatArray, sample: float) -> FloatArray:
    """Share of each sample, of tangent size ``sample``, inside the outline; exact for a rectangle."""
    if spec.outline == "ellipse":
        radius = np.maximum(np.hypot(u, v), 1e-12)
        slope = np.hypot(u / spec.size[0], v / spec.size[1]) / radius
        return np.asarray(np.clip((0.5 - radius) / (slope * sample) + 0.5, 0.0, 1.0))
    inside_x = np.clip((0.5 - np.abs(u)) * spec.size[0] / sample + 0.5, 0.0, 1.0)
    inside_y = np.clip((0.5 - np.abs(v)) * spec.size[1] / sample + 0.5, 0.0, 1.0)
    return np.asarray(inside_x * inside_y)


def step_depths_m(spec: SceneObject) -> FloatArray:
    """Depths of an object's steps, ascending: shape (n_steps,), one for a flat object."""
    nearest, farthest = spec.relative_depths
    count = max(1, math.ceil((farthest - nearest) / _TILT_STEP))
    return np.asarray(spec.depth_m * (1.0 + nearest + (farthest - nearest) * (np.arange(count) + 0.5) / count))


def _steps(spec: SceneObject, u: FloatArray, v: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Depths of an object's steps, and the step of each sample."""
    depth_m = step_depths_m(spec)
    nearest, farthest = spec.relative_depths
    if depth_m.size == 1:
        return depth_m, np.zeros(u.shape, dtype=np.intp)
    height = spec.tilt[0] * u + spec.tilt[1] * v + 4.0 * (spec.bulge[0] * u**2 + spec.bulge[1] * v**2)
    step = np.floor((height - nearest) / (farthest - nearest) * depth_m.size)
    return depth_m, np.clip(step, 0, depth_m.size - 1).astype(np.intp)


def extent(hit: ArrayLike) -> slice:
    """From the first to the last set flag of ``hit``, shape (n,); at least one is set."""
    where = np.flatnonzero(np.asarray(hit))
    return slice(int(where[0]), int(where[-1]) + 1)


def shifted(part: slice, by: int) -> slice:
    """The slice moved up by ``by``."""
    return slice(part.start + by, part.stop + by)


def largest_slope(values: FloatArray) -> float:
    """Largest slope down the columns of values at pixels, shape (n_y, n_x), as :func:`numpy.gradient` defines it."""
    inner, ends = values[2:] - values[:-2], values[[1, -1]] - values[[0, -2]]
    return max(0.5 * float(np.abs(inner).max(initial=0.0)), float(np.abs(ends).max(initial=0.0)))


def supersampled(values: FloatArray, crop: tuple[slice, slice]) -> FloatArray:
    """Values, shape (m_y, m_x), at a regular grid of s x s points inside each pixel of a crop, (n_y, n_x) of them.

    They are linear within a pixel: shape (s n_y, s n_x).
    """
    s = _SUPERSAMPLING
    offset = (np.arange(s) + 0.5) / s - 0.5
    # The slopes of the outer pixels need their neighbours.
    rows, columns = (slice(max(0, part.start - 1), part.stop + 1) for part in crop)
    inside = (shifted(crop[0], -rows.start), shifted(crop[1], -columns.start))
    slopes = np.gradient(values[rows, columns])
    slope_y, slope_x = slopes[0][inside], slopes[1][inside]
    fine = (
        values[crop][:, None, :, None]
        + slope_y[:, None, :, None] * offset[None, :, None, None]
        + slope_x[:, None, :, None] * offset[None, None, None, :]
    )
    return np.asarray(fine.reshape(slope_y.shape[0] * s, slope_y.shape[1] * s))


def _binned(fine: FloatArray) -> FloatArray:
    s = _SUPERSAMPLING
    n_y, n_x = fine.shape[0] // s, fine.shape[1] // s
    return np.asarray(fine.reshape(n_y, s, n_x, s).mean(axis=(1, 3)))
