"""Defects of a real camera's frame: dead pixels, rows and columns, and a black level that is too high."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.spec.fields import LARGEST

#: Share of the light on both of its sides that a pixel holds at least, as an image is blurred over pixels, and standard
#: deviations of noise by which a dead one has to be below them.
_LEAST_SHARE, _SIGMAS = 0.3, 8.0
#: Distances to both sides at which light is compared: one or two dead rows lie between.
_SIDES = ((1, 1), (1, 2), (2, 1))


def dead_pixels(frame: FloatArray, read_noise_e: float) -> NDArray[np.bool_]:
    """Pixels much darker than what stands on both sides of them, up and down or left and right.

    ``frame``, shape (n_rows, n_columns), is in electrons. Shot noise and ``read_noise_e`` explain none of them; in the
    dark, dead pixels do no harm, and none is found. Up to two dead rows or columns may touch. The same shape.
    """
    light = np.where(np.abs(frame) <= LARGEST, frame, np.nan)
    dead = np.zeros(frame.shape, dtype=bool)
    for axis in (0, 1):
        for before, after in _SIDES:
            if frame.shape[axis] <= before + after:
                continue
            lines = np.moveaxis(light, axis, 0)
            here = lines[before : len(lines) - after]
            least = np.minimum(lines[: len(lines) - before - after], lines[before + after :])
            noise = np.sqrt(np.maximum(least, 0.0) + np.maximum(here, 0.0) + 2.0 * read_noise_e**2)
            found = (here < _LEAST_SHARE * least) & (least - here > _SIGMAS * noise)
            np.moveaxis(dead, axis, 0)[before : len(lines) - after] |= found
    return dead


def share_below_black(frame: FloatArray, read_noise_e: float) -> float:
    """Share of a frame's pixels that are more than ``_SIGMAS`` standard deviations of read noise below zero.

    ``frame``, shape (n_rows, n_columns), is in electrons over the black level; the read noise counts as an electron at
    least.
    """
    return float(np.mean(frame < -_SIGMAS * max(read_noise_e, 1.0)))
