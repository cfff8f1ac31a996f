"""The written pillars, their files, and the rules that they keep."""

from __future__ import annotations

from html import escape

from metafab.report import html
from metafab.report.run_folder import RunFolder
from metafab.report.sections.parts import Drawn, facts_line


def mask(run: RunFolder, drawn: Drawn) -> str:
    """The written pillars, and the rules that they keep; nothing for a design without a mask."""
    if not run.has_mask:
        return ""
    part = run.part("layout")
    facts = facts_line(
        part,
        pillars="pillars",
        distinct_sizes="sizes",
        min_gap_nm="smallest gap / nm",
        phase_rms_error_rad="phase error / rad rms",
        mean_transmittance="mean transmittance",
        efficiency="efficiency of the mapping",
    )
    if isinstance(each := part.get("gap_rule_each"), dict):
        facts += "<h3>If every pillar kept the gap by itself</h3>"
        facts += facts_line(
            each,
            phase_rms_error_rad="phase error / rad rms",
            mean_transmittance="mean transmittance",
            efficiency="efficiency of the mapping",
        )
    rows = [
        [escape(str(file.get("name", ""))), html.number(file.get("bytes"))]
        for file in part.get("files", [])
        if isinstance(file, dict)
    ]
    caption = f"Drawn from {run.mask_file}, the file that goes to the writer." if run.pillars is not None else ""
    return html.section(
        "mask",
        "Mask",
        facts,
        html.grid(html.figure(drawn[n]) for n in ("mask", "mask_wide", "mask_close") if n in drawn),
        html.paragraph(escape(caption), "caption") if caption else html.note(run.notes.get("mask", "no mask")),
        html.grid([_rules(run), _files(rows)]),
    )


def _files(rows: list[list[str]]) -> str:
    return f"<div><h3>Files</h3>{html.table(['file', 'bytes'], rows, ['', 'n'])}</div>" if rows else ""


def _rules(run: RunFolder) -> str:
    drc = run.part("drc")
    violations = drc.get("violations")
    if not violations:
        return html.note("no design-rule results in summary.json")
    rows = [
        [
            escape(str(rule).replace("_", " ")),
            html.number(count),
            '<span class="good">kept</span>' if count == 0 else '<span class="bad">broken</span>',
        ]
        for rule, count in violations.items()
    ]
    links = "".join(
        f' <a href="{escape(path.name)}">{escape(path.name)}</a>' for path in sorted(run.path.glob("*.lyrdb"))
    )
    markers = f" Places, for KLayout:{links}." if links else ""
    checked = html.number(drc.get("pillars"))
    engine = f" by the {escape(str(drc['engine']))} engine" if "engine" in drc else ""
    return (
        "<div><h3>Design rules</h3>"
        + html.paragraph(f"Checked on the written file: {checked} pillars{engine}.{markers}")
        + html.table(["rule", "violations", ""], rows, ["", "n"])
        + "</div>"
    )
