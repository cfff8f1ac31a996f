"""A run in a dozen lines: what somebody at a terminal wants to know, and where the rest stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

#: Label, step, key of its part of the summary, and how the value is said; lines without a value are left out.
_LINES: tuple[tuple[str, str, str, Callable[[Any], str]], ...] = (
    ("library error", "library", "max_error", lambda v: f"{v:.2g} of complex t at worst"),
    ("phase reach", "library", "coverage_rad", lambda v: f"{v:.3g} rad"),
    ("peak gain", "phase", "peak_gain", lambda v: f"{v:.3g}"),
    ("hologram", "phase", "hologram_efficiency", lambda v: f"{100.0 * v:.1f} % of the light in the picture"),
    ("likeness", "phase", "hologram_correlation", lambda v: f"{v:.3f} (correlation with the picture)"),
    ("pillars", "layout", "pillars", lambda v: f"{v:,}".replace(",", " ")),
    ("phase error", "layout", "phase_rms_error_rad", lambda v: f"{v:.3g} rad rms"),
    ("transmittance", "layout", "mean_transmittance", lambda v: f"{100.0 * v:.1f} %"),
    ("smallest gap", "drc", "min_gap_nm", lambda v: f"{v:g} nm"),
    ("rules broken", "drc", "violations", lambda v: str(sum(v.values()))),
    ("PSF error", "psf", "error", lambda v: f"{max(v):.2g} at worst (relative L2)"),
    ("efficiency", "psf", "efficiency_x", lambda v: f"{100.0 * sum(v) / len(v):.1f} % in the window (x)"),
    ("rotation", "merit", "rotation_deg", lambda v: f"{v:.1f} degrees over the depths"),
    ("depth error", "decode", "nmae", lambda v: f"{100.0 * v:.2g} % mean"),
)


def headlines(summary: Mapping[str, Any], folder: Path) -> dict[str, str]:
    """The few figures of a run that matter most, and its report's path, by label.

    Args:
        summary: of the run, as in ``summary.json``; what a step does not have is left out.
        folder: the run folder.
    """
    found = {
        label: say(value) for label, step, key, say in _LINES if (value := summary.get(step, {}).get(key)) is not None
    }
    if not summary.get("study") and "peak_gain" not in summary.get("phase", {}):
        found.pop("rotation", None)  # without spiral zones nothing turns
    total = sum(summary.get("seconds", {}).values())
    found["time"] = f"{total:.3g} s in all steps"
    found["all figures"] = str(folder / "summary.json")
    found["report"] = str(folder / "report.html")
    return found
