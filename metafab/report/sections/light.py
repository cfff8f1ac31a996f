"""The pair over depth and field."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from metafab.report import html
from metafab.report.figures import depth_text
from metafab.report.run_folder import RunFolder
from metafab.report.sections.parts import Drawn


def point_spread(run: RunFolder, drawn: Drawn) -> str:
    """The pair over depth: live, then on paper."""
    if run.psf is None:
        return html.section("psf", "Point-spread functions", html.note(run.notes.get("psf", "no PSF")))
    viewer = (
        '<div class="viewer" id="psf-viewer" hidden>'
        '<div class="pair">'
        '<figure><canvas data-pol="0" role="img" aria-label="PSF of x polarisation"></canvas>'
        '<figcaption class="x">x polarisation</figcaption></figure>'
        '<figure><canvas data-pol="1" role="img" aria-label="PSF of y polarisation"></canvas>'
        '<figcaption class="y">y polarisation</figcaption></figure></div>'
        '<div class="controls"><label>Object depth <output class="depth"></output>'
        '<input type="range" min="0" step="1" value="0"></label>'
        '<div class="choice" role="group" aria-label="What is shown"></div>'
        '<button type="button" class="play" aria-pressed="false">Play</button></div>'
        '<p class="readout" aria-live="polite"></p></div>'
    )
    return html.section(
        "psf",
        "Point-spread functions",
        html.paragraph(
            "The pair is simulated from the pillars in the written file. Crosshairs meet in the geometric image point; "
            "arrows run from there to the maximum."
        ),
        viewer,
        html.wide(html.figure(drawn["psf_pair"])) if "psf_pair" in drawn else "",
        html.grid(html.figure(drawn[n]) for n in ("psf_orientation", "psf_peak", "psf_mtf") if n in drawn),
        _merit(run),
        html.grid(html.figure(drawn[n]) for n in ("psf_field_x", "psf_field_y") if n in drawn),
        html.grid(html.figure(drawn[n]) for n in ("depth_bias", "distortion") if n in drawn),
        "" if run.ideal_psf is not None else html.note(run.notes.get("ideal_psf", "no PSF of the target phases")),
    )


def _merit(run: RunFolder) -> str:
    """Figures of merit over depth, and what was measured on the made device beside them."""
    merit = run.part("merit")
    if not merit:
        return ""
    rows = [
        [
            escape(depth_text(depth)),
            *(html.number(merit[f"{key}_{p}"][d]) for key in ("pinhole_efficiency", "strehl") for p in "xy"),
            html.number(merit["extinction_ratio"][d]),
            *(html.number(value) for value in merit["main_lobe_x_um"][d]),
        ]
        for d, depth in enumerate(merit["depth_m"])
    ]
    head = ["depth", "efficiency x", "efficiency y", "peak x", "peak y", "extinction", "lobe x / µm", "lobe y / µm"]
    text = (
        f"Efficiency: through a pinhole of {merit['pinhole_um']:g} µm, of the light at the aperture. Peak: over that "
        f"of the target phases. The pair turns by {merit['rotation_deg']:.1f}°, the target phases by "
        f"{merit['ideal_rotation_deg']:.1f}°."
    )
    return html.table(head, rows, ["n"] * len(head)) + html.paragraph(text, "caption") + _measured(merit)


def _measured(merit: Mapping[str, Any]) -> str:
    measured = merit.get("measured")
    chain = merit.get("loss_chain") or {}
    if not measured or not chain:
        return ""
    depth = merit["depth_m"].index(chain["depth_m"])
    known = [
        ("efficiency x", chain["efficiency"][0], measured.get("efficiency_x")),
        ("efficiency y", chain["efficiency"][1], measured.get("efficiency_y")),
        ("extinction ratio", merit["extinction_ratio"][depth], measured.get("extinction_ratio")),
    ]
    rows = [[name, html.number(ours), html.number(theirs)] for name, ours, theirs in known if theirs is not None]
    source = escape(str(measured.get("source", "")))
    return html.table(["", "simulated", "measured"], rows, ["", "n", "n"]) + html.paragraph(source, "caption")


def tolerances(run: RunFolder) -> str:
    """What corners of fabrication do; nothing where nobody asked."""
    part = run.part("tolerance")
    if not part:
        return ""
    head = ["corner", "PSF", "peak", "efficiency", "extinction", "turn / °", "depth error / %", "± of the change"]
    nearest = min(part["depth_m"])
    rows = [
        [
            escape(row["corner"].replace("_", " ")),
            html.number(row["change"], 2),
            html.number(row["peak_ratio"]),
            html.number(row["efficiency"]),
            html.number(row["extinction_ratio"]),
            html.number(row["turn_deg"], 2),
            html.number(None if row["depth_error_m"] is None else 100.0 * row["depth_error_m"] / nearest, 2),
            f"{100.0 * row['relative_error']:.0f}\u202f%",
        ]
        for row in part["rows"]
    ]
    text = (
        "The worst of both polarisations and all depths; of random faults the rms over draws. PSF: relative L2 change. "
        "Depth error: what a decoder reports that knows the nominal mask, against the nearest depth. The mask is not "
        "rebuilt: only its amplitudes change."
    )
    return html.section(
        "tolerance",
        "Tolerances of fabrication",
        html.table(head, rows, ["", *["n"] * (len(head) - 1)]),
        html.paragraph(text, "caption"),
    )
