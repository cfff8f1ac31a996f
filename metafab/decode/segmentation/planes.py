"""Tilted planes: least median of squares over the cells of a segment, RANSAC over the cells of a whole picture.

The vergence 1/z of a plane is linear over its picture: Z = Z_0 + a X + b Y with X = t_x Z and Y = t_y Z gives
1/Z = (1 - a t_x - b t_y) / Z_0. A segment is cut into cells, and each cell is given a depth. A plane is fitted where a
single depth does not explain them. Layers of one depth cut a tilted surface into stripes, each too narrow to show the
tilt; RANSAC over all cells finds the plane across them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.distance import box_about
from metafab.core.numeric.interpolation import spline_weights
from metafab.decode.matching.cost_volume import CostVolume, correlation
from metafab.decode.matching.depth import spline_peaks, standard_error

#: Side of a cell, frame pixels.
CELL_PX = 36
_FEWEST_CELLS = 8
#: Share of a segment's pixels away from the picture's rim from which its depth is measured on them alone.
_LEAST_CLEAR = 0.2
#: A tilt is significant from this many standard errors, and from this relative change of vergence over the segment.
_SIGNIFICANT, _SMALLEST_RISE = 6.0, 5e-3
#: Distance from the plane, in typical distances, from which Tukey's biweight rejects a cell.
_TUKEY = 4.7
_TUKEY_ROUNDS = 8
#: Random triples of cells that the least median of squares tries.
_TRIPLES = 200
#: RANSAC: radius of the neighbourhood that proposes a plane, in sides of a cell (21 cells), and its fewest cells.
_NEIGHBOURHOOD, _FEWEST_NEIGHBOURS = 2.5, 6
#: RANSAC: distance of an inlier, in standard errors of the cell plus a share of the layers' separation.
_INLIER_ERRORS, _INLIER_SHARE = 2.5, 0.15
#: RANSAC: fewest inliers of a plane.
FEWEST_INLIERS = 10
#: RANSAC: most planes.
_MOST_PLANES = 8
#: RANSAC: refits of a plane to its inliers.
_REFITS = 3
#: Layers that a plane may cross within a cell: an outline between two objects is steeper.
_STEEPEST = 1.5
#: Determinant of the normal equations over the product of their diagonal (Hadamard) of cells that lie on one line.
_DEGENERATE = 1e-9


@dataclass(frozen=True)
class Plane:
    """Vergence that is linear over the picture, or quadratic on a curved surface."""

    vergence_per_m: float  #: 1/depth at ``centre``.
    #: Its change per downsampled pixel along (y, x); (0, 0) for one depth.
    slope_per_m: tuple[float, float] = (0.0, 0.0)
    centre: tuple[float, float] = (0.0, 0.0)  #: (row, column), downsampled pixels.
    #: Factors of y^2, y x and x^2 from the centre, per squared downsampled pixel; (0, 0, 0) for a plane.
    curvature_per_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def tilted(self) -> bool:
        """Whether the surface has more than one depth."""
        return self.slope_per_m != (0.0, 0.0) or self.curved

    @property
    def curved(self) -> bool:
        """Whether the surface is no plane."""
        return self.curvature_per_m != (0.0, 0.0, 0.0)

    def at(self, row: FloatArray, column: FloatArray) -> FloatArray:
        """1/depth (1/m) at places in downsampled pixels, scalars or arrays that broadcast.

        It is at least a hundredth of that at the centre.
        """
        y, x = row - self.centre[0], column - self.centre[1]
        rise = self.slope_per_m[0] * y + self.slope_per_m[1] * x
        if self.curved:
            yy, yx, xx = self.curvature_per_m
            rise = rise + yy * y**2 + yx * y * x + xx * x**2
        return np.maximum(self.vergence_per_m + rise, 0.01 * self.vergence_per_m)

    def moved(self, rows: int, columns: int) -> Plane:
        """The plane in a picture whose contents are moved by some rows and columns."""
        return replace(self, centre=(self.centre[0] + rows, self.centre[1] + columns)) if self.tilted else self

    def over(self, shape: tuple[int, ...]) -> FloatArray:
        """1/depth at each pixel of a picture: shape ``shape``."""
        if not self.tilted:
            return np.broadcast_to(self.at(np.zeros(()), np.zeros(())), shape)
        row, column = np.ogrid[: shape[0], : shape[1]]
        return np.broadcast_to(self.at(row.astype(np.float64), column.astype(np.float64)), shape)


def cell_side(step: int, side_px: int = CELL_PX) -> int:
    """Side of a cell in downsampled pixels, for a downsampling step and a side in frame pixels."""
    return max(2, side_px // step)


def cell_depths(volume: CostVolume, sums: FloatArray, pixels: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """1/depth of cells at the largest correlation of their twins, and its standard error, in 1/m: shapes (n,).

    The error is inf where the twins do not agree, or best at an end of the candidates.

    Args:
        volume: cost volume, whose candidates the depths are measured at.
        sums: shape (n, 3, n_candidates), its products summed over each cell.
        pixels: shape (n,), of each cell.
    """
    peak = spline_peaks(correlation(np.moveaxis(sums, 1, 0)).astype(np.float64))
    error = standard_error(peak.height, peak.curvature / volume.step_per_m**2, 1.0)
    error = np.where(peak.inside & (peak.height > 0.0), error / np.sqrt(pixels * volume.samples), np.inf)
    return volume.vergences_per_m[0] + volume.step_per_m * peak.place, error


@dataclass(frozen=True)
class Cells:
    """Square cells of a segment, each with its own depth."""

    sums: FloatArray  #: Shape (n, 3, n_candidates), products of the twins summed over each cell.
    pixels: FloatArray  #: Shape (n,), pixels of each cell.
    row: FloatArray  #: Shape (n,), row of its centre, downsampled pixels.
    column: FloatArray  #: Shape (n,), column of its centre.
    vergence_per_m: FloatArray  #: Shape (n,), 1/depth at the largest correlation of its twins.
    error_per_m: FloatArray  #: Shape (n,), standard error of the vergence; inf for a cell without a depth.
    #: Shape (3, n_candidates), products summed over the segment, small cells included; without the cells along a rim of
    #: the picture that the segment reaches, beyond which it may continue, unless hardly any others are there.
    whole: FloatArray
    size: int  #: Pixels of ``whole``.

    @classmethod
    def of(cls, volume: CostVolume, mask: NDArray[np.bool_], step: int, side_px: int = CELL_PX) -> Cells:
        """Cells of a mask that hold at least a quarter of a whole cell.

        The mask, shape (n_y, n_x), has downsampled pixels of ``step`` frame pixels; ``side_px`` is the side of a cell
        in frame pixels.
        """
        return cls.of_each(volume, mask.astype(np.int32), 1, step, side_px)[0]

    @classmethod
    def of_each(
        cls, volume: CostVolume, label: NDArray[np.int32], count: int, step: int, side_px: int = CELL_PX
    ) -> list[Cells]:
        """Cells of each segment from 1 to ``count`` of ``label``, shape (n_y, n_x); see :meth:`of`."""
        row, column = np.nonzero(label)
        side = cell_side(step, side_px)
        down, across = (-(-n // side) for n in label.shape)
        # Numbers in the order of segments: the cells of one segment are contiguous.
        code = (label[row, column] * down + row // side) * across + column // side
        sizes = np.bincount(code)
        number = np.flatnonzero(sizes)
        cell, pixels = (np.cumsum(sizes > 0) - 1)[code], sizes[number]
        cell_label = np.zeros(label.shape, dtype=np.int32)
        cell_label[row, column] = cell + 1
        sums = volume.label_sums(cell_label, number.size)
        middle_row, middle_column = (np.bincount(cell, axis, number.size) / pixels for axis in (row, column))
        vergence, error = cell_depths(volume, sums, pixels)
        clear = np.ones(number.size, dtype=bool)
        segment = number // (down * across)
        for axis, middle in enumerate((middle_row, middle_column)):
            for rim, near in ((0, middle < side), (-1, middle >= label.shape[axis] - side)):
                reaching = np.zeros(count + 1, dtype=bool)
                reaching[label.take(rim, axis)] = True
                clear &= ~(near & reaching[segment])
        starts = np.searchsorted(segment, np.arange(1, count + 2))
        cells = []
        for start, stop in itertools.pairwise(starts.tolist()):
            measured = start + np.flatnonzero(clear[start:stop])
            if pixels[measured].sum() < _LEAST_CLEAR * pixels[start:stop].sum():
                measured = np.arange(start, stop)
            large = start + np.flatnonzero(pixels[start:stop] >= 0.25 * side**2)
            cells.append(
                cls(
                    sums[large],
                    pixels[large].astype(np.float64),
                    middle_row[large],
                    middle_column[large],
                    vergence[large],
                    error[large],
                    sums[measured].sum(axis=0),
                    int(pixels[measured].sum()),
                )
            )
        return cells

    def chosen(self, which: NDArray[np.bool_]) -> Cells:
        """The cells where ``which``, shape (n,), is set; ``whole`` and ``size`` stay."""
        return Cells(
            self.sums[which],
            self.pixels[which],
            self.row[which],
            self.column[which],
            self.vergence_per_m[which],
            self.error_per_m[which],
            self.whole,
            self.size,
        )

    def sheared(self, volume: CostVolume, plane: Plane) -> FloatArray:
        """Products summed along a plane's tilt: shape (3, n_candidates) over the vergence at its centre."""
        rise = plane.at(self.row, self.column) - plane.vergence_per_m
        nodes = volume.vergences_per_m
        at = np.clip(nodes + rise[:, None], nodes[0], nodes[-1])
        return np.asarray(np.einsum("cvk,cpk->pv", spline_weights(nodes, at), self.sums))


