"""Exposure of a mask: printed sizes of every pillar, with one dose for all or with corrected doses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress
from metafab.core.parallel.work import Work
from metafab.core.storage.tables import optional
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.beside import Beside
from metafab.exposure.energy.resist import ResistEnergy, TileEnergy
from metafab.exposure.prediction import (
    BIN_NM,
    BINS,
    Printing,
    SizeMap,
    WindowPoint,
    dose_to_size,
    predict,
)
from metafab.exposure.printing import EdgeTables, corner_radius_nm
from metafab.exposure.shape import corrected_shapes, printing_of
from metafab.exposure.sums import newton_doses
from metafab.layout import PillarMap
from metafab.layout.outlines import RECTANGLE, Outline

#: Pillars whose energies are compared with a direct sum for the stated error, and pillars whose corners are predicted.
_CHECKED, _CORNERS = 6, 200
#: Stated over largest checked error: the worst of 1000 pillars of the 2 mm lens is 2.7 times the worst of six.
_UNCHECKED = 4.0
#: Largest number of rounds of Newton's method, and the rms residual (nm) below which a round is the last. A round
#: reduces the residual about tenfold.
_MOST_ROUNDS, _CONVERGED_NM = 12, 0.1
#: Bounds of a corrected dose relative to the base dose.
_DOSE_BOUNDS = (0.2, 5.0)
#: Changes of all doses at which the process window is predicted (%).
_WINDOW_PERCENT = tuple(float(k) for k in range(-10, 11, 2))

Correction = Literal["none", "dose", "shape"]


@dataclass(frozen=True)
class ExposureNumerics:
    """Numerical settings of an exposure."""

    classes: int = 64  #: Dose classes that corrected doses are rounded to; 0 keeps them continuous.
    samples: int = 0  #: Number of random pillars whose figures are listed.
    seed: int = 1  #: Seed of the choice of random pillars.
    keep_sizes: bool = False  #: Whether the printed sizes of all pillars are kept.


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
    printed_corner_radius_nm: float


@dataclass(frozen=True)
class Walls:
    """Walls of the resist by its contrast, over a sample of the pillars; other sizes are those at half the height."""

    foot_bias_nm: float  #: Mean of printed less wanted size where the height vanishes.
    top_bias_nm: float  #: Mean of printed less wanted size where the height is whole.
    low_share: float  #: Share of the pillars whose height is nowhere whole.


@dataclass(frozen=True)
class ExposureFigures:
    """Figures of an exposure."""

    pillars: int  #: Number of pillars.
    #: Rms of printed less wanted size over widths and lengths. The wanted sizes are those of the mask before
    #: correction.
    cd_error_rms_nm: float
    cd_error_max_nm: float  #: Largest magnitude of printed less wanted size.
    cd_bias_nm: float  #: Mean of printed less wanted size.
    unprinted: int  #: Pillars that do not print.
    dose_min: float  #: Smallest dose relative to the base dose.
    dose_max: float  #: Largest dose.
    classes: int  #: Number of distinct doses.
    latitude_nm_per_percent: float  #: Mean change of the printed size for 1 % of dose.
    corner_radius_nm: float  #: Mean radius of printed corners of random pillars.
    corner_radius_rms_nm: float  #: Rms deviation of the radii from their mean.
    base_over_clearing_dose: float  #: Base dose over the clearing dose of a large pad.
    #: Bound of the error of an energy over the clearing energy: four times the largest difference from a direct sum,
    #: over all pillars in reach, at six random pillars.
    error: float
    rounds: int  #: Rounds of the correction; 0 without one.
    walls: Walls | None = optional()  #: Foot and top of the resist; None without a contrast.


@dataclass(frozen=True)
class Exposure:
    """Result of an exposure."""

    figures: ExposureFigures  #: Summary.
    drawn: PillarMap  #: The pillars to draw: those of the mask, or corrected shapes.
    #: Shape (n_y, n_x) of the lattice, relative to the base dose; equal everywhere without correction.
    dose: Float32Array
    #: Shape (n_y, n_x) of the lattice, index into ``class_dose``; None for continuous or equal doses.
    dose_class: NDArray[np.uint8] | None
    class_dose: FloatArray  #: Shape (classes,), ascending, without the dose of the lens.
    samples: tuple[SampledPillar, ...]  #: Random pillars.
    cd_histogram: NDArray[np.int64]  #: Shape (n,), number of widths and lengths in each bin of ``cd_edges_nm``.
    cd_edges_nm: FloatArray  #: Shape (n + 1,), bins of printed less wanted size.
    size_map: SizeMap  #: Mean size errors over the lens.
    window: tuple[WindowPoint, ...]  #: Size errors at changed doses.
    #: Shape (2, n_y, n_x), of width and length; -inf where a pillar does not print. None unless ``keep_sizes``.
    printed_less_drawn_nm: Float32Array | None


def expose(
    pillars: PillarMap,
    psf: BeamPsf,
    *,
    outline: Outline = RECTANGLE,
    beside: Beside | None = None,
    base_over_clearing_dose: float | None = None,
    contrast: float | None = None,
    lens_dose: float = 1.0,
    correction: Correction = "none",
    numerics: ExposureNumerics = ExposureNumerics(),
    work: Work = Work(),
) -> Exposure:
    """Expose a mask and predict the printed sizes.

    Args:
        pillars: drawn pillars, upright.
        psf: point-spread function of the beam.
        outline: outline of the drawn pillars, any but a cross or a ring.
        beside: what is exposed with the lens. Other lenses receive its corrected doses and shapes too.
        base_over_clearing_dose: base dose over the clearing dose of a large pad; None for the dose at which printed
            sizes equal drawn ones in the mean without correction ("dose to size"), of the lens alone.
        contrast: contrast of the resist: half the height remains at the clearing energy, and all of it, or none,
            at a factor of 10^(1 / (2 contrast)) more, or less; None for upright walls.
        lens_dose: dose of the whole lens relative to the base dose, on top of that of each pillar.
        correction: "dose" finds a dose for each pillar so that it prints at size; "shape" finds sizes to draw at one
            dose.
        numerics: classes and samples.

    Raises:
        InputError: no pillar, or a pattern that cannot be printed.
    """
    resist = _resist_of(pillars, psf, outline)
    tables = EdgeTables.of(psf, resist.shapes)
    dose = np.ones(resist.size_index.shape, dtype=np.float32)
    drawn, rounds, dose_class, class_dose = pillars, 0, None, np.ones(1)
    with work.threads() as executor:
        ratio = (
            dose_to_size(resist, tables, dose, executor) if base_over_clearing_dose is None else base_over_clearing_dose
        )
        resist = resist.among(beside)
        process = Printing(resist, tables, ratio, executor)
        if correction == "dose":
            dose, rounds = _corrected(process, dose, work.progress)
            if numerics.classes:
                dose_class, class_dose = _quantised(resist, dose, numerics.classes)
                dose = class_dose.astype(np.float32)[dose_class]
        elif correction == "shape":
            drawn, rounds = corrected_shapes(pillars, psf, outline, beside, ratio, executor, work.progress)
            process = printing_of(drawn, pillars, psf, outline, beside, ratio, executor)
        if lens_dose != 1.0:
            dose *= np.float32(lens_dose)
            dosed = process.resist.beside and replace(process.resist.beside, lens_dose=lens_dose)
            process = replace(process, resist=process.resist.among(dosed))
        places = _random_pillars(resist.size_index, max(numerics.samples, _CORNERS), numerics.seed)
        # Foot and top of the resist print like its middle at more and at less dose.
        factor = 1.0 if contrast is None else 10.0 ** (0.5 / contrast)
        percent = (*_WINDOW_PERCENT, 100.0 * (factor - 1.0), 100.0 * (1.0 / factor - 1.0))
        found = predict(process, dose, places, window_percent=percent, keep_sizes=numerics.keep_sizes)
    checked, listed, sums = places[:_CHECKED].tolist(), found.listed, found.sums
    largest = max(float(np.abs(listed[r, c][:3] - ratio * process.resist.direct(dose, r, c)).max()) for r, c in checked)
    samples = _samples(process, drawn, dose, [((row, column), listed[row, column]) for row, column in places.tolist()])
    radii = np.array([sample.printed_corner_radius_nm for sample in samples])
    radii = radii[np.isfinite(radii)] if np.isfinite(radii).any() else np.full(1, math.nan)
    *window, foot, top = found.window
    figures = ExposureFigures(
        pillars=sums.pillars,
        cd_error_rms_nm=sums.rms_nm,
        cd_error_max_nm=sums.largest_nm,
        cd_bias_nm=sums.bias_nm,
        unprinted=sums.unprinted,
        dose_min=sums.dose_min,
        dose_max=sums.dose_max,
        classes=len(class_dose),
        latitude_nm_per_percent=sums.latitude_nm / sums.sides,
        corner_radius_nm=float(radii.mean()),
        corner_radius_rms_nm=float(radii.std()),
        base_over_clearing_dose=ratio,
        error=_UNCHECKED * largest,
        rounds=rounds,
        walls=None if contrast is None else Walls(foot.bias_nm, top.bias_nm, top.unprinted_share),
    )
    bins_nm = np.asarray(BIN_NM * (np.arange(BINS + 1) - 0.5 * BINS), dtype=np.float64)
    return Exposure(
        figures=figures,
        drawn=drawn,
        dose=dose,
        dose_class=dose_class,
        class_dose=class_dose,
        samples=samples[: numerics.samples],
        cd_histogram=found.histogram,
        cd_edges_nm=bins_nm,
        size_map=found.size_map,
        window=tuple(window),
        printed_less_drawn_nm=found.printed_less_drawn_nm,
    )


def base_dose_to_size(pillars: PillarMap, psf: BeamPsf, outline: Outline, work: Work = Work()) -> float:
    """Return the base over clearing dose at which printed sizes equal drawn ones in the mean; errors as ``expose``."""
    resist = _resist_of(pillars, psf, outline)
    dose = np.ones(resist.size_index.shape, dtype=np.float32)
    with work.threads() as executor:
        return dose_to_size(resist, EdgeTables.of(psf, resist.shapes), dose, executor)


def _resist_of(pillars: PillarMap, psf: BeamPsf, outline: Outline) -> ResistEnergy:
    resist = ResistEnergy(pillars, psf, outline)
    if not resist.tiles:
        raise InputError.single("exposure", "pillars", "at least one pillar", "none")
    return resist


def _corrected(process: Printing, dose: Float32Array, progress: Progress) -> tuple[Float32Array, int]:
    """Find the doses at which the mean size error of each pillar's width and length vanishes, by Newton's method.

    The derivative assumes that the doses of neighbours change by the same factor. Returns doses, shape (n_y, n_x), and
    the number of rounds.
    """
    tables = process.tables
    for number in range(1, _MOST_ROUNDS + 1):
        new = np.ones_like(dose)

        def update(tile: TileEnergy, new: Float32Array = new) -> FloatArray:
            place = new[tile.rows, tile.columns]
            edges = (tile.others, tables.at_edge, tables.slope_per_nm)
            return np.array(
                newton_doses(tile.size_index, tile.dose, *edges, process.base_over_clearing_dose, _DOSE_BOUNDS, place)
            )

        parts = [found for _, found in process.resist.map_tiles(dose, process.executor, update)]
        square, count = np.sum(parts, axis=0)
        dose = new
        progress("correction", number, _MOST_ROUNDS)
        if math.sqrt(square / max(count, 1.0)) < _CONVERGED_NM:
            break
    return dose, number


def _quantised(resist: ResistEnergy, dose: Float32Array, classes: int) -> tuple[NDArray[np.uint8], FloatArray]:
    """Divide the doses into classes by equal steps of their logarithm; the dose of a class is the mean of its members.

    Returns the class of each site, shape (n_y, n_x), and the dose of each class, shape (classes,).
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


