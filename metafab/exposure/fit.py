"""Process from measured sizes: dose to clear, backscatter, blur, focus and etch, by a robust nonlinear fit.

A pillar of a lens with dose D prints where its energy reaches the clearing energy. Both edges of a side stand s outside
the drawn ones, where

    D base_over_clearing_dose [S(s) + O] = 1,    size = drawn + 2 s + bias + microloading (density - mean density),

with its own energy S(s) (:mod:`metafab.exposure.printing`) and that of all others O, both per unit dose. The
point-spread function is f / (1 + eta) + eta b / (1 + eta), with its forward and backscattered parts f and b and the
backscatter ratio eta, so that O follows from two energies of each measured pillar. The forward one depends smoothly on
the blur and is interpolated between Chebyshev nodes. A beam out of focus has a wider blur
(:func:`metafab.exposure.electrons.process.blur_out_of_focus_nm`). The density is that of the drawn pillars, times the
printed over the drawn area of the measured ones at the same dose and focus (:mod:`metafab.exposure.etch`).

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
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.special import erf

from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.parallel.work import Work
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.electrons.process import beam_psf, blur_out_of_focus_nm
from metafab.exposure.energy.beside import Beside
from metafab.exposure.energy.resist import ResistEnergy, TileEnergy
from metafab.exposure.etch import local_density
from metafab.exposure.prediction import inside
from metafab.layout import PillarMap
from metafab.spec.mask import Etch, ExposureProcess

#: Parameters of the process in the order of the fit.
Parameter = Literal["threshold", "eta", "blur", "bias", "microloading", "convergence", "focus"]
PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)
#: Bounds of base over clearing dose, backscatter ratio, blur (nm), bias (nm), microloading (nm), convergence (mrad) and
#: best focus (um).
_LOW = np.array([0.05, 1e-3, 0.5, -200.0, -500.0, 0.1, -50.0])
_HIGH = np.array([100.0, 20.0, 60.0, 200.0, 500.0, 100.0, 50.0])
#: Start of the convergence, mrad, and largest blur of a beam out of focus, nm.
_CONVERGENCE_MRAD, _WIDEST_NM = 5.0, 100.0
#: Nodes of the blur for the energy of the other pillars; the error of the interpolation is below 1e-5.
_BLUR_NODES = 7
#: Halvings of the interval of an edge's displacement (of up to 200 nm): to 1e-8 nm, for difference quotients.
_HALVINGS = 35
#: Largest correlation at which two parameters count as distinguishable.
_MOST_CORRELATED = 0.9999
#: Reach of an edge outwards (nm).
_REACH_NM = 100.0
#: Residual in standard deviations above which Huber's loss is linear: an efficiency of 95 % for normal noise.
_HUBER = 1.345
#: Median magnitude of a normal deviation, in standard deviations.
_MEDIAN = 0.6745
#: Least standard deviation of a size (nm), below that of any microscope; the printed sizes are exact to 1e-3 nm.
_LEAST_NOISE_NM = 0.02
#: Most fits by Huber's loss, each with the standard deviation of the one before, and the change of it that ends them.
_ROUNDS, _SETTLED = 5, 0.01
#: Residual in standard deviations above which a size is listed.
_FAR = 6.0


@dataclass(frozen=True, eq=False)
class MeasuredLens:
    """Measured pillars of one lens at one or several doses, and one focus."""

    pillars: PillarMap  #: The drawn pillars.
    place: NDArray[np.int64]  #: Shape (n, 2), row and column of each measurement.
    dose: FloatArray  #: Shape (n,), dose of the whole lens relative to the base dose.
    size_nm: FloatArray  #: Shape (n, 2), measured width and length.
    focus_um: float = 0.0  #: Focus of the beam.
    beside: Beside | None = None  #: What is exposed with the lens, for energies per unit dose of it.


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
    if not chosen.any() or count <= chosen.sum():
        expected = f"more sizes than the {int(chosen.sum())} fitted parameters, of which at least one"
        raise InputError.single("process fit", "sizes", expected, f"{count}", "measure more pillars")
    if start.base_over_clearing_dose is None and "threshold" not in free:
        expected, remedy = "a dose, where `threshold` is not fitted", "state it, or fit `threshold` too"
        raise InputError.single("process.exposure", "base_over_clearing_dose", expected, "none", remedy)
    focuses = {lens.focus_um for lens in lenses}
    known_beam = start.convergence_mrad is not None or "convergence" in free
    if not known_beam and (focuses != {start.best_focus_um} or "focus" in free):
        expected, remedy = "a half angle, for lenses out of focus", "state it, or fit `convergence` too"
        raise InputError.single("process.exposure", "convergence_mrad", expected, "none", remedy)
    convergence = start.convergence_mrad or (_CONVERGENCE_MRAD if known_beam else 0.0)
    values = [0.0, eta, start.blur_nm, etch.bias_nm, etch.microloading_nm, convergence, start.best_focus_um]
    model = _Model(lenses, forward, back, np.array(values), chosen, etch, work)
    first = np.array([start.base_over_clearing_dose or model.first_ratio(np.array(values)), *values[1:]])

    def all_values(values: FloatArray) -> FloatArray:
        whole = first.copy()
        whole[chosen] = values
        return whole

    def residuals(values: FloatArray) -> FloatArray:
        return np.asarray((model.sizes_nm(all_values(values)) - model.measured_nm).ravel())

    found, deviation_nm = _robust(residuals, first[chosen], _LOW[chosen], _HIGH[chosen])
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
        deviation_nm = max(_LEAST_NOISE_NM, float(np.median(magnitude_nm[start.size :])) / _MEDIAN)
        if abs(deviation_nm - before_nm) < _SETTLED * deviation_nm or _HUBER * deviation_nm >= magnitude_nm[-1]:
            break
        found = least_squares(residuals, found.x, loss="huber", f_scale=_HUBER * deviation_nm, **options)
    return found, deviation_nm


class _Model:
    """Sizes of measured pillars for any process, whose values have the order of :data:`PARAMETERS`.

    ``forward`` (without blur) and ``back`` are the parts of the point-spread function, weights of sum 1 each. ``start``
    are values of the process, ``chosen`` those that are fitted; ``etch`` is the range of the microloading.
    """

    def __init__(
        self,
        lenses: Sequence[MeasuredLens],
        forward: BeamPsf,
        back: BeamPsf,
        start: FloatArray,
        chosen: NDArray[np.bool_],
        etch: Etch,
        work: Work,
    ) -> None:
        self._forward, self._back = forward, back
        self._drawn = np.concatenate([lens.pillars.size_nm()[_index(lens)] for lens in lenses])
        self._dose = np.concatenate([lens.dose for lens in lenses])
        self._focus_um = np.concatenate([np.full(len(lens.dose), lens.focus_um) for lens in lenses])
        self.measured_nm = np.concatenate([lens.size_nm for lens in lenses])
        exposed = np.stack([self._dose, self._focus_um], axis=1)
        self._exposed = np.unique(exposed, axis=0, return_inverse=True)[1].ravel()
        is_loaded = bool(chosen[4] or start[4])
        self._density = np.concatenate([_excess_density(lens, etch) for lens in lenses]) if is_loaded else None
        self._nodes = np.unique(self._blurs_nm(start))
        self._widest_nm = float(self._nodes.max())
        if chosen[[2, 5, 6]].any() or self._nodes.size > _BLUR_NODES:
            turn = np.cos(np.pi * (np.arange(_BLUR_NODES) + 0.5) / _BLUR_NODES)
            is_out_of_focus = chosen[[5, 6]].any() or np.any(self._focus_um != start[6])
            self._widest_nm = _WIDEST_NM if is_out_of_focus else float(_HIGH[2])
            self._nodes = 0.5 * (self._widest_nm + _LOW[2]) + 0.5 * (self._widest_nm - _LOW[2]) * turn
        place = np.concatenate([lens.place for lens in lenses])
        patterns, of_lens = _distinct(lenses)
        pattern = np.repeat(of_lens, [len(lens.dose) for lens in lenses])
        with work.threads() as executor:

            def others(part: BeamPsf) -> FloatArray:
                """Energy of all other pillars at the edges, per unit dose: shape (n, 2)."""
                values = np.zeros((len(pattern), 2))
                for number, lens in enumerate(patterns):
                    rows = np.flatnonzero(pattern == number)
                    resist = ResistEnergy(lens.pillars, part).among(lens.beside)
                    dose = np.ones(resist.size_index.shape, dtype=np.float32)
                    touched = [block for block in resist.tiles if len(inside(place[rows], *block))]

                    def keep(tile: TileEnergy, rows: NDArray[np.int64] = rows) -> FloatArray:
                        row, column = (place[rows] - (tile.rows.start, tile.columns.start)).T
                        n_y, n_x = tile.dose.shape
                        here = (row >= 0) & (row < n_y) & (column >= 0) & (column < n_x)
                        values[rows[here]] = tile.others[:, row[here], column[here]].T
                        return np.empty(0)

                    for _ in resist.map_tiles(dose, executor, keep, touched):
                        pass
                return values

            # The backscattered part is far wider than any blur.
            self._others_back = others(back)
            self._others_forward = np.stack([others(forward.blurred(float(blur))) for blur in self._nodes])

    def first_ratio(self, values: FloatArray) -> float:
        """Base over clearing dose at which the measured edges are at the clearing energy in the mean."""
        moved = 0.5 * (self.measured_nm - self._drawn)
        return float(1.0 / np.mean(self._dose[:, None] * self._energy(moved, values)))

    def sizes_nm(self, values: FloatArray) -> FloatArray:
        """Sizes for a process, by bisection of the edges: shape (n, 2)."""
        low, high = -0.5 * self._drawn, np.full_like(self._drawn, _REACH_NM)
        clearing = 1.0 / (values[0] * self._dose[:, None])
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            stays = self._energy(middle, values) > clearing
            low, high = np.where(stays, middle, low), np.where(stays, high, middle)
        printed = self._drawn + low + high
        if self._density is None:
            return np.asarray(printed + values[3])
        areas = [np.bincount(self._exposed, sizes.prod(axis=1)) for sizes in (printed, self._drawn)]
        excess = self._density * (areas[0] / areas[1])[self._exposed]
        return np.asarray(printed + values[3] + values[4] * excess[:, None])

    def require_within_reach(self, values: FloatArray) -> None:
        """Refuse a process whose blur out of focus is beyond the interpolation."""
        widest = float(self._blurs_nm(values).max())
        if widest > self._widest_nm:
            expected = f"a blur of at most {self._widest_nm:g} nm at each focus"
            raise InputError.single("process fit", "convergence", expected, f"{widest:.3g} nm", "leave out that focus")

    def _blurs_nm(self, values: FloatArray) -> FloatArray:
        """Blur of each measurement, shape (n,)."""
        return blur_out_of_focus_nm(values[2], values[5], self._focus_um - values[6])

    def _energy(self, moved_nm: FloatArray, values: FloatArray) -> FloatArray:
        """Energy at edges moved outwards, per unit dose: shape (n, 2), like ``moved_nm``."""
        eta, blur_nm = float(values[1]), np.minimum(self._blurs_nm(values), self._widest_nm)
        others = (self._interpolated(blur_nm) + eta * self._others_back) / (1.0 + eta)
        ranges = [np.hypot(beta, blur_nm)[:, None] for beta in self._forward.range_nm]
        ranges += [np.full((1, 1), beta) for beta in self._back.range_nm]
        weights = np.concatenate([self._forward.weight, eta * self._back.weight]) / (1.0 + eta)
        own = np.zeros_like(moved_nm)
        for weight, beta in zip(weights, ranges, strict=True):
            across = erf(self._drawn[:, ::-1] / (2.0 * beta))
            own += 0.5 * weight * (erf((self._drawn + moved_nm) / beta) - erf(moved_nm / beta)) * across
        return np.asarray(own + others)

    def _interpolated(self, blur_nm: FloatArray) -> FloatArray:
        """Forward energy of the others at a blur for each pillar, shape (n,): Lagrange's polynomial in its square."""
        nodes, square = self._nodes**2, blur_nm[:, None] ** 2
        total = np.zeros_like(self._others_back)
        for k, node in enumerate(nodes):
            rest = np.delete(nodes, k)
            total += np.prod((square - rest) / (node - rest), axis=1)[:, None] * self._others_forward[k]
        return total