def fit_plane(cells: Cells) -> Plane | None:
    """Fit a plane to cells: least median of squares, refined by Tukey's biweight; None without a significant tilt."""
    known = np.isfinite(cells.error_per_m)
    if known.sum() < _FEWEST_CELLS:
        return None
    row, column, vergence = cells.row[known], cells.column[known], cells.vergence_per_m[known]
    weight = 1.0 / cells.error_per_m[known] ** 2
    centre = float(np.average(row, weights=weight)), float(np.average(column, weights=weight))
    design = np.stack([np.ones(row.size), row - centre[0], column - centre[1]], axis=1)
    solution, biweight, scale = _robust_plane(_triples(vergence.size), design, vergence, np.sqrt(weight))
    if not np.isfinite(scale):
        return None
    normal = design.T @ (design * (weight * biweight)[:, None]) / scale**2
    slope = solution[1:]
    slope_information = normal[1:, 1:] - np.outer(normal[1:, 0], normal[0, 1:]) / normal[0, 0]
    rise = float(np.ptp((design[:, 1:] @ slope)[biweight > 0.0])) if (biweight > 0.0).any() else 0.0
    if float(slope @ slope_information @ slope) < _SIGNIFICANT**2 or rise < _SMALLEST_RISE * abs(solution[0]):
        return None
    return Plane(float(solution[0]), (float(slope[0]), float(slope[1])), centre)


