"""Summary of a run: figures of all steps, error budget, ledger of work left out, and their file ``summary.json``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from metafab.core.figures import OrdersFigures, PhaseFigures, ToleranceTable
from metafab.core.storage.files import plain, write_json
from metafab.core.storage.tables import DAMAGED, optional, typed
from metafab.spec import Design
from metafab.steps.exposure import PrintedFigures
from metafab.steps.images import CaptureFigures, DecodeFigures
from metafab.steps.layout import DrcFigures, LayoutFigures
from metafab.steps.library import LibraryFigures
from metafab.steps.optics import PsfFigures
from metafab.steps.optics.lights import LightsFigures
from metafab.steps.optics.merit import MeritFigures
from metafab.steps.orders import CouplingFigures
from metafab.steps.phase import StudyFigures

#: The file of the summary. It and the hidden ``.rerun.json`` hold times: equal designs give equal bytes in all others.
SUMMARY_FILE = "summary.json"
#: Reason for skipping a step that is up to date.
UNCHANGED = "its inputs and its files are unchanged"


@dataclass(frozen=True)
class BudgetLine:
    """One source of error."""

    source: str  #: Name of the source.
    value: float | None  #: The error; None where this run did not measure it.
    unit: str  #: Unit of the error.
    how: str  #: Method of the measurement.


@dataclass(frozen=True)
class SkippedStep:
    """A step that was not run."""

    step: str  #: Its name.
    why: str  #: The reason.
    #: Time of the step when it ran last; None for a step that the design does not need.
    saved_s: float | None = optional()


@dataclass(frozen=True)
class Saving:
    """Work that a step left out."""

    step: str  #: Name of the step.
    what: str  #: The pieces of work.
    computed: int  #: Number of pieces that were computed.
    of: int | None  #: Number of pieces without the saving; None for a continuous range.
    why: str  #: Reason for which the others need not be computed.
    error: float | None = optional()  #: Measured error of leaving them out; None where it is not measured.
    error_of: str | None = optional()  #: Quantity of that error; None where nothing is lost.


@dataclass(frozen=True)
class RunSummary:
    """Figures of all steps of a run, as in ``summary.json``."""

    name: str = ""  #: Name of the design.
    #: Figures of the step of that name, None where the design does not need it; likewise to ``decode``.
    library: LibraryFigures | None = None
    phase: PhaseFigures | None = None
    study: StudyFigures | None = None
    layout: LayoutFigures | None = None
    drc: DrcFigures | None = None
    exposure: PrintedFigures | None = None
    psf: PsfFigures | None = None
    orders: OrdersFigures | None = None
    merit: MeritFigures | None = None
    lights: LightsFigures | None = None
    tolerance: ToleranceTable | None = None
    capture: CaptureFigures | None = None
    decode: DecodeFigures | None = None
    seconds: dict[str, float] = field(default_factory=dict)  #: Time of each step when it ran.
    peak_rss_mb: dict[str, float] = field(default_factory=dict)  #: Peak memory of each step when it ran.
    skipped: tuple[SkippedStep, ...] = ()  #: Steps that this run skipped.
    saved: tuple[Saving, ...] = ()  #: Work that the steps left out, in the order of the pipeline.
    versions: dict[str, str] = field(default_factory=dict)  #: Versions of metafab, Python and the libraries.
    #: Figures of the rows that ``metafab coupling`` or the step ``orders`` solved for this mask; None without any.
    coupling: CouplingFigures | None = None
    error_budget: tuple[BudgetLine, ...] = ()  #: Sources of error, in the order of the pipeline.
    #: Time of the last change of each file when its step had written it, by its name in ``steps.json``.
    modified_ns: dict[str, int] = field(default_factory=dict)

    @property
    def violations(self) -> int:
        """Number of violations of all design rules."""
        return 0 if self.drc is None else sum(self.drc.violations.values())

    @property
    def picture(self) -> tuple[float, str] | None:
        """Share of the light in a hologram's picture and its place in words: the written mask's, else the target's."""
        if self.merit is not None and self.merit.picture_efficiency is not None:
            return self.merit.picture_efficiency, "in the picture"
        share = None if self.phase is None else self.phase.hologram_efficiency
        return None if share is None else (share, "in the picture, by the target phases")

    def table(self) -> dict[str, Any]:
        """Content of ``summary.json``; a step that was not needed has an empty table."""
        table = {name: {} if figures is None else figures for name, figures in vars(self).items()}
        if self.coupling is None:
            del table["coupling"]
        return dict(plain(table))

    def save(self, path: Path) -> None:
        """Write ``summary.json``."""
        write_json(path, self.table())

    @classmethod
    def load(cls, path: Path) -> RunSummary:
        """Read ``summary.json``; figures that an older version wrote in another form are left out.

        ValueError if the file does not hold one JSON object.
        """
        table = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(table, dict):
            raise ValueError("expected one JSON object")
        known: dict[str, Any] = {}
        for name in (item.name for item in fields(cls) if table.get(item.name)):
            try:
                known[name] = getattr(typed(cls, {name: table[name]}), name)
            except DAMAGED:
                continue
        return cls(**known)


