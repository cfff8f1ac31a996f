"""Raw frame, and what the decoder makes of it."""

from __future__ import annotations

from collections.abc import Mapping

from metafab.report import html
from metafab.report.run_folder import RunFolder
from metafab.report.sections.parts import Drawn, facts_line


def imaging(run: RunFolder, drawn: Drawn) -> str:
    """Raw frame, and what the decoder makes of it; nothing for a device that photographs no scene."""
    asked = "scene" in run.design_table or not run.design_table
    if not asked and run.raw is None and run.decoded is None:
        return ""
    live = ""
    if run.decoded is not None:
        live = (
            '<div class="viewer" id="image-viewer" hidden>'
            '<p class="readout" aria-live="polite">Point at a picture to read its pixel.</p>'
            '<div class="quad"></div>'
            '<figure class="relief" hidden><canvas tabindex="0" role="img" '
            'aria-label="Decoded pixels at their depths; drag or use arrow keys to turn"></canvas>'
            "<figcaption>The scene in relief, as on the sensor: nearer is nearer to you. Drag to turn.</figcaption>"
            "</figure></div>"
        )
    facts = facts_line(run.part("decode"), nmae="mean |Δz| / z", seconds="seconds to decode")
    stills = ("intensity_x", "intensity_y", "contrast", "depth")
    paper = html.grid(html.figure(drawn[n]) for n in stills if n in drawn)
    return html.section(
        "image",
        "One exposure, four dimensions",
        html.fitting(
            html.figure(drawn["raw_frame"], "Both polarisations of the scene on one sensor, y up, as recorded.")
        )
        if "raw_frame" in drawn
        else html.note(run.notes.get("raw", "no raw frame")),
        "" if run.decoded is not None else html.note(run.notes.get("decoded", "no decoded image")),
        facts if run.decoded is not None else "",
        live,
        f"<details><summary>The same with scales and units</summary>{paper}</details>" if live else paper,
        html.grid(html.figure(drawn[n]) for n in ("depth_truth", "confidence") if n in drawn),
        _segments(run),
    )


def _segments(run: RunFolder) -> str:
    segments = run.part("decode").get("segments") or (run.decoded.segments if run.decoded is not None else ())
    rows = [row for row in segments if isinstance(row, Mapping)] if not isinstance(segments, int) else []
    if not rows:
        return ""
    keys = list(rows[0])
    return html.table(
        [html.column(key) for key in keys],
        [[html.number(row.get(key), 4) for key in keys] for row in rows],
        ["n"] * len(keys),
    )
