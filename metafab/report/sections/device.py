"""Target phases, mask, its exposure, full-wave simulations of its parts, and library."""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING

from metafab.core.conventions import POLARISATIONS
from metafab.core.figures import MappingFigures, OrdersFigures
from metafab.optics.point_spread import NeighbourMap
from metafab.report import html
from metafab.report.html import Drawn
from metafab.report.run_folder import RunFolder

if TYPE_CHECKING:
    from metafab.exposure import SizeErrors
    from metafab.fullwave import Coupling, Patch


def phases(run: RunFolder, drawn: Drawn) -> str:
    """Target phases over the aperture, their lobe and depth bounds, and the colour filter."""
    figures = run.summary.phase
    facts = (
        {}
        if figures is None
        else {
            "peak gain of the optimisation": figures.peak_gain,
            "rotation / °": figures.rotation_deg,
            "of the light in the picture, by the target phases": figures.hologram_efficiency,
            "correlation with the picture": figures.hologram_correlation,
        }
    )
    bounds = "Cramér-Rao bounds at equal aperture and equal light, by the paraxial pupil; no decoder does better."
    return html.section(
        "phases",
        "Target phases",
        html.facts(facts),
        html.figures(drawn, "phase_x", "phase_y"),
        _flat(run),
        html.figures(drawn, "hologram_wanted", "hologram_found"),
        html.figures(drawn, "lobe_peak", "lobe_orientation"),
        html.figures(drawn, "bounds_point", "bounds_texture"),
        html.paragraph(bounds, "caption") if "bounds_point" in drawn else _without_bounds(run),
        _filter(run, drawn),
    )


def _without_bounds(run: RunFolder) -> str:
    """Note where no bounds of depth are drawn; a device without a lobe measures no depth."""
    reason = run.notes.get("study", "a single depth has no bounds over depth" if run.outline.has_lobe else "")
    return html.note(reason) if reason else ""


def _flat(run: RunFolder) -> str:
    """Note where no phases are drawn."""
    if run.phases is None:
        return html.note(run.notes.get("phases", "no phases"))
    carriers = run.outline.carriers or "carriers"
    return "" if run.phases.vary else html.note(f"the target is the phase of the {carriers} alone")


def _filter(run: RunFolder, drawn: Drawn) -> str:
    """Cost of the colour filter, and changes that reduce it."""
    figures = None if run.summary.study is None else run.summary.study.bandwidth
    if figures is None:
        return ""
    facts = {
        "nm filter": figures.filter_fwhm_nm,
        "µm of dispersion a nanometre": figures.dispersion_um_per_nm,
        "µm smear": figures.smear_um,
        "of the information kept": figures.information_kept,
        "times the depth error of one wavelength": figures.depth_error_factor,
    }
    rows = [
        [escape(remedy.change), html.number(remedy.information_kept), html.number(remedy.depth_error_factor)]
        for remedy in figures.remedies
    ]
    return (
        "<h3>Colour filter</h3>"
        + html.facts(facts)
        + html.figures(drawn, "filter", "filter_orientation")
        + html.table(["remedy", "information kept", "depth error relative to this design"], rows, ["", "n", "n"])
    )


def mask(run: RunFolder, drawn: Drawn) -> str:
    """Written pillars, their files, and the design rules; empty for a design without a mask."""
    if not run.outline.has_mask:
        return ""
    figures = run.summary.layout
    facts, files = "", ""
    if figures is not None:
        counts = {
            "pillars": figures.pillars,
            "sizes": figures.distinct_sizes,
            "smallest gap of standing pillars / nm": figures.min_gap_nm,
        }
        facts = html.facts(counts | _mapping(figures))
        if figures.gap_rule_each is not None:
            facts += "<h3>With the gap rule kept by each pillar alone</h3>"
            facts += html.facts(_mapping(figures.gap_rule_each))
        if (time := figures.write_time) is not None:
            facts += "<h3>Writing</h3>"
            facts += html.facts(
                {
                    "s in all": time.seconds,
                    "s of beam": time.beam_seconds,
                    "trapezoids": time.trapezoids,
                    "shots": time.shots,
                    "write fields": time.fields,
                    "nm of drift between fields, rms": time.stitching_rms_nm,
                }
            )
        rows = [[escape(file.name), html.number(file.bytes)] for file in figures.files]
        files = f"<div><h3>Files</h3>{html.table(['file', 'bytes'], rows, ['', 'n'])}</div>"
    return html.section(
        "mask",
        "Mask",
        facts,
        html.figures(drawn, "mask", "mask_wide", "mask_close"),
        html.paragraph(f"Drawn from {escape(run.mask_file)}, the file for the mask writer.", "caption")
        if run.pillars is not None
        else html.note(run.notes.get("mask", "no mask")),
        html.grid([_rules(run), files]),
    )