@lru_cache(maxsize=256)
def _triples(count: int) -> NDArray[np.int64]:
    """Random triples of ``count`` cells: shape (n_triples, 3), read-only."""
    triples = np.random.default_rng(0).integers(0, count, (_TRIPLES, 3))
    triples.flags.writeable = False
    return triples


@compiled
def _robust_plane(
    triples: NDArray[np.int64], design: FloatArray, vergence: FloatArray, root: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """The plane of least median residual, refined by Tukey's biweight.

    Args:
        triples: shape (n_triples, 3), cells through which planes are tried.
        design: shape (n, 3), 1 and the place of each cell along y and x.
        vergence: shape (n,), 1/depth of each cell.
        root: shape (n,), inverse standard error of each.

    Returns:
        Factors of the design's columns, biweight of each cell and scale of the residuals in standard errors; inf if the
        cells that count lie on one line.
    """
    solution = _least_median_of_squares(triples, design, vergence, root)
    biweight, scale, count = np.ones(vergence.size), 1.0, vergence.size
    for _ in range(_TUKEY_ROUNDS):
        residual = np.empty(count)
        for k in range(count):
            fitted = solution[0] * design[k, 0] + solution[1] * design[k, 1] + solution[2] * design[k, 2]
            residual[k] = abs(vergence[k] - fitted) * root[k]
        scale = max(1.0, 1.48 * _median(residual))
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for k in range(count):
            kept = max(1.0 - (residual[k] / (_TUKEY * scale)) ** 2, 0.0)
            biweight[k] = kept * kept
            weight = root[k] * root[k] * biweight[k]
            for i in range(3):
                right[i] += weight * vergence[k] * design[k, i]
                for j in range(3):
                    normal[i, j] += weight * design[k, i] * design[k, j]
        if not _determinant(normal) > _DEGENERATE * normal[0, 0] * normal[1, 1] * normal[2, 2]:
            return solution, biweight, np.inf
        before, solution = solution, _solved(normal, right)
        change = 0.0
        for k in range(count):
            moved = 0.0
            for i in range(3):
                moved += design[k, i] * (solution[i] - before[i])
            change = max(change, abs(moved))
        if change < 1e-9 * abs(solution[0]):
            break
    return solution, biweight, scale


@compiled
def _least_median_of_squares(
    triples: NDArray[np.int64], design: FloatArray, vergence: FloatArray, root: FloatArray
) -> FloatArray:
    """Of planes through triples of cells, the one of least median residual: a third of the cells may be outliers."""
    best, least = np.array([_median(vergence), 0.0, 0.0]), np.inf
    middle, corners, at, residual = vergence.size // 2, np.empty((3, 3)), np.empty(3), np.empty(vergence.size)
    lowest, highest = design[0].copy(), design[0].copy()
    for k in range(1, vergence.size):
        for i in range(3):
            lowest[i], highest[i] = min(lowest[i], design[k, i]), max(highest[i], design[k, i])
    narrow = 0.1 * (highest[1] - lowest[1]) * (highest[2] - lowest[2])
    for triple in range(triples.shape[0]):
        for i in range(3):
            at[i] = vergence[triples[triple, i]]
            for j in range(3):
                corners[i, j] = design[triples[triple, i], j]
        # A cell that is picked twice gives no area.
        if not abs(_determinant(corners)) > narrow:
            continue
        plane, smaller = _solved(corners, at), 0
        for k in range(vergence.size):
            fitted = plane[0] * design[k, 0] + plane[1] * design[k, 1] + plane[2] * design[k, 2]
            residual[k] = abs(vergence[k] - fitted) * root[k]
            smaller += residual[k] < least
        # The median is sought only where it is less.
        if smaller > middle:
            best, least = plane, _kth_smallest(residual, middle)
    return best


@compiled
def _determinant(a: FloatArray) -> float:
    """Determinant of a matrix of shape (3, 3)."""
    return float(
        a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
        - a[0, 1] * (a[1, 0] * a[2, 2] - a[1, 2] * a[2, 0])
        + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
    )


@compiled
def _solved(a: FloatArray, b: FloatArray) -> FloatArray:
    """Solution of a linear system, shapes (3, 3) and (3,), by Cramer's rule: shape (3,)."""
    determinant, out, replaced = _determinant(a), np.empty(3), a.copy()
    for column in range(3):
        for row in range(3):
            replaced[row, column] = b[row]
        out[column] = _determinant(replaced) / determinant
        for row in range(3):
            replaced[row, column] = a[row, column]
    return out


@compiled
def _median(values: FloatArray) -> float:
    """Median of values, shape (n,), as ``numpy.median``, which takes a second to compile."""
    return 0.5 * (_kth_smallest(values, (values.size - 1) // 2) + _kth_smallest(values, values.size // 2))


@compiled
def _kth_smallest(values: FloatArray, k: int) -> float:
    """``numpy.partition(values, k)[k]`` of finite values, shape (n,), by Hoare's quickselect.

    That of numba takes five seconds to compile.
    """
    parted, first, last = values.copy(), 0, values.size - 1
    while first < last:
        pivot, i, j = parted[(first + last) // 2], first, last
        while i <= j:
            while parted[i] < pivot:
                i += 1
            while parted[j] > pivot:
                j -= 1
            if i <= j:
                parted[i], parted[j] = parted[j], parted[i]
                i += 1
                j -= 1
        first, last = (first if k <= j else i if k >= i else k), (j if k <= j else last if k >= i else k)
    return float(parted[k])


def ransac_planes(
    cells: Cells, side: int, separation_per_m: float, steepest: float = _STEEPEST, most: int = _MOST_PLANES
) -> list[Plane]:
    """Find at most ``most`` planes that span more than one layer by RANSAC, those of most cells first.

    Cells are those of the whole picture, at most one at a place, of ``side`` downsampled pixels; layers differ by
    ``separation_per_m`` of vergence, and a plane crosses at most ``steepest`` of them within a cell.
    """
    remaining = np.isfinite(cells.error_per_m)
    near = np.hypot(cells.row[:, None] - cells.row, cells.column[:, None] - cells.column) <= _NEIGHBOURHOOD * side
    tolerance = _INLIER_ERRORS * cells.error_per_m + _INLIER_SHARE * separation_per_m
    planes: list[Plane] = []
    while remaining.sum() >= FEWEST_INLIERS and len(planes) < most:
        inliers = _ransac_step(cells, remaining, near, tolerance, side)
        if inliers.sum() < FEWEST_INLIERS:
            break
        remaining = remaining & ~inliers
        plane = fit_plane(cells.chosen(inliers))
        if plane is None:
            continue
        vergence = plane.at(cells.row, cells.column)
        remaining = remaining & (np.abs(cells.vergence_per_m - vergence) > tolerance)
        gentle = np.hypot(*plane.slope_per_m) * side < steepest * separation_per_m
        if np.ptp(vergence[inliers]) > separation_per_m and gentle:
            planes.append(plane)
    return planes


def _ransac_step(
    cells: Cells, remaining: NDArray[np.bool_], near: NDArray[np.bool_], tolerance: FloatArray, side: int
) -> NDArray[np.bool_]:
    """RANSAC step: the largest connected set of cells on one plane; each cell's neighbourhood proposes a plane."""
    design = np.stack([np.ones(cells.row.size), cells.row, cells.column], axis=1)
    weight = np.where(near & remaining, 1.0 / np.where(remaining, tolerance, 1.0) ** 2, 0.0)
    products = design[:, :, None] * design[:, None, :]
    normal = (weight @ products.reshape(-1, 9)).reshape(-1, 3, 3)
    right_side = weight @ (design * np.where(remaining, cells.vergence_per_m, 0.0)[:, None])
    diagonal = np.prod(np.diagonal(normal, axis1=1, axis2=2), axis=1)
    enough = remaining & ((weight > 0.0).sum(axis=1) >= _FEWEST_NEIGHBOURS)
    proposing = enough & (np.linalg.det(normal) > _DEGENERATE * diagonal)
    if not proposing.any():
        return np.zeros(remaining.size, dtype=bool)
    planes = np.linalg.solve(normal[proposing], right_side[proposing][..., None])[..., 0]
    vergence = np.where(remaining, cells.vergence_per_m, np.inf)
    agreeing = np.abs(vergence - planes @ design.T) < tolerance
    best = int(agreeing.sum(axis=1).argmax())
    inliers, seed = agreeing[best], int(np.flatnonzero(proposing)[best])
    for _ in range(_REFITS):
        inliers = _connected_to(cells, inliers, seed, side)
        root = inliers / tolerance
        plane = np.linalg.lstsq(design * root[:, None], cells.vergence_per_m * root, rcond=None)[0]
        inliers = np.abs(vergence - design @ plane) < tolerance
    return _connected_to(cells, inliers, seed, side)


def _connected_to(cells: Cells, chosen: NDArray[np.bool_], seed: int, side: int) -> NDArray[np.bool_]:
    """The chosen cells in one connected component with the seed."""
    at = (cells.row // side).astype(np.intp), (cells.column // side).astype(np.intp)
    grid = np.zeros((int(at[0].max()) + 1, int(at[1].max()) + 1), dtype=bool)
    grid[at] = chosen
    grid[at[0][seed], at[1][seed]] = True
    component, _ = connected_components(grid, np.ones((3, 3), dtype=bool))
    return np.asarray(chosen & (component[at] == component[at[0][seed], at[1][seed]]))


def distinct_planes(planes: list[Plane], label: NDArray[np.int32], separation_per_m: float) -> list[Plane]:
    """Planes without those that continue the plane of a tilted neighbour; the larger segment's plane is kept.

    ``label``, shape (n_y, n_x), holds the numbers of the segments from 1. Planes differ by ``separation_per_m`` of
    vergence; segments nearer than half of it are on one plane.
    """
    sizes = np.bincount(label.ravel(), minlength=len(planes) + 1)[1:]
    kept: list[int] = []
    touching: dict[int, NDArray[np.bool_]] = {}
    for index in sorted(range(len(planes)), key=lambda k: (not planes[k].tilted, -sizes[k])):
        beside = [other for other, numbers in touching.items() if numbers[index + 1]]
        if beside:
            row, column = (axis.astype(np.float64) for axis in np.nonzero(label == index + 1))
            vergence = planes[index].at(row, column)
            away = [np.median(np.abs(planes[other].at(row, column) - vergence)) for other in beside]
            if min(away) < 0.5 * separation_per_m:
                continue
        kept.append(index)
        if planes[index].tilted:
            touching[index] = _touching(label, index + 1, len(planes) + 1)
    return [planes[index] for index in sorted(kept)]


def _touching(label: NDArray[np.int32], number: int, count: int) -> NDArray[np.bool_]:
    """Whether a segment, of the numbers in ``label`` below ``count``, has pixels within two steps of that ``number``.

    Shape (count,).
    """
    mask = label == number
    box = box_about(mask, 2)
    near = label[box][binary_dilation(mask[box], iterations=2)] if mask.any() else label[:0].ravel()
    return np.asarray(np.bincount(near, minlength=count) > 0)
