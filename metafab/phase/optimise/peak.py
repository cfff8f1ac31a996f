"""The main lobe made as bright as it can be over the whole turn: an iterative Fourier transform algorithm.

At rim defocus W_d the lobe is wanted at the radius v on a circle, at the orientation phi_d = phi_0 - W_d / L. Its
amplitude there is the inner product of the mask p with the wave f_d = exp(-i W_d u^2 + i v_d . u), and the step

    p  <-  exp(i arg sum_d c_d f_d),    c_d = w_d <f_d, p>

never lowers the weighted sum of the peaks: the sum is convex in p, and the step maximises its tangent. At the end
the mask *is* the phase of a sum of waves, known at every point (:class:`WaveSumPhase`). ``bound`` proves how
close it comes to the best mask of all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from threadpoolctl import threadpool_limits

from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.parallel.progress import Progress, silent
from metafab.phase.optimise.bound import PeakBound, peak_bound, worst_peak_bound
from metafab.phase.optimise.rotation import MainLobe, full_turn_defocus_rad, main_lobe
from metafab.phase.pupil import Outline, Pupil, phasor
from metafab.phase.terms.helices import SpiralZonesPhase, WaveSumPhase

#: The lobe may come this much nearer to the centre than the plain spiral's. Nearer still it would be brighter,
#: and its turning harder to see: at the centre there is nothing left that turns.
_NEAREST_LOBE = 0.7
#: Samples a side of the pupil on which the lobe's radius and aim are found.
_COARSE = 48
_STEERING_ROUNDS = 10

#: What is made large: the mean of the peaks over depth, or the smallest.
Goal: TypeAlias = Literal["mean", "worst"]


@dataclass(frozen=True)
class PeakDesign:
    """An optimised mask and how good it is.

    Attributes:
        zones: L, which sets the rate of rotation.
        defocus_rad: shape (n_depth,), rim defocuses that count.
        lobe_radius: where the lobe was wanted, optical units.
        phi_deg: shape (n_depth,), orientations wanted of the lobe.
        aim_deg: shape (n_depth,), orientations of the points whose brightness is maximised; they lead or lag the law
            so that the lobe itself keeps to it.
        amplitude: shape (n_depth,), weights of the waves whose sum has the mask's phase.
        goal: what was made large, the mean of ``target`` or its smallest value.
        target: shape (n_depth,), Strehl ratio at the aimed points.
        bound: what no mask can exceed for that.
        lobe: measured main lobe of the mask.
        plain: measured main lobe of the spiral of Eq. 2 at the same defocuses.
    """

    zones: int
    defocus_rad: FloatArray
    lobe_radius: float
    phi_deg: FloatArray
    aim_deg: FloatArray
    amplitude: ComplexArray
    goal: Goal
    target: FloatArray
    bound: PeakBound
    lobe: MainLobe
    plain: MainLobe

    @property
    def peak_gain(self) -> float:
        """Mean peak over that of the plain spiral (the paper's iteration reached 1.36)."""
        return float(self.lobe.peak.mean() / self.plain.peak.mean())

    @property
    def worst_gain(self) -> float:
        """Smallest peak over the smallest of the plain spiral."""
        return float(self.lobe.peak.min() / self.plain.peak.min())

    @property
    def reached(self) -> float:
        """The goal's value: mean or smallest Strehl ratio at the aimed points."""
        return float(self.target.mean() if self.goal == "mean" else self.target.min())

    @property
    def bound_fraction(self) -> float:
        """Goal's value over its bound: 1 is the best that any mask can do."""
        return self.reached / self.bound.dual

    def term(self, radius_um: float, polarisation: Polarisation | None = None) -> WaveSumPhase:
        """The mask as a phase term for an aperture of ``radius_um``."""
        tilt = self.lobe_radius * _directions(self.aim_deg)
        return WaveSumPhase(radius_um, self.amplitude, self.defocus_rad, tilt, polarisation)


def optimise_peak(
    zones: int,
    exponent: float = 0.5,
    *,
    pupil: Pupil | None = None,
    defocus_rad: FloatArray | None = None,
    goal: Goal = "mean",
    lobe_radius: float | None = None,
    iterations: int = 200,
    seed: int = 1,
    progress: Progress = silent,
) -> PeakDesign:
    """Maximise the main lobe's peak, its mean over depth or its worst, while it turns as Eq. 2's does.

    Args:
        zones: L of Eq. 2, at least 2; the orientation changes by -1 / L rad per rad of rim defocus.
        exponent: epsilon of Eq. 2, of the spiral that is compared with and whose lobe sets radius and origin of phi.
        pupil: samples; a circle of 128 by default.
        defocus_rad: rim defocuses that count, ascending; one full turn by default.
        goal: "mean" peak, or the "worst" one.
        lobe_radius: where the lobe is wanted, optical units; by default chosen for the brightest lobe, at least 0.7
            of the plain spiral's.
        iterations: largest number of steps of each kind.
        seed: of the random start; the result does not depend on it (tested).
        progress: called at the start and at the end.

    Raises:
        ValueError: fewer than two zones: a plain vortex does not turn.
    """
    if zones < 2:
        raise ValueError(f"`zones`: expected at least 2, got {zones}; a plain vortex does not turn with depth")
    # Small matrices: a second BLAS thread costs more than it brings, at times a hundredfold.
    with threadpool_limits(1):
        return _optimise(zones, exponent, pupil or Pupil(), defocus_rad, goal, lobe_radius, iterations, seed, progress)


def _optimise(
    zones: int,
    exponent: float,
    pupil: Pupil,
    defocus_rad: FloatArray | None,
    goal: Goal,
    lobe_radius: float | None,
    iterations: int,
    seed: int,
    progress: Progress,
) -> PeakDesign:
    defocus = full_turn_defocus_rad(zones, max(24, 6 * zones)) if defocus_rad is None else defocus_rad
    half_width = 2.0 * zones + 6.0
    plain = main_lobe(pupil, spiral_field(pupil, zones, exponent), defocus, half_width)
    # The plain spiral's lobe follows the law up to a slow swing: the law's origin is the mean over depth.
    origin_rad = float(np.angle(np.mean(np.exp(1j * (np.radians(plain.phi_deg) + defocus / zones)))))
    phi_deg = np.degrees(origin_rad - defocus / zones)
    if lobe_radius is None:
        progress("phase: peak", 0, 2)
        lobe_radius = _brightest_radius(pupil.shape, defocus, phi_deg, float(plain.radius.mean()), seed)
    aim_deg = _steered(pupil.shape, defocus, phi_deg, lobe_radius, goal, seed)
    progress("phase: peak", 1, 2)
    waves = _waves(pupil, defocus, lobe_radius * _directions(aim_deg))
    amplitude = _solve(waves, goal, iterations, seed)
    uniform = np.full(defocus.size, 1.0 / defocus.size)
    if goal == "mean":
        bound = peak_bound(waves, uniform, iterations, seed)
    else:
        bound = worst_peak_bound(waves, amplitude, iterations)
    field = _mask(amplitude @ waves)
    target = np.abs(waves.conj() @ field / pupil.count) ** 2
    lobe = main_lobe(pupil, field, defocus, half_width)
    progress("phase: peak", 2, 2)
    return PeakDesign(zones, defocus, lobe_radius, phi_deg, aim_deg, amplitude, goal, target, bound, lobe, plain)


def spiral_field(pupil: Pupil, zones: int, exponent: float) -> ComplexArray:
    """exp(i psi) of Eq. 2 for x polarisation at the pupil's samples, shape (n,)."""
    phase = SpiralZonesPhase(zones, exponent, 1.0)(pupil.axis, pupil.axis, "x")
    return phasor(phase[pupil.inside])


def _directions(phi_deg: FloatArray) -> FloatArray:
    phi = np.radians(phi_deg)
    return np.stack([np.cos(phi), np.sin(phi)], axis=1)


def _waves(pupil: Pupil, defocus_rad: FloatArray, tilt_rad: FloatArray) -> ComplexArray:
    """Target waves f_d, shape (n_depth, n)."""
    phase = np.outer(tilt_rad[:, 0], pupil.x) + np.outer(tilt_rad[:, 1], pupil.y)
    phase -= np.outer(defocus_rad, pupil.radius_squared)
    return phasor(phase)


def _mask(total: ComplexArray) -> ComplexArray:
    return np.asarray(total / np.maximum(np.abs(total), np.finfo(np.float64).tiny))


def _solve(waves: ComplexArray, goal: Goal, iterations: int, seed: int) -> ComplexArray:
    """Amplitudes of the best mask for target waves; the relaxation behind the bound says where to start."""
    weights = np.full(len(waves), 1.0 / len(waves))
    start = peak_bound(waves, weights, iterations, seed).start
    amplitude = _iterate(waves, weights, start, iterations)
    return _level(waves, amplitude, iterations) if goal == "worst" else amplitude


def _steered(
    shape: Outline,
    defocus_rad: FloatArray,
    phi_deg: FloatArray,
    lobe_radius: float,
    goal: Goal,
    seed: int,
) -> FloatArray:
    """Orientations to aim at, so that the brightest point, which drifts from the aimed one, keeps to the law."""
    pupil = Pupil(_COARSE, shape)
    aim_deg, best, smallest = phi_deg.copy(), phi_deg, math.inf
    for _ in range(_STEERING_ROUNDS):
        waves = _waves(pupil, defocus_rad, lobe_radius * _directions(aim_deg))
        amplitude = _solve(waves, goal, 40, seed)
        lobe = main_lobe(pupil, _mask(amplitude @ waves), defocus_rad, 2.0 * lobe_radius + 3.0)
        drift_deg = np.mod(lobe.phi_deg - phi_deg + 180.0, 360.0) - 180.0
        if (size := float(np.abs(drift_deg).mean())) < smallest:
            best, smallest = aim_deg, size
        aim_deg = aim_deg - 0.7 * np.clip(drift_deg, -20.0, 20.0)
    return best


def _iterate(waves: ComplexArray, weights: FloatArray, amplitude: ComplexArray, iterations: int) -> ComplexArray:
    """Ascend the weighted sum of peaks until a step gains less than 1e-7 of it."""
    adjoint = waves.conj().T / waves.shape[1]
    reached = 0.0
    for _ in range(iterations):
        response = _mask(amplitude @ waves) @ adjoint
        amplitude = weights * response
        value = float(weights @ np.abs(response) ** 2)
        if value - reached < 1e-7 * value:
            break
        reached = value
    return amplitude


def _level(waves: ComplexArray, amplitude: ComplexArray, iterations: int) -> ComplexArray:
    """Raise the worst depth: depths gain weight while they stay behind the mean (weighted Gerchberg-Saxton).

    Returns the amplitudes with the best worst peak that was met.
    """
    adjoint = waves.conj().T / waves.shape[1]
    gain = np.abs(amplitude)
    best, best_worst = amplitude, -math.inf
    for _ in range(iterations):
        response = _mask(amplitude @ waves) @ adjoint
        size = np.abs(response)
        if size.min() > best_worst:
            best, best_worst = amplitude, float(size.min())
        gain = gain * size.mean() / size
        amplitude = gain * response / size
    return best


def _brightest_radius(
    shape: Outline, defocus_rad: FloatArray, phi_deg: FloatArray, plain_radius: float, seed: int
) -> float:
    """The lobe radius, from 0.7 to 1.1 of the plain spiral's, whose optimised mean peak is largest."""
    pupil = Pupil(_COARSE, shape)
    weights = np.full(defocus_rad.size, 1.0 / defocus_rad.size)
    directions = _directions(phi_deg)
    candidates = plain_radius * np.linspace(_NEAREST_LOBE, 1.1, 9)
    means = []
    for radius in candidates:
        waves = _waves(pupil, defocus_rad, radius * directions)
        start = peak_bound(waves, weights, 20, seed).start
        amplitude = _iterate(waves, weights, start, 30)
        means.append(float(np.mean(np.abs(waves.conj() @ _mask(amplitude @ waves)) ** 2)))
    return float(candidates[int(np.argmax(means))])
