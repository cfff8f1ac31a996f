"""The brightest main lobe over the whole turn, by an iterative Fourier transform algorithm.

At rim defocus W_d the lobe belongs on a circle of radius v, at the orientation phi_d = phi_0 - W_d / L. Its amplitude
there is the inner product of the mask p with the target wave f_d = exp(-i W_d u^2 + i v_d . u). The step

    p  <-  exp(i arg sum_d c_d f_d),    c_d = w_d <f_d, p>

never lowers the weighted sum of the peaks: the sum is convex in p, and the step maximises its tangent. The final mask
is the phase of a sum of waves, known at every point (:class:`~metafab.phase.terms.helices.WaveSumPhase`).

Upper bounds of the lobe peaks of any mask show how close it is to the best one. The weighted sum of peaks is p^H G p
with G = sum_d w_d f_d f_d^H over the target waves, for a mask p with |p| <= 1 at each of n samples:

- spectral: n times the largest eigenvalue of G;
- dual: for any positive d, p^H G p <= sum(d) times the largest eigenvalue of D^-1/2 G D^-1/2. The best d belongs to the
  relaxation in which each sample of the mask is a unit vector of a few components instead of one phase. The iteration
  of the mask solves the relaxation, too (Burer and Monteiro, Mathematical Programming 95, 329, 2003).

G has few target waves, so both eigenvalues are those of small matrices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.numeric.phasor import phasor
from metafab.core.parallel.executor import one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.phase.optimise.rotation import MainLobe, full_turn_defocus_rad, helix_half_width, main_lobe
from metafab.phase.pupil import Outline, Pupil
from metafab.phase.terms.helices import WaveSumPhase, spiral_field

#: Components of a sample in the relaxation: one more than the rank of the optimal solutions met so far.
_COMPONENTS = 4
#: Smallest radius of the lobe over that of the plain spiral's. Nearer to the centre the lobe would be brighter, but its
#: turning harder to see.
_NEAREST_LOBE = 0.7
#: Samples a side of the pupil for the search of the lobe's radius and target points.
_COARSE = 48
#: Rounds in which the target points are moved against the drift of the lobe.
_STEERING_ROUNDS = 10

#: Quantity that is maximised: the mean of the peaks over depth, or the smallest.
Goal: TypeAlias = Literal["mean", "worst"]


@dataclass(frozen=True)
class PeakBound:
    """Upper bounds of the weighted mean of the target peaks, Strehl ratios."""

    spectral: float  #: From the largest eigenvalue of G; holds for any mask of the same mean square.
    dual: float  #: The tighter bound; holds for every mask with |p| <= 1 everywhere.
    start: ComplexArray  #: Shape (n_waves,), wave amplitudes of the main component of the relaxed solution.


def peak_bound(waves: ComplexArray, weights: FloatArray, iterations: int, seed: int) -> PeakBound:
    """Bound the sum over d of weights_d |<f_d, p>|^2 for all masks p.

    ``waves`` are the target waves f_d at the samples of the pupil, shape (n_waves, n), modulus 1; weights are positive,
    of sum 1. The bounds hold after any number of steps of the relaxation, which starts at random.
    """
    count = waves.shape[1]
    root = np.sqrt(weights)[:, None] * waves
    spectral = _largest_eigenvalue(root, np.ones(count)) / count
    random = np.random.default_rng(seed)
    shape = (_COMPONENTS, len(waves))
    amplitude = random.normal(size=shape) + 1j * random.normal(size=shape)
    adjoint = waves.conj().T / count
    drive = amplitude @ waves
    d, reached = _norm(drive), 0.0
    for step in range(iterations):
        amplitude = (drive / d @ adjoint) * weights
        drive = amplitude @ waves
        d = _norm(drive)
        # The mean of d rises to the bound; the first step still has the scale of the random start.
        value = float(d.mean())
        if step and value - reached < 1e-7 * value:
            break
        reached = value
    dual = _largest_eigenvalue(root, d) / count**2 * float(d.sum())
    _, values, right = np.linalg.svd(amplitude, full_matrices=False)
    return PeakBound(spectral, min(dual, spectral), values[0] * right[0])


def worst_peak_bound(waves: ComplexArray, start: ComplexArray, iterations: int) -> PeakBound:
    """Bound the smallest of the peaks |<f_d, p>|^2 for all masks p, by a weighted mean that is as low as possible.

    The weights come from the relaxation with levelled peaks: a depth gains weight while its peak is below the mean. The
    bounds hold after any number of steps. ``waves`` are as in :func:`peak_bound`; ``start``, shape (n_waves,), holds
    the wave amplitudes of a mask with about equal peaks.
    """
    count = waves.shape[1]
    adjoint = waves.conj().T / count
    # A second component, a quarter turn away, lets the relaxation leave the mask.
    amplitude = np.stack([start, 0.1j * start * np.exp(1j * np.arange(start.size))])
    gain = np.linalg.norm(amplitude, axis=0)
    for _ in range(iterations):
        drive = amplitude @ waves
        response = (drive / _norm(drive)) @ adjoint
        size = np.linalg.norm(response, axis=0)
        gain = gain * size.mean() / size
        amplitude = gain * response / size
    weights = gain / size
    return peak_bound(waves, weights / weights.sum(), iterations, seed=0)


def _norm(drive: ComplexArray) -> FloatArray:
    """Length of each sample's vector, kept away from zero; shape (n,)."""
    length = np.sqrt((np.abs(drive) ** 2).sum(axis=0))
    return np.asarray(np.maximum(length, 1e-6 * math.sqrt(float(np.mean(length**2)))), dtype=np.float64)


