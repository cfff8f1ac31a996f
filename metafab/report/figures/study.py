"""What the phases are worth: the lobe over a turn, bounds of depth for several masks, the cost of the colour filter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes

from metafab.core.conventions import FloatArray
from metafab.phase.studies.bandwidth import BandwidthBudget
from metafab.phase.studies.compare import DepthBounds
from metafab.phase.studies.propose import Proposal
from metafab.phase.studies.study import LobeOverDepth
from metafab.report.style import (
    GOOD,
    HAIRLINE,
    IDEAL,
    INK,
    MUTED,
    X_COLOUR,
    Y_COLOUR,
    depth_unit,
    dress,
    legend,
    logarithmic,
)

_INKS = (X_COLOUR, IDEAL, Y_COLOUR, GOOD, INK)
_FOCUS = "vergence from the focus / dioptre"


def lobe_peak(lobe: LobeOverDepth, axes: Axes) -> Axes:
    """Peak of the main lobe over one turn, before and after the optimisation; the verified depths are shaded."""
    axes.axvspan(*lobe.range_per_m, color=HAIRLINE, alpha=0.6, linewidth=0.0)
    axes.plot(lobe.vergence_per_m, lobe.plain.peak, color=Y_COLOUR, linewidth=1.4, label="plain spiral, Eq. 2")
    axes.plot(lobe.vergence_per_m, lobe.design.peak, color=X_COLOUR, linewidth=1.6, label="this design")
    dress(axes, _FOCUS, "Strehl ratio of the lobe", "Main lobe over one turn")
    axes.set_ylim(0.0, 1.35 * float(max(lobe.design.peak.max(), lobe.plain.peak.max())))
    return _finished(axes)


def lobe_orientation(lobe: LobeOverDepth, axes: Axes) -> Axes:
    """Orientation of the main lobe over one turn against the law of rotation; the verified depths are shaded."""
    axes.axvspan(*lobe.range_per_m, color=HAIRLINE, alpha=0.6, linewidth=0.0)
    axes.plot(lobe.vergence_per_m, lobe.law_deg, color=IDEAL, linewidth=3.5, alpha=0.6, label="law of rotation")
    axes.plot(lobe.vergence_per_m, lobe.design.phi_deg, color=X_COLOUR, linewidth=1.4, label="this design")
    dress(axes, _FOCUS, "orientation φ / °", "The lobe turns evenly")
    return _finished(axes)


def depth_bounds(bounds: DepthBounds, axes: Axes, of: Literal["point", "texture"]) -> Axes:
    """Smallest standard deviation of depth that a mask allows, over depth; masks that allow none are named."""
    scale, unit = depth_unit(bounds.depth_m)
    curves = bounds.point_m if of == "point" else bounds.texture_m
    for name, curve, ink in zip(bounds.masks, curves, _INKS, strict=False):
        told = bool(np.isfinite(curve).any())
        label = name if told else f"{name}: nothing"
        axes.plot(scale * bounds.depth_m, 1e3 * curve, color=ink, linewidth=1.5, label=label)
    title = "Smallest error, known point source" if of == "point" else "Smallest error, unknown texture"
    dress(axes, f"object depth / {unit}", "σ of depth / mm", title)
    logarithmic(axes, "y")
    finite = 1e3 * curves[np.isfinite(curves)]
    if finite.size:
        axes.set_ylim(0.6 * float(finite.min()), 6.0 * float(finite.max()))
    return _finished(axes)


def filter_tradeoff(budget: BandwidthBudget, axes: Axes) -> Axes:
    """Error of depth against the width of the filter, for several angles of the split; the chosen ones are marked."""
    curves = budget.tradeoff
    chosen = int(np.argmin(np.abs(curves.fwhm_nm - budget.fwhm_nm)))
    for angle, error, ink in zip(curves.angle_deg[::-1], curves.relative_error[::-1], _INKS, strict=False):
        axes.plot(curves.fwhm_nm, error, color=ink, linewidth=1.5, label=f"split by {angle:.3g}°")
    axes.plot(curves.fwhm_nm[chosen], curves.relative_error[-1, chosen], "o", color=X_COLOUR, label="this design")
    dress(axes, "width of the filter / nm", "σ of depth, relative", "Light against smear")
    logarithmic(axes, "x")
    ticks = [tick for tick in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200) if _within(tick, curves.fwhm_nm)]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
    axes.set_xticks([], minor=True)
    axes.set_ylim(bottom=0.0)
    return _finished(axes)


def filter_orientation(budget: BandwidthBudget, axes: Axes) -> Axes:
    """Information kept behind the filter against the direction of the split; 0 is the design's."""
    closed = np.append(budget.azimuth_deg, 360.0)
    axes.plot(closed, np.append(budget.kept_by_azimuth, budget.kept_by_azimuth[0]), color=X_COLOUR, linewidth=1.5)
    axes.plot(0.0, budget.kept, "o", color=X_COLOUR, label="this design", clip_on=False)
    dress(axes, "split turned against the mask by / °", "information kept", "Direction of the split")
    axes.set(xlim=(0.0, 360.0), ylim=(0.0, 1.0), xticks=(0, 90, 180, 270, 360))
    return _finished(axes)


def proposals(found: Sequence[Proposal], axes: Axes) -> Axes:
    """Smallest relative error over depth of several choices of [L, epsilon], the first one strongest."""
    scale, unit = depth_unit(found[0].depth_m)
    for rank, (proposal, ink) in enumerate(zip(found, _INKS, strict=False)):
        line: dict[str, Any] = {"color": ink, "linewidth": 2.0 if rank == 0 else 1.2}
        label = f"L = {proposal.zones}, ε = {proposal.exponent:g}: turns {proposal.rotation_deg:.0f}°"
        axes.plot(scale * proposal.depth_m, 100.0 * proposal.crlb_m / proposal.depth_m, label=label, **line)
    dress(axes, f"object depth / {unit}", "σ of depth / depth, %", "Smallest error, unknown texture")
    axes.set_ylim(0.0, 160.0 * max(float((p.crlb_m / p.depth_m).max()) for p in found[: len(_INKS)]))
    return _finished(axes)


def proposed_orientation(found: Sequence[Proposal], axes: Axes) -> Axes:
    """Turn of the main lobe from the nearest depth on, for the same choices."""
    scale, unit = depth_unit(found[0].depth_m)
    for rank, (proposal, ink) in enumerate(zip(found, _INKS, strict=False)):
        line: dict[str, Any] = {"color": ink, "linewidth": 2.0 if rank == 0 else 1.2}
        axes.plot(scale * proposal.depth_m, proposal.phi_deg - proposal.phi_deg[0], **line)
    dress(axes, f"object depth / {unit}", "turn of the lobe / °", "The lobe turns once at most")
    return _finished(axes)


def _within(value: float, range_of: FloatArray) -> bool:
    return bool(range_of[0] <= value <= range_of[-1])


def _finished(axes: Axes) -> Axes:
    axes.grid(color=MUTED, linewidth=0.4, alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        legend(axes)
    return axes
