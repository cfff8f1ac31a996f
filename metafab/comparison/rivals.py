"""Cameras of a comparison: one aperture, split lens and sensor with different phases."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from metafab.camera.kernels import PairKernels
from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.core.parallel.work import Work
from metafab.layout import lattice_of
from metafab.optics import Imaging, Psf, PsfNumerics, depth_nodes, ideal_field, psf
from metafab.optics.interpolation import without_depths
from metafab.phase import profile_of
from metafab.spec import Design
from metafab.spec.terms import DoubleHelix, Grating, Lens, PhaseTerm, SplitLens

#: Terms that bring the light to the sensor; all others shape the PSF.
_CARRIERS = (SplitLens, Lens, Grating)
#: Distance of the focus before the nearest depth for the lens of depth from defocus, as a share of the range of
#: vergence. Near focus the PSF of a lens does not change with depth, and it is alike on both sides of focus.
_BEFORE = 0.25
#: Margin of the calibration beyond the compared depths, as a share of their range of vergence.
_MARGIN = 0.15


@dataclass(frozen=True)
class Rival:
    """One camera of a comparison."""

    name: str  #: Label in figures and files.
    truth: PairKernels  #: PSFs at the compared depths (and at the nodes of the calibration).
    calibration: PairKernels  #: PSFs that the depth estimates use, at other depths; between them they interpolate.


def rivals(design: Design, depth_m: FloatArray, *, progress: Progress = silent) -> tuple[Rival, ...]:
    """Return the design's target phases, a lens in focus, a lens focused nearer (depth from defocus), a double helix.

    All split the polarisations alike, so that sensor, aperture and light are equal.

    Args:
        design: has a split lens and a term that shapes the PSF.
        depth_m: shape (n,), compared depths, ascending.
        progress: called camera by camera.

    Raises:
        InputError: the design has no split lens, or nothing but a lens.
    """
    carriers = tuple(term for term in design.phase if isinstance(term, _CARRIERS))
    if design.split_angle_deg == 0.0 or len(carriers) == len(design.phase):
        expected = "a `split_lens` and a term that turns the pair with depth"
        raise InputError.single(design.name, "phase", expected, ", ".join(term.term for term in design.phase))
    vergence = 1.0 / depth_m
    span = float(vergence[0] - vergence[-1])
    nearer = replace(design.sensor, focus_depth_m=1.0 / (float(vergence[0]) + _BEFORE * span))
    cameras: tuple[tuple[str, tuple[PhaseTerm, ...], Design], ...] = (
        ("this design", design.phase, design),
        ("standard lens", carriers, design),
        ("lens, focused nearer", carriers, replace(design, sensor=nearer)),
        ("double helix", (DoubleHelix(), *carriers), design),
    )
    result = []
    for done, (name, phase, base) in enumerate(cameras, start=1):
        stack, nodes = _stack(replace(base, phase=phase), depth_m)
        calibration = without_depths(stack, ~np.isin(stack.depth_m, nodes))
        result.append(Rival(name, PairKernels(stack), PairKernels(calibration)))
        progress("PSFs", done, len(cameras))
    return tuple(result)


def _stack(design: Design, depth_m: FloatArray) -> tuple[Psf, FloatArray]:
    """The PSF pair at the compared depths and at the nodes of a calibration, and these nodes."""
    imaging = Imaging.of(design)
    near, far = 1.0 / float(depth_m[0]), 1.0 / float(depth_m[-1])
    margin = _MARGIN * (near - far)
    target = design.verify.target_error
    nodes = depth_nodes(imaging, 1.0 / (near + margin), 1.0 / max(far - margin, 0.5 * far), target)
    every = np.unique(np.concatenate([nodes, depth_m]))
    source = ideal_field(profile_of(design), lattice_of(design), design.device)
    numerics = PsfNumerics(design.verify.window_px, target)
    return psf(source, imaging, every, numerics, work=Work(workers=1)), nodes