def _distinct(lenses: Sequence[MeasuredLens]) -> tuple[list[MeasuredLens], list[int]]:
    """Lenses of distinct patterns, and the number of that of each lens; copies alone on the wafer share theirs."""
    distinct: list[MeasuredLens] = []
    number = []
    for lens in lenses:
        found = (k for k, other in enumerate(distinct) if lens.beside is other.beside and _are_equal(lens, other))
        number.append(next(found, len(distinct)))
        if number[-1] == len(distinct):
            distinct.append(lens)
    return distinct, number


def _are_equal(lens: MeasuredLens, other: MeasuredLens) -> bool:
    """Whether two lenses have the same pillars."""
    one, two = lens.pillars, other.pillars
    same_sizes = np.array_equal(one.size_dbu, two.size_dbu)
    return one is two or (same_sizes and np.array_equal(one.to_array(), two.to_array()))


def _excess_density(lens: MeasuredLens, etch: Etch) -> FloatArray:
    """Local density of the drawn pillars at each measurement, less its mean over all pillars: shape (n,)."""
    index, area_nm2 = lens.pillars.to_array(), lens.pillars.size_nm().prod(axis=1)
    density, mean = local_density(lens.pillars, lambda rows: area_nm2[index[rows]], etch)
    at = [density.at(slice(row, row + 1), slice(column, column + 1)).item() for row, column in lens.place.tolist()]
    return np.array(at) - mean


