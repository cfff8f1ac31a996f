"""What a pillar can do."""

from __future__ import annotations

from metafab.report import html
from metafab.report.run_folder import RunFolder
from metafab.report.sections.parts import Drawn, facts_line


def library(run: RunFolder, drawn: Drawn) -> str:
    """Maps of the library; nothing for a design that places no pillars."""
    if not run.has_mask:
        return ""
    names = ("library_phase_x", "library_phase_y", "coverage")
    more = ("library_transmittance_x", "library_transmittance_y", "library_error")
    part = run.part("library")
    facts = facts_line(
        part,
        points_total="sizes",
        points_solved="of them solved",
        max_error="largest error of t",
        coverage_rad="phase reach / rad",
    )
    return html.section(
        "library",
        "Library: what a pillar can do",
        facts,
        html.grid(html.figure(drawn[n]) for n in names if n in drawn),
        html.grid(html.figure(drawn[n]) for n in more if n in drawn),
        html.paragraph("Lines ring the guided-mode resonances: less than half of the light passes inside.", "caption")
        if run.library is not None
        else html.note(run.notes.get("library", "no library")),
    )
