"""Tilted segments: the depth of a plane, and which pixels lie on it.

The vergence 1/z of a plane is linear over its picture: Z = Z_0 + a X + b Y with X = t_x Z and Y = t_y Z gives
1/Z = (1 - a t_x - b t_y) / Z_0. A segment is cut into cells, each of which says a depth by itself; a plane goes through
them where a single depth does not.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from metafab.core.conventions import FloatArray
from metafab.decode.matching.cost_volume import Volume, correlation
from metafab.decode.matching.depth import spline_peaks, standard_error
from metafab.optics.interpolation.field import spline_weights

#: Side of a cell, pixels of the frame.
_CELL_PX = 36
_FEWEST_CELLS = 8
#: Share of a segment that has to be clear of the picture's rim for its depth to be from that alone.
_LEAST_CLEAR = 0.2
#: A tilt counts from so many standard errors, and from this change over the segment (relative).
_SIGNIFICANT = 6.0
_SMALLEST_RISE = 5e-3
#: Cells farther from the plane than this many times their typical distance do not count (Tukey's biweight).
_TUKEY = 4.7
_ROUNDS = 8
#: Planes through three cells that are tried first.
_TRIPLES = 200


@dataclass(frozen=True)
class Plane:
    """Vergence that is linear over the picture.

    Attributes:
        vergence_per_m: 1/depth at ``centre``.
        slope_per_m: its change a compared pixel along (y, x); (0, 0) for one depth.
        centre: (row, column) of compared pixels.
    """

    vergence_per_m: float
    slope_per_m: tuple[float, float] = (0.0, 0.0)
    centre: tuple[float, float] = (0.0, 0.0)

    @property
    def tilted(self) -> bool:
        """Whether it is more than one depth."""
        return self.slope_per_m != (0.0, 0.0)

    def at(self, row: FloatArray, column: FloatArray) -> FloatArray:
        """1/depth at places, compared pixels; not below a hundredth of that at the centre."""
        rise = self.slope_per_m[0] * (row - self.centre[0]) + self.slope_per_m[1] * (column - self.centre[1])
        return np.maximum(self.vergence_per_m + rise, 0.01 * self.vergence_per_m)

    def moved(self, rows: int, columns: int) -> Plane:
        """The plane in a picture in which everything stands at rows and columns larger by these."""
        return replace(self, centre=(self.centre[0] + rows, self.centre[1] + columns)) if self.tilted else self

    def over(self, shape: tuple[int, ...]) -> FloatArray:
        """1/depth at each compared pixel."""
        row, column = np.ogrid[: shape[0], : shape[1]]
        return np.broadcast_to(self.at(row.astype(np.float64), column.astype(np.float64)), shape)


def cell_side(every: int, side_px: int = _CELL_PX) -> int:
    """Side of a cell in compared pixels, from that in pixels of the frame and how many of these a compared one has."""
    return max(2, side_px // every)


@dataclass(frozen=True)
class Cells:
    """Cells of a segment.

    Attributes:
        sums: shape (n, 3, n_candidates), products of the twins.
        pixels: shape (n,).
        row: shape (n,), their middles, compared pixels; likewise ``column``.
        vergence_per_m: shape (n,), where their twins agree best.
        error_per_m: shape (n,), its standard error; inf for a cell that says no depth.
        whole: shape (3, n_candidates), the sums over all of the segment, cells too small to count included; those
            along the picture's rim, beyond which it goes on unseen, only if hardly any others are there.
        size: how many pixels that are.
    """

    sums: FloatArray
    pixels: FloatArray
    row: FloatArray
    column: FloatArray
    vergence_per_m: FloatArray
    error_per_m: FloatArray
    whole: FloatArray
    size: int

    @classmethod
    def of(cls, volume: Volume, mask: NDArray[np.bool_], every: int, side_px: int = _CELL_PX) -> Cells:
        """Those of the pixels of a mask that hold at least a quarter of a whole cell.

        Args:
            volume: agreement of the twins.
            mask: shape (n_y, n_x), compared pixels.
            every: pixels of the frame a compared pixel.
            side_px: side of a cell, pixels of the frame.
        """
        return cls.of_each(volume, mask.astype(np.int32), 1, every, side_px)[0]

    @classmethod
    def of_each(
        cls, volume: Volume, label: NDArray[np.int32], count: int, every: int, side_px: int = _CELL_PX
    ) -> list[Cells]:
        """As :meth:`of`, of the segments from 1 to ``count`` that ``label`` (n_y, n_x) gives pixels to."""
        row, column = np.nonzero(label)
        segment = label[row, column]
        side = cell_side(every, side_px)
        down, across = (-(-n // side) for n in label.shape)
        # Numbers in the order of segments: those of one segment lie together.
        given = (segment * down + row // side) * across + column // side
        sizes = np.bincount(given)
        number = np.flatnonzero(sizes)
        cell, pixels = (np.cumsum(sizes > 0) - 1)[given], sizes[number]
        numbered = np.zeros(label.shape, dtype=np.int32)
        numbered[row, column] = cell + 1
        sums = volume.over(numbered, number.size)
        middle_row, middle_column = (np.bincount(cell, axis, number.size) / pixels for axis in (row, column))
        vergence, error = _cell_depths(volume, sums, pixels)
        starts = np.searchsorted(number // (down * across), np.arange(1, count + 2))
        clear = np.ones(number.size, dtype=bool)
        for middle, length in zip((middle_row, middle_column), label.shape, strict=True):
            clear &= (middle >= side) & (middle < length - side)
        found = []
        for start, stop in itertools.pairwise(starts.tolist()):
            part = start + np.flatnonzero(clear[start:stop])
            if pixels[part].sum() < _LEAST_CLEAR * pixels[start:stop].sum():
                part = np.arange(start, stop)
            kept = start + np.flatnonzero(pixels[start:stop] >= 0.25 * side**2)
            cells = cls(
                sums[kept],
                pixels[kept].astype(np.float64),
                middle_row[kept],
                middle_column[kept],
                vergence[kept],
                error[kept],
                sums[part].sum(axis=0),
                int(pixels[part].sum()),
            )
            found.append(cells)
        return found

    def chosen(self, which: NDArray[np.bool_]) -> Cells:
        """Some of the cells, with the same whole."""
        return replace(
            self,
            sums=self.sums[which],
            pixels=self.pixels[which],
            row=self.row[which],
            column=self.column[which],
            vergence_per_m=self.vergence_per_m[which],
            error_per_m=self.error_per_m[which],
        )

    def sheared(self, volume: Volume, plane: Plane) -> FloatArray:
        """Sums of the products along a plane's tilt: shape (3, n_candidates) over its vergence at the centre."""
        rise = plane.at(self.row, self.column) - plane.vergence_per_m
        nodes = volume.vergences_per_m
        at = np.clip(nodes + rise[:, None], nodes[0], nodes[-1])
        return np.asarray(np.einsum("cvk,cpk->pv", spline_weights(nodes, at), self.sums))


