"""The brightest helix whose side lobes stay below a share of the main lobe.

Side lobes make ghosts in the image, and a lobe that is mistaken for the main one makes a wrong depth. At each depth
the *side lobe* is the brightest light farther from the main lobe than Airy's first dark ring, over the main lobe's
peak. The mean peak over the turn is maximised while the worst or the mean side lobe is held (augmented Lagrangian;
Nocedal and Wright, Numerical Optimization, chapter 17). The unknowns are the phases of all pupil samples; the
largest sample of a side lobe is replaced by a p-norm, so that there is a gradient.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.parallel.progress import Progress, silent
from metafab.phase.optimise.peak import PeakDesign, spiral_field
from metafab.phase.optimise.rotation import MainLobe, main_lobe
from metafab.phase.pupil import FocalPlane, Pupil, phasor
from metafab.phase.terms.sampled import SampledPhase

#: First zero of J_1: the dark ring around a clear aperture's image, optical units.
AIRY_RADIUS = 3.8317
#: Step of the plane on which lobes are held; between its samples a lobe is at most 9 % higher.
_STEP = 0.85
#: Exponent of the p-norm that stands for the largest sample.
_NORM = 12
_ROUNDS, _STIFFNESS = 8, 10.0

#: What is held: the side lobe at the worst depth, or its mean over the depths.
Over: TypeAlias = Literal["worst", "mean"]


@dataclass(frozen=True)
class SideLobeDesign:
    """A mask whose side lobes are held.

    Attributes:
        pupil: samples.
        phase_rad: shape (n,), phase of x polarisation at the samples.
        limit: largest side lobe allowed.
        over: what is held below it.
        side_lobe: shape (n_depth,), side lobe over main lobe at the defocuses of ``start``.
        start_side_lobe: the same of the mask without a limit.
        lobe: measured main lobe.
        plain: measured main lobe of the spiral of Eq. 2.
    """

    pupil: Pupil
    phase_rad: FloatArray
    limit: float
    over: Over
    side_lobe: FloatArray
    start_side_lobe: FloatArray
    lobe: MainLobe
    plain: MainLobe

    @property
    def held(self) -> float:
        """The side lobe that is limited: the worst or the mean."""
        return _held(self.side_lobe, self.over)

    @property
    def held_at_start(self) -> float:
        """The same without a limit."""
        return _held(self.start_side_lobe, self.over)

    @property
    def peak_gain(self) -> float:
        """Mean peak over that of the plain spiral."""
        return float(self.lobe.peak.mean() / self.plain.peak.mean())

    @property
    def worst_gain(self) -> float:
        """Smallest peak over the smallest of the plain spiral."""
        return float(self.lobe.peak.min() / self.plain.peak.min())

    def term(self, radius_um: float, polarisation: Polarisation | None = None) -> SampledPhase:
        """The mask as a phase term; y is the point mirror of x, between samples the complex field is interpolated."""
        return SampledPhase.of_pupil(self.pupil, self.phase_rad, radius_um, polarisation)


@dataclass(frozen=True)
class SideLobes:
    """Target peaks and side lobes of a mask, with the gradient of any function of them over the phases.

    Attributes:
        pupil: samples.
        defocus_rad: shape (n_depth,), rim defocuses.
        aim: shape (n_depth, 2), where the lobe is wanted, optical units.
        half_width: of the window that is watched, optical units.
        excluded: radius around the aim that counts as main lobe.
    """

    pupil: Pupil
    defocus_rad: FloatArray
    aim: FloatArray
    half_width: float
    excluded: float = AIRY_RADIUS

    @cached_property
    def _kernel(self) -> ComplexArray:
        return phasor(-np.outer(FocalPlane(self.pupil, self.half_width, _STEP).axis, self.pupil.axis))

    @cached_property
    def _outside(self) -> FloatArray:
        """1 outside the main lobe, else 0; shape (n_depth, n_v, n_v)."""
        axis = FocalPlane(self.pupil, self.half_width, _STEP).axis
        x, y = axis[None, None, :] - self.aim[:, 0, None, None], axis[None, :, None] - self.aim[:, 1, None, None]
        return (np.hypot(x, y) > self.excluded).astype(np.float64)

    @cached_property
    def _defocus(self) -> ComplexArray:
        return phasor(np.multiply.outer(self.defocus_rad, self.pupil.radius_squared_grid)) / self.pupil.count

    @cached_property
    def _waves(self) -> ComplexArray:
        tilt = np.outer(self.aim[:, 0], self.pupil.x) + np.outer(self.aim[:, 1], self.pupil.y)
        return phasor(np.outer(self.defocus_rad, self.pupil.radius_squared) - tilt) / self.pupil.count

    def evaluate(self, mask: ComplexArray) -> tuple[FloatArray, FloatArray, tuple[ComplexArray, ...]]:
        """Peaks at the aims and side lobes (p-norm), Strehl ratios of shape (n_depth,), and what a gradient needs.

        Args:
            mask: shape (n,), pupil field.
        """
        grid = np.zeros(self.pupil.inside.shape, dtype=np.complex128)
        grid[self.pupil.inside] = mask
        amplitude = self._kernel @ (grid * self._defocus) @ self._kernel.T
        target = self._waves @ mask
        power = (np.abs(amplitude) ** 2 * self._outside) ** _NORM
        return np.abs(target) ** 2, power.sum(axis=(1, 2)) ** (1.0 / _NORM), (amplitude, target)

    def gradient(
        self, mask: ComplexArray, kept: tuple[ComplexArray, ...], by_peak: FloatArray, by_side: FloatArray
    ) -> FloatArray:
        """Derivative over the phases, shape (n,), of a function with these derivatives over peaks and side lobes."""
        amplitude, target = kept
        light = np.abs(amplitude) ** 2 * self._outside
        side = (light**_NORM).sum(axis=(1, 2)) ** (1.0 / _NORM)
        by_light = (light / side[:, None, None]) ** (_NORM - 1) * self._outside * by_side[:, None, None]
        back = self._kernel.conj().T @ (by_light * amplitude) @ self._kernel.conj()
        by_field = (back * self._defocus.conj()).sum(axis=0)[self.pupil.inside]
        by_field += (by_peak * target) @ self._waves.conj()
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
        start: the mask without a limit, whose lobe sets aims and depths.
        limit: largest side lobe over main lobe, between 0 and 1.
        over: hold it at the worst depth, or in the mean over the depths.
        pupil: samples; a circle of 64 by default.
        exponent: epsilon of the plain spiral that is compared with.
        iterations: of the ascent in each of its rounds.
        progress: called at each round.

    Raises:
        ValueError: the limit is not between 0 and 1, or no mask was found that keeps it.
    """
    if not 0.0 < limit < 1.0:
        raise ValueError(f"`limit`: expected a share between 0 and 1, got {limit}")
    pupil = pupil or Pupil(64)
    half_width = 2.0 * start.zones + 6.0
    aim = start.lobe_radius * np.stack([np.cos(np.radians(start.aim_deg)), np.sin(np.radians(start.aim_deg))], axis=1)
    problem = SideLobes(pupil, start.defocus_rad, aim, half_width)
    term = start.term(1.0)
    phase_rad = term(pupil.axis, pupil.axis, "x")[pupil.inside]
    before = measured_side_lobes(pupil, phasor(phase_rad), start.defocus_rad, half_width)
    plain = main_lobe(pupil, spiral_field(pupil, start.zones, exponent), start.defocus_rad, half_width)
    side_lobe = before
    with threadpool_limits(1):
        if _held(before, over) > limit:
            phase_rad, side_lobe = _held_phases(problem, phase_rad, limit, over, iterations, progress)
    lobe = main_lobe(pupil, phasor(phase_rad), start.defocus_rad, half_width)
    return SideLobeDesign(pupil, phase_rad, limit, over, side_lobe, before, lobe, plain)


