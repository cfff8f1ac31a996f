"""Study of the phases, proposals and comparison: lobe over one turn, depth bounds, colour filter, other cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes

from metafab.comparison import Comparison
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
    finished,
    logarithmic,
)

_INKS = (X_COLOUR, IDEAL, Y_COLOUR, GOOD, INK)
_FOCUS = "vergence from the focus / dioptre"


def lobe_peak(lobe: LobeOverDepth, axes: Axes) -> Axes:
    """Draw the peak of the main lobe over one turn, before and after the optimisation; verified depths are shaded."""
    axes.axvspan(*lobe.range_per_m, color=HAIRLINE, alpha=0.6, linewidth=0.0)
    axes.plot(lobe.vergence_per_m, lobe.plain.peak, color=Y_COLOUR, linewidth=1.4, label="plain spiral, Eq. 2")
    axes.plot(lobe.vergence_per_m, lobe.design.peak, color=X_COLOUR, linewidth=1.6, label="this design")
    dress(axes, _FOCUS, "Strehl ratio of the lobe", "Main lobe over one turn")
    axes.set_ylim(0.0, 1.35 * float(max(lobe.design.peak.max(), lobe.plain.peak.max())))
    return finished(axes)


def lobe_orientation(lobe: LobeOverDepth, axes: Axes) -> Axes:
    """Draw the orientation of the main lobe over one turn and the law of rotation; verified depths are shaded."""
    axes.axvspan(*lobe.range_per_m, color=HAIRLINE, alpha=0.6, linewidth=0.0)
    axes.plot(lobe.vergence_per_m, lobe.law_deg, color=IDEAL, linewidth=3.5, alpha=0.6, label="law of rotation")
    axes.plot(lobe.vergence_per_m, lobe.design.phi_deg, color=X_COLOUR, linewidth=1.4, label="this design")
    dress(axes, _FOCUS, "orientation φ / °", "The lobe turns evenly")
    return finished(axes)


def depth_bounds(bounds: DepthBounds, axes: Axes, of: Literal["point", "texture"]) -> Axes:
    """Draw the Cramér-Rao bound of depth over depth for each mask; masks without depth information are named."""
    scale, unit = depth_unit(bounds.depth_m)
    curves = bounds.point_m if of == "point" else bounds.texture_m
    for name, curve, ink in zip(bounds.masks, curves, _INKS, strict=False):
        label = name if np.isfinite(curve).any() else f"{name}: nothing"
        axes.plot(scale * bounds.depth_m, 1e3 * curve, color=ink, linewidth=1.5, label=label)
    title = "Smallest error, known point source" if of == "point" else "Smallest error, unknown texture"
    dress(axes, f"object depth / {unit}", "σ of depth / mm", title)
    logarithmic(axes, "y")
    finite = 1e3 * curves[np.isfinite(curves)]
    if finite.size:
        axes.set_ylim(0.6 * float(finite.min()), 6.0 * float(finite.max()))
    return finished(axes)


def filter_tradeoff(budget: BandwidthBudget, axes: Axes) -> Axes:
    """Draw the depth error over the filter width for several split angles; the design is marked."""
    curves = budget.tradeoff
    chosen = int(np.argmin(np.abs(curves.fwhm_nm - budget.fwhm_nm)))
    for angle, error, ink in zip(curves.angle_deg[::-1], curves.relative_error[::-1], _INKS, strict=False):
        axes.plot(curves.fwhm_nm, error, color=ink, linewidth=1.5, label=f"split by {angle:.3g}°")
    axes.plot(curves.fwhm_nm[chosen], curves.relative_error[-1, chosen], "o", color=X_COLOUR, label="this design")
    dress(axes, "width of the filter / nm", "σ of depth, relative", "Light against smear")
    logarithmic(axes, "x")
    low_nm, high_nm = curves.fwhm_nm[[0, -1]]
    ticks = [tick for tick in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200) if low_nm <= tick <= high_nm]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
    axes.set_xticks([], minor=True)
    axes.set_ylim(bottom=0.0)
    return finished(axes)


def filter_orientation(budget: BandwidthBudget, axes: Axes) -> Axes:
    """Draw the information kept behind the filter over the direction of the split; 0 is the design's."""
    closed = np.append(budget.azimuth_deg, 360.0)
    axes.plot(closed, np.append(budget.kept_by_azimuth, budget.kept_by_azimuth[0]), color=X_COLOUR, linewidth=1.5)
    axes.plot(0.0, budget.kept, "o", color=X_COLOUR, label="this design", clip_on=False)
    dress(axes, "split turned against the mask by / °", "information kept", "Direction of the split")
    axes.set(xlim=(0.0, 360.0), ylim=(0.0, 1.0), xticks=(0, 90, 180, 270, 360))
    return finished(axes)