def _largest_eigenvalue(root: ComplexArray, d: FloatArray) -> float:
    scaled = root / np.sqrt(d)
    return float(np.linalg.eigvalsh(scaled @ scaled.conj().T)[-1])


@dataclass(frozen=True)
class PeakDesign:
    """An optimised mask and its quality."""

    zones: int  #: L, which sets the rate of rotation.
    defocus_rad: FloatArray  #: Shape (n_depth,), rim defocuses of the target points.
    lobe_radius: float  #: Radius of the target points, optical units.
    #: Shape (n_depth,), orientations of the target points; they lead or lag the law of rotation so that the lobe itself
    #: keeps to it.
    aim_deg: FloatArray
    amplitude: ComplexArray  #: Shape (n_depth,), weights of the waves whose sum has the phase of the mask.
    goal: Goal  #: Maximised quantity, the mean or the smallest value of ``target``.
    target: FloatArray  #: Shape (n_depth,), Strehl ratio at the target points.
    bound: PeakBound  #: Upper bound of that quantity for any mask.
    lobe: MainLobe  #: Measured main lobe of the mask.
    plain: MainLobe  #: Measured main lobe of the spiral of Eq. 2 at the same defocuses.

    @property
    def peak_gain(self) -> float:
        """Mean peak over that of the plain spiral (1.36 in Shen 2023)."""
        return self.lobe.peak_gain(self.plain)

    @property
    def worst_gain(self) -> float:
        """Smallest peak over the smallest of the plain spiral."""
        return self.lobe.worst_gain(self.plain)

    @property
    def reached(self) -> float:
        """Value of the maximised quantity, Strehl ratio."""
        return float(self.target.mean() if self.goal == "mean" else self.target.min())

    @property
    def bound_fraction(self) -> float:
        """Value of the maximised quantity over its bound; 1 is the best of any mask."""
        return self.reached / self.bound.dual

    @property
    def aim(self) -> FloatArray:
        """Target points, shape (n_depth, 2), x and y in optical units."""
        return self.lobe_radius * _directions(self.aim_deg)

    def term(self, radius_um: float, polarisation: Polarisation | None = None) -> WaveSumPhase:
        """Return the mask of an aperture of this radius as a phase term of one polarisation, or of both (None)."""
        return WaveSumPhase(radius_um, self.amplitude, self.defocus_rad, self.aim, polarisation=polarisation)