def _cell_depths(volume: Volume, sums: FloatArray, pixels: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    agreement = correlation(np.moveaxis(sums, 1, 0)).astype(np.float64)
    place, peak, curvature, inside = spline_peaks(agreement)
    error = standard_error(peak, curvature / volume.step_per_m**2, 1.0) / np.sqrt(pixels * volume.samples)
    return volume.vergences_per_m[0] + volume.step_per_m * place, np.where(inside & (peak > 0.0), error, np.inf)


def fitted_plane(cells: Cells) -> Plane | None:
    """The plane through cells, if they say that there is a tilt; outlying ones do not count."""
    known = np.isfinite(cells.error_per_m)
    if known.sum() < _FEWEST_CELLS:
        return None
    row, column, vergence = cells.row[known], cells.column[known], cells.vergence_per_m[known]
    weight = 1.0 / cells.error_per_m[known] ** 2
    centre = float(np.average(row, weights=weight)), float(np.average(column, weights=weight))
    table = np.stack([np.ones(row.size), row - centre[0], column - centre[1]], axis=1)
    found = _most_agreed(table, vergence, np.sqrt(weight))
    scale, trust = 1.0, np.ones(row.size)
    for _ in range(_ROUNDS):
        away = np.abs(vergence - table @ found) * np.sqrt(weight)
        scale = max(1.0, 1.48 * float(np.median(away)))
        trust = np.clip(1.0 - (away / (_TUKEY * scale)) ** 2, 0.0, None) ** 2
        normal = table.T @ (table * (weight * trust)[:, None])
        # Of a volume against its edges (Hadamard): cells on one line make no plane.
        if not np.linalg.det(normal) > 1e-9 * np.prod(np.diag(normal)):
            return None
        before = found
        found = np.asarray(np.linalg.solve(normal, table.T @ (weight * trust * vergence)), dtype=np.float64)
        if np.abs(table @ (found - before)).max() < 1e-9 * abs(found[0]):
            break
    normal = table.T @ (table * (weight * trust)[:, None]) / scale**2
    slope = found[1:]
    left = normal[1:, 1:] - np.outer(normal[1:, 0], normal[0, 1:]) / normal[0, 0]
    rise = float(np.ptp((table[:, 1:] @ slope)[trust > 0.0])) if (trust > 0.0).any() else 0.0
    if float(slope @ left @ slope) < _SIGNIFICANT**2 or rise < _SMALLEST_RISE * abs(found[0]):
        return None
    return Plane(float(found[0]), (float(slope[0]), float(slope[1])), centre)


def _most_agreed(table: FloatArray, vergence: FloatArray, weight: FloatArray) -> FloatArray:
    """Of the planes through three cells each, the one with the least median distance: a third may be outliers."""
    rng = np.random.default_rng(0)
    picks = rng.integers(0, vergence.size, (_TRIPLES, 3))
    corners = table[picks]  # one that is picked twice makes no plane, and is left out with the others that are narrow
    good = np.abs(np.linalg.det(corners)) > 0.1 * np.ptp(table[:, 1]) * np.ptp(table[:, 2])
    if not good.any():
        return np.array([float(np.median(vergence)), 0.0, 0.0])
    planes = np.linalg.solve(corners[good], vergence[picks[good]][..., None])[..., 0]
    away = np.abs(vergence - planes @ table.T) * weight
    return np.asarray(planes[np.partition(away, vergence.size // 2, axis=1)[:, vergence.size // 2].argmin()])


def distinct_planes(planes: list[Plane], label: NDArray[np.int32], separation_per_m: float) -> list[Plane]:
    """Planes without those that go on in a tilted neighbour; the larger segment's plane is kept.

    Args:
        planes: of each segment.
        label: shape (n_y, n_x), numbers of the segments from 1.
        separation_per_m: segments whose own depth is nearer to the neighbour's plane than half of this lie on it.
    """
    sizes = np.bincount(label.ravel(), minlength=len(planes) + 1)[1:]
    kept: list[int] = []
    for index in sorted(range(len(planes)), key=lambda k: (not planes[k].tilted, -sizes[k])):
        row, column = (axis.astype(np.float64) for axis in np.nonzero(label == index + 1))
        own = planes[index].at(row, column)
        about = binary_dilation(label == index + 1, iterations=2)
        if not any(
            planes[other].tilted
            and about[label == other + 1].any()
            and np.median(np.abs(planes[other].at(row, column) - own)) < 0.5 * separation_per_m
            for other in kept
        ):
            kept.append(index)
    return [planes[index] for index in sorted(kept)]