def proposed_bounds(choices: Sequence[Proposal], axes: Axes) -> Axes:
    """Draw the bound of the relative depth error over depth for several choices of [L, epsilon], best first."""
    scale, unit = depth_unit(choices[0].depth_m)
    for rank, (proposal, ink) in enumerate(zip(choices, _INKS, strict=False)):
        line: dict[str, Any] = {"color": ink, "linewidth": 2.0 if rank == 0 else 1.2}
        label = f"L = {proposal.zones}, ε = {proposal.exponent:g}: turns {proposal.rotation_deg:.0f}°"
        axes.plot(scale * proposal.depth_m, 100.0 * proposal.crlb_m / proposal.depth_m, label=label, **line)
    dress(axes, f"object depth / {unit}", "σ of depth / depth, %", "Smallest error, unknown texture")
    axes.set_ylim(0.0, 160.0 * max(float((p.crlb_m / p.depth_m).max()) for p in choices[: len(_INKS)]))
    return finished(axes)


def proposed_orientation(choices: Sequence[Proposal], axes: Axes) -> Axes:
    """Draw the rotation of the main lobe from the nearest depth on, for several choices of [L, epsilon]."""
    scale, unit = depth_unit(choices[0].depth_m)
    for rank, (proposal, ink) in enumerate(zip(choices, _INKS, strict=False)):
        line: dict[str, Any] = {"color": ink, "linewidth": 2.0 if rank == 0 else 1.2}
        axes.plot(scale * proposal.depth_m, proposal.phi_deg - proposal.phi_deg[0], **line)
    dress(axes, f"object depth / {unit}", "turn of the lobe / °", "The lobe turns once at most")
    return finished(axes)


def rival_depth_errors(comparison: Comparison, axes: Axes) -> Axes:
    """Draw the rms error of depth over depth for each camera and estimate, with its scatter; its bound is dotted."""
    scale, unit = depth_unit(comparison.depth_m)
    less, more = 1.0 - comparison.error_scatter, 1.0 + comparison.error_scatter
    for name, error, bound, ink in zip(comparison.methods, comparison.error, comparison.bound, _INKS, strict=True):
        axes.plot(scale * comparison.depth_m, 100.0 * error, "o-", color=ink, linewidth=1.4, markersize=3, label=name)
        axes.plot(scale * comparison.depth_m, 100.0 * bound, color=ink, linewidth=1.0, linestyle=":")
        axes.vlines(scale * comparison.depth_m, 100.0 * less * error, 100.0 * more * error, color=ink, linewidth=0.8)
    axes.plot([], [], color=MUTED, linewidth=1.0, linestyle=":", label="bound of each")
    dress(axes, f"object depth / {unit}", "rms error of depth, %", "Depth of a textured plane")
    logarithmic(axes, "y")
    axes.set_ylim(top=20.0 * 100.0 * float(comparison.error.max()))
    return finished(axes)


def rival_sharpness(comparison: Comparison, axes: Axes) -> Axes:
    """Draw the rms error of the best linear restoration over depth for each camera; 0 is perfect."""
    scale, unit = depth_unit(comparison.depth_m)
    for name, left, ink in zip(comparison.cameras, comparison.restored, _INKS, strict=False):
        axes.plot(scale * comparison.depth_m, left, "o-", color=ink, linewidth=1.4, markersize=3, label=name)
    dress(axes, f"object depth / {unit}", "rms left over rms of the texture", "All in focus: error of the sharp image")
    axes.set_ylim(0.0, 1.7 * float(comparison.restored.max()))
    return finished(axes)
