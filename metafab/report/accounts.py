"""Loss chain and decoded against true depth of a run, as data for the figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.decode.evaluation import overlap
from metafab.report.run_folder import RunFolder


@dataclass(frozen=True)
class Stage:
    """A stage of the loss chain."""

    name: str  #: Name of the stage.
    share: float  #: Remaining share of the light at the aperture, mean over polarisations and depths.


@dataclass(frozen=True)
class DepthPairs:
    """Decoded and true depth of the segments."""

    true_m: FloatArray  #: Shape (n,), true depth, median over the pixels of the segment.
    decoded_m: FloatArray  #: Shape (n,), decoded depth.
    error_m: FloatArray  #: Shape (n,), standard error of the decoded depth.


def loss_chain(run: RunFolder) -> list[Stage]:
    """Shares of the light at the aperture after each stage.

    With figures of merit, the chain is theirs, to a pinhole, a picture's frame or the target wave. Without them, it
    ends in the window of the PSF, and a last stage holds the target phases for comparison.
    """
    merit = run.summary.merit
    if merit is not None:
        stages, share = [Stage("at the aperture", 1.0)], 1.0
        for loss in merit.loss_chain.losses:
            if loss.factor is not None:
                share *= float(np.mean(loss.factor))
                stages.append(Stage(loss.stage, share))
        return stages
    if run.psf is None:
        return []
    stages = [Stage("at the aperture", 1.0)]
    figures = run.summary.psf
    if run.outline.has_mask and figures is not None:
        transmitted = [share for share in (figures.transmitted_x, figures.transmitted_y) if share is not None]
        if transmitted:
            stages.append(Stage("through the pillars", float(np.mean(transmitted))))
    stages.append(Stage("in the window of its PSF", float(np.mean(run.psf.efficiency))))
    if run.ideal_psf is not None:
        ideal = float(np.mean(run.ideal_psf.efficiency))
        stages.append(Stage("for comparison: target phases, in the window", ideal))
    return stages


def depths_against_truth(run: RunFolder) -> DepthPairs | None:
    """True and decoded depth of every segment with known truth; None without any."""
    decoded = run.decoded
    both = None if decoded is None or run.raw is None else overlap(decoded, run.raw)
    if decoded is None or both is None:
        return None
    here, truth = both
    segment, depth_m, true_m = decoded.segment[here], decoded.depth_m[here], truth.depth_m
    errors = {figures.number: figures.error_m for figures in decoded.segments}
    rows = []
    for number in np.unique(segment[segment > 0]):
        inside = (segment == number) & np.isfinite(depth_m) & np.isfinite(true_m)
        if inside.any():
            rows.append((np.median(true_m[inside]), np.median(depth_m[inside]), errors.get(int(number), 0.0)))
    return DepthPairs(*np.array(rows, dtype=np.float64).T) if rows else None
