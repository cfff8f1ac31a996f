"""Loss chain and decoded against true depth of a run, as data for the figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.camera.frames.frame import RawFrame
from metafab.core.conventions import FloatArray
from metafab.decode.image import Image4D
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
    true_m = None if decoded is None or run.raw is None else _truth_on(decoded, run.raw)
    if decoded is None or true_m is None:
        return None
    errors = {figures.number: figures.error_m for figures in decoded.segments}
    rows = []
    for number in np.unique(decoded.segment[decoded.segment > 0]):
        inside = (decoded.segment == number) & np.isfinite(decoded.depth_m) & np.isfinite(true_m)
        if inside.any():
            rows.append((np.median(true_m[inside]), np.median(decoded.depth_m[inside]), errors.get(int(number), 0.0)))
    return DepthPairs(*np.array(rows, dtype=np.float64).T) if rows else None


def _truth_on(decoded: Image4D, raw: RawFrame) -> FloatArray | None:
    """True depth at the decoded pixels, NaN outside the truth's grid; both grids share the pixel pitch."""
    if raw.truth is None or raw.truth_origin_um is None:
        return None
    true_m = np.full(decoded.depth_m.shape, np.nan)
    indices = []
    for axis in (1, 0):
        offset = (decoded.origin_um[axis] - raw.truth_origin_um[axis]) / raw.pixel_um
        indices.append(np.arange(decoded.depth_m.shape[1 - axis]) + round(offset))
    row, column = np.meshgrid(*indices, indexing="ij")
    n_y, n_x = raw.truth.depth_m.shape
    known = (row >= 0) & (row < n_y) & (column >= 0) & (column < n_x)
    true_m[known] = raw.truth.depth_m[row[known], column[known]]
    return true_m
