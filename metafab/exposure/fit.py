"""Process from measured sizes: dose to clear, backscatter, blur and bias, by nonlinear least squares.

A pillar of a lens with dose D prints where its energy reaches the clearing energy. Both edges of a side stand s outside
the drawn ones, where

    D base_over_clearing_dose [S(s) + O] = 1,    size = drawn + 2 s + bias,

with its own energy S(s) (:mod:`metafab.exposure.printing`) and that of all others O, both per unit dose. The
point-spread function is f / (1 + eta) + eta b / (1 + eta), with its forward and backscattered parts f and b and the
backscatter ratio eta, so that O follows from two energies of each measured pillar. The forward one depends smoothly on
the blur and is interpolated between Chebyshev nodes.

The size's dependence on dose separates the clearing dose from the bias, and its dependence on the pillars around, from
the middle of the lens to its rim, gives the backscatter ratio. Standard errors follow from the residuals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares
from scipy.special import erf

from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.parallel.work import Work
from metafab.exposure.electrons.beam import BeamPsf
from metafab.exposure.energy.resist import ResistEnergy, TileEnergy
from metafab.exposure.prediction import inside
from metafab.layout import PillarMap

#: Parameters of the process in the order of the fit.
Parameter = Literal["threshold", "eta", "blur", "bias"]
PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)
#: Bounds of base over clearing dose, backscatter ratio, blur (nm) and bias (nm).
_LOW, _HIGH = np.array([0.05, 1e-3, 0.5, -200.0]), np.array([100.0, 20.0, 60.0, 200.0])
#: Nodes of the blur for the energy of the other pillars; the error of the interpolation is below 1e-5.
_BLUR_NODES = 5
#: Halvings of the interval of an edge's displacement (of up to 200 nm): to 1e-8 nm, for difference quotients.
_HALVINGS = 35
#: Reach of an edge outwards (nm).
_REACH_NM = 100.0


@dataclass(frozen=True, eq=False)
class MeasuredLens:
    """Measured pillars of one lens at one or several doses."""

    pillars: PillarMap  #: The drawn pillars.
    place: NDArray[np.int64]  #: Shape (n, 2), row and column of each measurement.
    dose: FloatArray  #: Shape (n,), dose of the whole lens relative to the base dose.
    size_nm: FloatArray  #: Shape (n, 2), measured width and length.


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
class ProcessFit:
    """Fitted process."""

    base_over_clearing_dose: FittedValue  #: Base dose over the clearing dose of a large pad.
    backscatter_ratio: FittedValue  #: Backscattered over forward-scattered energy.
    blur_nm: FittedValue  #: Range of the beam's blur.
    bias_nm: FittedValue  #: Measured less printed size, of the etch and of the microscope.
    residual_rms_nm: float  #: Rms of measured less fitted sizes.
    sizes: int  #: Number of measured widths and lengths.
    doses: int  #: Number of distinct doses.
    largest_correlation: float  #: Magnitude of the largest correlation between two fitted parameters.
    correlated: tuple[str, ...]  #: These parameters.
    bias_map: BiasMap  #: Bias over the lens.


def fit_process(
    lenses: Sequence[MeasuredLens],
    psf: BeamPsf,
    blur_nm: float,
    free: Sequence[Parameter] = ("threshold", "eta", "bias"),
    base_over_clearing_dose: float | None = None,
    work: Work = Work(),
) -> ProcessFit:
    """Fit the process to measured sizes.

    Args:
        lenses: the measurements.
        psf: point-spread function of the beam without its blur; its ratio of backscattered to forward energy is the
            start of "eta".
        blur_nm: range of the blur; the start of "blur".
        free: parameters that are fitted; the others keep their start. The bias starts at 0.
        base_over_clearing_dose: start of "threshold"; None for the dose at which pillars print as measured.
        work: threads.

    Raises:
        InputError: no backscattered term, no dose, too few sizes, or sizes that do not determine the parameters.
    """
    forward, back, eta = psf.scattered()
    chosen = np.array([name in free for name in PARAMETERS])
    count = 2 * sum(len(lens.dose) for lens in lenses)
    if not chosen.any() or count <= chosen.sum():
        expected = f"more sizes than the {int(chosen.sum())} fitted parameters, of which at least one"
        raise InputError.single("process fit", "sizes", expected, f"{count}", "measure more pillars")
    if base_over_clearing_dose is None and "threshold" not in free:
        expected, remedy = "a dose, where `threshold` is not fitted", "state it, or fit `threshold` too"
        raise InputError.single("process.exposure", "base_over_clearing_dose", expected, "none", remedy)
    model = _Model(lenses, forward, back, None if "blur" in free else blur_nm, work)
    start = np.array([base_over_clearing_dose or model.first_ratio(eta, blur_nm), eta, blur_nm, 0.0])

    def all_values(values: FloatArray) -> FloatArray:
        whole = start.copy()
        whole[chosen] = values
        return whole

    def residuals(values: FloatArray) -> FloatArray:
        return np.asarray((model.sizes_nm(all_values(values)) - model.measured_nm).ravel())

    found = least_squares(
        residuals,
        np.clip(start, _LOW + 1e-3 * np.abs(_LOW), _HIGH - 1e-3 * _HIGH)[chosen],
        bounds=(_LOW[chosen], _HIGH[chosen]),
        x_scale="jac",
        diff_step=[1e-5],
    )
    _require_inside(found, chosen)
    square = float((found.fun**2).sum()) / (count - int(chosen.sum()))
    covariance = _covariance(
        np.asarray(found.jac), [name for name, is_free in zip(PARAMETERS, chosen, strict=True) if is_free]
    )
    covariance *= square
    whole = all_values(np.asarray(found.x, dtype=np.float64))
    errors = np.full(len(PARAMETERS), np.nan)
    errors[chosen] = np.sqrt(np.diag(covariance))
    fitted = [
        FittedValue(float(value), float(error) if is_free else None)
        for value, error, is_free in zip(whole, errors, chosen, strict=True)
    ]
    largest, names = _largest_correlation(covariance, [n for n, f in zip(PARAMETERS, chosen, strict=True) if f])
    return ProcessFit(
        base_over_clearing_dose=fitted[0],
        backscatter_ratio=fitted[1],
        blur_nm=fitted[2],
        bias_nm=fitted[3],
        residual_rms_nm=float(np.sqrt(np.mean(found.fun**2))),
        sizes=count,
        doses=len(np.unique(np.concatenate([lens.dose for lens in lenses]))),
        largest_correlation=largest,
        correlated=names,
        bias_map=_bias_map(lenses, whole[3] - found.fun.reshape(-1, 2)),
    )


class _Model:
    """Sizes of measured pillars for any process.

    Args:
        lenses: the measurements.
        forward: forward part of the point-spread function, weights of sum 1, without blur.
        back: backscattered part, weights of sum 1.
        blur_nm: the blur if it is fixed.
        work: threads.
    """

    def __init__(
        self, lenses: Sequence[MeasuredLens], forward: BeamPsf, back: BeamPsf, blur_nm: float | None, work: Work
    ) -> None:
        self._forward, self._back = forward, back
        self._drawn = np.concatenate([lens.pillars.size_nm()[_index(lens)] for lens in lenses])
        self._dose = np.concatenate([lens.dose for lens in lenses])
        self.measured_nm = np.concatenate([lens.size_nm for lens in lenses])
        turn = np.cos(np.pi * (np.arange(_BLUR_NODES) + 0.5) / _BLUR_NODES)
        middle, half = 0.5 * (_LOW[2] + _HIGH[2]), 0.5 * (_HIGH[2] - _LOW[2])
        self._nodes = np.array([blur_nm]) if blur_nm is not None else middle + half * turn
        with work.threads() as executor:

            def others(part: BeamPsf) -> FloatArray:
                """Energy of all other pillars at the edges, per unit dose: shape (n, 2)."""
                found = []
                for lens in lenses:
                    resist = ResistEnergy(lens.pillars, part)
                    dose = np.ones(resist.size_index.shape, dtype=np.float32)
                    touched = [block for block in resist.tiles if len(inside(lens.place, *block))]
                    values = np.zeros((len(lens.place), 2))

                    def keep(tile: TileEnergy, lens: MeasuredLens = lens, values: FloatArray = values) -> FloatArray:
                        row, column = lens.place[:, 0] - tile.rows.start, lens.place[:, 1] - tile.columns.start
                        here = (row >= 0) & (row < tile.dose.shape[0]) & (column >= 0) & (column < tile.dose.shape[1])
                        values[here] = tile.others[:, row[here], column[here]].T
                        return np.empty(0)

                    for _ in resist.map_tiles(dose, executor, keep, touched):
                        pass
                    found.append(values)
                return np.concatenate(found)

            # The backscattered part is far wider than any blur.
            self._others_back = others(back)
            self._others_forward = np.stack([others(forward.blurred(float(blur))) for blur in self._nodes])

    def first_ratio(self, eta: float, blur_nm: float) -> float:
        """Base over clearing dose at which the measured edges are at the clearing energy in the mean."""
        moved = 0.5 * (self.measured_nm - self._drawn)
        return float(1.0 / np.mean(self._dose[:, None] * self._energy(moved, eta, blur_nm)))

    def sizes_nm(self, values: FloatArray) -> FloatArray:
        """Sizes for a ratio, eta, blur and bias, by bisection of the edges: shape (n, 2)."""
        ratio, eta, blur_nm, bias_nm = values.tolist()
        low, high = -0.5 * self._drawn, np.full_like(self._drawn, _REACH_NM)
        clearing = 1.0 / (ratio * self._dose[:, None])
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            stays = self._energy(middle, eta, blur_nm) > clearing
            low, high = np.where(stays, middle, low), np.where(stays, high, middle)
        return np.asarray(self._drawn + low + high + bias_nm)

    def _energy(self, moved_nm: FloatArray, eta: float, blur_nm: float) -> FloatArray:
        """Energy at edges moved outwards, per unit dose: shape (n, 2), like ``moved_nm``."""
        others = (self._interpolated(blur_nm) + eta * self._others_back) / (1.0 + eta)
        ranges = np.concatenate([np.hypot(self._forward.range_nm, blur_nm), self._back.range_nm])
        weights = np.concatenate([self._forward.weight, eta * self._back.weight]) / (1.0 + eta)
        own = np.zeros_like(moved_nm)
        for weight, beta in zip(weights, ranges, strict=True):
            across = erf(self._drawn[:, ::-1] / (2.0 * beta))
            own += 0.5 * weight * (erf((self._drawn + moved_nm) / beta) - erf(moved_nm / beta)) * across
        return np.asarray(own + others)

    def _interpolated(self, blur_nm: float) -> FloatArray:
        """Forward energy of the other pillars at a blur, by Lagrange's polynomial in its square."""
        nodes = self._nodes**2
        total = np.zeros_like(self._others_back)
        for k, node in enumerate(nodes):
            rest = np.delete(nodes, k)
            total += float(np.prod((blur_nm**2 - rest) / (node - rest))) * self._others_forward[k]
        return total


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


def _largest_correlation(covariance: FloatArray, names: Sequence[str]) -> tuple[float, tuple[str, ...]]:
    """Magnitude of the largest correlation, and the names of its two parameters."""
    if len(names) < 2:
        return 0.0, ()
    sigma = np.sqrt(np.diag(covariance))
    correlation = np.abs(covariance / np.outer(sigma, sigma))
    np.fill_diagonal(correlation, 0.0)
    one, other = divmod(int(correlation.argmax()), len(names))
    return float(correlation.max()), (names[one], names[other])


def _bias_map(lenses: Sequence[MeasuredLens], bias_nm: FloatArray) -> BiasMap:
    """Fit mean, tilts and bowl to the bias of each measured size, shape (n, 2).

    A coefficient that the places do not determine is 0 without an error.
    """
    at_mm = np.concatenate([
        np.stack([lens.pillars.lattice.x_um()[lens.place[:, 1]], lens.pillars.lattice.y_um()[lens.place[:, 0]]], axis=1)
        for lens in lenses
    ]) * 1e-3  # fmt: skip
    places = np.repeat(at_mm, 2, axis=0)
    square = (places**2).sum(axis=1)
    values = bias_nm.ravel()
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
