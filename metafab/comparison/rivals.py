"""What a design is compared with: the same aperture, split lens and sensor with other phases."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.layout import lattice_of
from metafab.optics import Imaging, Psf, depth_nodes, ideal_field, psf, without_depths
from metafab.phase import profile_of
from metafab.spec import Design
from metafab.spec.terms import DoubleHelix, Grating, Lens, PhaseTerm, SplitLens

#: Terms that bring the light to the sensor; all others shape the PSF.
_CARRIERS = (SplitLens, Lens, Grating)
#: How far before the nearest depth the lens for depth from defocus is focused, as a share of the range of vergence:
#: about the focus itself its PSF does not change with depth, and on both sides of it is the same.
_BEFORE = 0.25
#: The calibration reaches beyond the depths that are tried by this share of their range of vergence.
_MARGIN = 0.15


@dataclass(frozen=True)
class Rival:
    """One camera.

    Attributes:
        name: for people.
        twins: whether the relation of its two images tells the depth of any texture; else they are one image twice.
        truth: PSFs as they are at the depths to be tried, among others.
        calibration: the PSFs that its estimates know: of other depths, between which they interpolate.
    """

    name: str
    twins: bool
    truth: PairKernels
    calibration: PairKernels


def rivals(design: Design, depth_m: FloatArray, *, progress: Progress = silent) -> tuple[Rival, ...]:
    """The design's target phases, a standard lens, one that is focused for depth from defocus, and a double helix.

    All split polarisation in the same way, so that sensor, aperture and light are the same.

    Args:
        design: with a split lens, and a term that shapes the PSF.
        depth_m: shape (n,), depths to be tried, ascending.
        progress: called camera by camera.

    Raises:
        InputError: the design has no split lens, or nothing but a lens.
    """
    carriers = tuple(term for term in design.phase if isinstance(term, _CARRIERS))
    if design.split_angle_deg == 0.0 or len(carriers) == len(design.phase):
        raise InputError.single(
            design.name, "phase", "a `split_lens` and a term that turns the pair with depth",
            ", ".join(term.term for term in design.phase),
        )  # fmt: skip
    vergence = 1.0 / depth_m
    span = float(vergence[0] - vergence[-1])
    before = replace(design.sensor, focus_depth_m=1.0 / (float(vergence[0]) + _BEFORE * span))
    others: tuple[tuple[str, tuple[PhaseTerm, ...], Design], ...] = (
        ("this design", design.phase, design),
        ("standard lens", carriers, design),
        ("lens, focused nearer", carriers, replace(design, sensor=before)),
        ("double helix", (DoubleHelix(), *carriers), design),
    )
    found = []
    for done, (name, phase, base) in enumerate(others, start=1):
        stack, nodes = _stack(replace(base, phase=phase), depth_m)
        known = PairKernels(without_depths(stack, ~np.isin(stack.depth_m, nodes)))
        found.append(Rival(name, phase == design.phase, PairKernels(stack), known))
        progress("PSFs", done, len(others))
    return tuple(found)


def _stack(design: Design, depth_m: FloatArray) -> tuple[Psf, FloatArray]:
    """The pair at the depths to be tried and at the nodes of a calibration, and these nodes."""
    imaging = Imaging.of(design)
    near, far = 1.0 / float(depth_m[0]), 1.0 / float(depth_m[-1])
    margin = _MARGIN * (near - far)
    target = design.verify.target_error
    nodes = depth_nodes(imaging, 1.0 / (near + margin), 1.0 / max(far - margin, 0.5 * far), target)
    every = np.unique(np.concatenate([nodes, depth_m]))
    source = ideal_field(profile_of(design), lattice_of(design), design.device)
    return psf(source, imaging, every, window_px=design.verify.window_px, target_error=target, workers=1), nodes
