"""The helix that tells most about depth when the texture is unknown: gradient ascent of ``information``.

The unknowns are the phases of all pupil samples; the derivative of the information with respect to each follows by
running the chain phases -> amplitude -> PSF -> transfer function -> information backwards once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.parallel.progress import Progress, silent
from metafab.information.twin_images import Texture
from metafab.phase.pupil import Pupil, phasor
from metafab.phase.terms.sampled import SampledPhase


@dataclass(frozen=True)
class BlindInformation:
    """Information about the rim defocus in a conjugate pair, and its gradient over the pupil's phases.

    PSFs lie on a grid of twice the pupil's samples a side, whose step is the intensity's Nyquist step.

    Attributes:
        pupil: samples.
        defocus_rad: shape (n_depth,), rim defocuses.
        texture: unknown texture and noise; a pixel is one step of the grid.
    """

    pupil: Pupil
    defocus_rad: FloatArray
    texture: Texture

    @cached_property
    def _signal_to_noise(self) -> FloatArray:
        side = 2 * self.pupil.samples
        return self.texture.signal_to_noise((side, side))

    @cached_property
    def _defocus(self) -> ComplexArray:
        return phasor(np.multiply.outer(self.defocus_rad, self.pupil.radius_squared_grid)) * self.pupil.inside

    def of_field(self, field: ComplexArray) -> FloatArray:
        """Information, shape (n_depth,), 1/rad^2, of a pupil field, shape (n,)."""
        return self._evaluate(field)[0]

    def transfer(self, field: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Transfer functions of x polarisation and their derivatives over the rim defocus.

        Args:
            field: shape (n,), pupil field.

        Returns:
            Two arrays of shape (n_depth, 2 samples, 2 samples), zero frequency first, where the transfer is 1; y
            polarisation has their complex conjugates.
        """
        return self._evaluate(field)[3:]

    def with_gradient(self, phase_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Information, shape (n_depth,), and the derivative of its mean over the phases, shape (n,).

        Args:
            phase_rad: shape (n,), phases of the pupil's samples.
        """
        field = phasor(phase_rad)
        information, amplitude, amplitude_slope, transfer, slope = self._evaluate(field)
        snr, total = self._signal_to_noise, 4.0 * self.pupil.samples**2
        turn = (slope * transfer.conj()).imag
        weight = 1.0 / (1.0 + 2.0 * snr * np.abs(transfer) ** 2)
        by_turn = 8.0 * snr**2 * turn * weight
        by_power = -8.0 * snr**3 * (turn * weight) ** 2
        # Backwards: transfer functions -> PSF and its derivative -> amplitudes -> pupil.
        scale = self._psf_scale * total / len(self.defocus_rad)
        by_psf = scale * fft.ifft2(-1j * by_turn * slope + 2.0 * by_power * transfer).real
        by_slope = scale * fft.ifft2(1j * by_turn * transfer).real
        by_amplitude = 2.0 * (amplitude * by_psf + amplitude_slope * by_slope)
        by_amplitude_slope = 2.0 * amplitude * by_slope
        n = self.pupil.samples
        u2 = self.pupil.radius_squared_grid
        back = fft.ifft2(by_amplitude)[:, :n, :n] - 1j * u2 * fft.ifft2(by_amplitude_slope)[:, :n, :n]
        by_field = (total * back * self._defocus.conj()).sum(axis=0)[self.pupil.inside]
        return information, np.asarray((by_field * field.conj()).imag, dtype=np.float64)

    @property
    def _psf_scale(self) -> float:
        """Makes a PSF's sum 1 (Parseval)."""
        return 1.0 / (4.0 * self.pupil.samples**2 * self.pupil.count)

    def _evaluate(
        self, field: ComplexArray
    ) -> tuple[FloatArray, ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
        grid = np.zeros(self.pupil.inside.shape, dtype=np.complex128)
        grid[self.pupil.inside] = field
        defocused = grid * self._defocus
        side = (2 * self.pupil.samples, 2 * self.pupil.samples)
        amplitude = fft.fft2(defocused, side)
        amplitude_slope = fft.fft2(1j * self.pupil.radius_squared_grid * defocused, side)
        transfer = fft.fft2(self._psf_scale * np.abs(amplitude) ** 2)
        slope = fft.fft2(self._psf_scale * 2.0 * (amplitude.conj() * amplitude_slope).real)
        snr = self._signal_to_noise
        turn = (slope * transfer.conj()).imag
        density = 4.0 * (snr * turn) ** 2 / (1.0 + 2.0 * snr * np.abs(transfer) ** 2)
        return density.sum(axis=(1, 2)), amplitude, amplitude_slope, transfer, slope


@dataclass(frozen=True)
class BlindDesign:
    """A mask optimised for information.

    Attributes:
        pupil: samples.
        phase_rad: shape (n,), phase of x polarisation at the samples.
        information: shape (n_depth,), 1/rad^2 of rim defocus.
        start_information: shape (n_depth,), of the mask that the ascent started from.
        evaluations: of the gradient.
    """

    pupil: Pupil
    phase_rad: FloatArray
    information: FloatArray
    start_information: FloatArray
    evaluations: int

    def term(self, radius_um: float, polarisation: Polarisation | None = None) -> SampledPhase:
        """The mask as a phase term; y is the point mirror of x, between samples the complex field is interpolated."""
        return SampledPhase.of_pupil(self.pupil, self.phase_rad, radius_um, polarisation)


def optimise_blind(
    problem: BlindInformation, start: ComplexArray, *, iterations: int = 60, progress: Progress = silent
) -> BlindDesign:
    """Ascend the mean information over the depths (L-BFGS).

    Args:
        problem: depths, texture and noise.
        start: shape (n,), pupil field to start from.
        iterations: at most.
        progress: called at each evaluation.
    """
    before = problem.of_field(start)
    scale = float(before.mean()) or 1.0
    evaluations = 0

    def descend(phase_rad: FloatArray) -> tuple[float, FloatArray]:
        nonlocal evaluations
        evaluations += 1
        progress("phase: blind information", min(evaluations, iterations), iterations)
        information, gradient = problem.with_gradient(phase_rad)
        return -float(information.mean()) / scale, -gradient / scale

    with threadpool_limits(1):
        found = minimize(
            descend, np.angle(start), jac=True, method="L-BFGS-B", options={"maxiter": iterations, "maxcor": 20}
        )
    phase_rad = np.asarray(found.x, dtype=np.float64)
    return BlindDesign(problem.pupil, phase_rad, problem.of_field(phasor(phase_rad)), before, evaluations)
