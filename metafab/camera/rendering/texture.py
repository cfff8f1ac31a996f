"""Textures: brightness patterns of mean 1 on a unit square, sampled anywhere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates, spline_filter

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.storage.pictures import read_grey
from metafab.spec.scene import SceneObject

Texture = Callable[[FloatArray, FloatArray], FloatArray]

#: Squares of a checker along each side.
_CHECKER_SQUARES = 8
#: Smallest brightness of a texture, relative to its mean: no surface is blacker.
_DARKEST = 0.02
#: Largest value of a picture, whose square is a number, too.
_LARGEST = 1e100


def make_texture(spec: SceneObject, texels: tuple[int, int], rng: np.random.Generator) -> Texture:
    """Make the texture of an object: a function of (u, v), arrays of any shape, 0 to 1 across its bounding box.

    ``texels`` is the resolution (n_v, n_u) of a procedural texture, ``rng`` the source of its randomness. InputError
    for a picture with values that are not finite, or too large to average.
    """
    if spec.texture == "uniform" or spec.texture_contrast == 0.0:
        return lambda u, v: np.ones(np.broadcast_shapes(u.shape, v.shape))
    if spec.texture == "checker":
        contrast = min(spec.texture_contrast, 1.0 - _DARKEST)
        squares = _CHECKER_SQUARES
        return lambda u, v: 1.0 + contrast * (2.0 * ((np.floor(squares * u) + np.floor(squares * v)) % 2) - 1.0)
    if spec.texture == "image" and spec.texture_file is not None:
        grey = _finite(read_grey(spec.texture_file), spec.texture_file)[::-1]  # lowest row first
        pattern = (grey - grey.mean()) / max(float(grey.std()), 1e-300)
    else:
        pattern = fractal(texels, rng)
    return _sampled(_with_contrast(pattern, spec.texture_contrast))


def _finite(grey: FloatArray, file: Path) -> FloatArray:
    """The values of a picture, shape (n_y, n_x), if all are finite and of at most :data:`_LARGEST`."""
    bad = int(np.count_nonzero(~(np.abs(grey) <= _LARGEST)))
    if bad:
        expected, got = f"finite values up to {_LARGEST:g}", f"{bad} others in {file}"
        raise InputError.single("scene", "texture_file", expected, got, "repair or scale the picture")
    return grey


def fractal(shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """Gaussian noise of amplitude 1/frequency, as in natural scenes: shape ``shape``, mean 0, rms 1, not periodic."""
    n_y, n_x = (2 * count for count in shape)  # twice the size, cropped, so that opposite edges are independent
    frequency = np.hypot(scipy.fft.fftfreq(n_y)[:, None] * 1.0, scipy.fft.rfftfreq(n_x)[None, :])
    frequency[0, 0] = np.inf
    spectrum = scipy.fft.rfft2(rng.standard_normal((n_y, n_x))) / frequency
    pattern = scipy.fft.irfft2(spectrum, (n_y, n_x))[: shape[0], : shape[1]]
    pattern -= pattern.mean()
    return np.asarray(pattern / max(float(pattern.std()), 1e-300))


def _with_contrast(pattern: FloatArray, contrast: float) -> FloatArray:
    """1 + contrast * pattern, with mean 1 and the wanted rms as far as the darkest value allows."""
    values = 1.0 + contrast * pattern
    for _ in range(20):
        values = np.maximum(values, _DARKEST)
        values = 1.0 + (values - values.mean()) * (contrast / max(float(values.std()), 1e-300))
        if values.min() >= _DARKEST:
            break
    return np.maximum(values, _DARKEST)


def _sampled(values: FloatArray) -> Texture:
    coefficients = spline_filter(values, order=3, mode="mirror")
    n_v, n_u = values.shape

    def texture(u: FloatArray, v: FloatArray) -> FloatArray:
        place = np.broadcast_arrays(v * n_v - 0.5, u * n_u - 0.5)
        sampled = map_coordinates(coefficients, place, order=3, mode="mirror", prefilter=False)
        return np.maximum(sampled, 0.0)

    return texture
