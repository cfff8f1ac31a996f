"""The brightest helix whose side lobes stay below a share of the main lobe.

Side lobes make ghosts in the image, and a side lobe taken for the main lobe gives a wrong depth. The *side lobe* at a
depth is the brightest light farther from the main lobe than Airy's first dark ring, over the main lobe's peak. The mean
peak over the turn is maximised under a limit of the worst or the mean side lobe, by an augmented Lagrangian (Nocedal
and Wright, Numerical Optimization, chapter 17). The unknowns are the phases of all pupil samples. A p-norm stands for
the largest sample of a side lobe, so that there is a gradient.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from scipy.optimize import minimize

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.phasor import phasor
from metafab.core.parallel.executor import one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.phase.optimise.peak import PeakDesign, target_waves
from metafab.phase.optimise.rotation import MainLobe, helix_half_width, main_lobe
from metafab.phase.pupil import FocalPlane, Pupil
from metafab.phase.terms.helices import spiral_field
from metafab.phase.terms.sampled import SampledMask

#: First zero of J_1: the dark ring around a clear aperture's image, optical units.
AIRY_RADIUS = 3.8317
#: Step of the plane on which side lobes are limited, optical units; between its samples a lobe is at most 9 % higher.
_STEP = 0.85
#: Exponent of the p-norm.
_NORM = 12
#: Rounds of the augmented Lagrangian, and its first stiffness.
_ROUNDS, _STIFFNESS = 8, 10.0

#: Limited quantity: the side lobe at the worst depth, or its mean over the depths.
Over: TypeAlias = Literal["worst", "mean"]


@dataclass(frozen=True)
class SideLobeDesign(SampledMask):
    """A mask with limited side lobes."""

    limit: float  #: Largest side lobe allowed, over the main lobe.
    over: Over  #: Limited quantity, the worst or the mean side lobe.
    side_lobe: FloatArray  #: Shape (n_depth,), side lobe over main lobe at the defocuses of the start.
    start_side_lobe: FloatArray  #: Shape (n_depth,), the same ratio of the mask without a limit.
    lobe: MainLobe  #: Measured main lobe.
    plain: MainLobe  #: Measured main lobe of the spiral of Eq. 2.

    @property
    def limited(self) -> float:
        """The limited side lobe: the worst or the mean."""
        return _reduced(self.side_lobe, self.over)

    @property
    def limited_at_start(self) -> float:
        """The limited quantity in the mask without a limit."""
        return _reduced(self.start_side_lobe, self.over)

    @property
    def peak_gain(self) -> float:
        """Mean peak over that of the plain spiral."""
        return self.lobe.peak_gain(self.plain)


@dataclass(frozen=True)
class LobeValues:
    """Main and side lobes of a mask, and the amplitudes that their gradient needs."""

    peak: FloatArray  #: Shape (n_depth,), Strehl ratio at the target points.
    side: FloatArray  #: Shape (n_depth,), p-norm of the Strehl ratios outside the main lobe.
    amplitude: ComplexArray  #: Shape (n_depth, n_v, n_v), on the watched window.
    target: ComplexArray  #: Shape (n_depth,), amplitude at the target points.


@dataclass(frozen=True)
class SideLobes:
    """Peaks and side lobes as functions of a mask, with the gradient of any function of them over the phases."""

    pupil: Pupil  #: Samples.
    defocus_rad: FloatArray  #: Shape (n_depth,), rim defocuses.
    aim: FloatArray  #: Shape (n_depth, 2), target points of the main lobe, optical units.
    half_width: float  #: Of the watched window, optical units.
    excluded: float = AIRY_RADIUS  #: Radius around the target point that counts as main lobe, optical units.

    @cached_property
    def _plane(self) -> FocalPlane:
        return FocalPlane(self.pupil, self.half_width, _STEP)

    @cached_property
    def _outside(self) -> FloatArray:
        return _outside(self._plane.axis, self.aim, self.excluded)

    @cached_property
    def _defocus(self) -> ComplexArray:
        return phasor(np.multiply.outer(self.defocus_rad, self.pupil.radius_squared_grid)) / self.pupil.count

    @cached_property
    def _waves(self) -> ComplexArray:
        return np.asarray(target_waves(self.pupil, self.defocus_rad, self.aim).conj() / self.pupil.count)

    def evaluate(self, mask: ComplexArray) -> LobeValues:
        """Evaluate peaks and side lobes of a pupil field, shape (n,)."""
        kernel = self._plane.kernel
        amplitude = kernel @ (self.pupil.on_grid(mask) * self._defocus) @ kernel.T
        target = self._waves @ mask
        power = (np.abs(amplitude) ** 2 * self._outside) ** _NORM
        return LobeValues(np.abs(target) ** 2, power.sum(axis=(1, 2)) ** (1.0 / _NORM), amplitude, target)

    def gradient(self, mask: ComplexArray, values: LobeValues, by_peak: FloatArray, by_side: FloatArray) -> FloatArray:
        """Derivative of a function of the peaks and side lobes over the phases of a pupil field, shape (n,).

        ``values`` are those of :meth:`evaluate` for the field ``mask``, shape (n,); ``by_peak`` and ``by_side``, shape
        (n_depth,), the derivatives of the function over the peaks and over the side lobes.
        """
        light = np.abs(values.amplitude) ** 2 * self._outside
        by_light = (light / values.side[:, None, None]) ** (_NORM - 1) * self._outside * by_side[:, None, None]
        kernel = self._plane.kernel
        back = kernel.conj().T @ (by_light * values.amplitude) @ kernel.conj()
        by_field = (back * self._defocus.conj()).sum(axis=0)[self.pupil.inside]
        by_field += (by_peak * values.target) @ self._waves.conj()
        return np.asarray(2.0 * (by_field * mask.conj()).imag, dtype=np.float64)


def limit_side_lobes(
    start: PeakDesign,
    limit: float,
    *,
    over: Over = "worst",
    pupil: Pupil | None = None,
    exponent: float = 0.5,
    iterations: int = 30,
    progress: Progress = silent,
) -> SideLobeDesign:
    """Maximise the mean peak of a rotating lobe while its side lobes stay below a share of it.

    Args:
        start: the mask without a limit; its target points and depths are kept.
        limit: largest side lobe over main lobe, between 0 and 1.
        over: limited quantity, the side lobe at the worst depth or its mean over the depths.
        pupil: samples; a circle of 64 by default.
        exponent: epsilon of the plain spiral that serves for comparison.
        iterations: of the ascent in each round.

    Raises:
        ValueError: the limit is not between 0 and 1, or no mask met it.
    """
    if not 0.0 < limit < 1.0:
        raise ValueError(f"`limit`: expected a share between 0 and 1, got {limit}")
    pupil = pupil or Pupil(64)
    half_width = helix_half_width(start.zones)
    problem = SideLobes(pupil, start.defocus_rad, start.aim, half_width)
    phase_rad = start.term(1.0)(pupil.axis, pupil.axis, "x")[pupil.inside]
    side_lobe = before = measured_side_lobes(pupil, phasor(phase_rad), start.defocus_rad, half_width)
    plain = main_lobe(pupil, spiral_field(pupil, start.zones, exponent), start.defocus_rad, half_width)
    with one_blas_thread():
        if _reduced(before, over) > limit:
            phase_rad, side_lobe = _limited_phases(problem, phase_rad, limit, over, iterations, progress)
    lobe = main_lobe(pupil, phasor(phase_rad), start.defocus_rad, half_width)
    return SideLobeDesign(pupil, phase_rad, limit, over, side_lobe, before, lobe, plain)


def measured_side_lobes(pupil: Pupil, mask: ComplexArray, defocus_rad: FloatArray, half_width: float) -> FloatArray:
    """Measure the brightest light farther than Airy's dark ring from the main lobe, over its peak: shape (n_depth,).

    The arguments are those of :func:`~metafab.phase.optimise.rotation.main_lobe`.
    """
    plane = FocalPlane(pupil, half_width)
    lobe = main_lobe(pupil, mask, defocus_rad, half_width)
    phi = np.radians(lobe.phi_deg)
    place = lobe.radius[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    outside = plane.psf(mask, defocus_rad) * _outside(plane.axis, place, AIRY_RADIUS)
    return np.asarray(outside.max(axis=(1, 2)) / lobe.peak)


def _outside(axis: FloatArray, lobe: FloatArray, radius: float) -> FloatArray:
    """1 farther than ``radius`` from the lobe, else 0; shape (n_depth, n_v, n_v)."""
    x, y = axis[None, None, :] - lobe[:, 0, None, None], axis[None, :, None] - lobe[:, 1, None, None]
    return (np.hypot(x, y) > radius).astype(np.float64)


def _reduced(side_lobe: FloatArray, over: Over) -> float:
    return float(side_lobe.max() if over == "worst" else side_lobe.mean())


def _limited_phases(
    problem: SideLobes, phase_rad: FloatArray, limit: float, over: Over, iterations: int, progress: Progress
) -> tuple[FloatArray, FloatArray]:
    """Phases of the brightest mask whose measured side lobes meet the limit, and these side lobes."""
    count = problem.defocus_rad.size if over == "worst" else 1
    multiplier, stiffness, aimed = np.zeros(count), _STIFFNESS, limit
    scale = float(problem.evaluate(phasor(phase_rad)).peak.mean())
    best: tuple[float, FloatArray, FloatArray] | None = None
    lowest = np.inf

    def excess_over(target: float, ratio: FloatArray) -> FloatArray:
        return (ratio if over == "worst" else np.array([ratio.mean()])) - target

    def descend(phases: FloatArray) -> tuple[float, FloatArray]:
        mask = phasor(phases)
        values = problem.evaluate(mask)
        peak, ratio = values.peak, values.side / values.peak
        # Only the active part of an inequality has a multiplier.
        pull = np.maximum(multiplier + stiffness * excess_over(aimed, ratio), 0.0)
        value = -peak.mean() / scale + float((pull**2 - multiplier**2).sum()) / (2.0 * stiffness)
        by_ratio = pull if over == "worst" else np.full(peak.size, pull[0] / peak.size)
        by_peak = -1.0 / (scale * peak.size) - by_ratio * ratio / peak
        return value, problem.gradient(mask, values, by_peak, by_ratio / peak)

    for done in range(_ROUNDS):
        progress("phase: side lobes", done, _ROUNDS)
        result = minimize(
            descend, phase_rad, jac=True, method="L-BFGS-B", options={"maxiter": iterations, "maxcor": 15}
        )
        phase_rad = np.asarray(result.x, dtype=np.float64)
        mask = phasor(phase_rad)
        values = problem.evaluate(mask)
        mean_peak, ratio = float(values.peak.mean()), values.side / values.peak
        measured = measured_side_lobes(problem.pupil, mask, problem.defocus_rad, problem.half_width)
        reached = _reduced(measured, over)
        lowest = min(lowest, reached)
        if reached <= limit and (best is None or mean_peak > best[0]):
            best = mean_peak, phase_rad, measured
        multiplier = np.maximum(multiplier + stiffness * excess_over(aimed, ratio), 0.0)
        stiffness *= 2.0
        # The p-norm on coarse samples is no maximum: aim where the measured side lobe meets the limit.
        aimed = limit * float(np.clip(_reduced(ratio, over) / reached, 0.5, 1.5)) * 0.99
    progress("phase: side lobes", _ROUNDS, _ROUNDS)
    if best is None:
        raise ValueError(f"`limit`: expected at least about {1.02 * lowest:.2g}, the lowest met, got {limit:g}")
    return best[1], best[2]
