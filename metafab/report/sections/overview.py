"""Head of the page: the device in one line, the most important figures, loss chain and error budget."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from metafab.core.figures import LightMapping, OrdersFigures
from metafab.report import html
from metafab.report.accounts import loss_chain
from metafab.report.html import Drawn
from metafab.report.run_folder import RunFolder
from metafab.spec.light import light_label
from metafab.spec.terms import Grating, PhaseTerm
from metafab.steps.layout import LayoutFigures
from metafab.steps.optics.lights import LightFigures, LightsFigures
from metafab.steps.optics.merit import MeritFigures
from metafab.steps.summary import SUMMARY_FILE, UNCHANGED, Saving

#: Mean relative depth error below which the headline is marked as good.
_GOOD_DEPTH_ERROR = 0.01
#: Most lights whose figures are listed one by one.
_LISTED_LIGHTS = 3
#: Files that grow or change after the page is written: their sizes would make two pages of one run differ.
_LATER = {"report.html", "steps.json", SUMMARY_FILE}


def headlines(run: RunFolder) -> str:
    """The most important figures, in large type."""
    summary = run.summary
    nmae = None if summary.decode is None else summary.decode.nmae
    items = []
    if nmae is not None:
        tone = "good" if nmae < _GOOD_DEPTH_ERROR else "bad"
        items.append(html.headline(f"{100 * nmae:.2g}\u202f%", "mean depth error", tone))
    if summary.phase is not None:
        rotation = summary.phase.rotation_deg
        if rotation is not None:
            items.append(html.headline(f"{abs(rotation):.0f}°", "rotation of the PSF pair over the depths"))
    if summary.picture is not None:
        items.append(html.headline(f"{100 * summary.picture[0]:.0f}\u202f%", f"of the light {summary.picture[1]}"))
    solved = summary.orders is not None and summary.orders.sites is not None
    if summary.orders is not None and solved:
        items.append(_by_full_wave(summary.orders))
    among_neighbours = None if summary.orders is None else summary.orders.efficiency_ratio
    if summary.lights is None and summary.merit is not None and run.forms_images and nmae is None:
        items += _focus(summary.merit, among_neighbours)
    elif among_neighbours is not None:
        text = "of the light of equal neighbours in the focus, by full wave of rows of unlike neighbours"
        items.append(html.headline(f"{100 * among_neighbours:.0f}\u202f%", text))
    if summary.lights is not None and run.forms_images:
        items += _lights(summary.lights, summary.layout)
    terms = () if run.design is None else run.design.phase
    if summary.layout is not None and not solved and terms and all(isinstance(term, Grating) for term in terms):
        items.append(html.headline(f"{100 * summary.layout.efficiency:.0f}\u202f%", _orders(terms)))
    if summary.layout is not None:
        items.append(html.headline(html.number(summary.layout.pillars), "pillars"))
    if summary.drc is not None:
        broken = summary.violations
        items.append(html.headline(html.number(broken), "rules broken", "bad" if broken else "good"))
    return f'<ul class="headlines">{"".join(items)}</ul>' if items else ""


def _by_full_wave(orders: OrdersFigures) -> str:
    """Light in the wanted orders by full wave, beside the library's."""
    (x, _, of_x), (y, _, of_y) = orders.wanted("x"), orders.wanted("y")
    text = (
        "of x · of y polarised light in the wanted order, by full wave "
        f"(each pillar among equal ones: {100 * of_x:.0f} · {100 * of_y:.0f}\u202f%)"
    )
    return html.headline(f"{100 * x:.0f} · {100 * y:.0f}\u202f%", text)


def _orders(gratings: Sequence[PhaseTerm]) -> str:
    """Label of the light that a deflector sends into the order of its target phases."""
    (grating, *others) = gratings
    at = f" at {grating.angle_deg:g}°" if isinstance(grating, Grating) and not others else ""
    return f"of the light in the wanted order{at}"


def _lights(figures: LightsFigures, layout: LayoutFigures | None) -> list[str]:
    """Share of each light in the wanted wave, and the Strehl ratio of each focus along the axis."""
    mapped = [(each, each.figures.efficiency) for each in (layout and layout.lights) or ()]
    strehl = [(each, each.focus.strehl) for each in figures.lights if each.focus is not None]
    items = []
    if mapped:
        lights, shares = zip(*mapped, strict=True)
        text = _listed([100 * share for share in shares], "{:.0f}") + "\u202f%"
        items.append(html.headline(text, f"of the light in the wanted wave at {_labels(lights)}"))
    if strehl:
        lights, ratios = zip(*strehl, strict=True)
        where = _labels(lights) + " along the axis" * (len(lights) < len(figures.lights))
        items.append(html.headline(_listed(ratios, "{:.2f}"), f"Strehl ratio at {where}"))
    return items


def _listed(values: Sequence[float], pattern: str) -> str:
    """Up to three values one by one, more by their range."""
    if len(values) > _LISTED_LIGHTS:
        return f"{pattern.format(min(values))} to {pattern.format(max(values))}"
    return " · ".join(map(pattern.format, values))