#: Sources of error that only images have.
_OF_IMAGES = {"depth interpolation", "field interpolation", "oblique light", "decoder"}
#: Sources of error that only pillars have.
_OF_PILLARS = {
    "solver and library",
    "size snapping and finite library",
    "index of the pillar",
    "local-period approximation",
    "model of unlike neighbours",
    "joint effect of rows and columns",
    "oblique light",
}


def _errors_of_mask(library: LibraryFigures | None, layout: LayoutFigures | None) -> tuple[float | None, float | None]:
    """Library error and phase error of a mask's pillars, each in the worst light.

    The library error is that of all sizes where the layout does not state it.
    """
    largest = None if library is None or math.isnan(library.max_error) else library.max_error
    if layout is None:
        return largest, None
    lights = [light.figures for light in layout.lights or ()] or [layout]
    errors = [each.library_error for each in lights if each.library_error is not None]
    return max(errors, default=largest), max(each.phase_rms_error_rad for each in lights)


def _neighbour_lines(summary: RunSummary) -> list[BudgetLine]:
    """Error of the light of unlike neighbours: of the model if the PSFs used it, else of the approximation."""
    psf, coupling = summary.psf, summary.coupling
    if psf is not None and psf.with_neighbours and summary.library is not None:
        statistics = summary.library.neighbours
        return [
            BudgetLine(
                "model of unlike neighbours",
                None if statistics is None else statistics.error_alike,
                "relative L2",
                "field of held-out rows whose phases change steadily, by the library's model against the solver",
            ),
            BudgetLine(
                "joint effect of rows and columns",
                psf.joint_error,
                "relative L2",
                "the PSFs leave it out, and it is not solved for these pillars"
                if psf.joint_error is None
                else "left out of the PSFs: what coarse elements add to the field in up to eight windows of 3 x 3 "
                "pillars of the mask, continued periodically, cross-polarised light included; few hold most of it",
            ),
        ]
    return [
        BudgetLine(
            "local-period approximation",
            None if coupling is None else coupling.coupling_error,
            "relative L2",
            "field behind rows of one local period, full-wave, against the stitched library; `metafab coupling`"
            if coupling is None or coupling.polarised_ratio is None
            else "field behind the pillars of a repeat, full-wave, against the stitched library",
        )
    ]


def error_budget(summary: RunSummary) -> tuple[BudgetLine, ...]:
    """Collect the measured contributions to the error of the whole, in the order of the pipeline.

    Errors of images are left out for a design without a scene, errors of pillars for a design without a mask.
    """
    library, layout, psf, decode = summary.library, summary.layout, summary.psf, summary.decode
    library_error, phase_error_rad = _errors_of_mask(library, layout)
    worst = ", in the worst light" if layout is not None and layout.lights else ""
    index_error_rad = None if library is None else library.index_phase_error_rad
    lines = [
        BudgetLine(
            "solver and library",
            library_error,
            "complex t",
            f"rms over the pillars of the bound of each size: certificate of the truncation plus interpolation{worst}",
        ),
        BudgetLine(
            "size snapping and finite library",
            phase_error_rad,
            "rad rms",
            f"phase of the chosen size against the target, over all pillars{worst}",
        ),
        BudgetLine(
            "index of the pillar",
            index_error_rad,
            "rad rms",
            "the unit cell states no standard uncertainty of it (`n_error` of `[materials] pillar`)"
            if index_error_rad is None
            else "phases solved again with the index raised by its standard uncertainty, common phase taken out",
        ),
        *_neighbour_lines(summary),
        BudgetLine(
            "oblique light",
            None if psf is None else psf.oblique_error,
            "relative L2",
            "field of sizes of the mask under light from the corner of the field, common phase taken out"
            if psf is None or psf.oblique_change is None
            else "field of held-out sizes under light from the corner of the field, by the change that the PSFs carry "
            f"({psf.oblique_change:.2g} without it)",
        ),
        BudgetLine(
            "pupil reduction and sampling",
            None if psf is None else max(psf.error),
            "relative L2",
            "PSF with blocks of half the size",
        ),
        BudgetLine(
            "depth interpolation",
            None if psf is None else psf.depth_interpolation_error,
            "relative L2",
            "PSFs computed at the verified depths against those interpolated from the other nodes",
        ),
        BudgetLine(
            "field interpolation",
            None if psf is None else psf.field_interpolation_error,
            "relative L2",
            "PSF computed in the middle of an outermost cell of field points against the interpolated one",
        ),
        BudgetLine(
            "decoder",
            None if decode is None else decode.nmae,
            "mean |dz|/z",
            "decoded against true depth of the simulated scene",
        ),
    ]
    absent = (set() if decode else _OF_IMAGES) | (set() if layout else _OF_PILLARS)
    return tuple(line for line in lines if line.value is not None or line.source not in absent)


