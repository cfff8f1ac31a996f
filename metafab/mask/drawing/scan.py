"""Pillars of a tile sorted by size, and within a size by strip and line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.compiled import compiled


@dataclass(frozen=True)
class Scan:
    """The order in which the pillars of one size are listed: strip by strip, and in each strip line by line."""

    along_y: bool  #: Whether lines run along y; else along x.
    strip_sites: int  #: Length of a line; the strips lie side by side along the lines.


def sorted_by_size(
    size_index: NDArray[np.uint16], sizes: int, scan: Scan
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """Sort the pillars of a tile of size indices, shape (n_y, n_x), by size, strip and line.

    Returns row and column of each pillar, shape (n_pillars,) each; and the end of each size in the list, shape
    (sizes,).
    """
    # One layout in memory, so that one form is compiled.
    return _sorted_by_size(np.ascontiguousarray(size_index), sizes, scan.along_y, scan.strip_sites)


@compiled
def _sorted_by_size(
    size_index: NDArray[np.uint16], sizes: int, along_y: bool, strip_sites: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    n_y, n_x = size_index.shape
    end_of = np.zeros(sizes, dtype=np.int64)
    for i in range(n_y):
        for j in range(n_x):
            if size_index[i, j]:
                end_of[size_index[i, j]] += 1
    following = np.zeros(sizes, dtype=np.int64)  # Loops: cumsum and append take a second to compile.
    for size in range(1, sizes):
        end_of[size] += end_of[size - 1]
        following[size] = end_of[size - 1]
    row, column = np.empty(end_of[-1], dtype=np.int32), np.empty(end_of[-1], dtype=np.int32)
    slow, fast = (n_x, n_y) if along_y else (n_y, n_x)
    for strip in range(0, fast, strip_sites):
        for i in range(slow):
            for j in range(strip, min(strip + strip_sites, fast)):
                size = size_index[j, i] if along_y else size_index[i, j]
                if size:
                    place = following[size]
                    row[place], column[place] = (j, i) if along_y else (i, j)
                    following[size] = place + 1
    return row, column, end_of


@compiled
def count_sizes(size_index: NDArray[np.uint16], sizes: int) -> NDArray[np.int64]:
    """Count how often each size index occurs, shape (sizes,); the first count is that of sites without a pillar.

    Indices have the shape (n_y, n_x), 0 for no pillar; ``sizes`` is the number of rows of the size table.
    """
    # np.bincount would first convert all indices to 64-bit integers.
    count = np.zeros(sizes, dtype=np.int64)
    for i in range(size_index.shape[0]):
        for j in range(size_index.shape[1]):
            count[size_index[i, j]] += 1
    return count