def _mapping(figures: MappingFigures) -> dict[str, float | None]:
    return {
        "phase error / rad rms": figures.phase_rms_error_rad,
        "mean transmittance": figures.mean_transmittance,
        "efficiency of the mapping": figures.efficiency,
    } | (
        {}
        if figures.neighbour_efficiency is None
        else {
            "efficiency among neighbours": figures.neighbour_efficiency,
            "of the sizes for equal neighbours": figures.neighbour_efficiency_before,
            "local phase error among neighbours / rad rms": figures.neighbour_phase_rms_error_rad,
            "of the sizes for equal neighbours / rad rms": figures.neighbour_phase_rms_error_before_rad,
        }
    )


def _rules(run: RunFolder) -> str:
    drc = run.summary.drc
    if drc is None:
        return html.note("no design-rule results in summary.json")
    rows = [
        [
            escape(rule.replace("_", " ")),
            html.number(count),
            '<span class="good">kept</span>' if count == 0 else '<span class="bad">broken</span>',
        ]
        for rule, count in drc.violations.items()
    ]
    links = "".join(
        f' <a href="{escape(path.name)}">{escape(path.name)}</a>' for path in sorted(run.path.glob("*.lyrdb"))
    )
    markers = f" Violations, for KLayout:{links}." if links else ""
    checked = f"{html.number(drc.pillars)} pillars by the {escape(drc.engine)} engine"
    return (
        "<div><h3>Design rules</h3>"
        + html.paragraph(f"Checked on the written file: {checked}.{markers}")
        + html.table(["rule", "violations", ""], rows, ["", "n"])
        + "</div>"
    )


def exposure(run: RunFolder, drawn: Drawn) -> str:
    """Printed sizes with one dose and after the correction; empty without ``exposure.json``."""
    title, record = "Exposure: printed sizes", run.exposure
    if record is None:
        return html.section("exposure", title, html.note(run.notes["exposure"])) if "exposure" in run.notes else ""
    head = ["", "rms / nm", "largest / nm", "mean / nm", "nm for 1 % of dose", "doses", "classes", "not printed"]
    rows = [_printed("one dose", record.plain)]
    if record.corrected is not None:
        rows.append(_printed(f"corrected {record.correction}s", record.corrected))
        figures = record.corrected.figures
        if figures.continuous_rms_nm is not None and figures.continuous_max_nm is not None:
            sizes = map(html.number, (figures.continuous_rms_nm, figures.continuous_max_nm))
            rows.append(["before rounding to classes", *sizes, *[""] * 5])
    caption = (
        f"Printed less wanted widths and lengths by the threshold model. Beam: {record.psf_source}. Maps: means over "
        "blocks. Process window: mean and one standard deviation."
    )
    return html.section(
        "exposure",
        title,
        html.table(head, rows, ["", *["n"] * 7]),
        html.figures(drawn, "exposure_map_plain", "exposure_map_corrected"),
        html.figures(drawn, "exposure_histogram", "exposure_window"),
        html.paragraph(escape(caption), "caption"),
    )


def _printed(name: str, errors: SizeErrors) -> list[str]:
    found = errors.figures
    sizes = (found.cd_error_rms_nm, found.cd_error_max_nm, found.cd_bias_nm, found.latitude_nm_per_percent)
    doses = f"{html.number(found.dose_min)} to {html.number(found.dose_max)}"
    return [escape(name), *map(html.number, sizes), doses, html.number(found.classes), html.number(found.unprinted)]


def fullwave(run: RunFolder, drawn: Drawn) -> str:
    """Light of unlike neighbours: the model's maps, and full-wave simulations of parts of the mask; empty without."""
    maps = _neighbour_maps(run.psf.neighbours, drawn) if run.psf is not None and run.psf.neighbours is not None else ""
    rows = "" if run.coupling is None else _rows(run.coupling)
    patch = _patch(run.patch, drawn) if run.patch is not None else ""
    orders = "" if run.summary.orders is None else _orders(run.summary.orders, run.summary.seconds.get("orders", 0.0))
    if not (maps or rows or patch or orders):
        return ""
    simulated = ", by full-wave simulation" if rows or patch or orders else ""
    return html.section("fullwave", f"Coupling of neighbours{simulated}", maps, orders, rows, patch)


def _neighbour_maps(found: NeighbourMap, drawn: Drawn) -> str:
    pairs = [html.figures(drawn, *(f"neighbours_{kind}_{p}" for p in POLARISATIONS)) for kind in ("change", "kept")]
    side_um = float(found.x_um[1] - found.x_um[0]) if found.x_um.size > 1 else math.nan
    caption = (
        f"Light of the pillars among their own neighbours, by the library's model, against that among equal ones, in "
        f"blocks of {side_um:.3g} µm. Change: rms of the difference over the rms among equal ones. Kept: light in the "
        "wave of pillars among equal ones, over its light; sizes that were chosen among neighbours leave that wave on "
        "purpose."
    )
    return "".join(pairs) + html.paragraph(escape(caption), "caption")


