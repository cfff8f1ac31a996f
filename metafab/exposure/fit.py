"""Process from measured sizes: dose to clear, backscatter, blur, focus and etch, by a robust fit of a model of sizes.

The size's dependence on dose separates the clearing dose from the bias, and its dependence on the pillars around, from
the middle of the lens to its rim, gives the backscatter ratio. The rim gives the microloading too; only the dose
separates both.

The fit is Huber's M-estimator (Huber and Ronchetti, *Robust Statistics*, 2009): residuals up to 1.345 standard
deviations count by their square, larger ones linearly. The standard deviation is that of the median residual. Standard
errors follow from the residuals, by the estimator's asymptotic covariance. Sizes beyond six standard deviations are
listed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.parallel.work import Work
from metafab.exposure.electrons.process import beam_psf
from metafab.exposure.size_model import HIGH, LOW, PARAMETERS, MeasuredLens, Parameter, SizeModel
from metafab.spec.mask import Etch, ExposureProcess

#: Start of the convergence, mrad.
_CONVERGENCE_MRAD = 5.0
#: Largest correlation at which two parameters count as distinguishable.
_MOST_CORRELATED = 0.9999
#: Residual in standard deviations above which Huber's loss is linear: an efficiency of 95 % for normal noise.
_HUBER = 1.345
#: Median magnitude of a normal deviate, in standard deviations: Phi^-1(3/4).
_MEDIAN_PER_SIGMA = 0.6745
#: Least standard deviation of a size (nm), below that of any microscope; the printed sizes are exact to 1e-3 nm.
_LEAST_NOISE_NM = 0.02
#: Most fits by Huber's loss, each with the standard deviation of the one before, and the change of it that ends them.
_ROUNDS, _SETTLED = 5, 0.01
#: Residual in standard deviations above which a size is listed.
_FAR = 6.0


@dataclass(frozen=True)
class FittedValue:
    """A parameter of the process."""

    value: float  #: The value.
    error: float | None  #: Standard error; None for a value that was not fitted.


@dataclass(frozen=True)
class BiasMap:
    """Bias over the lens: mean + tilt_x x + tilt_y y + bowl (r^2 - mean r^2), each with its standard error."""

    mean_nm: FittedValue  #: Bias in the mean.
    tilt_x_nm_per_mm: FittedValue  #: Change along x.
    tilt_y_nm_per_mm: FittedValue  #: Change along y.
    bowl_nm_per_mm2: FittedValue  #: Change with the squared radius.
    rms_nm: float  #: Rms of the sizes about the map.


@dataclass(frozen=True)
class FarSize:
    """A measured size far from the fit."""

    row: int  #: Number of the measurement, counted from 1 in the order of the lenses or of the table.
    x_um: float  #: Place of the pillar from the axis of its lens.
    y_um: float  #: Likewise.
    side: Literal["width", "length"]  #: The side.
    measured_nm: float  #: Measured size.
    fitted_nm: float  #: Fitted size.
    deviations: float  #: Measured less fitted size in standard deviations.

    def __str__(self) -> str:
        return (
            f"row {self.row}, ({self.x_um:g}, {self.y_um:g}) um: {self.side} {self.measured_nm:.1f} nm, "
            f"{self.measured_nm - self.fitted_nm:+.1f} nm ({self.deviations:+.0f} standard deviations) from the fit"
        )


@dataclass(frozen=True)
class ProcessFit:
    """Fitted process."""

    base_over_clearing_dose: FittedValue  #: Base dose over the clearing dose of a large pad.
    backscatter_ratio: FittedValue  #: Backscattered over forward-scattered energy.
    blur_nm: FittedValue  #: Range of the beam's blur.
    bias_nm: FittedValue  #: Measured less printed size, of the etch and of the microscope.
    microloading_nm: FittedValue  #: Further change of size where the local density is larger by 1.
    convergence_mrad: FittedValue | None  #: Half angle of the beam; None where it is neither stated nor fitted.
    best_focus_um: FittedValue  #: Focus of the smallest blur.
    residual_rms_nm: float  #: Rms of measured less fitted sizes, without those listed as far.
    far: tuple[FarSize, ...]  #: Sizes beyond six standard deviations, farthest first.
    sizes: int  #: Number of measured widths and lengths.
    doses: int  #: Number of distinct doses.
    focuses: int  #: Number of distinct focuses.
    largest_correlation: float  #: Magnitude of the largest correlation between two fitted parameters.
    correlated: tuple[str, ...]  #: Names of these two parameters.
    bias_map: BiasMap  #: Bias over the lens.


def fit_process(
    lenses: Sequence[MeasuredLens],
    start: ExposureProcess,
    free: Sequence[Parameter] = ("threshold", "eta", "bias"),
    etch: Etch | None = None,
    work: Work = Work(),
) -> ProcessFit:
    """Fit the process to measured sizes.

    Args:
        lenses: the measurements.
        start: beam and dose, from which fitted parameters start and at which the others stay. Without
            ``base_over_clearing_dose`` the threshold starts where pillars print as measured.
        free: parameters that are fitted.
        etch: bias and microloading, likewise, and the range of the microloading.
        work: threads.

    Raises:
        InputError: no backscattered term, no dose, lenses out of focus without a convergence, too few sizes, or sizes
            that leave a parameter open.
    """
    etch = etch or Etch()
    forward, back, eta = beam_psf(replace(start, blur_nm=0.0)).scattered()
    chosen = np.array([name in free for name in PARAMETERS])
    count = 2 * sum(len(lens.dose) for lens in lenses)
    known_beam = start.convergence_mrad is not None or "convergence" in free
    focuses = {lens.focus_um for lens in lenses}
    _require_known(start, free, count, focuses, known_beam=known_beam)
    convergence = start.convergence_mrad or (_CONVERGENCE_MRAD if known_beam else 0.0)
    values = [0.0, eta, start.blur_nm, etch.bias_nm, etch.microloading_nm, convergence, start.best_focus_um]
    model = SizeModel(lenses, forward, back, np.array(values), chosen, etch, work)
    first = np.array([start.base_over_clearing_dose or model.first_ratio(np.array(values)), *values[1:]])

    def all_values(values: FloatArray) -> FloatArray:
        whole = first.copy()
        whole[chosen] = values
        return whole

    def residuals(values: FloatArray) -> FloatArray:
        return np.asarray((model.sizes_nm(all_values(values)) - model.measured_nm).ravel())

    found, deviation_nm = _robust(residuals, first[chosen], LOW[chosen], HIGH[chosen])
    _require_inside(found, chosen)
    names = [name for name, is_free in zip(PARAMETERS, chosen, strict=True) if is_free]
    # The Jacobian of Huber's loss is 0 for sizes on its linear part: the share of the others is the mean curvature.
    slope = np.clip(found.fun, -_HUBER * deviation_nm, _HUBER * deviation_nm)
    square = float((slope**2).sum()) / (count - int(chosen.sum())) / np.mean(slope == found.fun)
    covariance = square * _covariance(np.asarray(found.jac), names)
    is_near = np.abs(found.fun) <= _FAR * deviation_nm
    whole = all_values(np.asarray(found.x, dtype=np.float64))
    model.require_within_reach(whole)
    errors = np.full(len(PARAMETERS), np.nan)
    errors[chosen] = np.sqrt(np.diag(covariance))
    fitted = [
        FittedValue(float(value), float(error) if is_free else None)
        for value, error, is_free in zip(whole, errors, chosen, strict=True)
    ]
    largest, correlated = _largest_correlation(covariance, names)
    _require_determined(whole, errors, largest, correlated)
    return ProcessFit(
        base_over_clearing_dose=fitted[0],
        backscatter_ratio=fitted[1],
        blur_nm=fitted[2],
        bias_nm=fitted[3],
        microloading_nm=fitted[4],
        convergence_mrad=fitted[5] if known_beam else None,
        best_focus_um=fitted[6],
        residual_rms_nm=float(np.sqrt(np.mean(found.fun[is_near] ** 2))),
        far=_far_sizes(lenses, model.measured_nm, found.fun, deviation_nm),
        sizes=count,
        doses=len(np.unique(np.concatenate([lens.dose for lens in lenses]))),
        focuses=len(focuses),
        largest_correlation=largest,
        correlated=correlated,
        bias_map=_bias_map(lenses, whole[3] - found.fun.reshape(-1, 2), is_near),
    )


def _require_known(
    start: ExposureProcess, free: Sequence[Parameter], count: int, focuses: set[float], *, known_beam: bool
) -> None:
    """Refuse too few sizes, and a dose or convergence that is neither stated nor fitted."""
    fitted = len({*free} & {*PARAMETERS})
    if not fitted or count <= fitted:
        expected = f"more sizes than the {fitted} fitted parameters, of which at least one"
        raise InputError.single("process fit", "sizes", expected, f"{count}", "measure more pillars")
    if start.base_over_clearing_dose is None and "threshold" not in free:
        expected, remedy = "a dose, where `threshold` is not fitted", "state it, or fit `threshold` too"
        raise InputError.single("process.exposure", "base_over_clearing_dose", expected, "none", remedy)
    if not known_beam and (focuses != {start.best_focus_um} or "focus" in free):
        expected, remedy = "a half angle, for lenses out of focus", "state it, or fit `convergence` too"
        raise InputError.single("process.exposure", "convergence_mrad", expected, "none", remedy)


def _robust(
    residuals: Callable[[FloatArray], FloatArray], start: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[OptimizeResult, float]:
    """Fit by Huber's loss; the result and the standard deviation of the residuals, both of the last round.

    The first round is by least squares. The deviation is that of the median magnitude without the smallest ones, one
    for each parameter, which the fit can bring to 0.
    """
    options: dict[str, Any] = {"bounds": (low, high), "x_scale": "jac", "diff_step": [1e-5]}
    inner = np.clip(start, low + 1e-3 * np.abs(low), high - 1e-3 * high)
    found, deviation_nm = least_squares(residuals, inner, **options), math.inf
    for _ in range(_ROUNDS):
        before_nm, magnitude_nm = deviation_nm, np.sort(np.abs(found.fun))
        deviation_nm = max(_LEAST_NOISE_NM, float(np.median(magnitude_nm[start.size :])) / _MEDIAN_PER_SIGMA)
        if abs(deviation_nm - before_nm) < _SETTLED * deviation_nm or _HUBER * deviation_nm >= magnitude_nm[-1]:
            break
        found = least_squares(residuals, found.x, loss="huber", f_scale=_HUBER * deviation_nm, **options)
    return found, deviation_nm


def _require_inside(found: OptimizeResult, chosen: NDArray[np.bool_]) -> None:
    """Refuse a fit that did not converge, or ended at a bound."""
    free = np.flatnonzero(chosen)
    faults = []
    for place in np.flatnonzero(found.active_mask):
        at = free[place]
        expected = f"sizes that give one between {LOW[at]:g} and {HIGH[at]:g}"
        got = f"the bound {found.x[place]:.4g}"
        faults.append(Fault(PARAMETERS[at], expected, got, "measure other doses, or fit fewer (`free`)"))
    if not found.success:
        faults.append(Fault("sizes", "sizes on which the fit converges", str(found.message), "fit fewer (`free`)"))
    if faults:
        raise InputError("process fit", faults)


def _covariance(jacobian: FloatArray, names: Sequence[str]) -> FloatArray:
    """Inverse of J^T J; refuses parameters that the sizes do not determine."""
    scale = np.sqrt((jacobian**2).sum(axis=0))
    left, singular, right = np.linalg.svd(jacobian / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    del left
    if not scale.all() or singular[-1] < 1e-6 * singular[0]:
        worst = names[int(np.abs(right[-1]).argmax())]
        expected, remedy = f"sizes that determine {', '.join(names)}", "measure other doses, or fit fewer (`free`)"
        raise InputError.single("process fit", "sizes", expected, f"sizes that leave {worst} open", remedy)
    inverse = (right.T / singular) / scale[:, None]
    return np.asarray(inverse @ inverse.T)


def _require_determined(values: FloatArray, errors: FloatArray, largest: float, correlated: tuple[str, ...]) -> None:
    """Refuse parameters whose standard error exceeds themselves, or half the range of those that may be 0."""
    faults = []
    half_range = 0.5 * (HIGH - LOW)
    for name, value, error, least, half in zip(PARAMETERS, values, errors, LOW, half_range, strict=True):
        most = value if least > 0.0 else half
        if error > most:
            further = "further focuses" if name in ("convergence", "focus") else "further doses, and up to the rim"
            expected, got = f"sizes that give it with an error below {most:.3g}", f"{value:.3g} +- {error:.3g}"
            faults.append(Fault(name, expected, got, f"measure at {further}, or leave `{name}` out of `free`"))
    if largest > _MOST_CORRELATED:
        expected, got = f"sizes that tell {' and '.join(correlated)} apart", f"a correlation of {largest:.6f}"
        remedy = f"measure at further doses or focuses, or leave `{correlated[1]}` out of `free`"
        faults.append(Fault(", ".join(correlated), expected, got, remedy))
    if faults:
        raise InputError("process fit", faults)


def _largest_correlation(covariance: FloatArray, names: Sequence[str]) -> tuple[float, tuple[str, ...]]:
    """Magnitude of the largest correlation, and the names of its two parameters."""
    if len(names) < 2:
        return 0.0, ()
    sigma = np.sqrt(np.diag(covariance))
    correlation = np.abs(covariance / np.outer(sigma, sigma))
    np.fill_diagonal(correlation, 0.0)
    one, other = divmod(int(correlation.argmax()), len(names))
    return float(correlation.max()), (names[one], names[other])


def _far_sizes(
    lenses: Sequence[MeasuredLens], measured_nm: FloatArray, residual_nm: FloatArray, deviation_nm: float
) -> tuple[FarSize, ...]:
    """Sizes far from the fit; ``measured_nm`` of shape (n, 2), ``residual_nm``, fitted less measured, flat."""
    place_um, deviation = 1e3 * _places_mm(lenses), -residual_nm / deviation_nm
    fitted_nm = measured_nm + residual_nm.reshape(-1, 2)
    sides: tuple[Literal["width", "length"], ...] = ("width", "length")
    return tuple(
        FarSize(
            row + 1,
            round(float(place_um[row, 0]), 6),
            round(float(place_um[row, 1]), 6),
            sides[side],
            float(measured_nm[row, side]),
            float(fitted_nm[row, side]),
            float(deviation[2 * row + side]),
        )
        for row, side in (divmod(at, 2) for at in np.argsort(-np.abs(deviation)).tolist())
        if abs(deviation[2 * row + side]) > _FAR
    )


def _places_mm(lenses: Sequence[MeasuredLens]) -> FloatArray:
    """Place (x, y) of each measured pillar from the axis of its lens, shape (n, 2)."""
    return 1e-3 * np.concatenate([
        np.stack([lens.pillars.lattice.x_um()[lens.place[:, 1]], lens.pillars.lattice.y_um()[lens.place[:, 0]]], axis=1)
        for lens in lenses
    ])  # fmt: skip


def _bias_map(lenses: Sequence[MeasuredLens], bias_nm: FloatArray, is_near: NDArray[np.bool_]) -> BiasMap:
    """Fit mean, tilts and bowl to the bias of each measured size, shape (n, 2), where the flat ``is_near`` is set.

    A coefficient that the places do not determine is 0 without an error.
    """
    places, values = np.repeat(_places_mm(lenses), 2, axis=0)[is_near], bias_nm.ravel()[is_near]
    square = (places**2).sum(axis=1)
    columns = [np.ones(len(values)), *places.T, square - square.mean()]
    determined = len(values) > 8 and np.linalg.matrix_rank(np.stack(columns, axis=1)) == 4
    design = np.stack(columns if determined else columns[:1], axis=1)
    coefficient, *_ = np.linalg.lstsq(design, values, rcond=None)
    rest = values - design @ coefficient
    variance = float((rest**2).sum()) / max(1, len(values) - design.shape[1])
    errors = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * variance)
    fitted = [FittedValue(float(value), float(error)) for value, error in zip(coefficient, errors, strict=True)]
    fitted += [FittedValue(0.0, None)] * (4 - len(fitted))
    return BiasMap(fitted[0], fitted[1], fitted[2], fitted[3], math.sqrt(float(np.mean(rest**2))))
