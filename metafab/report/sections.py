"""The page's sections: accounts first, then light and image, then phases, mask and library, then what it cost.

Each function takes the opened run and the drawn figures (name -> SVG) and returns ready HTML; a section whose files
are missing says so in a line.
"""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from metafab.fullwave import Coupling, Patch
from metafab.report import html
from metafab.report.accounts import chain_of
from metafab.report.run_folder import RunFolder

Drawn = Mapping[str, str]


def headlines(run: RunFolder) -> str:
    """The few figures that matter most."""
    items = []
    nmae = run.part("decode").get("nmae")
    if nmae is not None:
        items.append(html.headline(f"{100 * nmae:.2g}\u202f%", "mean depth error", "good" if nmae < 0.01 else "bad"))
    rotation = run.part("phase").get("rotation_deg")
    if rotation is not None:
        items.append(html.headline(f"{abs(rotation):.0f}°", "turn of the pair over the design’s depths"))
    pillars = run.part("layout").get("pillars")
    if pillars is not None:
        items.append(html.headline(html.number(pillars), "pillars"))
    violations = run.part("drc").get("violations")
    if violations is not None:
        broken = sum(violations.values())
        items.append(html.headline(html.number(broken), "rules broken", "bad" if broken else "good"))
    seconds = run.part("seconds")
    if seconds:
        items.append(html.headline(f"{sum(seconds.values()):.3g}\u202fs", "from unit cell to depth map"))
    return f'<ul class="headlines">{"".join(items)}</ul>' if items else ""


def subtitle(run: RunFolder) -> str:
    """The device in a line."""
    device = run.design_table.get("device", {})
    cell = run.design_table.get("unit_cell", {})
    wavelength = cell.get("illumination", {}).get("wavelength_nm")
    parts = []
    if "aperture_um" in device:
        aperture = device["aperture_um"]
        size = f"{aperture / 1000:g} mm" if aperture >= 1000 else f"{aperture:g} µm"
        parts.append(f"{size} {device.get('aperture_shape', 'aperture')}")
    if "focal_length_mm" in device:
        parts.append(f"focal length {device['focal_length_mm']:g} mm")
    if wavelength is not None:
        parts.append(f"{wavelength:g} nm")
    terms = [str(term.get("term", "")).replace("_", " ") for term in run.design_table.get("phase", [])]
    return escape(" · ".join([*parts, " + ".join(terms)] if terms else parts))


def accounts(run: RunFolder, drawn: Drawn) -> str:
    """Loss chain and error budget."""
    budget = run.summary.get("error_budget") or []
    chain = chain_of(run)
    rows = [
        [
            escape(str(line.get("source", ""))),
            html.number(line["value"]) if line.get("value") is not None else "not measured",
            escape(str(line.get("unit", ""))),
            escape(str(line.get("how", ""))),
        ]
        for line in budget
    ]
    return html.section(
        "accounts",
        "Where the light goes, and where the error comes from",
        html.grid(html.figure(drawn[name]) for name in ("loss_chain", "error_budget") if name in drawn),
        "" if chain else html.note(run.notes.get("psf", "the run holds no efficiencies: no loss chain")),
        html.table(["source", "error", "unit", "how it was measured"], rows, ["", "n"], "stack")
        if rows
        else html.note("summary.json holds no error budget"),
    )


def library(run: RunFolder, drawn: Drawn) -> str:
    """Maps of the library."""
    names = ("library_phase_x", "library_phase_y", "coverage")
    more = ("library_transmittance_x", "library_transmittance_y", "library_error")
    part = run.part("library")
    facts = _facts(
        part,
        points_total="sizes",
        points_solved="of them solved",
        max_error="largest error of t",
        coverage_rad="phase reach / rad",
    )
    return html.section(
        "library",
        "Library: what a pillar can do",
        facts,
        html.grid(html.figure(drawn[n]) for n in names if n in drawn),
        html.grid(html.figure(drawn[n]) for n in more if n in drawn),
        html.paragraph("Lines ring the guided-mode resonances: less than half of the light passes inside.", "caption")
        if run.library is not None
        else html.note(run.notes.get("library", "no library")),
    )


