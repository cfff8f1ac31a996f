"""Oracle for gaps between neighbours: every pair of a block at once, in NumPy."""

from __future__ import annotations

import numpy as np

from metafab.layout import Lattice
from metafab.layout.gaps import LISTED, Gaps, centre_distances


def gaps_by_numpy(size_index: np.ndarray, size_dbu: np.ndarray, lattice: Lattice, limit_dbu: float, rows: int) -> Gaps:
    """Gaps of rectangles, as :func:`metafab.layout.smallest_gap` measures them."""
    n_y, n_x = size_index.shape
    smallest, overlapping = np.inf, 0
    sites, neighbours = [], []
    for pair, ((down, right), (x, y)) in enumerate(zip(lattice.pairs, centre_distances(lattice), strict=True)):
        left, end = max(0, -right), min(rows, n_y - down)
        here = size_index[:end, left : n_x - max(0, right)]
        there = size_index[down : end + down, left + right : n_x + min(0, right)]
        gap_x = x - (size_dbu[here, 0] + size_dbu[there, 0]) / 2.0
        gap_y = y - (size_dbu[here, 1] + size_dbu[there, 1]) / 2.0
        depth, apart = np.maximum(gap_x, gap_y), np.maximum(gap_x, 0.0) ** 2 + np.maximum(gap_y, 0.0) ** 2
        square = np.where((here > 0) & (there > 0), np.where(depth < 0.0, -(depth**2), apart), np.inf)
        smallest = min(smallest, float(square.min(initial=np.inf)))
        row, column = np.nonzero(square < limit_dbu * abs(limit_dbu))
        overlapping += int(np.count_nonzero(square[row, column] <= 0.0))
        sites.append(row * n_x + column + left)
        neighbours.append(np.full(row.size, pair))
    site, neighbour = np.concatenate(sites), np.concatenate(neighbours)
    order = np.lexsort((neighbour, site))[:LISTED]
    root = float(np.sign(smallest) * np.sqrt(abs(smallest)))
    return Gaps(root, site.size, overlapping, site[order], neighbour[order])
