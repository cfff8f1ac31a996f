"""Apodisation in the plane of the pillars: a round stop and a sampled amplitude."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.bilinear import bilinear_on_grid
from metafab.optics.sources.source import ApodisedField, Source
from metafab.phase.terms.sampled import read_array, require_coverage
from metafab.spec import Design

#: Transmitted amplitude, 0 to 1, shape (n_y, n_x), at x, shape (n_x,), and y, shape (n_y,), in um.
Transmission = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Apodisation:
    """Round stop and sampled amplitude; either may be absent."""

    stop_um: float = np.inf  #: Diameter of the stop; infinite for none.
    #: Shape (n_y, n_x), amplitudes on a square grid about the axis, lowest y first; None for 1.
    samples: FloatArray | None = None
    pitch_um: float = 1.0  #: Distance of the samples, between which the amplitude is bilinear.

    def __call__(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Return the transmitted amplitude, shape (n_y, n_x), at ``x_um``, shape (n_x,), and ``y_um``, shape (n_y,).

        A site is inside the stop if its centre is, as with the aperture.
        """
        open_ = np.hypot(x_um[None, :], y_um[:, None]) <= 0.5 * self.stop_um
        if self.samples is None:
            return open_.astype(np.float64)
        return np.asarray(open_ * bilinear_on_grid(self.samples, x_um / self.pitch_um, y_um / self.pitch_um))

    @classmethod
    def of(cls, design: Design) -> Apodisation | None:
        """Return the apodisation of a design (``[optics]``); None for none.

        InputError if the file of amplitudes cannot be read, has values outside 0 to 1, or does not cover the aperture.
        """
        optics = design.optics
        if optics is None or (optics.stop_um is None and optics.amplitude_file is None):
            return None
        stop_um = np.inf if optics.stop_um is None else optics.stop_um
        if optics.amplitude_file is None or optics.amplitude_pitch_um is None:
            return cls(stop_um)
        samples = _amplitudes(optics.amplitude_file, optics.amplitude_dataset)
        reach_um = 0.5 * min(samples.shape) * optics.amplitude_pitch_um
        radius_um = 0.5 * design.device.aperture_um
        require_coverage(optics.amplitude_file, "optics.amplitude_pitch_um", reach_um, radius_um)
        return cls(stop_um, samples, optics.amplitude_pitch_um)


def apodised(source: Source, transmission: Transmission | None) -> Source:
    """Return the source behind an apodisation; the source itself for None."""
    return source if transmission is None else ApodisedField(source, transmission)


def _amplitudes(file: Path, dataset: str) -> FloatArray:
    samples = read_array(file, dataset)
    fits = samples.ndim == 2 and min(samples.shape) >= 2 and samples.dtype.kind in "fiu"
    if not fits or not np.isfinite(samples).all() or samples.min() < 0.0 or samples.max() > 1.0:
        got = f"{samples.dtype} of shape {samples.shape}"
        if fits:
            got += f", {samples.min():g} to {samples.max():g}"
        expected = "amplitudes from 0 to 1 of shape (n_y, n_x), at least 2 x 2"
        remedy = "give the square root of the transmitted power"
        raise InputError.single(str(file), "optics.amplitude_file", expected, got, remedy)
    return samples.astype(np.float64)
