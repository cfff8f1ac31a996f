"""The helix with the largest depth information for unknown texture, by gradient ascent.

The unknowns are the phases of all pupil samples. One backward pass through the chain phases -> amplitude -> PSF ->
transfer function -> information gives the derivative with respect to each of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft
from scipy.optimize import minimize

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.phasor import phasor
from metafab.core.parallel.executor import one_blas_thread
from metafab.core.parallel.progress import Progress, silent
from metafab.information.fisher import conjugate_information
from metafab.information.texture import Texture
from metafab.phase.pupil import NyquistImages, Pupil, nyquist_scale
from metafab.phase.terms.sampled import SampledMask


@dataclass(frozen=True)
class BlindInformation:
    """Information about the rim defocus in a conjugate pair of images, and its gradient over the pupil's phases.

    The images have m = 2 samples Nyquist pixels a side.
    """

    pupil: Pupil  #: Samples.
    defocus_rad: FloatArray  #: Shape (n_depth,), rim defocuses.
    texture: Texture  #: Unknown texture and noise, per Nyquist pixel.

    @cached_property
    def _signal_to_noise(self) -> FloatArray:
        side = 2 * self.pupil.samples
        return self.texture.signal_to_noise((side, side))

    @cached_property
    def _defocus(self) -> ComplexArray:
        return phasor(np.multiply.outer(self.defocus_rad, self.pupil.radius_squared_grid)) * self.pupil.inside

    def of_field(self, field: ComplexArray) -> FloatArray:
        """Information about the rim defocus, shape (n_depth,), 1/rad^2, of an x-polarised pupil field, shape (n,)."""
        return conjugate_information(*self.transfer(field), self._signal_to_noise)

    def transfer(self, field: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Transfer functions of x polarisation and their derivatives over the rim defocus, from a field of shape (n,).

        Both have the shape (n_depth, m, m), zero frequency first, where the transfer is 1; y polarisation has the
        complex conjugates.
        """
        images = self._images(field)
        return fft.fft2(images.psf), fft.fft2(images.psf_slope)

    def with_gradient(self, phase_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Information, shape (n_depth,), 1/rad^2, and the slope of its mean over the phases, shape (n,), 1/rad^3."""
        field = phasor(phase_rad)
        images = self._images(field)
        transfer, slope = fft.fft2(images.psf), fft.fft2(images.psf_slope)
        information = conjugate_information(transfer, slope, self._signal_to_noise)
        snr, total = self._signal_to_noise, 4.0 * self.pupil.samples**2
        turn = (slope * transfer.conj()).imag
        weight = 1.0 / (1.0 + 2.0 * snr * np.abs(transfer) ** 2)
        by_turn = 8.0 * snr**2 * turn * weight
        by_power = -8.0 * snr**3 * (turn * weight) ** 2
        # Backwards: transfer functions -> PSF and its derivative -> amplitudes -> pupil.
        scale = nyquist_scale(self.pupil) * total / len(self.defocus_rad)
        by_psf = scale * fft.ifft2(-1j * by_turn * slope + 2.0 * by_power * transfer).real
        by_slope = scale * fft.ifft2(1j * by_turn * transfer).real
        by_amplitude = 2.0 * (images.amplitude * by_psf + images.amplitude_slope * by_slope)
        by_amplitude_slope = 2.0 * images.amplitude * by_slope
        n = self.pupil.samples
        u2 = self.pupil.radius_squared_grid
        back = fft.ifft2(by_amplitude)[:, :n, :n] - 1j * u2 * fft.ifft2(by_amplitude_slope)[:, :n, :n]
        by_field = (total * back * self._defocus.conj()).sum(axis=0)[self.pupil.inside]
        return information, np.asarray((by_field * field.conj()).imag, dtype=np.float64)

    def _images(self, field: ComplexArray) -> NyquistImages:
        return NyquistImages.of(self.pupil, self.pupil.on_grid(field) * self._defocus)


@dataclass(frozen=True)
class BlindDesign(SampledMask):
    """A mask optimised for information."""

    information: FloatArray  #: Shape (n_depth,), information about the rim defocus, 1/rad^2.


def optimise_blind(
    problem: BlindInformation, start: ComplexArray, *, iterations: int = 60, progress: Progress = silent
) -> BlindDesign:
    """Maximise the mean information over the depths (L-BFGS), from a pupil field ``start``, shape (n,)."""
    scale = float(problem.of_field(start).mean()) or 1.0
    evaluations = 0

    def descend(phase_rad: FloatArray) -> tuple[float, FloatArray]:
        nonlocal evaluations
        evaluations += 1
        progress("phase: blind information", min(evaluations, iterations), iterations)
        information, gradient = problem.with_gradient(phase_rad)
        return -float(information.mean()) / scale, -gradient / scale

    with one_blas_thread():
        optimum = minimize(
            descend, np.angle(start), jac=True, method="L-BFGS-B", options={"maxiter": iterations, "maxcor": 20}
        )
    phase_rad = np.asarray(optimum.x, dtype=np.float64)
    return BlindDesign(problem.pupil, phase_rad, problem.of_field(phasor(phase_rad)))
