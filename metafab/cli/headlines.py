"""The most important figures of a run, as text."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

from metafab.cli.again import pages

if TYPE_CHECKING:
    from metafab.core.figures import PhaseFigures
    from metafab.steps import RunSummary
    from metafab.steps.exposure import PrintedFigures
    from metafab.steps.layout import LayoutFigures
    from metafab.steps.library import LibraryFigures


def headlines(summary: RunSummary, folder: Path) -> dict[str, str]:
    """Return the most important figures of a run and the path of its report, as text by label."""
    lines: dict[str, str] = {}
    if summary.library is not None:
        lines |= _of_library(summary.library, summary.layout)
    if summary.phase is not None:
        lines |= _of_phase(summary.phase, summary.picture)
    if (layout := summary.layout) is not None:
        lines["pillars"] = f"{layout.pillars:,}".replace(",", " ")
        lines["phase error"] = f"{layout.phase_rms_error_rad:.3g} rad rms"
        lines["transmittance"] = f"{100.0 * layout.mean_transmittance:.1f} %"
    if (drc := summary.drc) is not None:
        if drc.min_gap_nm is not None:
            lines["smallest drawn gap"] = f"{drc.min_gap_nm:g} nm"
        lines["rules broken"] = str(summary.violations)
    if summary.exposure is not None:
        lines["printed sizes"] = _printed(summary.exposure)
    if (psf := summary.psf) is not None:
        efficiency = sum(psf.efficiency_x) / len(psf.efficiency_x)
        lines["PSF error"] = f"{max(psf.error):.2g} at most (relative L2)"
        lines["efficiency"] = f"{100.0 * efficiency:.1f} % in the window (x)"
    if summary.orders is not None:
        lines[summary.orders.label] = summary.orders.sentence
    has_zones = summary.phase is not None and summary.phase.peak_gain is not None
    has_bandwidth = summary.study is not None and summary.study.bandwidth is not None
    if summary.merit is not None and (has_zones or has_bandwidth):
        lines["rotation"] = f"{summary.merit.rotation_deg:.1f} degrees over the depths"
    if summary.decode is not None and summary.decode.nmae is not None:
        lines["depth error"] = f"{100.0 * summary.decode.nmae:.2g} % mean"
    return lines | _times(summary) | pages(folder)


def _of_library(library: LibraryFigures, layout: LayoutFigures | None) -> dict[str, str]:
    """Error of the sizes that the mask uses, weighted by pillars, beside the worst of them; range of phases."""
    lines: dict[str, str] = {}
    alone = ", without that of the imported sweep" if library.is_imported else ""
    if layout is not None and layout.library_error is not None:
        worst = f"{layout.worst_library_error:.2g} at worst{alone}"
        lines["library error"] = f"{layout.library_error:.2g} of complex t (rms over the pillars), {worst}"
    elif not isnan(library.max_error):
        lines["library error"] = f"{library.max_error:.2g} of complex t at most{alone}"
    lines["phase reach"] = f"{library.coverage_rad:.3g} rad"
    return lines


def _of_phase(phase: PhaseFigures, picture: tuple[float, str] | None) -> dict[str, str]:
    """Gain of a helix, and light in the picture of a hologram."""
    lines: dict[str, str] = {}
    if phase.peak_gain is not None:
        lines["peak gain"] = f"{phase.peak_gain:.3g}"
    if picture is not None:
        lines["hologram"] = f"{100.0 * picture[0]:.1f} % of the light {picture[1]}"
    if phase.hologram_correlation is not None:
        lines["likeness"] = f"{phase.hologram_correlation:.3f} (correlation with the picture)"
    return lines


def _printed(figures: PrintedFigures) -> str:
    """Errors of the printed sizes, before and after the correction."""
    corrected = figures.corrected_rms_nm
    after = "" if corrected is None else f", {corrected:.2g} nm with corrected doses or shapes"
    if isnan(figures.cd_error_rms_nm):
        return f"no pillar prints with one dose{after}"
    left_out = f" (without {figures.unprinted} pillars that do not print)" if figures.unprinted else ""
    return f"{figures.cd_error_rms_nm:.2g} nm off (rms) with one dose{left_out}{after}"


def _times(summary: RunSummary) -> dict[str, str]:
    """Time of the steps that ran, and of those that were skipped because nothing had changed, when they ran last."""
    from metafab.steps.summary import UNCHANGED

    unchanged = {entry.step for entry in summary.skipped if entry.why == UNCHANGED}
    spent_s = sum(seconds for step, seconds in summary.seconds.items() if step not in unchanged)
    lines = {"time": f"{spent_s:.3g} s in the steps that ran"}
    if unchanged:
        # A run that was interrupted leaves no times.
        saved_s = [summary.seconds[step] for step in unchanged if step in summary.seconds]
        took = f", which took {sum(saved_s):.3g} s when they last ran" if len(saved_s) == len(unchanged) else ""
        lines["skipped"] = f"unchanged steps: {len(unchanged)}{took}"
    return lines
