"""Defects of a real camera's frame: dead pixels, rows and columns, and a black level that is too high."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
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

    A dead pixel holds no more than noise of ``read_noise_e`` (an electron at least) between bright pixels along rows,
    columns and both diagonals: a PSF has dark rings, which go on along one of them. A dead row or column, or two that
    touch, is dark all along the light on both of its sides. In the dark, and at the border, none is found.
    """
    light = np.where(np.abs(frame) <= LARGEST, frame, np.nan)
    empty = light <= _SIGMAS * max(read_noise_e, 1.0)
    lines, single = np.zeros(frame.shape, dtype=bool), empty.copy()
    n_lit = 0
    for axis in (0, 1):
        lit, dark = _between(light, axis, read_noise_e)
        n_lit = max(n_lit, int(lit.sum()))
        dark &= empty
        length = lit.sum(axis=1 - axis)
        is_dead = (length >= _LEAST_LIT_PX) & (dark.sum(axis=1 - axis) >= _DEAD_SHARE * length)
        np.moveaxis(lines, axis, 0)[is_dead] = True
        single &= dark
    row, column = np.nonzero(single)
    for turned in (1, -1):
        along = np.array([_along_diagonal(light, row, column, turned, step) for step in (-2, -1, 1, 2)])
        least = np.max([np.minimum(along[2 - before], along[1 + after]) for before, after in _SIDES], axis=0)
        single[row, column] &= _is_dark(light[row, column], least, read_noise_e)
    dead = (lines | single) & np.isfinite(light)
    if dead.sum() > max(_MOST_DEAD * n_lit, _FEWEST_OF_PATTERN):
        return DeadPixels(np.zeros(frame.shape, dtype=bool), has_pattern=True)
    return DeadPixels(dead)


def _between(light: FloatArray, axis: int, read_noise_e: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Pixels between bright ones along an axis, and those of them that are much darker: shapes of ``light``."""
    lit, dark = (np.zeros(light.shape, dtype=bool) for _ in range(2))
    for before, after in _SIDES:
        if light.shape[axis] <= before + after:
            continue
        lines = np.moveaxis(light, axis, 0)
        least = np.minimum(lines[: len(lines) - before - after], lines[before + after :])
        inner = slice(before, len(lines) - after)
        np.moveaxis(lit, axis, 0)[inner] |= _is_dark(np.zeros(()), least, read_noise_e)  # as a pixel without light
        np.moveaxis(dark, axis, 0)[inner] |= _is_dark(lines[inner], least, read_noise_e)
    return lit, dark


def _is_dark(here: FloatArray, least: FloatArray, read_noise_e: float) -> NDArray[np.bool_]:
    """Whether light is far below the lesser one on both sides, of any shape that broadcasts with it."""
    noise = np.sqrt(np.maximum(least, 0.0) + np.maximum(here, 0.0) + 2.0 * read_noise_e**2)
    return np.asarray((here < _DARK_SHARE * least) & (least - here > _SIGMAS * noise))


def _along_diagonal(
    light: FloatArray, row: NDArray[np.intp], column: NDArray[np.intp], turned: int, step: int
) -> FloatArray:
    """Light some steps along a diagonal from pixels, shape (n,): NaN beyond the border."""
    i, j = row + step, column + turned * step
    inside = (i >= 0) & (i < light.shape[0]) & (j >= 0) & (j < light.shape[1])
    return np.where(inside, light[np.where(inside, i, 0), np.where(inside, j, 0)], np.nan)


def share_below_black(frame: FloatArray, read_noise_e: float) -> float:
    """Share of a frame's pixels that are more than ``_SIGMAS`` standard deviations of read noise below zero.

    ``frame``, shape (n_rows, n_columns), is in electrons over the black level; the read noise counts as an electron at
    least.
    """
    return float(np.mean(frame < -_SIGMAS * max(read_noise_e, 1.0)))
