"""Exposure of a mask: printed sizes of every pillar, with one dose for all or with corrected doses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.exposure.beam import BeamPsf
from metafab.exposure.printing import EdgeTables, add_edge_displacements
from metafab.exposure.resist import ResistEnergy, TileEnergy
from metafab.exposure.sums import dose_to_size_sums, newton_doses, size_statistics
from metafab.layout import PillarMap

Float32Array = NDArray[np.float32]

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
    if not resist.tiles():
        raise InputError.single("exposure", "pillars", "at least one pillar", "none")
    tables = EdgeTables.of(psf, resist.size_nm)
    dose = np.ones(resist.size_index.shape, dtype=np.float32)
    rounds = 0
    with work.threads() as executor:
        ratio = (
            _dose_to_size(resist, tables, dose, executor)
            if base_over_clearing_dose is None
            else base_over_clearing_dose
        )
        if correct:
            dose, rounds = _corrected(resist, tables, dose, ratio, executor, work)
        dose_class, class_dose = None, np.ones(1)
        if correct and numerics.classes:
            dose_class, class_dose = _quantised(resist, dose, numerics.classes)
            dose = class_dose.astype(np.float32)[dose_class]
        return _printed(resist, tables, dose, dose_class, class_dose, ratio, rounds, numerics, executor, pillars)


def _dose_to_size(resist: ResistEnergy, tables: EdgeTables, dose: Float32Array, executor: Executor) -> float:
    """Base over clearing dose for a mean linear size error of zero at dose 1, from a part of the tiles."""

    def sums(tile: TileEnergy) -> FloatArray:
        return np.array(dose_to_size_sums(tile.size_index, tile.dose, tile.others, tables.at_edge, tables.slope_per_nm))

    tiles = resist.tiles()
    every = max(1, len(tiles) // _SAMPLED_TILES)
    energy, count = np.sum([found for _, found in resist.map_tiles(dose, executor, sums, tiles[::every])], axis=0)
    return float(count / energy)


def _corrected(
    resist: ResistEnergy, tables: EdgeTables, dose: Float32Array, ratio: float, executor: Executor, work: Work
) -> tuple[Float32Array, int]:
    """Find the doses at which the mean size error of each pillar's width and length vanishes, by Newton's method.

    The derivative assumes that the doses of neighbours change by the same factor.

    Returns:
        Doses, shape (n_y, n_x), and the number of rounds.
    """
    for number in range(1, _MOST_ROUNDS + 1):
        new = np.ones_like(dose)

        def update(tile: TileEnergy, new: Float32Array = new) -> FloatArray:
            place = new[tile.rows, tile.columns]
            edges = (tile.others, tables.at_edge, tables.slope_per_nm)
            return np.array(newton_doses(tile.size_index, tile.dose, *edges, ratio, _DOSE_BOUNDS, place))

        square, count = np.sum([found for _, found in resist.map_tiles(dose, executor, update)], axis=0)
        dose = new
        work.progress("correction", number, _MOST_ROUNDS)
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
    parts = [np.log(dose[block][resist.size_index[block] > 0]) for block in resist.tiles()]
    low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
    step = max(high - low, 1e-6) / classes
    dose_class = np.zeros(dose.shape, dtype=np.uint8)
    total, count = np.zeros(classes), np.zeros(classes)
    for block in resist.tiles():
        stand = resist.size_index[block] > 0
        values = dose[block][stand]
        number = np.minimum(((np.log(values) - low) / step).astype(np.int64), classes - 1)
        dose_class[block][stand] = number
        total += np.bincount(number, values, classes)
        count += np.bincount(number, minlength=classes)
    middle = np.exp(low + step * (np.arange(classes) + 0.5))
    return dose_class, np.where(count > 0, total / np.maximum(count, 1.0), middle)


def _printed(
    resist: ResistEnergy,
    tables: EdgeTables,
    dose: Float32Array,
    dose_class: NDArray[np.uint8] | None,
    class_dose: FloatArray,
    ratio: float,
    rounds: int,
    numerics: ExposureNumerics,
    executor: Executor,
    pillars: PillarMap,
) -> Exposure:
    """Predict the printed sizes at doses of shape (n_y, n_x)."""
    histogram = np.zeros(_BINS, dtype=np.int64)
    wanted = _random_pillars(resist, numerics.samples + _CHECKED, numerics.seed)
    found: dict[tuple[int, int], FloatArray] = {}
    edges = (tables.displacement_nm, tables.energy)

    def printed(tile: TileEnergy) -> FloatArray:
        moved = np.zeros_like(tile.others)
        add_edge_displacements(tile.size_index, tile.dose, tile.others, 1.0 / ratio, *edges, moved)
        counts = np.zeros(_BINS, dtype=np.int64)
        sums = size_statistics(tile.size_index, tile.dose, tables.slope_per_nm, moved, ratio, _BIN_NM, counts)
        for row, column in _inside(wanted, tile):
            y, x = row - tile.rows.start, column - tile.columns.start
            at_edges = tables.at_edge[:, tile.size_index[y, x]] * tile.dose[y, x] + tile.others[:, y, x]
            found[row, column] = np.concatenate([[ratio * tile.centre[y, x]], ratio * at_edges, 2.0 * moved[:, y, x]])
        return np.concatenate([sums, counts])

    parts = [result for _, result in resist.map_tiles(dose, executor, printed)]
    sums = np.sum(parts, axis=0)
    histogram += sums[8:].astype(np.int64)
    count, unprinted, total, square, _, latitude = sums[:6]
    largest, largest_dose = (max(part[k] for part in parts) for k in (4, 7))
    smallest_dose = min(part[6] for part in parts)
    sides = max(1.0, 2.0 * (count - unprinted))
    checked = wanted[:_CHECKED]
    error = max(float(np.max(np.abs(found[p][:3] - ratio * resist.direct(dose, *p)))) for p in checked)
    figures = ExposureFigures(
        pillars=int(count),
        cd_error_rms_nm=math.sqrt(square / sides),
        cd_error_max_nm=float(largest),
        cd_bias_nm=total / sides,
        unprinted=int(unprinted),
        dose_min=float(smallest_dose),
        dose_max=float(largest_dose),
        classes=1 if dose_class is None and rounds == 0 else len(class_dose),
        latitude_nm_per_percent=latitude / sides,
        base_over_clearing_dose=ratio,
        error=error,
        rounds=rounds,
    )
    samples = tuple(_sample(resist, dose, pillars, place, found[place]) for place in wanted[_CHECKED:])
    bins_nm = np.asarray(_BIN_NM * (np.arange(_BINS + 1) - 0.5 * _BINS), dtype=np.float64)
    return Exposure(figures, dose, dose_class, class_dose, samples, histogram, bins_nm)


def _random_pillars(resist: ResistEnergy, count: int, seed: int) -> list[tuple[int, int]]:
    """Distinct random sites with a pillar, as (row, column); fewer if there are fewer pillars."""
    rng = np.random.default_rng(seed)
    index = resist.size_index
    if np.count_nonzero(index[: 1 << 10, : 1 << 10]) == np.count_nonzero(index) <= 4 * count:
        places = np.argwhere(index > 0)
        return [(int(r), int(c)) for r, c in rng.permutation(places)[:count]]
    chosen: dict[tuple[int, int], None] = {}
    while len(chosen) < count:
        row, column = (int(rng.integers(n)) for n in index.shape)
        if index[row, column]:
            chosen[row, column] = None
    return list(chosen)


def _inside(places: list[tuple[int, int]], tile: TileEnergy) -> Iterator[tuple[int, int]]:
    for row, column in places:
        if tile.rows.start <= row < tile.rows.stop and tile.columns.start <= column < tile.columns.stop:
            yield row, column


def _sample(
    resist: ResistEnergy, dose: Float32Array, pillars: PillarMap, place: tuple[int, int], values: FloatArray
) -> SampledPillar:
    row, column = place
    width, length = (float(side) for side in resist.size_nm[resist.size_index[place]])
    centre, edge_x, edge_y, wider, longer = (float(value) for value in values)
    return SampledPillar(
        x_um=float(pillars.lattice.x_um()[column]),
        y_um=float(pillars.lattice.y_um()[row]),
        width_nm=width,
        length_nm=length,
        dose=float(dose[place]),
        energy_centre=centre,
        energy_edge_x=edge_x,
        energy_edge_y=edge_y,
        printed_width_nm=max(0.0, width + wider),
        printed_length_nm=max(0.0, length + longer),
    )