def ledger(
    design: Design,
    library: LibraryFigures | None,
    layout: LayoutFigures | None,
    psf: PsfFigures | None,
    decode: DecodeFigures | None,
) -> tuple[Saving, ...]:
    """Collect the savings of all steps, in the order of the pipeline, from the figures of a run."""
    savings: list[Saving] = []
    if library is not None:
        savings += _of_library(library)
    if psf is not None:
        savings += [*_of_psf(design, psf, layout), *_of_angles(design, psf, library)]
    if decode is not None:
        savings += _of_decode(decode)
    return tuple(savings)


def _of_library(library: LibraryFigures) -> Iterator[Saving]:
    solved, total = library.points_solved, library.points_total
    if not 0 < solved < total:
        return
    why = "mirror images about the diagonal exchange x and y polarisation"
    if not library.max_model_error > 0.0:  # NaN without a model
        yield Saving("library", "unit cells", solved, total, why)
        return
    why += ", and a rational model gives the other sizes; it was tested at sizes that it was not fitted to"
    yield Saving("library", "unit cells", solved, total, why, library.max_model_error, "complex t, bound")


def _of_psf(design: Design, psf: PsfFigures, layout: LayoutFigures | None) -> Iterator[Saving]:
    if layout is not None and psf.blocks is not None and psf.blocks < layout.pillars:
        yield Saving(
            "psf",
            "places on the lens",
            round(psf.blocks),
            layout.pillars,
            "the path over a block of sites is expanded to second order",
            max(psf.error),
            "relative L2",
        )
    if design.scene is None:
        return
    yield Saving(
        "psf",
        "depths",
        psf.depths,
        None,
        "PSFs are interpolated between depths, which stand densely enough for the target error",
        psf.depth_interpolation_error,
        "relative L2",
    )
    directions = math.prod(design.verify.field_points)
    yield Saving(
        "psf",
        "directions of the field",
        directions,
        math.prod(design.scene.field_px),
        "one direction serves all" if directions == 1 else "PSFs are interpolated between the directions",
        psf.field_interpolation_error,
        "relative L2",
    )


def _of_angles(design: Design, psf: PsfFigures, library: LibraryFigures | None) -> Iterator[Saving]:
    """Light at angles that the PSFs over the field leave out."""
    if psf.oblique_error is None or psf.oblique_change is not None:
        return
    statistics = None if library is None or not psf.with_neighbours else library.neighbours
    if design.optics is not None and design.optics.oblique is False:
        why = "`optics.oblique` is false"
    elif design.light:
        why = "not available with several `light`"
    elif statistics is None:
        why = (
            "unlike neighbours, which the library does not know, change the field as well; `optics.oblique` asks for it"
        )
    else:
        why = f"the model of unlike neighbours errs by more, {statistics.error_alike:.2g}"
    yield Saving("psf", "angles of the light on pillars", 1, None, why, psf.oblique_error, "relative L2 of the field")


def _of_decode(decode: DecodeFigures) -> Iterator[Saving]:
    if decode.pixels is None:
        return
    dark = (decode.pixels_without_signal or 0) + (decode.pixels_broken or 0)
    if dark:
        why = "pixels without light, saturated ones and those that are no number hold no depth"
        yield Saving("decode", "pixels", decode.pixels - dark, decode.pixels, why)
    if decode.step_px is not None and decode.step_px > 1:
        yield Saving(
            "decode",
            "compared pixels",
            math.ceil(decode.pixels / decode.step_px**2),
            decode.pixels,
            "the compared pixels keep 90 % of the Fisher information about depth, or more",
        )
