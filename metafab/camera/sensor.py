"""What the sensor makes of light: shot noise and read noise."""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import FloatArray


def expose(mean_e: FloatArray, read_noise_e: float, rng: np.random.Generator) -> FloatArray:
    """One exposure of the mean electrons ``mean_e``: Poisson arrivals, Gaussian read noise."""
    arrived = rng.poisson(np.maximum(mean_e, 0.0)).astype(np.float64)
    return arrived + rng.normal(0.0, read_noise_e, mean_e.shape) if read_noise_e > 0.0 else arrived
