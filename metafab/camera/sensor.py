"""What the sensor makes of light: shot noise, dark current, read noise, full wells, hot pixels, whole counts."""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.spec.scene import Scene


def expose(mean_e: FloatArray, scene: Scene, rng: np.random.Generator) -> FloatArray:
    """One exposure.

    Args:
        mean_e: mean electrons that light leaves in each pixel.
        scene: the sensor's figures.
        rng: source of the noise; hot pixels stand where it puts them.

    Returns:
        The same shape, electrons: Poisson arrivals with the dark current, less its known mean, plus Gaussian read
        noise; with ``full_well_e``, at most that; with ``bit_depth``, in steps of the full well's share of a count.
    """
    arrived = rng.poisson(np.maximum(mean_e, 0.0) + scene.dark_e).astype(np.float64)
    if scene.hot_pixels > 0.0 and scene.full_well_e is not None:
        arrived[rng.random(mean_e.shape) < scene.hot_pixels] = scene.full_well_e
    if scene.full_well_e is not None:
        arrived = np.minimum(arrived, scene.full_well_e)
    full = arrived == scene.full_well_e
    value = arrived - scene.dark_e
    if scene.read_noise_e > 0.0:
        value += rng.normal(0.0, scene.read_noise_e, mean_e.shape)
    if scene.full_well_e is None:
        return value
    if scene.bit_depth is not None:
        step = scene.full_well_e / (2**scene.bit_depth - 1)
        value = np.clip(np.round(value / step), 0, 2**scene.bit_depth - 1) * step
    return np.where(full, scene.full_well_e, np.minimum(value, scene.full_well_e))
