"""Least-squares fit of a line model to solved rows, by the Levenberg-Marquardt method with the exact Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.blas import zherk

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.neighbours.line import LineModel, LineShape
from metafab.library.neighbours.solve import corrections_and_jacobian, line_corrections, scattered_corrections

#: Rows whose Jacobian is held at once.
_ROWS_AT_ONCE = 32


@dataclass(frozen=True)
class RowSet:
    """Solved rows of one length."""

    size_nm: FloatArray  #: Shape (rows, sites, 2), width and length of each pillar.
    local: ComplexArray  #: Shape (2, rows, sites), the library's r and t of each pillar.
    amplitude: ComplexArray  #: Shape (2, rows, orders), solved amplitudes of the reflected and transmitted orders.
    order: FloatArray  #: Shape (orders,), numbers of the orders.
    weight: FloatArray  #: Shape (orders,), weight of each squared residual.

    @property
    def to_orders(self) -> ComplexArray:
        """Matrix from the field of the sites to the amplitudes of the orders, shape (orders, sites)."""
        sites = self.size_nm.shape[1]
        at = (np.arange(sites) + 0.5) / sites - 0.5
        return np.asarray(np.exp(-2j * np.pi * np.outer(self.order, at)) / sites)

    def errors(self, model: LineModel | None) -> FloatArray:
        """Relative rms error of each row over its transmitted orders, shape (rows,).

        ``model`` None is the local-period approximation.
        """
        field, amplitude = self.local[1], self.amplitude[1]
        if model is not None:
            field = field + line_corrections(model, model.polynomials(self.size_nm))
        off = field @ self.to_orders.T - amplitude
        return np.asarray(np.linalg.norm(off, axis=1) / np.linalg.norm(amplitude, axis=1))

    def part(self, chosen: NDArray[np.bool_]) -> RowSet:
        """The rows where ``chosen``, shape (rows,), is true."""
        return replace(
            self, size_nm=self.size_nm[chosen], local=self.local[:, chosen], amplitude=self.amplitude[:, chosen]
        )


@dataclass(frozen=True)
class FitLimits:
    """Stopping rules and prior of a fit."""

    steps: int = 120  #: Most steps.
    ridge: float = 2e-2  #: Weight of the squared parameters, relative to one row; grows with the degree of a term.
    gain: float = 5e-3  #: Smallest relative decrease of the loss over five steps.
    reflected: float = 0.5  #: Weight of the squared residuals of reflected light; that of transmitted light is 1.


def fit(
    model: LineModel,
    sets: Sequence[RowSet],
    limits: FitLimits = FitLimits(),
) -> LineModel:
    """Fit a chain to the light that rows reflect and transmit: least squares, with a prior against high degrees.

    Args:
        model: parameters to start from.
        sets: rows to fit, at least one.
        limits: stopping rules and prior.

    Returns:
        The chain with the smallest loss.
    """
    vector = model.vector
    ridge = limits.ridge * _prior(model.shape)
    terms = [model.polynomials(rows.size_nm) for rows in sets]
    damping, losses = 1e-1, []
    least = _loss(model, sets, terms, ridge, limits.reflected)
    for _ in range(limits.steps):
        normal, gradient = _normal_equations(model, sets, terms, limits.reflected)
        gradient = gradient + ridge * vector
        normal[np.diag_indices(vector.size)] += ridge
        scale = np.diag(normal).real.copy()
        while damping < 1e8:
            damped = normal.copy(order="K")
            damped[np.diag_indices(vector.size)] += damping * scale
            trial = vector - cho_solve(cho_factor(damped, overwrite_a=True), gradient)
            trial_loss = _loss(model.with_vector(trial), sets, terms, ridge, limits.reflected)
            if trial_loss < least:
                break
            damping *= 4.0
        else:
            break
        vector, least = trial, trial_loss
        model = model.with_vector(vector)
        damping = max(damping / 5.0, 1e-9)
        losses.append(least)
        if len(losses) > 8 and losses[-6] - least < limits.gain * least:
            break
    return model


def loss(model: LineModel, sets: Sequence[RowSet], limits: FitLimits) -> float:
    """The quantity that :func:`fit` makes small: weighted squared residuals, relative to the light, plus the prior."""
    terms = [model.polynomials(rows.size_nm) for rows in sets]
    return _loss(model, sets, terms, limits.ridge * _prior(model.shape), limits.reflected)


def _prior(shape: LineShape) -> FloatArray:
    """Weight of each squared parameter, shape (n,): it grows with the degree of its term."""
    degree = shape.powers.sum(axis=1)
    weight = (1.0 + degree) ** 2.0
    r, _ = shape.pairs
    parts = [np.repeat(weight, n) for n in (r.size, shape.even, shape.modes, shape.even, shape.modes)]
    return np.concatenate([*parts, np.ones(shape.hop_pairs[0].size)])


def _weights(rows: RowSet, reflected: float) -> FloatArray:
    """Factors of the residuals of reflected and transmitted orders over the rms light of a row, shape (2, orders)."""
    power = np.mean(np.sum(np.abs(rows.amplitude) ** 2, axis=-1), axis=1)
    return np.asarray(np.sqrt(rows.weight * (np.array([reflected, 1.0]) / power)[:, None]))


def _loss(
    model: LineModel,
    sets: Sequence[RowSet],
    terms: Sequence[FloatArray],
    ridge: FloatArray,
    reflected: float,
) -> float:
    total = float(ridge @ np.abs(model.vector) ** 2)
    for rows, values in zip(sets, terms, strict=True):
        off = (rows.local + scattered_corrections(model, values)) @ rows.to_orders.T - rows.amplitude
        total += float(np.sum(np.abs(off * _weights(rows, reflected)[:, None]) ** 2))
    return total if np.isfinite(total) else np.inf


def _normal_equations(
    model: LineModel, sets: Sequence[RowSet], terms: Sequence[FloatArray], reflected: float
) -> tuple[ComplexArray, ComplexArray]:
    """J^H J, shape (n, n), and J^H r, shape (n,), of the weighted residuals r of all rows.

    Only the upper triangle of J^H J is filled.
    """
    n = model.vector.size
    conjugate = np.zeros((n, n), dtype=np.complex128, order="F")
    gradient = np.zeros(n, dtype=np.complex128)
    # Reflected light without weight needs no derivatives.
    faces = (0, 1) if reflected > 0.0 else (1,)
    for rows, values in zip(sets, terms, strict=True):
        weights = _weights(rows, reflected)[list(faces)]
        to_orders = rows.to_orders * weights[..., None]
        for start in range(0, len(values), _ROWS_AT_ONCE):
            part = slice(start, start + _ROWS_AT_ONCE)
            correction, jacobian = corrections_and_jacobian(model, values[part], faces)
            jacobian = (to_orders[:, None] @ jacobian).reshape(-1, n)
            local, solved = (both[list(faces), part] for both in (rows.local, rows.amplitude))
            off = (local + correction) @ rows.to_orders.T - solved
            conjugate = zherk(1.0, jacobian.T, beta=1.0, c=conjugate, overwrite_c=True)
            gradient += (off * weights[:, None]).ravel() @ jacobian.conj()
    return conjugate.conj(), gradient
