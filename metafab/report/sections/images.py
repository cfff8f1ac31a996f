"""Raw frame and decoded image, and the comparison with other cameras."""

from __future__ import annotations

from dataclasses import fields
from html import escape

from metafab.comparison import comparison_figures
from metafab.core.figures import SegmentFigures
from metafab.report import html
from metafab.report.html import Drawn
from metafab.report.run_folder import RunFolder

_VIEWER = (
    '<div class="viewer" id="image-viewer" hidden>'
    '<p class="readout" aria-live="polite">Point at a picture to read its pixel.</p>'
    '<div class="quad"></div>'
    '<figure class="relief" hidden><canvas tabindex="0" role="img" '
    'aria-label="Decoded pixels at their depths; drag or use arrow keys to turn"></canvas>'
    "<figcaption>The scene in relief, as on the sensor: nearer is nearer to you. Drag to turn.</figcaption>"
    "</figure></div>"
)


def imaging(run: RunFolder, drawn: Drawn) -> str:
    """Raw frame and decoded image; empty for a design without a scene."""
    if not run.outline.has_scene and run.raw is None and run.decoded is None:
        return ""
    stills = html.figures(drawn, "intensity_x", "intensity_y", "contrast", "depth")
    has_image = run.decoded is not None
    return html.section(
        "image",
        "One exposure, four dimensions",
        html.fitting(
            html.figure(drawn["raw_frame"], "Both polarisations of the scene on one sensor, y up, as recorded.")
        )
        if "raw_frame" in drawn
        else html.note(run.notes.get("raw", "no raw frame")),
        _decoder(run) if has_image else html.note(run.notes.get("decoded", "no decoded image")),
        _VIEWER if has_image else "",
        f"<details><summary>The pictures with scales and units</summary>{stills}</details>" if has_image else stills,
        html.figures(drawn, "depth_truth", "confidence"),
        _accuracy(run),
        _segments(run),
    )


def _decoder(run: RunFolder) -> str:
    figures = run.summary.decode
    if figures is None:
        return ""
    line = html.facts({"mean |Δz| / z": figures.nmae})
    return line + (html.note(figures.warning) if figures.warning is not None else "")


def _accuracy(run: RunFolder) -> str:
    """Errors of the image against the truth of the scene."""
    figures = run.summary.decode
    if figures is None:
        return ""
    errors = {
        "depth of pixels, by their segments: mean |Δz| / z": figures.nmae,
        "depth of pixels, each by its own window: mean |Δz| / z": figures.nmae_pixel,
        "depth of the objects: mean |Δz| / z": figures.object_error,
        "depth of the worst object: |Δz| / z": figures.worst_object_error,
        "share of the objects' pixels with a depth": figures.share_decoded,
        "contrast of the objects: mean relative error": figures.contrast_error,
        "PSNR of I_x / dB": figures.psnr_x_db,
        "PSNR of I_y / dB": figures.psnr_y_db,
        "SSIM of I_x": figures.ssim_x,
        "SSIM of I_y": figures.ssim_y,
        "share of the twins' power that neither noise nor depth explains": figures.twin_mismatch,
    }
    rows = [[escape(name), html.number(value)] for name, value in errors.items() if value is not None]
    return html.table(["against the scene's truth", ""], rows, ["", "n"]) if rows else ""


def _segments(run: RunFolder) -> str:
    if run.decoded is None or not run.decoded.segments:
        return ""
    keys = [item.name for item in fields(SegmentFigures)]
    rows = [[html.number(getattr(segment, key), 4) for key in keys] for segment in run.decoded.segments]
    return html.table([html.column(key) for key in keys], rows, ["n"] * len(keys))


def comparison(run: RunFolder, drawn: Drawn) -> str:
    """Depth and sharpness over depth of this design, a standard lens and a double helix; empty without the file."""
    result = run.comparison
    if result is None:
        return ""
    figures = comparison_figures(result)
    rows = [
        [escape(name), html.number(100.0 * figures.depth_error[name]), html.number(100.0 * figures.depth_bound[name])]
        for name in result.methods
    ]
    caption = (
        f"Target phases with equal aperture, light and sensor. Planes of 1/f texture fill the view: {result.planes} at "
        f"each depth, {result.electrons:g} electrons a pixel and image, contrast {result.contrast:g}, windows of "
        f"{result.side_px} x {result.side_px} px. All cameras use one likelihood, with the texture's spectrum known. "
        "Dotted: the Cramér-Rao bound for tapered windows; light from beyond their edges keeps the estimates above it, "
        f"but for scatter: an error at one depth is known to {100.0 * result.error_scatter:.0f} % (bars). "
        "For a texture of unknown spectrum, a lens and a double helix give no depth."
    )
    return html.section(
        "comparison",
        "Comparison with other cameras",
        html.figures(drawn, "rival_depth", "rival_sharpness"),
        html.table(["camera and estimate", "rms error of depth / %", "bound / %"], rows, ["", "n", "n"]),
        html.paragraph(escape(caption), "caption"),
    )
