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
    def mirrored(self) -> bool:
        """Whether each row is its own mirror image: orders m and -m are then equal."""
        return np.array_equal(self.size_nm, self.size_nm[:, ::-1])

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
    targets = [_Target.of(rows, model, limits.reflected) for rows in sets]
    damping, losses = 1e-1, []
    least = _loss(model, targets, ridge)
    for _ in range(limits.steps):
        normal, gradient = _normal_equations(model, targets)
        gradient = gradient + ridge * vector
        normal[np.diag_indices(vector.size)] += ridge
        scale = np.diag(normal).real.copy()
        while damping < 1e8:
            damped = normal.copy(order="K")
            damped[np.diag_indices(vector.size)] += damping * scale
            trial = vector - cho_solve(cho_factor(damped, overwrite_a=True), gradient)
            trial_loss = _loss(model.with_vector(trial), targets, ridge)
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
    """Loss that :func:`fit` minimises: weighted squared residuals, relative to the light, plus the prior."""
    targets = [_Target.of(rows, model, limits.reflected) for rows in sets]
    return _loss(model, targets, limits.ridge * _prior(model.shape))


@dataclass(frozen=True)
class _Target:
    """Weighted amplitudes of solved rows; of rows that are their own mirror images the first half and orders >= 0."""

    terms: FloatArray  #: Shape (rows, sites, terms), polynomial values of the sizes.
    mirrored: bool  #: Whether the rows are their own mirror images.
    local: ComplexArray  #: Shape (faces, rows, half), the library's r and t, or t alone.
    to_orders: ComplexArray  #: Shape (faces, orders, half), from the field of the sites to weighted amplitudes.
    amplitude: ComplexArray  #: Shape (faces, rows, orders), weighted amplitudes.

    @classmethod
    def of(cls, rows: RowSet, model: LineModel, reflected: float) -> _Target:
        sites, mirrored = rows.size_nm.shape[1], rows.mirrored
        half = (sites + 1) // 2 if mirrored else sites
        # Of mirrored rows the orders m and -m are equal, and so is the light of a site and of its image.
        weight, kept, to_orders = rows.weight, rows.order >= -np.inf, rows.to_orders
        if mirrored:
            weight, kept = np.where(rows.order > 0, weight + weight[::-1], weight), rows.order >= 0
            to_orders[:, : sites - half] += to_orders[:, : half - 1 : -1]
        # Reflected light without weight needs no derivatives.
        faces = slice(0 if reflected > 0.0 else 1, 2)
        power = np.mean(np.sum(np.abs(rows.amplitude) ** 2, axis=-1), axis=1)
        scale = np.sqrt(weight * (np.array([reflected, 1.0]) / power)[:, None])[faces, kept]
        return cls(
            model.polynomials(rows.size_nm),
            mirrored,
            rows.local[faces, :, :half],
            scale[..., None] * to_orders[kept, :half],
            scale[:, None] * rows.amplitude[faces][..., kept],
        )

    def residuals(self, field: ComplexArray, part: slice = slice(None)) -> ComplexArray:
        """Weighted residuals of some rows with corrections ``field``; shape (faces, rows, half) to (..., orders)."""
        return (self.local[:, part] + field) @ self.to_orders.swapaxes(-1, -2) - self.amplitude[:, part]


def _prior(shape: LineShape) -> FloatArray:
    """Weight of each squared parameter, shape (n,): it grows with the degree of its term."""
    degree = shape.powers.sum(axis=1)
    weight = (1.0 + degree) ** 2.0
    r, _ = shape.pairs
    parts = [np.repeat(weight, n) for n in (r.size, shape.even, shape.modes, shape.even, shape.modes)]
    return np.concatenate([*parts, np.ones(shape.hop_pairs[0].size)])


def _loss(model: LineModel, targets: Sequence[_Target], ridge: FloatArray) -> float:
    total = float(ridge @ np.abs(model.vector) ** 2)
    for target in targets:
        field = scattered_corrections(model, target.terms, target.mirrored)[-len(target.local) :]
        total += float(np.sum(np.abs(target.residuals(field)) ** 2))
    return total if np.isfinite(total) else np.inf


def _normal_equations(model: LineModel, targets: Sequence[_Target]) -> tuple[ComplexArray, ComplexArray]:
    """J^H J, shape (n, n), and J^H r, shape (n,), of the weighted residuals r of all rows.

    Only the upper triangle of J^H J is filled.
    """
    n = model.vector.size
    conjugate = np.zeros((n, n), dtype=np.complex128, order="F")
    gradient = np.zeros(n, dtype=np.complex128)
    for target in targets:
        faces = (0, 1)[-len(target.local) :]
        for start in range(0, len(target.terms), _ROWS_AT_ONCE):
            part = slice(start, start + _ROWS_AT_ONCE)
            field, jacobian = corrections_and_jacobian(model, target.terms[part], faces, target.mirrored)
            jacobian = (target.to_orders[:, None] @ jacobian).reshape(-1, n)
            conjugate = zherk(1.0, jacobian.T, beta=1.0, c=conjugate, overwrite_c=True)
            gradient += target.residuals(field, part).ravel() @ jacobian.conj()
    return conjugate.conj(), gradient
