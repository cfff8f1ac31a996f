"""The pair over depth and field."""

from __future__ import annotations

from metafab.report import html
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
        html.grid(html.figure(drawn[n]) for n in ("psf_field_x", "psf_field_y") if n in drawn),
        "" if run.ideal_psf is not None else html.note(run.notes.get("ideal_psf", "no PSF of the target phases")),
    )
