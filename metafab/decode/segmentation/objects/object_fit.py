"""Depth and outline of a small object by a model of both images: a surface, and a rectangle or an ellipse before it.

An object no larger than the blur hides part of the texture behind it, as in the model of
:mod:`metafab.decode.segmentation.objects.object_scene`; light is blurred by the pair of its own place
(:mod:`metafab.decode.segmentation.objects.object_window`). A Gauss-Newton step solves by conjugate gradients for the
textures and for the changes of depth, rectangle and mean intensities at once. These steps converge to the joint maximum
of the posterior, whose depth is biased away from the surface, where two textures explain more. So the last steps
maximise the marginal posterior: the textures are integrated out, which adds half the gradient of the log-determinant of
their information matrix (:mod:`metafab.decode.segmentation.objects.object_solver`). The standard error of the depth is
that of the posterior of all unknowns, times a measured ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from metafab.core.parallel.executor import default_workers, kept_threads
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.objects.null_channel import Rectangle
from metafab.decode.segmentation.objects.object_scene import LEVELS_AT
from metafab.decode.segmentation.objects.object_solver import STEPS, LinearModel, determinant_slopes, wide
from metafab.decode.segmentation.objects.object_window import ObjectStart, ObjectWindow
from metafab.decode.segmentation.prepared_frame import PreparedFrame

#: Error of depth in standard errors of the posterior: rms of 100 squares of 20 to 39 px in five frames.
_ERROR_RATIO = 1.2
#: Most Gauss-Newton steps, which cross the calibrated depths.
_ROUNDS = 24
#: Relative change of depth in a Gauss-Newton step that ends the fit.
_SETTLED = 2e-3
#: Steps of conjugate gradients in a Gauss-Newton step after the start or a large change of depth.
_STEPS_FAR = 20
#: Relative change of depth that is large.
_FAR = 0.03
#: Relative change of depth below which the textures are integrated out.
_NEAR = 0.003
#: Largest changes in one Gauss-Newton step.
_LARGEST = np.array([0.06, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
#: Least and largest mean intensity over the surface's, and least half side, downsampled pixels.
_LEVELS, _LEAST_HALF = (0.1, 3.0), 0.8
#: Most objects that are fitted at once: their data stay in a core's cache.
_AT_ONCE = 10


@dataclass(frozen=True)
class FittedObject:
    """A rectangle of light before a surface."""

    vergence_per_m: float  #: 1/depth.
    relative_error: float  #: Standard error of the depth over the depth.
    rectangle: Rectangle  #: Middle from the window's middle, and half sides.


def fitted_objects(
    prepared: PreparedFrame, optics: LayerOptics, starts: Sequence[ObjectStart]
) -> list[FittedObject | None]:
    """Fit objects, each by itself; None for those beyond their surface or the nearest calibrated depth.

    Objects with windows of equal size are fitted a few at a time, as calls cost more than small transforms; all cores
    share the batches.
    """
    sides = [start.side(optics) for start in starts]
    order = sorted(range(len(starts)), key=lambda number: sides[number])
    groups = [list(group) for _, group in groupby(order, key=lambda number: sides[number])]
    count = min(_AT_ONCE, -(-len(starts) // default_workers()))
    batches = [group[at : at + count] for group in groups for at in range(0, len(group), count)]
    fitted: dict[int, FittedObject | None] = {}
    with kept_threads() as pool:
        found = pool.map(lambda batch: _fitted(prepared, optics, [starts[number] for number in batch]), batches)
        for batch, one in zip(batches, found, strict=True):
            fitted.update(zip(batch, one, strict=True))
    return [fitted[number] for number in range(len(starts))]


def _fitted(prepared: PreparedFrame, optics: LayerOptics, starts: Sequence[ObjectStart]) -> list[FittedObject | None]:
    """Fit a batch with windows of equal size; each Gauss-Newton step treats those that have not settled together."""
    window, count = ObjectWindow.of(prepared, optics, starts), len(starts)
    origin = np.array([window.side // 2, window.side // 2, 0.0, 0.0])
    depths = np.log([[one.vergence_per_m] for one in starts])
    unknowns = np.hstack([depths, [one.rectangle + origin for one in starts], np.ones((count, 4))])
    textures = np.zeros((count, 2, window.side, window.side // 2 + 1), dtype=np.complex64)
    farthest = np.log(window.surface_per_m)
    nearest = math.log(float(1.0 / optics.calibration.kernels.psf.depth_m.min()))
    of_textures, integrated = np.zeros((count, 9)), np.zeros(count, dtype=bool)
    before, moved, steps = np.zeros(count), np.zeros(count), np.full(count, _STEPS_FAR)
    inside, going = np.ones(count, dtype=bool), np.ones(count, dtype=bool)
    for number in range(_ROUNDS):
        # Without textures, only mean intensities are fitted.
        first = 0 if number else LEVELS_AT
        for most in np.unique(steps[going]).tolist():
            at = np.flatnonzero(going & (steps == most))
            linear = LinearModel.of(window.taken(at), unknowns[at], textures[at], first)
            change, change_of_textures = linear.solved(of_textures[at], most)
            # A step of depth opposite to the last one is shortened by the secant rule: in full it would undo up to 0.9
            # of the last one, because the textures follow the depth only in part.
            back, share = before[at] * change[:, 0] < 0.0, np.ones(len(at))
            np.divide(moved[at], before[at] - change[:, 0], out=share, where=back)
            share = np.minimum(share, 1.0)
            step = np.clip(share[:, None] * change, -_LARGEST, _LARGEST)
            before[at], moved[at] = change[:, 0], step[:, 0]
            unknowns[at] += step
            textures[at] += wide(share) * change_of_textures
        unknowns[:, 3:5] = np.maximum(unknowns[:, 3:5], _LEAST_HALF)
        unknowns[:, 5:] = np.clip(unknowns[:, 5:], *_LEVELS)
        inside &= (farthest < unknowns[:, 0]) & (unknowns[:, 0] < nearest)
        going &= inside
        if first:
            continue
        steps = np.where(np.abs(before) < _FAR, STEPS, _STEPS_FAR)
        going &= ~(integrated & (np.abs(before) < _SETTLED))
        at = np.flatnonzero(going & ~integrated & (np.abs(before) < _NEAR))
        if at.size:
            of_textures[at], before[at] = determinant_slopes(window.taken(at), unknowns[at]), 0.0
            integrated[at] = True
        if not going.any():
            break
    fitted: list[FittedObject | None] = [None] * count
    at = np.flatnonzero(inside)
    if at.size:
        errors = _ERROR_RATIO * LinearModel.of(window.taken(at), unknowns[at], textures[at], 0).depth_errors()
        for number, error in zip(at.tolist(), errors.tolist(), strict=True):
            fitted[number] = FittedObject(math.exp(unknowns[number, 0]), error, unknowns[number, 1:5] - origin)
    return fitted
