"""What unlike neighbours do."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from metafab.report import html
from metafab.report.run_folder import RunFolder
from metafab.report.sections.parts import Drawn

if TYPE_CHECKING:
    from metafab.fullwave import Coupling, Patch

#: Figures of a patch that the page shows.
_PATCH_FIGURES = ("amplitude_rms", "phase_rms_rad", "relative_l2")


def fullwave(run: RunFolder, drawn: Drawn) -> str:
    """What unlike neighbours do: rows of one local period, and a patch; nothing where neither was simulated."""
    # The summary names the rows only if they were cut from this mask.
    rows = _local_periods(run.coupling) if run.coupling is not None and run.part("coupling") else ""
    patch = _patch(run.patch, drawn) if run.patch is not None else ""
    if not rows and not patch:
        return ""
    return html.section("fullwave", "Unlike neighbours, by full-wave simulation", rows, patch)


def _local_periods(coupling: Coupling) -> str:
    head = ["place / µm", "light", "solver", "pillars", "efficiency", "by lone pillars", "field missed"]
    rows = [
        [
            f"{row.x_um:g}, {row.y_um:g} along {row.axis}", row.polarisation, row.solver, str(row.sites),
            html.number(row.efficiency), html.number(row.local_period_efficiency), html.number(row.coupling_error),
        ]
        for row in coupling.rows
    ]  # fmt: skip
    text = "Rows of the mask, one turn of the phase long: power into the order that focuses; relative rms of the field."
    return html.table(head, rows, ["", "", "", *["n"] * 4]) + html.paragraph(text, "caption")


def _patch(patch: Patch, drawn: Drawn) -> str:
    kinds = ("phase_meep", "phase_library", "amplitude_meep", "amplitude_library", "difference_library")
    names = [f"patch_{kind}" for kind in (*kinds, "difference_coupling")]
    rows = [
        [escape(what), *(html.number(getattr(difference, figure)) for figure in _PATCH_FIGURES)]
        for what, difference in (
            ("Meep against the library", patch.against_library),
            ("Meep against each pillar alone on the same grid: coupling", patch.coupling),
            ("each pillar alone on Meep's grid against the library: the grid", patch.grid),
        )
    ]
    caption = (
        f"{patch.x_um.size} x {patch.y_um.size} pillars of the mask about ({patch.x_um.mean():.1f}, "
        f"{patch.y_um.mean():.1f}) um, {patch.polarisation} polarisation, {patch.pixels_per_period} pixels a period, "
        f"{patch.padding_sites} neighbours around. Waves that travel, in the plane where the pillars end."
    )
    return (
        html.grid(html.figure(drawn[n]) for n in names if n in drawn)
        + html.table(["", "amplitude rms", "phase rms / rad", "relative L2"], rows, ["", "n", "n", "n"])
        + html.paragraph(escape(caption), "caption")
    )