def _samples(
    process: Printing, drawn: PillarMap, dose: Float32Array, listed: Sequence[tuple[tuple[int, int], FloatArray]]
) -> tuple[SampledPillar, ...]:
    """Figures of listed pillars: place and values of :class:`metafab.exposure.prediction.Prediction` of each."""
    x_um, y_um = drawn.lattice.x_um(), drawn.lattice.y_um()
    rows, columns = np.array([place for place, _ in listed]).T
    values = np.array([row for _, row in listed])
    shapes, doses = (
        process.resist.shapes.some(process.resist.size_index[rows, columns]),
        dose[rows, columns].astype(float),
    )
    ratio, moved = process.base_over_clearing_dose, 0.5 * values[:, 3:]
    own = process.tables.at_edge[:, process.resist.size_index[rows, columns]].T * doses[:, None]
    others = (values[:, 1:3] / ratio - own).mean(axis=1)
    with np.errstate(invalid="ignore"):
        radius = corner_radius_nm(process.resist.psf, shapes, doses, others, moved, 1.0 / ratio)
    printed = np.maximum(0.0, shapes.size_nm + values[:, 3:])
    columns_ = (x_um[columns], y_um[rows], *shapes.size_nm.T, doses, *values[:, :3].T, *printed.T, radius)
    return tuple(SampledPillar(*row) for row in np.stack(columns_, axis=1).tolist())
