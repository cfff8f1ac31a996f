"""Target phases, what they are worth, and what the colour filter costs."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from metafab.report import html
from metafab.report.run_folder import RunFolder
from metafab.report.sections.parts import Drawn, facts_line


def phases(run: RunFolder, drawn: Drawn) -> str:
    """Target phases over the aperture."""
    facts = facts_line(
        run.part("phase"),
        peak_gain="peak gain of the optimisation",
        rotation_deg="rotation / °",
        hologram_efficiency="of the light in the picture",
        hologram_correlation="correlation with the picture",
    )
    return html.section(
        "phases",
        "Target phases",
        facts,
        html.grid(html.figure(drawn[n]) for n in ("phase_x", "phase_y") if n in drawn),
        _beside(run),
        html.grid(html.figure(drawn[n]) for n in ("hologram_wanted", "hologram_found") if n in drawn),
        html.grid(html.figure(drawn[n]) for n in ("lobe_peak", "lobe_orientation") if n in drawn),
        html.grid(html.figure(drawn[n]) for n in ("bounds_point", "bounds_texture") if n in drawn),
        html.paragraph(
            "Cramér-Rao bounds at equal aperture and equal light, by the paraxial pupil; no decoding does better.",
            "caption",
        )
        if "bounds_point" in drawn
        else html.note(run.notes.get("study", "one depth alone: no bounds over depth")),
        _filter(run, drawn),
    )


def _beside(run: RunFolder) -> str:
    """Why there is no picture of the phases, where there is none."""
    if run.phases is None:
        return html.note(run.notes.get("phases", "no phases"))
    return "" if run.phases.vary else html.note("lens, split and gratings alone: beside them the phase is flat")


def _filter(run: RunFolder, drawn: Drawn) -> str:
    """What the colour filter costs, and what helps."""
    budget = run.part("study").get("bandwidth")
    if not isinstance(budget, Mapping):
        return ""
    facts = facts_line(
        budget,
        filter_fwhm_nm="nm filter",
        dispersion_um_per_nm="µm a nanometre",
        smear_um="µm smear",
        information_kept="of the information kept",
        depth_error_factor="times the error of one wavelength",
    )
    rows = [
        [
            escape(str(row.get("change", ""))),
            html.number(row.get("information_kept")),
            html.number(row.get("depth_error_factor")),
        ]
        for row in budget.get("remedies") or []
        if isinstance(row, Mapping)
    ]
    return (
        "<h3>Colour filter</h3>"
        + facts
        + html.grid(html.figure(drawn[n]) for n in ("filter", "filter_orientation") if n in drawn)
        + html.table(["what helps", "information kept", "error of depth, times"], rows, ["", "n", "n"])
    )
