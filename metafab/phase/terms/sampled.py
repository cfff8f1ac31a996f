"""Terms given by samples: a user's own phase, or a pupil that was optimised sample by sample.

Between samples the complex field exp(i psi) is interpolated bilinearly and its angle taken, so a jump of 2 pi between
neighbours has no effect. Steps of pi or more between neighbours are ambiguous: sample finely enough.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray, Polarisation
from metafab.core.errors import InputError
from metafab.core.numeric.interpolation import bilinear_on_grid
from metafab.core.numeric.phasor import phasor
from metafab.core.storage import hdf5, pictures
from metafab.phase.pupil import Pupil
from metafab.phase.terms.angles import angle
from metafab.phase.terms.profile import PolarisedTerm

#: A turn with its rounding errors, and the share of steps that may be longer: outlines of zones of several turns, or of
#: an aperture with zeros around it, whose share is 2 over its samples a side.
_LARGEST_STEP_RAD, _STEEP_SHARE = 2.0 * np.pi + 1e-3, 0.1
#: Span from which two or more levels without slopes between them are no radians: 8 turns, of degrees (0, 180) or of a
#: picture (0, 255). Zones of several turns stay below it.
_WIDEST_LEVELS_RAD = 50.0
#: Fewest samples across an aperture: a single one is no map, but a pitch in other units.
_FEWEST_ACROSS = 2


@dataclass(frozen=True)
class SampledPhase(PolarisedTerm):
    """The phase of a sampled complex field; beyond the outermost samples their values are held.

    Raises:
        InputError: ``field`` is not complex, such as phases in place of their phasors, or has another shape.
    """

    #: Shape (2, n_y, n_x) for x and y polarisation, or (1, n_y, n_x): then y is the point mirror of x.
    field: ComplexArray = field(repr=False)
    pitch_um: float  #: Distance of the samples; the grid is centred on the axis, lowest y first.

    def __post_init__(self) -> None:
        """Check type and shape of the samples."""
        samples = np.asarray(self.field)
        if samples.dtype.kind != "c" or samples.ndim != 3 or len(samples) not in {1, 2}:
            expected, got = "a complex field of shape (2 or 1, n_y, n_x)", f"{samples.dtype} of shape {samples.shape}"
            remedy = "numpy.exp(1j * phase_rad) is the field of phases; stack those of x and y polarisation"
            raise InputError.single("phase", "field", expected, got, remedy)

    def _phase(self, x_um: FloatArray, y_um: FloatArray, polarisation: Polarisation) -> FloatArray:
        mirrored = len(self.field) == 1 and polarisation == "y"
        sign = -1.0 if mirrored else 1.0
        samples = self.field[0 if polarisation == "x" or mirrored else 1]
        return angle(bilinear_on_grid(samples, sign * x_um / self.pitch_um, sign * y_um / self.pitch_um))


@dataclass(frozen=True)
class SampledMask:
    """A mask of free phases, one for each sample of a pupil: the result of a gradient search."""

    pupil: Pupil  #: The samples.
    phase_rad: FloatArray  #: Shape (n,), phases of x polarisation at the samples; y is the point mirror.

    def term(self, radius_um: float, polarisation: Polarisation | None = None) -> SampledPhase:
        """Return the mask of an aperture of this radius as a phase term of one polarisation, or of both (None)."""
        field = self.pupil.on_grid(phasor(self.phase_rad), outside=1.0)
        return SampledPhase(field[None], 2.0 * radius_um / self.pupil.samples, polarisation=polarisation)


def load_array(
    file: Path, pitch_um: float, dataset: str, radius_um: float, polarisation: Polarisation | None = None
) -> SampledPhase:
    """Read a user's phase from a file.

    Args:
        file: .npy, .csv (comma-separated rows, one polarisation) or .h5; radians, real, shape (n_y, n_x) for both
            polarisations alike or (2, n_y, n_x) for x and y.
        pitch_um: distance of the samples.
        dataset: name inside an .h5 file.
        radius_um: radius of the aperture, which the samples must cover to half a pitch.
        polarisation: the polarisation that the term acts on; None for both.

    Raises:
        InputError: the file cannot be read, is not a finite array of that form that covers the aperture, or holds other
            units than radians.
    """
    phase = read_array(file, dataset)
    expected = "finite real numbers of shape (n_y, n_x) or (2, n_y, n_x), at least 2 x 2"
    shape_fits = phase.ndim == 2 or (phase.ndim == 3 and len(phase) == 2)
    if not shape_fits or min(phase.shape[-2:]) < 2 or phase.dtype.kind not in "fiu":
        remedy = "numpy.angle gives the phase of a field" if phase.dtype.kind == "c" else ""
        raise InputError.single(str(file), file.name, expected, f"{phase.dtype} of shape {phase.shape}", remedy)
    if lost := int(np.count_nonzero(~np.isfinite(phase))):
        raise InputError.single(str(file), file.name, expected, f"NaN or infinity at {lost} of {phase.size} places")
    require_coverage(file, "pitch_um", min(phase.shape[-2:]), pitch_um, radius_um)
    _require_radians(file, phase)
    field = np.exp(1j * np.broadcast_to(phase, (2, *phase.shape[-2:])))
    return SampledPhase(field, pitch_um, polarisation=polarisation)


def _require_radians(file: Path, phase: NDArray[np.generic]) -> None:
    """Refuse (InputError) values of which neighbours differ by more than a turn: degrees, levels, too few samples.

    So are levels of which all neighbours are equal or differ by more than a turn, over a span of many turns.
    """
    steps = [np.abs(np.diff(phase.astype(np.float64), axis=axis)) for axis in (-2, -1)]
    steep, changed = (sum(np.count_nonzero(each > least) for each in steps) for least in (_LARGEST_STEP_RAD, 0.0))
    share = steep / sum(each.size for each in steps)
    are_levels = 0 < changed == steep and float(phase.max()) - float(phase.min()) > _WIDEST_LEVELS_RAD
    if share > _STEEP_SHARE or are_levels:
        expected = "radians, in steps of less than half a turn from sample to sample (jumps of a turn aside)"
        values = f"values from {phase.min()} to {phase.max()}"
        got = f"steps of more than a turn at {100.0 * share:.3g} % of the samples, {values}"
        remedy = "convert degrees, or levels of a picture, to radians; sample a steep phase more finely"
        raise InputError.single(str(file), file.name, expected, got, remedy)


def require_coverage(file: Path, key: str, count: int, pitch_um: float, radius_um: float) -> None:
    """Refuse (InputError) ``count`` samples a side that do not cover the aperture, or of which too few lie across it.

    ``key`` is that of ``pitch_um``, the distance of the samples.
    """
    reach_um = 0.5 * count * pitch_um
    if 2.0 * radius_um < _FEWEST_ACROSS * pitch_um * (1.0 - 1e-9):
        expected = f"a pitch of at most {2.0 * radius_um / _FEWEST_ACROSS:g} um: {_FEWEST_ACROSS} samples or more "
        expected += f"across the aperture of {2.0 * radius_um:g} um"
        raise InputError.single(str(file), key, expected, f"{pitch_um:g} um", "is it in micrometres?")
    if reach_um < radius_um * (1.0 - 1e-9):
        expected, got = f"samples that cover the aperture to {radius_um:g} um from the axis", f"{reach_um:g} um"
        remedy = "give more samples or the right pitch; nothing is extrapolated"
        raise InputError.single(str(file), key, expected, f"a grid that reaches {got}", remedy)


def read_array(file: Path, dataset: str) -> NDArray[np.generic]:
    """Read the array, of any shape and type, of a .npy or .csv file, or that named ``dataset`` of an .h5 file.

    A file that cannot be read raises InputError.
    """
    expected = "a .npy, .csv or .h5 file with an array"
    if file.suffix not in {".npy", ".csv", ".h5"}:
        raise InputError.single(str(file), "file", expected, f"the ending {file.suffix!r}")
    try:
        if file.suffix == ".npy":
            return pictures.read_array(file)
        if file.suffix == ".csv":
            return np.loadtxt(file, delimiter=",", ndmin=2)
        with hdf5.open_file(file) as source:
            hdf5.require_modest(source, file, names=["/" + dataset.strip("/")])
            return np.asarray(source[dataset])
    except InputError:
        raise
    except Exception as error:  # the readers raise many types for a broken file
        raise InputError.single(str(file), "file", expected, f"an unreadable one ({error})") from error
