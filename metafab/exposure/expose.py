"""Exposure of a mask: printed sizes of every pillar, with one dose for all or with corrected doses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress
from metafab.core.parallel.work import Work
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.resist import ResistEnergy, TileEnergy
from metafab.exposure.printing import EdgeTables, add_edge_displacements
from metafab.exposure.sums import dose_to_size_sums, newton_doses, size_statistics
from metafab.layout import PillarMap

#: Pillars whose energies are compared with a direct sum for the stated error.
_CHECKED = 6
#: Largest number of rounds of Newton's method, and the rms residual (nm) below which a round is the last. A round
#: reduces the residual about tenfold.
_MOST_ROUNDS, _CONVERGED_NM = 12, 0.1
#: Bounds of a corrected dose relative to the base dose.
_DOSE_BOUNDS = (0.2, 5.0)
#: Tiles from which the dose to size is found.
_SAMPLED_TILES = 16
#: Bins of the histogram of size errors, and their width (nm).
_BINS, _BIN_NM = 1200, 0.05


@dataclass(frozen=True)
class ExposureNumerics:
    """Numerical settings of an exposure.

    Attributes:
        classes: dose classes that corrected doses are rounded to; 0 keeps them continuous.
        samples: number of random pillars whose figures are listed.
        seed: seed of the choice of random pillars.
    """

    classes: int = 64
    samples: int = 0
    seed: int = 1


@dataclass(frozen=True)
class SampledPillar:
    """Figures of one pillar; doses relative to the base dose, energies to the clearing energy.

    Energies at edges are the mean over both edges.
    """

    x_um: float
    y_um: float
    width_nm: float
    length_nm: float
    dose: float
    energy_centre: float
    energy_edge_x: float
    energy_edge_y: float
    printed_width_nm: float
    printed_length_nm: float


@dataclass(frozen=True)
class ExposureFigures:
    """Figures of an exposure.

    Attributes:
        pillars: number of pillars.
        cd_error_rms_nm: rms of printed less drawn size over widths and lengths.
        cd_error_max_nm: largest magnitude of printed less drawn size.
        cd_bias_nm: mean of printed less drawn size.
        unprinted: pillars that do not print.
        dose_min: smallest dose relative to the base dose.
        dose_max: largest dose.
        classes: number of distinct doses.
        latitude_nm_per_percent: mean change of the printed size for 1 % of dose.
        base_over_clearing_dose: base dose over the clearing dose of a large pad.
        error: largest difference of an energy from a direct sum over all pillars in reach, at random pillars, over
            the clearing energy.
        rounds: rounds of Newton's method; 0 without correction.
    """

    pillars: int
    cd_error_rms_nm: float
    cd_error_max_nm: float
    cd_bias_nm: float
    unprinted: int
    dose_min: float
    dose_max: float
    classes: int
    latitude_nm_per_percent: float
    base_over_clearing_dose: float
    error: float
    rounds: int


@dataclass(frozen=True)
class Exposure:
    """Result of an exposure.

    Attributes:
        figures: summary.
        dose: shape (n_y, n_x) of the lattice, relative to the base dose; 1 everywhere without correction.
        dose_class: shape (n_y, n_x) of the lattice, index into ``class_dose``; None for continuous or equal doses.
        class_dose: shape (classes,), ascending.
        samples: random pillars.
        cd_histogram: shape (n,), number of widths and lengths in each bin of ``cd_edges_nm``.
        cd_edges_nm: shape (n + 1,), bins of printed less drawn size.
    """

    figures: ExposureFigures
    dose: Float32Array
    dose_class: NDArray[np.uint8] | None
    class_dose: FloatArray
    samples: tuple[SampledPillar, ...]
    cd_histogram: NDArray[np.int64]
    cd_edges_nm: FloatArray


def expose(
    pillars: PillarMap,
    psf: BeamPsf,
    *,
    base_over_clearing_dose: float | None = None,
    correct: bool = False,
    numerics: ExposureNumerics = ExposureNumerics(),
    work: Work = Work(),
) -> Exposure:
    """Expose a mask and predict the printed sizes.

    Args:
        pillars: drawn rectangles on a rectangular lattice.
        psf: point-spread function of the beam.
        base_over_clearing_dose: base dose over the clearing dose of a large pad; None for the dose at which printed
            sizes equal drawn ones in the mean without correction ("dose to size").
        correct: whether doses are corrected so that each pillar prints at size.
        numerics: classes and samples.
        work: threads and progress.

    Raises:
        InputError: a hexagonal lattice, no pillar, or a pattern that cannot be printed.
    """
    resist = ResistEnergy(pillars, psf)
    if not resist.tiles:
        raise InputError.single("exposure", "pillars", "at least one pillar", "none")
    tables = EdgeTables.of(psf, resist.size_nm)
    dose = np.ones(resist.size_index.shape, dtype=np.float32)
    rounds, dose_class, class_dose = 0, None, np.ones(1)
    with work.threads() as executor:
        ratio = (
            _dose_to_size(resist, tables, dose, executor)
            if base_over_clearing_dose is None
            else base_over_clearing_dose
        )
        process = _Process(resist, tables, ratio, executor)
        if correct:
            dose, rounds = _corrected(process, dose, work.progress)
            if numerics.classes:
                dose_class, class_dose = _quantised(resist, dose, numerics.classes)
                dose = class_dose.astype(np.float32)[dose_class]
        places = _random_pillars(resist.size_index, max(numerics.samples, _CHECKED), numerics.seed)
        sums, histogram, listed = _printed(process, dose, places)
    checked = places[:_CHECKED].tolist()
    error = max(float(np.abs(listed[r, c][:3] - ratio * resist.direct(dose, r, c)).max()) for r, c in checked)
    sides = max(1.0, 2.0 * (sums.pillars - sums.unprinted))
    figures = ExposureFigures(
        pillars=sums.pillars,
        cd_error_rms_nm=math.sqrt(sums.square_nm2 / sides),
        cd_error_max_nm=sums.largest_nm,
        cd_bias_nm=sums.total_nm / sides,
        unprinted=sums.unprinted,
        dose_min=sums.dose_min,
        dose_max=sums.dose_max,
        classes=len(class_dose),
        latitude_nm_per_percent=sums.latitude_nm / sides,
        base_over_clearing_dose=ratio,
        error=error,
        rounds=rounds,
    )
    wanted = [(row, column) for row, column in places[: numerics.samples].tolist()]
    samples = _samples(pillars, dose, [(place, listed[place]) for place in wanted])
    bins_nm = np.asarray(_BIN_NM * (np.arange(_BINS + 1) - 0.5 * _BINS), dtype=np.float64)
    return Exposure(figures, dose, dose_class, class_dose, samples, histogram, bins_nm)


@dataclass(frozen=True)
class _Process:
    """A pattern, its tables of edges, and the base dose over the clearing dose; tiles run in ``executor``."""

    resist: ResistEnergy
    tables: EdgeTables
    ratio: float
    executor: Executor


def _dose_to_size(resist: ResistEnergy, tables: EdgeTables, dose: Float32Array, executor: Executor) -> float:
    """Base over clearing dose for a mean linear size error of zero at dose 1, from a part of the tiles."""

    def sums(tile: TileEnergy) -> FloatArray:
        return np.array(dose_to_size_sums(tile.size_index, tile.dose, tile.others, tables.at_edge, tables.slope_per_nm))

    every = max(1, len(resist.tiles) // _SAMPLED_TILES)
    parts = [found for _, found in resist.map_tiles(dose, executor, sums, resist.tiles[::every])]
    energy, count = np.sum(parts, axis=0)
    return float(count / energy)


def _corrected(process: _Process, dose: Float32Array, progress: Progress) -> tuple[Float32Array, int]:
    """Find the doses at which the mean size error of each pillar's width and length vanishes, by Newton's method.

    The derivative assumes that the doses of neighbours change by the same factor.

    Returns:
        Doses, shape (n_y, n_x), and the number of rounds.
    """
    tables = process.tables
    for number in range(1, _MOST_ROUNDS + 1):
        new = np.ones_like(dose)

        def update(tile: TileEnergy, new: Float32Array = new) -> FloatArray:
            place = new[tile.rows, tile.columns]
            edges = (tile.others, tables.at_edge, tables.slope_per_nm)
            return np.array(newton_doses(tile.size_index, tile.dose, *edges, process.ratio, _DOSE_BOUNDS, place))

        parts = [found for _, found in process.resist.map_tiles(dose, process.executor, update)]
        square, count = np.sum(parts, axis=0)
        dose = new
        progress("correction", number, _MOST_ROUNDS)
        if math.sqrt(square / max(count, 1.0)) < _CONVERGED_NM:
            break
    return dose, number


def _quantised(resist: ResistEnergy, dose: Float32Array, classes: int) -> tuple[NDArray[np.uint8], FloatArray]:
    """Divide the doses into classes by equal steps of their logarithm; the dose of a class is the mean of its members.

    Returns:
        Class of each site, shape (n_y, n_x), and dose of each class, shape (classes,).
    """
    if not 2 <= classes <= 256:
        raise InputError.single("exposure", "classes", "2 to 256", str(classes))
    parts = [np.log(dose[block][resist.size_index[block] > 0]) for block in resist.tiles]
    low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
    step = max(high - low, 1e-6) / classes
    dose_class = np.zeros(dose.shape, dtype=np.uint8)
    total, count = np.zeros(classes), np.zeros(classes)
    for block, logarithm in zip(resist.tiles, parts, strict=True):
        stand = resist.size_index[block] > 0
        number = np.minimum(((logarithm - low) / step).astype(np.int64), classes - 1)
        dose_class[block][stand] = number
        total += np.bincount(number, dose[block][stand], classes)
        count += np.bincount(number, minlength=classes)
    middle = np.exp(low + step * (np.arange(classes) + 0.5))
    return dose_class, np.where(count > 0, total / np.maximum(count, 1.0), middle)


@dataclass(frozen=True)
class _SizeSums:
    """Sums over all pillars of :func:`metafab.exposure.sums.size_statistics`."""

    pillars: int
    unprinted: int
    total_nm: float
    square_nm2: float
    largest_nm: float
    latitude_nm: float
    dose_min: float
    dose_max: float

    @classmethod
    def of(cls, parts: FloatArray) -> _SizeSums:
        """Add up the results of tiles, shape (n_tiles, 8)."""
        added, least, most = parts.sum(axis=0), parts.min(axis=0), parts.max(axis=0)
        pillars, unprinted, total, square, _, latitude, *_ = added.tolist()
        return cls(
            int(pillars), int(unprinted), total, square, float(most[4]), latitude, float(least[6]), float(most[7])
        )


def _printed(
    process: _Process, dose: Float32Array, places: NDArray[np.int64]
) -> tuple[_SizeSums, NDArray[np.int64], dict[tuple[int, int], FloatArray]]:
    """Predict the printed sizes.

    Args:
        process: the pattern.
        dose: shape (n_y, n_x).
        places: shape (n, 2), rows and columns of listed pillars.

    Returns:
        Sums over all pillars; the histogram of size errors, shape (n_bins,); and for each listed pillar, shape (5,):
        energy at the centre, the x and the y edges over the clearing energy, and printed less drawn width and length.
    """
    tables, ratio = process.tables, process.ratio

    def printed(tile: TileEnergy) -> FloatArray:
        moved = np.zeros_like(tile.others)
        edges = (tables.displacement_nm, tables.energy)
        add_edge_displacements(tile.size_index, tile.dose, tile.others, 1.0 / ratio, *edges, moved)
        counts = np.zeros(_BINS, dtype=np.int64)
        sums = size_statistics(tile.size_index, tile.dose, tables.slope_per_nm, moved, ratio, _BIN_NM, counts)
        y, x = (_inside(places, tile.rows, tile.columns) - (tile.rows.start, tile.columns.start)).T
        at_edges = tables.at_edge[:, tile.size_index[y, x]] * tile.dose[y, x] + tile.others[:, y, x]
        rows = np.concatenate([ratio * tile.centre[None, y, x], ratio * at_edges, 2.0 * moved[:, y, x]])
        return np.concatenate([sums, counts, rows.T.ravel()])

    parts, counts = [], np.zeros(_BINS, dtype=np.int64)
    listed: dict[tuple[int, int], FloatArray] = {}
    for block, result in process.resist.map_tiles(dose, process.executor, printed):
        statistics, bins, rows = np.split(result, [8, 8 + _BINS])
        parts.append(statistics)
        counts += bins.astype(np.int64)
        inside = _inside(places, *block).tolist()
        listed.update(zip(map(tuple, inside), rows.reshape(-1, 5), strict=True))
    return _SizeSums.of(np.array(parts)), counts, listed


def _random_pillars(size_index: NDArray[np.uint16], count: int, seed: int) -> NDArray[np.int64]:
    """Draw distinct pillars: (row, column) of each, shape (n, 2), n at most the number of pillars."""
    in_row = np.count_nonzero(size_index, axis=1)
    upto = np.cumsum(in_row)
    total = int(upto[-1])
    rank = np.random.default_rng(seed).choice(total, min(count, total), replace=False)
    rows = np.searchsorted(upto, rank, side="right")
    within = rank - (upto - in_row)[rows]
    columns = np.empty_like(rows)
    for row in np.unique(rows):
        here = rows == row
        columns[here] = np.flatnonzero(size_index[row])[within[here]]
    return np.stack([rows, columns], axis=1)


def _inside(places: NDArray[np.int64], rows: slice, columns: slice) -> NDArray[np.int64]:
    """The places within a tile, shape (n, 2), in their order."""
    row, column = places.T
    within = (rows.start <= row) & (row < rows.stop) & (columns.start <= column) & (column < columns.stop)
    return np.asarray(places[within])


def _samples(
    pillars: PillarMap, dose: Float32Array, listed: Sequence[tuple[tuple[int, int], FloatArray]]
) -> tuple[SampledPillar, ...]:
    """Figures of listed pillars: place and values of :func:`_printed` of each."""
    x_um, y_um, sizes_nm = pillars.lattice.x_um(), pillars.lattice.y_um(), pillars.size_nm()
    index = pillars.to_array()
    samples = []
    for (row, column), values in listed:
        width, length = (float(side) for side in sizes_nm[index[row, column]])
        centre, edge_x, edge_y, wider, longer = (float(value) for value in values)
        samples.append(
            SampledPillar(
                x_um=float(x_um[column]),
                y_um=float(y_um[row]),
                width_nm=width,
                length_nm=length,
                dose=float(dose[row, column]),
                energy_centre=centre,
                energy_edge_x=edge_x,
                energy_edge_y=edge_y,
                printed_width_nm=max(0.0, width + wider),
                printed_length_nm=max(0.0, length + longer),
            )
        )
    return tuple(samples)
