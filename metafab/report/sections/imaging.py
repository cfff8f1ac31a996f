"""Raw frame, and what the decoder makes of it."""

from __future__ import annotations

from dataclasses import fields
from html import escape

from metafab.decode.image import SegmentFigures
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
    if warning := run.part("decode").get("warning"):
        facts += html.note(str(warning))
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
        _judged(run),
        _segments(run),
    )


#: What is known of an image whose truth is known, in readers' words.
_JUDGED = {
    "nmae": "depth, all pixels by their segments: mean |Δz| / z",
    "nmae_pixel": "depth, each pixel by itself: mean |Δz| / z",
    "object_error": "depth of the objects: mean |Δz| / z",
    "worst_object_error": "depth of the worst object: |Δz| / z",
    "share_decoded": "share of the objects' pixels with a depth",
    "contrast_error": "contrast of the objects: mean relative error",
    "psnr_x_db": "PSNR of I_x / dB",
    "psnr_y_db": "PSNR of I_y / dB",
    "ssim_x": "SSIM of I_x",
    "ssim_y": "SSIM of I_y",
    "twin_mismatch": "share of the twins' power that neither noise nor depth explains",
}


def _judged(run: RunFolder) -> str:
    """The image against the scene's truth."""
    part = run.part("decode")
    rows = [[escape(text), html.number(part[key])] for key, text in _JUDGED.items() if part.get(key) is not None]
    return html.table(["against the scene's truth", ""], rows, ["", "n"]) if rows else ""


def _segments(run: RunFolder) -> str:
    if run.decoded is None or not run.decoded.segments:
        return ""
    keys = [item.name for item in fields(SegmentFigures)]
    return html.table(
        [html.column(key) for key in keys],
        [[html.number(getattr(row, key), 4) for key in keys] for row in run.decoded.segments],
        ["n"] * len(keys),
    )