def optimise_peak(
    zones: int,
    exponent: float = 0.5,
    *,
    pupil: Pupil | None = None,
    goal: Goal = "mean",
    iterations: int = 200,
    seed: int = 1,
    progress: Progress = silent,
) -> PeakDesign:
    """Maximise the peak of the main lobe over one full turn, in the mean or at the worst depth, under the law of Eq. 2.

    Args:
        zones: L of Eq. 2, at least 2 (else ValueError: a plain vortex does not turn); the orientation changes by -1 / L
            rad per rad of rim defocus.
        exponent: epsilon of the plain spiral, whose lobe sets the range of radii and the origin of phi.
        pupil: samples; a circle of 128 by default.
        goal: "mean" peak, or the "worst" one.
        iterations: largest number of steps of each kind.
        seed: of the random start; the result does not depend on it.
    """
    if zones < 2:
        raise ValueError(f"`zones`: expected at least 2, got {zones}; a plain vortex does not turn with depth")
    pupil = pupil or Pupil()
    # Small matrices: a second BLAS thread costs more than it brings, at times a hundredfold.
    with one_blas_thread():
        progress("phase: peak", 0, 2)
        defocus = full_turn_defocus_rad(zones, max(24, 6 * zones))
        half_width = helix_half_width(zones)
        plain = main_lobe(pupil, spiral_field(pupil, zones, exponent), defocus, half_width)
        # The plain spiral's lobe swings slowly about the law: the origin of the law is the mean over depth.
        origin_rad = float(np.angle(np.mean(np.exp(1j * (np.radians(plain.phi_deg) + defocus / zones)))))
        phi_deg = np.degrees(origin_rad - defocus / zones)
        lobe_radius = _brightest_radius(pupil.shape, defocus, phi_deg, float(plain.radius.mean()), seed)
        aim_deg = _steered(pupil.shape, defocus, phi_deg, lobe_radius, goal, seed)
        progress("phase: peak", 1, 2)
        waves = target_waves(pupil, defocus, lobe_radius * _directions(aim_deg))
        amplitude = _solve(waves, goal, iterations, seed)
        if goal == "mean":
            bound = peak_bound(waves, _uniform(waves), iterations, seed)
        else:
            bound = worst_peak_bound(waves, amplitude, iterations)
        field = _mask(amplitude @ waves)
        target = np.abs(waves.conj() @ field / pupil.count) ** 2
        lobe = main_lobe(pupil, field, defocus, half_width)
        progress("phase: peak", 2, 2)
    return PeakDesign(zones, defocus, lobe_radius, aim_deg, amplitude, goal, target, bound, lobe, plain)


def target_waves(pupil: Pupil, defocus_rad: FloatArray, aim: FloatArray) -> ComplexArray:
    """Target waves f_d: the masks that focus on one point each, at n_depth rim defocuses.

    The target points, optical units, have the shape (n_depth, 2), the waves (n_depth, n) and modulus 1.
    """
    phase = np.outer(aim[:, 0], pupil.x) + np.outer(aim[:, 1], pupil.y)
    phase -= np.outer(defocus_rad, pupil.radius_squared)
    return phasor(phase)


def _directions(phi_deg: FloatArray) -> FloatArray:
    phi = np.radians(phi_deg)
    return np.stack([np.cos(phi), np.sin(phi)], axis=1)


def _uniform(waves: ComplexArray) -> FloatArray:
    return np.full(len(waves), 1.0 / len(waves))


def _mask(total: ComplexArray) -> ComplexArray:
    """Phase factor of each sample."""
    return np.asarray(total / np.maximum(np.abs(total), np.finfo(np.float64).tiny))


def _solve(waves: ComplexArray, goal: Goal, iterations: int, seed: int) -> ComplexArray:
    """Amplitudes of the best mask for target waves; the iteration starts at the relaxed solution."""
    weights = _uniform(waves)
    start = peak_bound(waves, weights, iterations, seed).start
    amplitude = _iterate(waves, weights, start, iterations)
    return _level(waves, amplitude, iterations) if goal == "worst" else amplitude


def _steered(
    shape: Outline, defocus_rad: FloatArray, phi_deg: FloatArray, lobe_radius: float, goal: Goal, seed: int
) -> FloatArray:
    """Orientations of the target points for which the brightest point, which drifts from them, keeps to the law."""
    pupil = Pupil(_COARSE, shape)
    aim_deg, best, smallest = phi_deg.copy(), phi_deg, math.inf
    for _ in range(_STEERING_ROUNDS):
        waves = target_waves(pupil, defocus_rad, lobe_radius * _directions(aim_deg))
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
    """Raise the smallest peak: a depth gains weight while its peak is below the mean (weighted Gerchberg-Saxton).

    Returns the amplitudes with the largest smallest peak of all steps.
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
    """Lobe radius with the largest optimised mean peak, from 0.7 to 1.1 times that of the plain spiral."""
    pupil = Pupil(_COARSE, shape)
    directions = _directions(phi_deg)
    candidates = plain_radius * np.linspace(_NEAREST_LOBE, 1.1, 9)
    means = []
    for radius in candidates:
        waves = target_waves(pupil, defocus_rad, radius * directions)
        start = peak_bound(waves, _uniform(waves), 20, seed).start
        amplitude = _iterate(waves, _uniform(waves), start, 30)
        means.append(float(np.mean(np.abs(waves.conj() @ _mask(amplitude @ waves)) ** 2)))
    return float(candidates[int(np.argmax(means))])
