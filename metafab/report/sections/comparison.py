"""The design beside other cameras, where ``metafab compare`` left its file."""

from __future__ import annotations

from html import escape

from metafab.comparison import comparison_figures
from metafab.report import html
from metafab.report.run_folder import RunFolder
from metafab.report.sections.parts import Drawn


def comparison(run: RunFolder, drawn: Drawn) -> str:
    """Depth and sharpness over depth beside a standard lens and a double helix; nothing without the file."""
    found = run.comparison
    if found is None:
        return ""
    total = comparison_figures(found)
    rows = [
        [escape(name), html.number(100.0 * total.depth_error[name]), html.number(100.0 * total.depth_bound[name])]
        for name in found.methods
    ]
    caption = (
        f"Target phases, equal aperture, light and sensor: planes of 1/f texture that fill the view, {found.planes} at "
        f"each depth, {found.electrons:g} electrons a pixel and image, contrast {found.contrast:g}, windows of "
        f"{found.side_px} x {found.side_px} px. All cameras by one likelihood, which knows the texture's spectrum; "
        "dotted, the bound of that knowledge for tapered windows; light from beyond their edges keeps estimates above. "
        "Of a texture of unknown spectrum, a lens and a double helix tell nothing."
    )
    return html.section(
        "comparison",
        "Beside other cameras",
        html.grid(html.figure(drawn[n]) for n in ("rival_depth", "rival_sharpness") if n in drawn),
        html.table(["camera and estimate", "rms error of depth / %", "bound / %"], rows, ["", "n", "n"]),
        html.paragraph(escape(caption), "caption"),
    )
