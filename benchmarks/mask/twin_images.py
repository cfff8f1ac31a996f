"""Simulated twin images at the level of the pupil, and their depth by maximum likelihood: a test of the bound.

Both polarisations' PSFs image a random texture, with photon and read noise. The rim defocus is estimated under the
model of :mod:`metafab.information.fisher`: per frequency y = b s + noise with unknown s of unit power, whose log
likelihood is |b^H y|^2 / (1 + |b|^2) - ln(1 + |b|^2). The patch is periodic, so no border is lost.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.phase.optimise.blind import BlindInformation

#: Candidates over the range, and around the best of them.
_COARSE, _FINE = 65, 17


def twin_images(
    problem: BlindInformation, mask: ComplexArray, defocus_rad: float, random: np.random.Generator
) -> FloatArray:
    """Simulate noisy images of one random texture in both polarisations.

    Args:
        problem: pupil, texture and noise; its defocuses are not used.
        mask: shape (n,), pupil field of x polarisation; y is its point mirror.
        defocus_rad: rim defocus of the texture.
        random: source of texture and noise.

    Returns:
        Shape (2, m, m) with m = 2 samples of the pupil, electrons.
    """
    texture, side = problem.texture, 2 * problem.pupil.samples
    power = texture.signal_to_noise((side, side))
    white = fft.fft2(random.normal(size=(side, side)))
    relief = fft.ifft2(white * np.sqrt(power / power.mean())).real
    # Brightness is not negative: the darkest places of a strong texture are cut.
    scene = texture.electrons * np.maximum(1.0 + texture.contrast * relief, 0.0)
    transfer = replace(problem, defocus_rad=np.array([defocus_rad])).transfer(mask)[0][0]
    spectrum = fft.fft2(scene)
    # Rounding may leave dark pixels slightly below zero.
    mean = np.maximum(fft.ifft2(np.stack([transfer, transfer.conj()]) * spectrum).real, 0.0) + texture.background_e
    return np.asarray(random.poisson(mean) + texture.read_noise_e * random.normal(size=mean.shape))


def most_likely_defocus(
    images: FloatArray, problem: BlindInformation, mask: ComplexArray, nearest_rad: float, farthest_rad: float
) -> float:
    """Estimate the rim defocus of twin images by maximum likelihood.

    Args:
        images: shape (2, m, m) with m = 2 samples of the pupil, electrons.
        problem: pupil, texture and noise; its defocuses are not used.
        mask: shape (n,), pupil field of x polarisation; y is its point mirror.
        nearest_rad: one end of the search range.
        farthest_rad: the other end.

    Returns:
        Rim defocus, rad.
    """
    texture = problem.texture
    data = fft.fft2(images) / np.sqrt(texture.noise_variance_e2 * images[0].size)
    amplitude = np.sqrt(texture.signal_to_noise((images.shape[1], images.shape[2])))

    def likelihood(candidates: FloatArray) -> FloatArray:
        blurred = amplitude * replace(problem, defocus_rad=candidates).transfer(mask)[0]
        power = 1.0 + 2.0 * np.abs(blurred) ** 2
        matched = blurred.conj() * data[0] + blurred * data[1]
        return np.asarray((np.abs(matched) ** 2 / power - np.log(power)).sum(axis=(1, 2)))

    coarse = np.linspace(nearest_rad, farthest_rad, _COARSE)
    best = float(coarse[np.argmax(likelihood(coarse))])
    step = abs(float(coarse[1] - coarse[0]))
    fine = np.linspace(best - step, best + step, _FINE)
    value = likelihood(fine)
    top = int(np.clip(np.argmax(value), 1, _FINE - 2))
    below, here, above = value[top - 1 : top + 2]
    shift = 0.5 * (below - above) / (below - 2.0 * here + above)
    return float(fine[top] + shift * (fine[1] - fine[0]))
