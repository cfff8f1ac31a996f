"""Defects of a real camera's frame: dead pixels, rows and columns, and a black level that is too high."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.spread import normal_sigma
from metafab.spec.fields import LARGEST

#: Share of the light on both of its sides below which a pixel is dark between bright ones, and standard deviations of
#: noise by which it has to be below them.
_DARK_SHARE, _SIGMAS = 0.3, 8.0
#: Distances to both sides at which light is compared: one or two dead rows lie between.
_SIDES = ((1, 1), (1, 2), (2, 1))
#: Share of the lit length of a row or column that is dark where the whole of it is dead, and its least lit length.
_DEAD_SHARE, _LEAST_LIT_PX = 0.8, 16
#: Share of the lit pixels, and number, above which a frame has a pattern, such as a mosaic of colours.
_MOST_DEAD, _FEWEST_OF_PATTERN = 0.05, 500


@dataclass(frozen=True)
class DeadPixels:
    """Dead pixels of a frame."""

    where: NDArray[np.bool_]  #: Shape (n_rows, n_columns).
    has_pattern: bool = False  #: Whether so many pixels are dark between bright ones that none was taken as dead.


def dead_pixels(frame: FloatArray, read_noise_e: float) -> DeadPixels:
    """Find the dead pixels, rows and columns of a frame, shape (n_rows, n_columns), electrons over the black level.

    A dead pixel holds no more than noise of ``read_noise_e`` (an electron at least, and the noise of the frame's own
    dark areas) between bright pixels along rows, columns and both diagonals: a PSF has dark rings, which go on along
    one of them. A dead row or column, or two that touch, is dark all along the light on both of its sides. In the dark,
    and at the border, none is found.
    """
    read_noise_e = max(read_noise_e, dark_noise_e(frame))
    light = np.where(np.abs(frame) <= LARGEST, frame, np.nan)
    lines, single = np.zeros(frame.shape, dtype=bool), light <= _SIGMAS * max(read_noise_e, 1.0)
    empty, n_lit = single.copy(), 0
    for axis, direction in enumerate(((1, 0), (0, 1))):
        beside = _beside(light, direction)
        lit, dark = (_is_dark(here, beside, read_noise_e) for here in (np.zeros(()), light))
        length = lit.sum(axis=1 - axis)
        is_dead = (length >= _LEAST_LIT_PX) & ((dark & empty).sum(axis=1 - axis) >= _DEAD_SHARE * length)
        np.moveaxis(lines, axis, 0)[is_dead] = True
        single &= dark
        n_lit = max(n_lit, int(lit.sum()))
    if single.any():
        for direction in ((1, 1), (1, -1)):
            single &= _is_dark(light, _beside(light, direction), read_noise_e)
    dead = (lines | single) & np.isfinite(light)
    if dead.sum() > max(_MOST_DEAD * n_lit, _FEWEST_OF_PATTERN):
        return DeadPixels(np.zeros(frame.shape, dtype=bool), has_pattern=True)
    return DeadPixels(dead)


def dark_noise_e(frame: FloatArray) -> float:
    """Standard deviation of the noise in a frame's dark areas, electrons, from its values below zero.

    ``frame``, shape (n_rows, n_columns), is in electrons over the black level. 0 where no more of its pixels than can
    be dead are below zero: it then has no dark areas, or its file holds no values below the black level.
    """
    below = -frame[frame < 0.0]
    return float(normal_sigma(below)) if below.size > _MOST_DEAD * frame.size else 0.0


def _beside(light: FloatArray, direction: tuple[int, int]) -> FloatArray:
    """Light on both sides of each pixel along (rows, columns), the lesser of both, at the brightest of all distances.

    Shape of ``light``; NaN at the border.
    """
    reach = max(max(sides) for sides in _SIDES)
    wide = np.pad(light, reach, constant_values=np.nan)

    def moved(steps: int) -> FloatArray:
        row, column = (reach + steps * along for along in direction)
        return wide[row : row + light.shape[0], column : column + light.shape[1]]

    return np.asarray(np.fmax.reduce([np.minimum(moved(-before), moved(after)) for before, after in _SIDES]))


def _is_dark(here: FloatArray, beside: FloatArray, read_noise_e: float) -> NDArray[np.bool_]:
    """Whether light is far below that beside it; both of any shapes that broadcast."""
    noise = np.sqrt(np.maximum(beside, 0.0) + np.maximum(here, 0.0) + 2.0 * read_noise_e**2)
    return np.asarray((here < _DARK_SHARE * beside) & (beside - here > _SIGMAS * noise))


def share_below_black(frame: FloatArray, read_noise_e: float) -> float:
    """Share of a frame's pixels that are more than ``_SIGMAS`` standard deviations of read noise below zero.

    ``frame``, shape (n_rows, n_columns), is in electrons over the black level; the read noise counts as an electron at
    least.
    """
    return float(np.mean(frame < -_SIGMAS * max(read_noise_e, 1.0)))
