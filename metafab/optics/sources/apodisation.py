"""What stands in the plane of the pillars besides them: a round stop, and an amplitude of the user's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.numeric.bilinear import bilinear_on_grid
from metafab.optics.sources.source import ApodisedField, Source
from metafab.phase.terms.sampled import read_array
from metafab.spec import Design

#: Amplitude let through, 0 to 1, shape (n_y, n_x), at x (n_x,) and y (n_y,) in um.
Transmission = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Apodisation:
    """Stop and amplitude; either may be absent.

    Attributes:
        stop_um: diameter of the stop; infinite for none.
        samples: shape (n_y, n_x), amplitudes on a square grid about the axis, lowest y first, or None.
        pitch_um: distance of samples, between which amplitudes are interpolated bilinearly.
    """

    stop_um: float = np.inf
    samples: FloatArray | None = None
    pitch_um: float = 1.0

    def __call__(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Amplitude that is let through; sites count by their centres, as those of the aperture do."""
        open_ = np.hypot(x_um[None, :], y_um[:, None]) <= 0.5 * self.stop_um
        if self.samples is None:
            return open_.astype(np.float64)
        return np.asarray(open_ * bilinear_on_grid(self.samples, x_um / self.pitch_um, y_um / self.pitch_um))

    @classmethod
    def of(cls, design: Design) -> Apodisation | None:
        """What the ``[optics]`` of a design puts there; None for nothing.

        Raises:
            InputError: the file of amplitudes cannot be read, holds others than 0 to 1, or does not cover the aperture.
        """
        optics = design.optics
        if optics is None or (optics.stop_um is None and optics.amplitude_file is None):
            return None
        stop_um = np.inf if optics.stop_um is None else optics.stop_um
        if optics.amplitude_file is None or optics.amplitude_pitch_um is None:
            return cls(stop_um)
        samples = _amplitudes(optics.amplitude_file, optics.amplitude_dataset)
        reach_um, radius_um = 0.5 * min(samples.shape) * optics.amplitude_pitch_um, 0.5 * design.device.aperture_um
        if reach_um < radius_um * (1.0 - 1e-9):
            raise InputError.single(
                str(optics.amplitude_file), "optics.amplitude_pitch_um",
                f"samples that cover the aperture to {radius_um:g} um from the axis",
                f"a grid that reaches {reach_um:g} um", "give more samples or the right pitch; nothing is extrapolated",
            )  # fmt: skip
        return cls(stop_um, samples, optics.amplitude_pitch_um)


def apodised(source: Source, transmission: Transmission | None) -> Source:
    """The source behind stop and amplitude; itself where there is none."""
    return source if transmission is None else ApodisedField(source, transmission)


def _amplitudes(file: Path, dataset: str) -> FloatArray:
    samples = read_array(file, dataset)
    fits = samples.ndim == 2 and min(samples.shape) >= 2 and samples.dtype.kind in "fiu"
    if not fits or not np.isfinite(samples).all() or samples.min() < 0.0 or samples.max() > 1.0:
        got = f"{samples.dtype} of shape {samples.shape}"
        if fits:
            got += f", {samples.min():g} to {samples.max():g}"
        raise InputError.single(
            str(file), "optics.amplitude_file", "amplitudes from 0 to 1 of shape (n_y, n_x), at least 2 x 2", got,
            "amplitudes are roots of transmitted power",
        )  # fmt: skip
    return samples.astype(np.float64)
