"""Figures of all steps of a run, and their file ``summary.json``."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from metafab.core.figures import OrdersFigures, PhaseFigures, ToleranceTable
from metafab.core.storage.files import plain, write_json
from metafab.core.storage.tables import DAMAGED, optional, typed
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