def _orders(figures: OrdersFigures, seconds: float) -> str:
    if figures.efficiency_ratio is not None:
        return html.paragraph(escape(f"{figures.sentence}."), "note")
    if figures.sites is None:
        text = f"The orders of the mask come from the library alone: {figures.reason}."
        return html.paragraph(escape(text), "note")
    head = ["light", "order", "towards x, y", "efficiency", "error", "by the library", ""]
    rows = [
        [
            row.polarisation,
            ", ".join(map(str, row.order)),
            f"{row.angle_x_deg:.2f}°, {row.angle_y_deg:.2f}°",
            f"{row.efficiency:.3f}",
            f"{row.error:.1g}",
            f"{row.library_efficiency:.3f}",
            "wanted" if row.wanted else "",
        ]
        for row in figures.orders
    ]
    caption = (
        f"The pillars of the mask repeat after {figures.sites[0]} x {figures.sites[1]}. Light in each wanted order, "
        f"and in any other of at least 3 %, far from the rim: mean of {figures.windows} unlike repeats by full wave "
        f"with periodic boundaries ({seconds:.0f} s). The error is that of the solver, of the repeats that were not "
        "solved, and of a phase that drifts over a repeat. The library takes each pillar among equal "
        "ones, as the PSFs do."
    )
    return html.table(head, rows, ["", "", "n", "n", "n", "n", ""]) + html.paragraph(escape(caption), "caption")


def _rows(coupling: Coupling) -> str:
    head = ["place / µm", "light", "solver", "pillars", "efficiency", "local-period efficiency", "field error"]
    rows = [
        [
            f"{row.x_um:g}, {row.y_um:g} along {row.axis}",
            row.polarisation,
            row.solver,
            str(row.sites),
            html.number(row.efficiency),
            html.number(row.local_period_efficiency),
            html.number(row.coupling_error),
        ]
        for row in coupling.rows
    ]
    text = "Rows of the mask over one turn of the phase: power in the focusing order; relative L2 error of the field."
    return html.table(head, rows, ["", "", "", *["n"] * 4]) + html.paragraph(text, "caption")


def _patch(patch: Patch, drawn: Drawn) -> str:
    kinds = ("phase_meep", "phase_library", "amplitude_meep", "amplitude_library", "difference_library")
    names = [f"patch_{kind}" for kind in (*kinds, "difference_coupling", "difference_model")]
    compared = [
        ("Meep against the library", patch.against_library),
        ("Meep against single pillars on Meep's grid: coupling of neighbours", patch.coupling),
        ("single pillars on Meep's grid against the library: error of the grid", patch.grid),
    ]
    if patch.model is not None:
        compared.append(("model of neighbours against this coupling, added to the library's field", patch.model))
    rows = [
        [
            escape(text),
            html.number(difference.amplitude_rms),
            html.number(difference.phase_rms_rad),
            html.number(difference.relative_l2),
        ]
        for text, difference in compared
    ]
    caption = (
        f"{patch.x_um.size} x {patch.y_um.size} pillars of the mask around ({patch.x_um.mean():.1f}, "
        f"{patch.y_um.mean():.1f}) um, {patch.polarisation} polarisation, {patch.pixels_per_period} pixels a period, "
        f"{patch.padding_sites} neighbours on each side. Propagating waves in the plane of the pillar tops."
    )
    return (
        html.figures(drawn, *names)
        + html.table(["", "amplitude rms", "phase rms / rad", "relative L2"], rows, ["", "n", "n", "n"])
        + html.paragraph(escape(caption), "caption")
    )


def library(run: RunFolder, drawn: Drawn) -> str:
    """Maps of the library; empty for a design without a mask."""
    if not run.outline.has_mask:
        return ""
    figures = run.summary.library
    facts = (
        {}
        if figures is None
        else {
            "sizes": figures.points_total or None,
            "solved sizes": figures.points_solved or None,
            "largest error of interpolation" if figures.is_imported else "largest error of t": figures.max_error,
            "phase reach / rad": figures.coverage_rad,
        }
    )
    caption = "Lines enclose the guided-mode resonances, where less than half of the light is transmitted."
    if run.library is not None and run.library.unit_cell.cell.is_round:
        caption = "Less than half of the light is transmitted in guided-mode resonances."
    return html.section(
        "library",
        "Library: response of each pillar size",
        html.facts(facts),
        html.figures(drawn, "library_phase_x", "library_phase_y", "coverage"),
        html.figures(drawn, "library_transmittance_x", "library_transmittance_y", "library_error"),
        html.paragraph(caption, "caption")
        if run.library is not None
        else html.note(run.notes.get("library", "no library")),
    )
