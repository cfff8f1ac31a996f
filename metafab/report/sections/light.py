"""The pair over depth and field."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from metafab.report import html
from metafab.report.figures import depth_text
from metafab.report.run_folder import RunFolder
from metafab.report.sections.parts import Drawn

#: Whose light the page shows, by whether there is a mask.
_SOURCE = {True: "the pillars in the written file", False: "the target phases themselves: this design writes no mask"}


def point_spread(run: RunFolder, drawn: Drawn) -> str:
    """The pair over depth: live, then on paper."""
    if run.psf is None:
        return html.section("psf", "Point-spread functions", html.note(run.notes.get("psf", "no PSF")))
    several = run.psf.depth_m.size > 1
    still = "" if several else " hidden"
    over_depth = ("psf_orientation", "psf_peak") if several else ()
    viewer = (
        '<div class="viewer" id="psf-viewer" hidden>'
        '<div class="pair">'
        '<figure><canvas data-pol="0" role="img" aria-label="PSF of x polarisation"></canvas>'
        '<figcaption class="x">x polarisation</figcaption></figure>'
        '<figure><canvas data-pol="1" role="img" aria-label="PSF of y polarisation"></canvas>'
        '<figcaption class="y">y polarisation</figcaption></figure></div>'
        '<div class="controls"><label>Object depth <output class="depth"></output>'
        f'<input type="range" min="0" step="1" value="0"{still}></label>'
        '<div class="choice" role="group" aria-label="What is shown"></div>'
        f'<button type="button" class="play" aria-pressed="false"{still}>Play</button></div>'
        '<p class="readout" aria-live="polite"></p></div>'
    )
    return html.section(
        "psf",
        "Point-spread functions",
        html.paragraph(
            f"Simulated from {_SOURCE[run.has_mask]}. Crosshairs meet in the geometric image point; arrows run from "
            "there to the maximum."
        ),
        viewer,
        html.wide(html.figure(drawn["psf_pair"])) if "psf_pair" in drawn else "",
        html.grid(html.figure(drawn[n]) for n in (*over_depth, "psf_mtf") if n in drawn),
        _merit(run),
        html.grid(html.figure(drawn[n]) for n in ("psf_field_x", "psf_field_y") if n in drawn),
        html.grid(html.figure(drawn[n]) for n in ("depth_bias", "distortion") if n in drawn),
        ""
        if run.ideal_psf is not None or not run.has_mask
        else html.note(run.notes.get("ideal_psf", "no PSF of the target phases")),
    )


def _merit(run: RunFolder) -> str:
    """Figures of merit over depth, and what was measured on the made device beside them."""
    merit = run.part("merit")
    if not merit:
        return ""
    rows = [
        [
            escape(depth_text(depth)),
            *(_share(merit[f"{key}_{p}"][d]) for key in ("pinhole_efficiency", "strehl") for p in "xy"),
            _ratio(merit["extinction_ratio"][d]),
            *(html.number(value) for value in merit["main_lobe_x_um"][d]),
        ]
        for d, depth in enumerate(merit["depth_m"])
    ]
    head = ["depth", "efficiency x", "efficiency y", "peak x", "peak y", "extinction", "lobe x / µm", "lobe y / µm"]
    text = (
        f"Efficiency: through a pinhole of {merit['pinhole_um']:g} µm, of the light at the aperture. Peak: over that "
        "of the target phases."
    )
    if len(rows) > 1:
        turns = (round(merit[f"{which}rotation_deg"], 1) + 0.0 for which in ("", "ideal_"))  # no minus before 0.0
        text += " The pair turns by {:.1f}°, the target phases by {:.1f}°.".format(*turns)
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


#: Corners of the cell, by the first word of their names: what readers call them, and their unit.
_CORNERS = {
    "cd_bias_nm": ("CD bias", " nm"),
    "height_nm": ("height", " nm"),
    "sidewall_angle_deg": ("sidewall", "°"),
    "pillar_n_shift": ("pillar index", ""),
}


def _corner(name: str) -> str:
    """A corner's name for readers: ``cd_bias_nm -10`` as CD bias −10 nm."""
    key, _, value = name.partition(" ")
    if key not in _CORNERS:
        return name.replace("_", " ")
    what, unit = _CORNERS[key]
    return f"{what} {value.replace('-', '−')}{unit}"


def _share(value: Any) -> str:
    """Three decimals, which stand in line below each other; what is no number as the summary has it."""
    return f"{value:.3f}" if isinstance(value, float) else html.number(value)


def _ratio(value: Any) -> str:
    """A ratio to three digits, a large one to whole numbers."""
    return html.number(round(value) if isinstance(value, float) and value >= 100.0 else value)


def tolerances(run: RunFolder) -> str:
    """What corners of fabrication do; nothing where nobody asked."""
    part = run.part("tolerance")
    if not part:
        return ""
    head = ["corner", "PSF", "peak", "efficiency", "extinction", "turn / °", "depth error / %", "± of the change"]
    nearest = min(float(depth) for depth in part["depth_m"])
    rows = [
        [
            escape(_corner(row["corner"])),
            html.number(row["change"], 2),
            _share(row["peak_ratio"]),
            _share(row["efficiency"]),
            _ratio(row["extinction_ratio"]),
            html.number(row["turn_deg"], 2),
            html.number(None if row["depth_error_m"] is None else 100.0 * row["depth_error_m"] / nearest, 2),
            "below error" if row.get("below_error") else f"{html.number(100.0 * row['relative_error'], 2)}\u202f%",
        ]
        for row in part["rows"]
    ]
    text = (
        "The worst of both polarisations and all depths; of random faults the rms over draws, of efficiency, peak and "
        "extinction their mean. PSF: relative L2 change; below error: by no more than the PSFs err by. "
        "Depth error: what a decoder reports that knows the nominal mask, against the nearest depth. The mask is not "
        "rebuilt: only its amplitudes change."
    )
    return html.section(
        "tolerance",
        "Tolerances of fabrication",
        html.table(head, rows, ["", *["n"] * (len(head) - 1)]),
        html.paragraph(text, "caption"),
    )
