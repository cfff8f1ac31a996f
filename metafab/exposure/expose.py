"""Exposure of a mask: printed sizes of every pillar, with one dose for all, corrected doses or corrected shapes."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metafab.core.arguments import require_types
from metafab.core.conventions import Float32Array, FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.exposure.correction import MOST_CLASSES, LensDoses, corrected, dose_span, quantised
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.beside import Beside
from metafab.exposure.energy.resist import ResistEnergy
from metafab.exposure.prediction import (
    BIN_NM,
    BINS,
    NO_PLACES,
    Printing,
    SizeSums,
    dose_to_size,
    predict,
)
from metafab.exposure.printing import EdgeTables, corner_radius_nm
from metafab.exposure.results import Correction, Exposure, ExposureFigures, SampledPillar, Walls
from metafab.exposure.shape import corrected_shapes, printing_of
from metafab.layout import PillarMap
from metafab.layout.outlines import RECTANGLE, Outline

#: Pillars whose energies are compared with a direct sum for the stated error, and pillars whose corners are predicted.
_CHECKED, _CORNERS = 6, 200
#: Stated over largest checked error: the worst of 1000 pillars of the 2 mm lens is 2.7 times the worst of six.
_UNCHECKED = 4.0
#: Largest change of a printed size by rounding its dose to as few classes as that allows (nm).
_ROUNDING_NM = 0.1
#: Changes of all doses at which the process window is predicted (%).
_WINDOW_PERCENT = tuple(float(k) for k in range(-10, 11, 2))


@dataclass(frozen=True)
class ExposureNumerics:
    """Numerical settings of an exposure."""

    #: Dose classes that corrected doses are rounded to; 0 keeps them continuous, "auto" takes as few as change printed
    #: sizes by 0.1 nm at most, at the mean latitude.
    classes: int | Literal["auto"] = "auto"
    most_classes: int = MOST_CLASSES  #: Largest number of classes.
    samples: int = 0  #: Number of random pillars whose figures are listed.
    seed: int = 1  #: Seed of the choice of random pillars.
    keep_sizes: bool = False  #: Whether the printed sizes of all pillars are kept.


@dataclass(frozen=True, eq=False)
class ExposedLens:
    """A lens of a wafer."""

    pillars: PillarMap  #: Drawn pillars, upright.
    beside: Beside | None = None  #: What is exposed with the lens.
    dose: float = 1.0  #: Dose of the whole lens relative to the base dose, a factor on that of each pillar.
    number: int = 1  #: Number of the lens, by which ``beside`` of other lenses refers to it.


def expose(
    pillars: PillarMap,
    psf: BeamPsf,
    *,
    outline: Outline = RECTANGLE,
    base_over_clearing_dose: float | None = None,
    contrast: float | None = None,
    correction: Correction = "none",
    numerics: ExposureNumerics = ExposureNumerics(),
    work: Work = Work(),
) -> Exposure:
    """Expose a lens that is alone on its wafer; arguments and errors as :func:`expose_lenses`."""
    (exposure,) = expose_lenses(
        (ExposedLens(pillars),),
        psf,
        outline=outline,
        base_over_clearing_dose=base_over_clearing_dose,
        contrast=contrast,
        correction=correction,
        numerics=numerics,
        work=work,
    )
    return exposure


def expose_lenses(
    lenses: Sequence[ExposedLens],
    psf: BeamPsf,
    *,
    outline: Outline = RECTANGLE,
    base_over_clearing_dose: float | None = None,
    contrast: float | None = None,
    correction: Correction = "none",
    numerics: ExposureNumerics = ExposureNumerics(),
    work: Work = Work(),
) -> tuple[Exposure, ...]:
    """Expose lenses of a wafer and predict the printed sizes.

    Args:
        lenses: lenses of equal pillars, each exposed together with the others. Lenses in their reach that are not
            listed have the same doses, site by site. Lenses with nothing in reach share one result object.
        psf: point-spread function of the beam.
        outline: outline of the drawn pillars, any but a cross or a ring.
        base_over_clearing_dose: base dose over the clearing dose of a large pad; None for the dose at which printed
            sizes equal drawn ones in the mean without correction ("dose to size"), of the first lens alone.
        contrast: contrast of the resist: half the height remains at the clearing energy, and all of it, or none,
            at a factor of 10^(1 / (2 contrast)) more, or less; None for upright walls.
        correction: "dose" finds a dose for each pillar so that it prints at size where its lens has the base dose;
            "shape" finds sizes to draw at one dose, for a single lens.
        numerics: classes; samples and kept sizes of the first lens.

    Raises:
        InputError: no pillar, a pattern that cannot be printed, shapes of several lenses, or a correction at a base
            dose at which nothing prints.
    """
    first = lenses[0]
    require_types("exposure", pillars=(first.pillars, PillarMap), psf=(psf, BeamPsf))
    if correction == "shape" and len(lenses) > 1:
        expected, remedy = "one lens, whose shapes are corrected", 'correct each alone, or use "dose"'
        raise InputError.single("exposure", "lenses", expected, f"{len(lenses)}", remedy)
    drawn, rounds = first.pillars, 0
    with work.threads() as executor:
        resist = _resist_of(first.pillars, psf, outline)
        tables, dose = EdgeTables.of(psf, resist.shapes), np.ones(resist.size_index.shape, dtype=np.float32)
        ratio = base_over_clearing_dose or dose_to_size(resist, tables, dose, executor)
        process = Printing(resist, tables, ratio, executor)
        dosed = [LensDoses(process.among(lens.beside), lens.number, dose) for lens in lenses]
        if correction == "dose":
            dosed, rounds = corrected(dosed, work.progress)
        elif correction == "shape":
            printing = partial(
                printing_of,
                wanted=first.pillars,
                psf=psf,
                outline=outline,
                beside=first.beside,
                base_over_clearing_dose=ratio,
                executor=executor,
            )
            drawn, rounds = corrected_shapes(first.pillars, printing, work.progress)
            dosed = [replace(dosed[0], process=printing(drawn))]
        keys = [(one.surroundings, lens.dose) for lens, one in zip(lenses, dosed, strict=True)]
        classes = _Classes.of(lenses, dosed, keys, numerics) if correction == "dose" and numerics.classes else None
        dosed = dosed if classes is None else classes.dosed
        found: dict[Hashable, Exposure] = {}
        error: float | None = None
        for number, (lens, one, key) in enumerate(zip(lenses, dosed, keys, strict=True)):
            if key in found:
                continue
            own = numerics if number == 0 else replace(numerics, samples=0, keep_sizes=False)
            result = _predicted(one.at(lens.dose, dosed), drawn, contrast, own, error)
            error = result.figures.error
            result = replace(result, figures=replace(result.figures, rounds=rounds))
            found[key] = result if classes is None else classes.stated(result, number, key)
    if correction != "none":
        best = min((one.figures for one in found.values()), key=lambda figures: figures.unprinted)
        best.require_printed("exposure", "base_over_clearing_dose")
    return tuple(found[key] for key in keys)


@dataclass(frozen=True, eq=False)
class _Classes:
    """Corrected doses rounded to classes."""

    dosed: list[LensDoses]  #: Lenses with the rounded doses.
    of_site: Sequence[NDArray[np.uint8]]  #: Class of each site, by lens, shape (n_y, n_x).
    dose: FloatArray  #: Shape (n,), dose of each class.
    before: dict[Hashable, SizeSums]  #: Printed sizes with continuous doses, by surroundings and dose of the lens.

    @classmethod
    def of(
        cls,
        lenses: Sequence[ExposedLens],
        dosed: list[LensDoses],
        keys: Sequence[Hashable],
        numerics: ExposureNumerics,
    ) -> _Classes:
        """Round the doses of lenses; lenses of one key print alike."""
        before: dict[Hashable, SizeSums] = {}
        for lens, one, key in zip(lenses, dosed, keys, strict=True):
            if key not in before:
                at_dose = one.at(lens.dose, dosed)
                before[key] = predict(at_dose.process, at_dose.dose, NO_PLACES).sums
        of_site, class_dose = quantised(dosed, _class_count(numerics, dosed, list(before.values())))
        distinct = {id(of): of for of in of_site}  # lenses that share their classes share one array of doses
        rounded = {key: class_dose.astype(np.float32)[of] for key, of in distinct.items()}
        in_classes = [replace(one, dose=rounded[id(of)]) for one, of in zip(dosed, of_site, strict=True)]
        return cls(in_classes, of_site, class_dose, before)

    def stated(self, result: Exposure, number: int, key: Hashable) -> Exposure:
        """Return the exposure of a lens with its classes, and its size errors with continuous doses."""
        sums = self.before[key]
        figures = replace(
            result.figures,
            classes=len(self.dose),
            continuous_rms_nm=sums.rms_nm,
            continuous_max_nm=sums.largest_nm,
        )
        return replace(result, figures=figures, dose_class=self.of_site[number], class_dose=self.dose)


def _predicted(
    lens: LensDoses, drawn: PillarMap, contrast: float | None, numerics: ExposureNumerics, error: float | None
) -> Exposure:
    """Printed sizes of a lens, with its dose in those of its pillars; the error of energies is checked if not given."""
    process, dose, ratio = lens.process, lens.dose, lens.process.base_over_clearing_dose
    places = _random_pillars(process.resist.size_index, max(numerics.samples, _CORNERS), numerics.seed)
    # Foot and top of the resist print like its middle at more and at less dose.
    factor = 1.0 if contrast is None else 10.0 ** (0.5 / contrast)
    percent = (*_WINDOW_PERCENT, 100.0 * (factor - 1.0), 100.0 * (1.0 / factor - 1.0))
    found = predict(process, dose, places, window_percent=percent, keep_sizes=numerics.keep_sizes)
    checked, listed, sums = places[:_CHECKED].tolist(), found.listed, found.sums
    if error is None:
        direct = [np.abs(listed[r, c][:3] - ratio * process.resist.direct(dose, r, c)).max() for r, c in checked]
        error = _UNCHECKED * float(max(direct))
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
        classes=1,
        latitude_nm_per_percent=sums.latitude_nm / sums.sides,
        corner_radius_nm=float(radii.mean()),
        corner_radius_rms_nm=float(radii.std()),
        base_over_clearing_dose=ratio,
        error=error,
        rounds=0,
        walls=None if contrast is None else Walls(foot.bias_nm, top.bias_nm, top.unprinted_share),
    )
    bins_nm = np.asarray(BIN_NM * (np.arange(BINS + 1) - 0.5 * BINS), dtype=np.float64)
    return Exposure(
        figures=figures,
        drawn=drawn,
        dose=dose,
        dose_class=None,
        class_dose=np.ones(1),
        samples=samples[: numerics.samples],
        cd_histogram=found.histogram.astype(np.float64),
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


def _class_count(numerics: ExposureNumerics, lenses: Sequence[LensDoses], sums: Sequence[SizeSums]) -> int:
    """Number of dose classes; with "auto", half a step from class to class changes sizes by :data:`_ROUNDING_NM`.

    The lens of the largest mean latitude decides: one at a low dose may not print at all.
    """
    if numerics.classes != "auto":
        return min(numerics.classes, numerics.most_classes)
    span_percent = 100.0 * math.log(dose_span(lenses))
    latitude_nm = max((each.latitude_nm / each.sides for each in sums if each.unprinted < each.pillars), default=0.0)
    count = math.ceil(0.5 * span_percent * latitude_nm / _ROUNDING_NM)
    return min(max(count, 2), numerics.most_classes)


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