def measured_side_lobes(pupil: Pupil, mask: ComplexArray, defocus_rad: FloatArray, half_width: float) -> FloatArray:
    """Brightest light farther than Airy's dark ring from the main lobe, over its peak, shape (n_depth,)."""
    plane = FocalPlane(pupil, half_width)
    lobe = main_lobe(pupil, mask, defocus_rad, half_width)
    phi = np.radians(lobe.phi_deg)
    x = plane.axis[None, None, :] - (lobe.radius * np.cos(phi))[:, None, None]
    y = plane.axis[None, :, None] - (lobe.radius * np.sin(phi))[:, None, None]
    outside = plane.psf(mask, defocus_rad) * (np.hypot(x, y) > AIRY_RADIUS)
    return np.asarray(outside.max(axis=(1, 2)) / lobe.peak)


def _held(side_lobe: FloatArray, over: Over) -> float:
    return float(side_lobe.max() if over == "worst" else side_lobe.mean())


def _held_phases(
    problem: SideLobes, phase_rad: FloatArray, limit: float, over: Over, iterations: int, progress: Progress
) -> tuple[FloatArray, FloatArray]:
    """Phases that keep the limit as it is measured, and their side lobes; the brightest that were met."""
    count = problem.defocus_rad.size if over == "worst" else 1
    multiplier, stiffness, aimed = np.zeros(count), _STIFFNESS, limit
    scale = float(problem.evaluate(phasor(phase_rad))[0].mean())
    best: tuple[float, FloatArray, FloatArray] | None = None
    nearest = np.inf

    def descend(phases: FloatArray) -> tuple[float, FloatArray]:
        mask = phasor(phases)
        peak, side, kept = problem.evaluate(mask)
        ratio = side / peak
        excess = (ratio if over == "worst" else np.array([ratio.mean()])) - aimed
        # Of an inequality only the active part pulls.
        pull = np.maximum(multiplier + stiffness * excess, 0.0)
        value = -peak.mean() / scale + float((pull**2 - multiplier**2).sum()) / (2.0 * stiffness)
        by_ratio = pull if over == "worst" else np.full(peak.size, pull[0] / peak.size)
        by_peak = -1.0 / (scale * peak.size) - by_ratio * ratio / peak
        return value, problem.gradient(mask, kept, by_peak, by_ratio / peak)

    for done in range(_ROUNDS):
        progress("phase: side lobes", done, _ROUNDS)
        found = minimize(descend, phase_rad, jac=True, method="L-BFGS-B", options={"maxiter": iterations, "maxcor": 15})
        phase_rad = np.asarray(found.x, dtype=np.float64)
        mask = phasor(phase_rad)
        peak, side, _ = problem.evaluate(mask)
        ratio = side / peak
        measured = measured_side_lobes(problem.pupil, mask, problem.defocus_rad, problem.half_width)
        reached = _held(measured, over)
        nearest = min(nearest, reached)
        if reached <= limit and (best is None or peak.mean() > best[0]):
            best = float(peak.mean()), phase_rad, measured
        excess = (ratio if over == "worst" else np.array([ratio.mean()])) - aimed
        multiplier = np.maximum(multiplier + stiffness * excess, 0.0)
        stiffness *= 2.0
        # The p-norm on coarse samples is no maximum: aim where the measured side lobe meets the limit.
        aimed = limit * float(np.clip(_held(ratio, over) / reached, 0.5, 1.5)) * 0.99
    progress("phase: side lobes", _ROUNDS, _ROUNDS)
    if best is None:
        raise ValueError(f"`limit`: expected at least about {1.02 * nearest:.2g}, the lowest met, got {limit:g}")
    return best[1], best[2]