def _labels(lights: Sequence[LightFigures | LightMapping]) -> str:
    """Wavelengths of light along the axis, directions of light of one wavelength, or both."""
    if len(lights) > _LISTED_LIGHTS:
        return f"{len(lights)} lights"
    if not any(light.angle_x_deg or light.angle_y_deg for light in lights):
        return ", ".join(f"{light.wavelength_nm:g}" for light in lights) + " nm"
    if len({light.wavelength_nm for light in lights}) == 1 and not any(light.angle_y_deg for light in lights):
        return ", ".join(f"{light.angle_x_deg:g}°" for light in lights)
    return "; ".join(light_label(light.wavelength_nm, light.angle_x_deg, light.angle_y_deg) for light in lights)


def _focus(merit: MeritFigures, among_neighbours: float | None) -> list[str]:
    """Efficiency of a lens by the library, times the share that full-wave rows leave of it, and its focus."""
    lone = 0.5 * (merit.pinhole_efficiency_x[0] + merit.pinhole_efficiency_y[0])
    text = f"of the light in a pinhole of {merit.pinhole_um:.3g} µm"
    if among_neighbours is not None:
        text += f", by full wave of rows of unlike neighbours (among equal neighbours: {100 * lone:.0f}\u202f%)"
    items = [html.headline(f"{100 * lone * (among_neighbours or 1.0):.0f}\u202f%", text)]
    if merit.focus is not None:
        width_um = 0.5 * (merit.focus.fwhm_x_um + merit.focus.fwhm_y_um)
        items.append(html.headline(f"{merit.focus.strehl:.3f}", "Strehl ratio"))
        if math.isfinite(width_um):
            items.append(html.headline(f"{width_um:.3g} µm", f"FWHM; ideal lens {merit.focus.fwhm_limit_um:.3g} µm"))
    return items


def subtitle(run: RunFolder) -> str:
    """The device in one line."""
    outline, parts = run.outline, []
    if outline.aperture_um is not None:
        aperture = outline.aperture_um
        size = f"{aperture / 1000:g} mm" if aperture >= 1000 else f"{aperture:g} µm"
        parts.append(f"{size} {outline.aperture_shape}")
    if outline.focal_length_mm is not None:
        parts.append(f"{'focal length' if outline.focuses else 'sensor at'} {outline.focal_length_mm:.6g} mm")
    if outline.lights:
        parts.append("; ".join(outline.lights))
    elif outline.wavelength_nm is not None:
        parts.append(f"{outline.wavelength_nm:g} nm")
    if outline.terms:
        parts.append(" + ".join(term.replace("_", " ") for term in outline.terms))
    return escape(" · ".join(parts))


def accounts(run: RunFolder, drawn: Drawn) -> str:
    """Loss chain and error budget."""
    rows = [
        [
            escape(line.source),
            "not measured" if line.value is None else html.number(line.value),
            escape(line.unit),
            html.prose(line.how),
        ]
        for line in run.summary.error_budget
    ]
    figures = [name for name in drawn if name == "loss_chain" or name.startswith("error_budget")]
    return html.section(
        "accounts",
        "Losses of light, and sources of error",
        html.figures(drawn, *figures),
        html.paragraph(f"Losses of light at {run.outline.own_light}.", "caption") if run.outline.own_light else "",
        "" if loss_chain(run) else html.note(run.notes.get("psf", "the run holds no efficiencies: no loss chain")),
        html.table(["source", "error", "unit", "measurement"], rows, ["", "n"], "stack")
        if rows
        else html.note("summary.json holds no error budget"),
    )


def skipped(run: RunFolder) -> str:
    """Steps that the design does not need, and work that the others left out.

    Times and memory stand in ``summary.json`` alone, so that equal runs give equal pages.
    """
    steps = [[escape(entry.step), html.prose(entry.why)] for entry in run.summary.skipped if entry.why != UNCHANGED]
    savings = [_saving(entry) for entry in run.summary.saved]
    unneeded = html.note("the design needs every step")
    if steps:
        unneeded = html.table(["skipped step", "reason"], steps, kind="stack")
    head = ["step", "pieces of work", "computed", "of", "safe because", "error"]
    return html.section(
        "skipped",
        "Skipped work",
        unneeded,
        html.table(head, savings, ["", "", "n", "n", "", ""]) if savings else "",
    )


def _saving(entry: Saving) -> list[str]:
    """Row of a saving."""
    of = "a continuum" if entry.of is None else html.number(entry.of)
    error = "none" if entry.error_of is None else "not measured"
    if entry.error is not None and entry.error_of is not None:
        error = f"{html.number(entry.error, 2)} ({escape(entry.error_of)})"
    return [entry.step, entry.what, html.number(entry.computed), of, html.prose(entry.why), error]


def provenance(run: RunFolder) -> str:
    """Versions, files and design of the run."""
    versions = "\u2002".join(f"{escape(name)}\u00a0{escape(version)}" for name, version in run.summary.versions.items())
    files = sorted(p for p in run.path.iterdir() if p.is_file() and not p.name.startswith("."))
    rows = [
        [f'<a href="{escape(p.name)}">{escape(p.name)}</a>', html.number(p.stat().st_size)]
        for p in files
        if p.name not in _LATER
    ]
    design = ""
    if (run.path / "design.toml") in files:
        text = (run.path / "design.toml").read_text(encoding="utf-8")
        design = f"<details><summary>design.toml</summary><pre>{escape(text)}</pre></details>"
    return html.section(
        "provenance",
        "Provenance",
        html.paragraph(versions) if versions else html.note("summary.json holds no versions"),
        html.table(["file of this run", "bytes"], rows, ["", "n"]) if rows else "",
        design,
    )
