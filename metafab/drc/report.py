"""Violations of a file: counts of all, places of the first; JSON and KLayout's report database."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metafab.core.storage.files import untimed, whole_file, write_json
from metafab.drc.rules import RULES
from metafab.mask.read import place_remedy

Engine = Literal["lattice", "rectangles", "polygons"]

#: Places that are kept for each rule; violations are counted without limit.
MARKERS = 1000


@dataclass(frozen=True)
class Marker:
    """Place of one violation: its bounding box, nm, in the coordinates of the file."""

    x_nm: float
    y_nm: float
    width_nm: float
    height_nm: float


@dataclass(frozen=True)
class DrcReport:
    """The outcome of a check."""

    file: str  #: Name of the checked file.
    engine: Engine  #: ``lattice``, ``rectangles`` or ``polygons``.
    pillars: int  #: Number of rectangles on the pillar layer.
    violations: dict[str, int]  #: Count by rule, zero included, of the rules that this engine checks.
    #: Up to :data:`MARKERS` places of each rule that is violated.
    markers: dict[str, tuple[Marker, ...]] = field(default_factory=dict)
    #: Smallest gap between drawn neighbours, with ``mask.bias_nm``; None if it was not measured. ``lattice``
    #: measures it if all pillars lie on sites, ``rectangles`` if some pair is at or below the rule.
    min_gap_nm: float | None = None
    #: Number of shapes on other layers, which no rule concerns, by "layer/datatype".
    other_layers: dict[str, int] = field(default_factory=dict)
    #: Number of pillars of the other copies of the lens, by number from 1, if one copy was checked.
    other_copies: dict[int, int] = field(default_factory=dict)
    #: Centre of the lens in the file, (x, y), if ``lattice`` finds no pillar at a site of the design.
    stands_at_um: tuple[float, float] | None = None
    #: Hash of the size at every lattice site, equal for equal masks in either format; empty for an engine without a
    #: lattice.
    pillars_sha256: str = ""
    seconds: float = 0.0  #: Wall clock, reading included.

    def warnings(self) -> list[str]:
        """Return a sentence on a lens that stands elsewhere than in the design, with its remedy."""
        if self.stands_at_um is None:
            return []
        return [f"no pillar is at a site of the lens; {place_remedy(self.stands_at_um)}"]

    @property
    def clean(self) -> bool:
        """Whether no rule is violated."""
        return not any(self.violations.values())


class Findings:
    """Violations, collected while a file is checked.

    Args:
        rules: the rules that are checked.

    Attributes:
        counts: violations by rule.
    """

    def __init__(self, rules: Iterable[str]) -> None:
        self.counts = dict.fromkeys(rules, 0)
        self._boxes: dict[str, list[NDArray[Any]]] = {rule: [] for rule in self.counts}

    def add(self, rule: str, boxes: NDArray[Any], count: int | None = None) -> None:
        """Count violations of a rule and keep the first places: boxes (x, y, width, height), shape (n, 4).

        ``count`` is the number of violations, if it is not n.
        """
        self.counts[rule] += len(boxes) if count is None else count
        kept = self._boxes[rule]
        if len(boxes) and (room := MARKERS - sum(map(len, kept))) > 0:
            kept.append(boxes[:room].copy())  # a view would hold all boxes

    def merge(self, other: Findings) -> None:
        """Add the violations of another part of the file."""
        for rule, count in other.counts.items():
            self.counts[rule] += count
            self._boxes[rule] += other._boxes[rule]

    def markers(self, unit_nm: float = 1.0) -> dict[str, tuple[Marker, ...]]:
        """Return the first places of each violated rule; ``unit_nm`` is the unit of the boxes."""
        markers = {}
        for rule, boxes in self._boxes.items():
            if self.counts[rule]:
                first = np.concatenate([np.empty((0, 4)), *boxes])[:MARKERS] * unit_nm
                markers[rule] = tuple(Marker(*box) for box in first.tolist())
        return markers


def spanning_boxes(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """Bounding boxes of pairs of rectangles; x, y, width, height, shape (n, 4) each."""
    low = np.minimum(one[:, :2], other[:, :2])
    high = np.maximum(one[:, :2] + one[:, 2:], other[:, :2] + other[:, 2:])
    return np.concatenate([low, high - low], axis=1)


def save(reports: Sequence[DrcReport], directory: Path, top_cell: str = "TOP") -> tuple[Path, Path]:
    """Write ``drc.json``, every report by its file and without its time, and ``drc.lyrdb`` for KLayout.

    All files of a mask hold the same pillars; the database shows the report with the most violations.
    """
    json_path, database_path = directory / "drc.json", directory / "drc.lyrdb"
    write_json(json_path, {report.file: untimed(vars(report)) for report in reports})
    worst = max(reports, key=lambda report: sum(report.violations.values()))
    with whole_file(database_path) as part:
        part.write_text(report_database(worst, top_cell), encoding="utf-8")
    return json_path, database_path


def report_database(report: DrcReport, top_cell: str) -> str:
    """Return the report in KLayout's marker format (micrometres)."""
    categories = "".join(
        f"  <category><name>{rule}</name><description>{escape(RULES[rule])}</description></category>\n"
        for rule in report.violations
    )
    items = "".join(
        f"  <item><category>{rule}</category><cell>{escape(top_cell)}</cell><values><value>{_box(marker)}</value>"
        "</values></item>\n"
        for rule, markers in report.markers.items()
        for marker in markers
    )
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<report-database>\n'
        f" <description>{escape(report.file)}, {report.engine} engine</description>\n"
        f" <generator>metafab drc</generator>\n <top-cell>{escape(top_cell)}</top-cell>\n"
        f" <categories>\n{categories} </categories>\n"
        f" <cells>\n  <cell><name>{escape(top_cell)}</name></cell>\n </cells>\n"
        f" <items>\n{items} </items>\n</report-database>\n"
    )


def _box(marker: Marker) -> str:
    left, bottom = marker.x_nm * 1e-3, marker.y_nm * 1e-3
    return f"box: ({left:.6f},{bottom:.6f};{left + marker.width_nm * 1e-3:.6f},{bottom + marker.height_nm * 1e-3:.6f})"
