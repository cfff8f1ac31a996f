"""What a check found: counts of all violations, places of the first, as JSON and as KLayout's report database."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Literal

from metafab.core.errors import InputError
from metafab.core.storage.files import whole_file, write_json
from metafab.spec import Design

Engine = Literal["lattice", "rectangles", "polygons"]

#: Places that are kept for each rule; violations are counted without limit.
MARKERS = 1000

RULES = {
    "min_width": "a pillar narrower along x than `rules.min_feature_nm`",
    "min_length": "a pillar shorter along y than `rules.min_feature_nm`",
    "aspect_ratio": "a pillar whose shorter side is below its height over `rules.max_aspect_ratio`",
    "min_gap": "two pillars nearer than `rules.min_gap_nm`, corners of diagonal neighbours included",
    "overlap": "two pillars that overlap or touch",
    "grid": "edges that are no whole number of database units",
    "lattice_site": "a rectangle whose centre is no site of the lattice, or that is larger than a unit cell",
    "aperture": "a pillar whose unit cell is not inside the aperture",
    "duplicate": "a second rectangle at a site",
    "missing": "a site inside the aperture without a pillar",
    "foreign": "a shape on the pillar layer that is no axis-parallel rectangle",
}


def refuse_several_tops(path: Path, top_cells: Sequence[str]) -> None:
    """Refuse a file in which it is not certain what is to be made.

    Raises:
        InputError: not one top cell.
    """
    if len(top_cells) != 1:
        names = ", ".join(map(repr, sorted(top_cells)[:5]))
        raise InputError.single(
            str(path), "cells", "one top cell", f"{len(top_cells)}: {names}", "write the mask again"
        )


def refuse_empty(path: Path, design: Design, shapes: int) -> None:
    """Refuse a file in which an engine that knows no lattice would find nothing wrong, since there is nothing.

    Raises:
        InputError: no shape on the pillars' layer.
    """
    if shapes == 0:
        first, last = design.mask.datatypes
        layer = f"{design.mask.layer}/{first}" + (f" to {last}" if last > first else "")
        remedy = "are `mask.layer` and `mask.datatype` those of the file?"
        raise InputError.single(str(path), "pillars", f"shapes on layer {layer}", "none", remedy)


def upright_side_nm(design: Design) -> float | None:
    """Shortest drawn side that `rules.max_aspect_ratio` allows, nm; None without that rule."""
    ratio = design.rules.max_aspect_ratio
    return None if ratio is None else design.unit_cell.cell.height_nm / ratio + design.mask.bias_nm


@dataclass(frozen=True)
class Marker:
    """One violation's place: the box around it, nm, in the coordinates of the file."""

    x_nm: float
    y_nm: float
    width_nm: float
    height_nm: float


@dataclass(frozen=True)
class DrcReport:
    """The outcome of a check.

    Attributes:
        file: the checked file's name.
        engine: ``lattice``, ``rectangles`` or ``polygons``.
        pillars: rectangles found on the pillar layer.
        violations: count by rule, zero included; the rules that this engine can see.
        markers: up to :data:`MARKERS` places of each rule that is violated.
        min_gap_nm: smallest distance between neighbours; None if the engine does not measure it. ``lattice`` measures
            pillars on their sites, and gives None where others were found, whose gaps it does not check
            (``rectangles`` does); ``rectangles`` gives None where no pair is at or below the rule.
        other_layers: shapes on other layers, which no rule concerns, by "layer/datatype".
        other_copies: pillars of the other copies of the lens, by number from 1, where one copy was checked.
        pillars_sha256: hash of the size at every lattice site, equal for equal masks in either format; empty if
            the engine does not know sites.
        seconds: wall clock, reading included.
    """

    file: str
    engine: Engine
    pillars: int
    violations: dict[str, int]
    markers: dict[str, tuple[Marker, ...]] = field(default_factory=dict)
    min_gap_nm: float | None = None
    other_layers: dict[str, int] = field(default_factory=dict)
    other_copies: dict[int, int] = field(default_factory=dict)
    pillars_sha256: str = ""
    seconds: float = 0.0

    @property
    def clean(self) -> bool:
        """Whether no rule is violated."""
        return not any(self.violations.values())


def save(reports: Sequence[DrcReport], directory: Path, top_cell: str = "TOP") -> tuple[Path, Path]:
    """Write ``drc.json``, every report by its file, and ``drc.lyrdb``, which KLayout opens at the violations.

    The files of one mask hold the same pillars, so the database shows the one with the most violations.
    """
    json_path, database_path = directory / "drc.json", directory / "drc.lyrdb"
    write_json(json_path, {report.file: report for report in reports})
    worst = max(reports, key=lambda report: sum(report.violations.values()))
    with whole_file(database_path) as part:
        part.write_text(report_database(worst, top_cell), encoding="utf-8")
    return json_path, database_path


def report_database(report: DrcReport, top_cell: str) -> str:
    """The report in KLayout's marker format (micrometres)."""
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
