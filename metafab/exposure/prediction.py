"""Printed sizes of all pillars at given doses: their statistics, their map over the lens, and the process window."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import Float32Array, FloatArray
from metafab.exposure.energy.beside import Beside
from metafab.exposure.energy.resist import TILE_SITES, ResistEnergy, TileEnergy
from metafab.exposure.printing import EdgeTables, add_edge_displacements
from metafab.exposure.sums import dose_to_size_sums, size_statistics

#: Number of tiles from which the dose to size and the process window are found; the window takes every fourth row of
#: them.
_SAMPLED_TILES, _WINDOW_ROWS = 16, 4
#: Bins of the histogram of size errors, and their width (nm).
BINS, BIN_NM = 1200, 0.05
#: Least number of blocks along the lens in a map of size errors.
_MAP_BLOCKS = 64
#: No listed pillar.
NO_PLACES = np.empty((0, 2), dtype=np.int64)


@dataclass(frozen=True)
class Printing:
    """A pattern with its process."""

    resist: ResistEnergy  #: Energy of the drawn pattern.
    tables: EdgeTables  #: Energy of each size at its own edges.
    base_over_clearing_dose: float  #: Base dose over the clearing dose of a large pad.
    executor: Executor  #: Threads that compute tiles.
    #: Shape (2, n_y, n_x), width and length that should be printed, less those that are drawn; None where they are
    #: equal.
    wanted_less_drawn_nm: Float32Array | None = None

    def among(self, beside: Beside | None) -> Printing:
        """The same pattern with everything that is exposed with it."""
        return replace(self, resist=self.resist.among(beside))

    def edges(self, tile: TileEnergy, base_over_clearing_dose: float) -> Float32Array:
        """Displacement of the printed edges of a tile from the drawn ones: shape (2, n_y, n_x), nm."""
        moved = np.zeros_like(tile.others)
        tables = (self.tables.displacement_nm, self.tables.energy)
        clearing = 1.0 / base_over_clearing_dose
        add_edge_displacements(tile.size_index, tile.dose, tile.others, clearing, *tables, moved)
        return moved

    def errors(self, tile: TileEnergy, moved: Float32Array) -> Float32Array:
        """Half of printed less wanted size: shape (2, n_y, n_x), nm."""
        if self.wanted_less_drawn_nm is None:
            return moved
        return moved - np.float32(0.5) * self.wanted_less_drawn_nm[:, tile.rows, tile.columns]


@dataclass(frozen=True)
class SizeSums:
    """Sums over all pillars of :func:`metafab.exposure.sums.size_statistics`; sizes are NaN if no pillar prints."""

    pillars: int
    unprinted: int
    total_nm: float
    square_nm2: float
    largest_nm: float
    latitude_nm: float
    dose_min: float
    dose_max: float

    @property
    def sides(self) -> float:
        """Number of printed widths and lengths; NaN without any."""
        return 2.0 * (self.pillars - self.unprinted) or math.nan

    @property
    def bias_nm(self) -> float:
        """Mean size error."""
        return self.total_nm / self.sides

    @property
    def rms_nm(self) -> float:
        """Rms size error."""
        return math.sqrt(self.square_nm2 / self.sides)

    @classmethod
    def of(cls, parts: FloatArray) -> SizeSums:
        """Add up the results of tiles, shape (n_tiles, 8)."""
        added, least, most = parts.sum(axis=0), parts.min(axis=0), parts.max(axis=0)
        pillars, unprinted, total, square, _, latitude, *_ = added.tolist()
        return cls(
            pillars=int(pillars),
            unprinted=int(unprinted),
            total_nm=total,
            square_nm2=square,
            largest_nm=float(most[4]) if unprinted < pillars else math.nan,
            latitude_nm=latitude,
            dose_min=float(least[6]),
            dose_max=float(most[7]),
        )


@dataclass(frozen=True)
class SizeMap:
    """Mean size errors over the lens."""

    #: Shape (n_y, n_x), mean of printed less wanted width and length in each block; NaN without pillars.
    bias_nm: Float32Array
    block_um: tuple[float, float]  #: Side of a block (x, y).


@dataclass(frozen=True)
class WindowPoint:
    """Size errors of a sample of pillars at a changed dose."""

    dose_change_percent: float  #: Change of all doses.
    bias_nm: float  #: Mean of printed less wanted sizes.
    rms_nm: float  #: Rms of printed less wanted sizes.
    unprinted_share: float  #: Share of pillars that do not print.


@dataclass(frozen=True)
class Prediction:
    """Printed sizes of all pillars."""

    sums: SizeSums  #: Sums over all pillars.
    histogram: NDArray[np.int64]  #: Shape (BINS,), widths and lengths in each bin of size errors.
    #: For each listed pillar, shape (5,): energy at the centre, the x and the y edges over the clearing energy, and
    #: printed less drawn width and length.
    listed: dict[tuple[int, int], FloatArray]
    size_map: SizeMap  #: Mean size errors over the lens.
    window: tuple[WindowPoint, ...]  #: Errors of a sample of pillars at each of ``window_percent``.
    #: Shape (2, n_y, n_x), of width and length; -inf where a pillar does not print. None unless asked for.
    printed_less_drawn_nm: Float32Array | None


def dose_to_size(resist: ResistEnergy, tables: EdgeTables, dose: Float32Array, executor: Executor) -> float:
    """Return the base over clearing dose for a mean linear size error of zero, from a part of the tiles.

    Doses, shape (n_y, n_x), are relative to the base dose; the tables hold the energy of each size at its own edges.
    """

    def sums(tile: TileEnergy) -> FloatArray:
        return np.array(dose_to_size_sums(tile.size_index, tile.dose, tile.others, tables.at_edge, tables.slope_per_nm))

    parts = [found for _, found in resist.map_tiles(dose, executor, sums, _sampled_tiles(resist))]
    energy, count = np.sum(parts, axis=0)
    return float(count / energy)


def predict(
    process: Printing,
    dose: Float32Array,
    places: NDArray[np.int64],
    *,
    window_percent: Sequence[float] = (),
    keep_sizes: bool = False,
) -> Prediction:
    """Predict the printed sizes for a dose, shape (n_y, n_x).

    ``places``, shape (n, 2), are rows and columns of listed pillars; ``window_percent`` are changes of all doses for
    the process window; ``keep_sizes`` keeps the sizes of all.
    """
    tables, ratio, resist = process.tables, process.base_over_clearing_dose, process.resist
    shape = resist.size_index.shape
    side = min(TILE_SITES, 1 << max(0, (max(shape) // _MAP_BLOCKS).bit_length() - 1))
    bias_nm = np.full((-(-shape[0] // side), -(-shape[1] // side)), np.nan, dtype=np.float32)
    kept = np.zeros((2, *shape), dtype=np.float32) if keep_sizes else None
    sampled, no_window = _sampled_tiles(resist), np.empty((0, 8))

    def printed(tile: TileEnergy) -> FloatArray:
        moved = process.edges(tile, ratio)
        if kept is not None:
            kept[:, tile.rows, tile.columns] = 2.0 * moved
        errors = process.errors(tile, moved)
        counts = np.zeros(BINS, dtype=np.int64)
        sums = size_statistics(tile.size_index, tile.dose, tables.slope_per_nm, errors, ratio, BIN_NM, counts)
        blocks = _block_means(tile.size_index, errors, side)
        first = tile.rows.start // side, tile.columns.start // side
        bias_nm[first[0] : first[0] + blocks.shape[0], first[1] : first[1] + blocks.shape[1]] = blocks
        y, x = (inside(places, tile.rows, tile.columns) - (tile.rows.start, tile.columns.start)).T
        at_edges = tables.at_edge[:, tile.size_index[y, x]] * tile.dose[y, x] + tile.others[:, y, x]
        rows = np.concatenate([ratio * tile.centre[None, y, x], ratio * at_edges, 2.0 * moved[:, y, x]])
        is_sampled = (tile.rows, tile.columns) in sampled
        window = _changed(process, tile, window_percent) if is_sampled else no_window
        return np.concatenate([sums, counts, rows.T.ravel(), window.ravel()])

    parts, windows, counts = [], [], np.zeros(BINS, dtype=np.int64)
    listed: dict[tuple[int, int], FloatArray] = {}
    for block, result in resist.map_tiles(dose, process.executor, printed):
        here = inside(places, *block)
        statistics, bins, rows, window = np.split(result, np.cumsum([8, BINS, 5 * len(here)]))
        parts.append(statistics)
        counts += bins.astype(np.int64)
        listed.update(zip(map(tuple, here.tolist()), rows.reshape(-1, 5), strict=True))
        if window.size:
            windows.append(window.reshape(-1, 8))
    block_um = (side * resist.period_nm[0] * 1e-3, side * resist.period_nm[1] * 1e-3)
    window_points = _window(np.array(windows), window_percent) if window_percent else ()
    return Prediction(SizeSums.of(np.array(parts)), counts, listed, SizeMap(bias_nm, block_um), window_points, kept)


def _changed(process: Printing, tile: TileEnergy, dose_change_percent: Sequence[float]) -> FloatArray:
    """Sums over some rows of a tile at changes of all doses: shape (n, 8)."""
    step = _WINDOW_ROWS if len(process.resist.tiles) > 1 else 1
    size_index, dose = np.ascontiguousarray(tile.size_index[::step]), np.ascontiguousarray(tile.dose[::step])
    others = np.ascontiguousarray(tile.others[:, ::step])
    rows = slice(tile.rows.start, tile.rows.stop, step)
    part = replace(tile, rows=rows, size_index=size_index, dose=dose, others=others)
    sums = np.zeros((len(dose_change_percent), 8))
    for row, percent in zip(sums, dose_change_percent, strict=True):
        ratio = process.base_over_clearing_dose * (1.0 + 0.01 * percent)
        errors, counts = process.errors(part, process.edges(part, ratio)), np.zeros(2, np.int64)
        row[:] = size_statistics(size_index, dose, process.tables.slope_per_nm, errors, ratio, BIN_NM, counts)
    return sums


def _window(parts: FloatArray, dose_change_percent: Sequence[float]) -> tuple[WindowPoint, ...]:
    """Errors at each change of the doses from sums of tiles, shape (n_tiles, n, 8)."""
    points = []
    for percent, row in zip(dose_change_percent, np.swapaxes(parts, 0, 1), strict=True):
        sums = SizeSums.of(row)
        points.append(WindowPoint(percent, sums.bias_nm, sums.rms_nm, sums.unprinted / max(1, sums.pillars)))
    return tuple(points)


def _sampled_tiles(resist: ResistEnergy) -> Sequence[tuple[slice, slice]]:
    """Every n-th tile, at least :data:`_SAMPLED_TILES` of them, or all."""
    return resist.tiles[:: max(1, len(resist.tiles) // _SAMPLED_TILES)]


def _block_means(size_index: NDArray[np.uint16], errors: Float32Array, side: int) -> Float32Array:
    """Mean over both axes of twice the errors in blocks of ``side`` sites; NaN without printed pillars."""
    stand = (size_index > 0) & np.isfinite(errors).all(axis=0)
    total = np.where(stand, errors.sum(axis=0), 0.0)
    edges = [np.arange(0, n, side) for n in size_index.shape]
    sums, count = (np.add.reduceat(np.add.reduceat(v, edges[0], 0), edges[1], 1) for v in (total, stand.astype(float)))
    return np.asarray(np.divide(sums, count, out=np.full(sums.shape, np.nan), where=count > 0), dtype=np.float32)


def inside(places: NDArray[np.int64], rows: slice, columns: slice) -> NDArray[np.int64]:
    """Return the places (row, column) within a tile, in their order; shapes (n, 2) and (m, 2)."""
    row, column = places.T
    within = (rows.start <= row) & (row < rows.stop) & (columns.start <= column) & (column < columns.stop)
    return np.asarray(places[within])