def phases(run: RunFolder, drawn: Drawn) -> str:
    """Target phases over the aperture."""
    facts = _facts(run.part("phase"), peak_gain="peak gain of the optimisation", rotation_deg="rotation / °")
    return html.section(
        "phases",
        "Target phases",
        facts,
        html.grid(html.figure(drawn[n]) for n in ("phase_x", "phase_y") if n in drawn),
        "" if run.phases is not None else html.note(run.notes.get("phases", "no phases")),
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


def _filter(run: RunFolder, drawn: Drawn) -> str:
    """What the colour filter costs, and what helps."""
    budget = run.part("study").get("bandwidth")
    if not isinstance(budget, Mapping):
        return ""
    facts = _facts(
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


def mask(run: RunFolder, drawn: Drawn) -> str:
    """The written pillars, and the rules that they keep."""
    part = run.part("layout")
    facts = _facts(
        part,
        pillars="pillars",
        distinct_sizes="sizes",
        min_gap_nm="smallest gap / nm",
        phase_rms_error_rad="phase error / rad rms",
        efficiency="efficiency of the mapping",
    )
    if isinstance(each := part.get("gap_rule_each"), dict):
        facts += "<h3>If every pillar kept the gap by itself</h3>"
        facts += _facts(each, phase_rms_error_rad="phase error / rad rms", efficiency="efficiency of the mapping")
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
    found = patch.figures()
    kinds = ("phase_meep", "phase_library", "amplitude_meep", "amplitude_library", "difference_library")
    names = [f"patch_{kind}" for kind in (*kinds, "difference_coupling")]
    rows = [
        [escape(what), *(html.number(found[f"{key}{figure}"]) for figure in _PATCH_FIGURES)]
        for what, key in (
            ("Meep against the library", ""),
            ("Meep against each pillar alone on the same grid: coupling", "coupling_"),
            ("each pillar alone on Meep's grid against the library: the grid", "grid_"),
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


#: Figures of a patch that the page shows.
_PATCH_FIGURES = ("amplitude_rms", "phase_rms_rad", "relative_l2")


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


def imaging(run: RunFolder, drawn: Drawn) -> str:
    """Raw frame, and what the decoder makes of it."""
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
    facts = _facts(run.part("decode"), nmae="mean |Δz| / z", seconds="seconds to decode")
    stills = ("intensity_x", "intensity_y", "contrast", "depth")
    paper = html.grid(html.figure(drawn[n]) for n in stills if n in drawn)
    return html.section(
        "image",
        "One exposure, four dimensions",
        html.wide(html.figure(drawn["raw_frame"], "Both polarisations of the scene on one sensor, y up, as recorded."))
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


def cost(run: RunFolder, drawn: Drawn) -> str:
    """Seconds, memory, and what was not done."""
    seconds, memory = run.part("seconds"), run.part("peak_rss_mb")
    rows = [
        [escape(step), html.number(float(value)), html.number(memory.get(step))]
        for step, value in seconds.items()
        if isinstance(value, int | float)
    ]
    skipped = [line for line in run.summary.get("skipped") or [] if isinstance(line, dict)]
    return html.section(
        "cost",
        "Time, memory, and what was skipped",
        html.grid([html.figure(drawn["seconds"]), html.table(["step", "seconds", "peak MB"], rows, ["", "n", "n"])])
        if "seconds" in drawn
        else html.note("summary.json holds no timings"),
        html.table(
            ["skipped", "why that was safe"],
            [[escape(str(line.get("step", ""))), escape(str(line.get("why", "")))] for line in skipped],
            kind="stack",
        )
        if skipped
        else html.note("nothing was skipped: every step ran"),
    )


def provenance(run: RunFolder) -> str:
    """Which code and which inputs made this."""
    versions = "\u2002".join(
        f"{escape(name)}\u00a0{escape(str(version))}" for name, version in run.part("versions").items()
    )
    files = sorted(p for p in run.path.iterdir() if p.is_file() and not p.name.startswith("."))
    rows = [
        [f'<a href="{escape(p.name)}">{escape(p.name)}</a>', html.number(p.stat().st_size)]
        for p in files
        if p.name != "report.html"
    ]
    design = ""
    if "design_table" not in run.notes:
        text = (run.path / "design.toml").read_text(encoding="utf-8")
        design = f"<details><summary>design.toml</summary><pre>{escape(text)}</pre></details>"
    return html.section(
        "provenance",
        "Provenance",
        html.paragraph(versions) if versions else html.note("summary.json holds no versions"),
        html.table(["file of this run", "bytes"], rows, ["", "n"]) if rows else "",
        design,
    )


def _facts(part: Mapping[str, Any], **labels: str) -> str:
    """Figures of a step's summary in a line, those that are there."""
    items = [
        f"<li><b>{html.number(part[key])}</b> {escape(label)}</li>"
        for key, label in labels.items()
        if isinstance(part.get(key), int | float | str)
    ]
    return f'<ul class="facts">{"".join(items)}</ul>' if items else ""