def _index(lens: MeasuredLens) -> NDArray[np.int64]:
    """Size index of each measured pillar."""
    row, column = lens.place.T
    return np.asarray(lens.pillars.to_array()[row, column], dtype=np.int64)


def _require_inside(found: OptimizeResult, chosen: NDArray[np.bool_]) -> None:
    """Refuse a fit that did not converge, or ended at a bound."""
    free = np.flatnonzero(chosen)
    faults = []
    for place in np.flatnonzero(found.active_mask):
        at = free[place]
        expected = f"sizes that give one between {_LOW[at]:g} and {_HIGH[at]:g}"
        got = f"the bound {found.x[place]:.4g}"
        faults.append(Fault(PARAMETERS[at], expected, got, "measure other doses, or fit fewer (`--free`)"))
    if not found.success:
        faults.append(Fault("sizes", "sizes on which the fit converges", str(found.message), "fit fewer (`--free`)"))
    if faults:
        raise InputError("process fit", faults)


def _covariance(jacobian: FloatArray, names: Sequence[str]) -> FloatArray:
    """Inverse of J^T J; refuses parameters that the sizes do not determine."""
    scale = np.sqrt((jacobian**2).sum(axis=0))
    left, singular, right = np.linalg.svd(jacobian / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    del left
    if not scale.all() or singular[-1] < 1e-6 * singular[0]:
        worst = names[int(np.abs(right[-1]).argmax())]
        expected, remedy = f"sizes that determine {', '.join(names)}", "measure other doses, or fit fewer (`--free`)"
        raise InputError.single("process fit", "sizes", expected, f"sizes that leave {worst} open", remedy)
    inverse = (right.T / singular) / scale[:, None]
    return np.asarray(inverse @ inverse.T)


def _require_determined(values: FloatArray, errors: FloatArray, largest: float, correlated: tuple[str, ...]) -> None:
    """Refuse parameters whose standard error exceeds themselves, or half the range of those that may be 0."""
    faults = []
    half_range = 0.5 * (_HIGH - _LOW)
    for name, value, error, least, half in zip(PARAMETERS, values, errors, _LOW, half_range, strict=True):
        most = value if least > 0.0 else half
        if error > most:
            further = "further focuses" if name in ("convergence", "focus") else "further doses, and up to the rim"
            expected, got = f"sizes that give it with an error below {most:.3g}", f"{value:.3g} +- {error:.3g}"
            faults.append(Fault(name, expected, got, f"measure at {further}, or leave `{name}` out of `--free`"))
    if largest > _MOST_CORRELATED:
        expected, got = f"sizes that tell {' and '.join(correlated)} apart", f"a correlation of {largest:.6f}"
        remedy = f"measure at further doses or focuses, or leave `{correlated[1]}` out of `--free`"
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
