"""The sensor: shot noise, dark current, read noise, full wells, hot pixels, whole counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
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
    """Expose one frame: electrons, from the mean electrons in each pixel of mean response, shape (n_y, n_x) each.

    Poisson arrivals with the dark current, minus its known mean, plus Gaussian read noise; at most ``full_well_e``, and
    in steps of a count where ``bit_depth`` is given.
    """
    arrived = rng.poisson(np.maximum(mean_e, 0.0) * pattern.response + scene.dark_frame_e).astype(np.float64)
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
