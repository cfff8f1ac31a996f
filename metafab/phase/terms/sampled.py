"""Terms given by samples: a user's own phase, or a pupil that was optimised sample by sample.

Between samples the complex field exp(i psi) is interpolated bilinearly and its angle taken, so a jump of 2 pi
between neighbours is no jump at all. Steps of pi or more between neighbours cannot be told from their complement:
sample finely enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.errors import InputError
from metafab.phase.pupil import Pupil, phasor
from metafab.phase.terms.angle import angle


@dataclass(frozen=True)
class SampledPhase:
    """The phase of a sampled complex field.

    Attributes:
        field: shape (2, n_y, n_x) for x and y polarisation, or (1, n_y, n_x): then y is the point mirror of x.
        pitch_um: distance of samples; the grid is centred on the axis, lowest y first.
        polarisation: the one that it acts on; None for both.
    """

    field: ComplexArray
    pitch_um: float
    polarisation: Polarisation | None = None

    @classmethod
    def of_pupil(
        cls, pupil: Pupil, phase_rad: FloatArray, radius_um: float, polarisation: Polarisation | None
    ) -> SampledPhase:
        """Phases of x polarisation at a pupil's samples, shape (n,), over an aperture of ``radius_um``; y mirrors x."""
        grid = np.ones(pupil.inside.shape, dtype=np.complex128)
        grid[pupil.inside] = phasor(phase_rad)
        return cls(grid[None], 2.0 * radius_um / pupil.samples, polarisation)

    def __call__(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        """Phase on the grid of ``x_um`` (n_x,) and ``y_um`` (n_y,): shape (n_y, n_x), rad in [-pi, pi].

        Beyond the outermost samples their values are held; :func:`load_array` sees that this is at most half a
        pitch inside the aperture.
        """
        if self.polarisation not in {None, polarisation}:
            return np.zeros((y_um.size, x_um.size))
        mirrored = len(self.field) == 1 and polarisation == "y"
        sign = -1.0 if mirrored else 1.0
        samples = self.field[0 if polarisation == "x" or mirrored else 1]
        row, share_y = neighbours(sign * y_um / self.pitch_um, samples.shape[0])
        column, share_x = neighbours(sign * x_um / self.pitch_um, samples.shape[1])
        rows = samples[row] * (1.0 - share_y)[:, None] + samples[row + 1] * share_y[:, None]
        field = rows[:, column] * (1.0 - share_x) + rows[:, column + 1] * share_x
        return angle(field)


def neighbours(position: FloatArray, count: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Lower neighbour and share of the upper one for positions in pitches from the centre of ``count`` samples."""
    index = np.clip(position + 0.5 * (count - 1), 0.0, count - 1.0)
    lower = np.minimum(index.astype(np.int64), count - 2)
    return lower, index - lower


def load_array(
    file: Path, pitch_um: float, dataset: str, radius_um: float, polarisation: Polarisation | None = None
) -> SampledPhase:
    """A user's phase from a file.

    Args:
        file: .npy, .csv (comma-separated rows, one polarisation) or .h5; radians, real, shape (n_y, n_x) for both
            polarisations alike or (2, n_y, n_x) for x and y.
        pitch_um: distance of the samples.
        dataset: name inside an .h5 file.
        radius_um: aperture's radius, which the samples must cover.
        polarisation: the one that the term acts on; None for both.

    Raises:
        InputError: the file cannot be read, or is not a finite array of that form that covers the aperture.
    """
    phase = read_array(file, dataset)
    expected = "finite real numbers of shape (n_y, n_x) or (2, n_y, n_x), at least 2 x 2"
    shape_fits = phase.ndim == 2 or (phase.ndim == 3 and len(phase) == 2)
    if not shape_fits or min(phase.shape[-2:]) < 2 or phase.dtype.kind not in "fiu":
        raise InputError.single(str(file), "array", expected, f"{phase.dtype} of shape {phase.shape}")
    if lost := int(np.count_nonzero(~np.isfinite(phase))):
        raise InputError.single(str(file), "array", expected, f"NaN or infinity at {lost} of {phase.size} places")
    reach_um = 0.5 * min(phase.shape[-2:]) * pitch_um
    if reach_um < radius_um * (1.0 - 1e-9):
        raise InputError.single(
            str(file),
            "pitch_um",
            f"samples that cover the aperture to {radius_um:g} um from the axis",
            f"a grid that reaches {reach_um:g} um",
            "give more samples or the right pitch; nothing is extrapolated",
        )
    return SampledPhase(np.exp(1j * np.broadcast_to(phase, (2, *phase.shape[-2:]))), pitch_um, polarisation)


def read_array(file: Path, dataset: str) -> NDArray[np.generic]:
    """The array of a .npy, .csv or .h5 file (there, the one named ``dataset``), whatever it holds.

    Raises:
        InputError: the file cannot be read as one.
    """
    expected = "a .npy, .csv or .h5 file with an array"
    if file.suffix not in {".npy", ".csv", ".h5"}:
        raise InputError.single(str(file), "file", expected, f"the ending {file.suffix!r}")
    try:
        if file.suffix == ".npy":
            return np.asarray(np.load(file, allow_pickle=False))
        if file.suffix == ".csv":
            return np.loadtxt(file, delimiter=",", ndmin=2)
        with h5py.File(file, "r") as source:
            return np.asarray(source[dataset])
    except Exception as error:  # the readers raise whatever they meet in a broken file
        raise InputError.single(str(file), "file", expected, f"an unreadable one ({error})") from error
