"""Amplitudes as rational functions of sizes and axes together: one model for all corners.

A guided mode's pole moves smoothly with wavelength, height or index as it does with the sizes, so an axis is one more
variable of N and D. The response bends far less along an axis than over the sizes; a power of its variable is
therefore counted ``weight`` times in the total degree. At a corner the axes' polynomials are numbers, and what is
left is an ordinary :class:`SizeModel`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.fit.models import SizeModel
from metafab.library.fit.rational import Degrees, Range, RationalModel, exponents, fit_coefficients, scaled

#: Weights of an axis, and degrees of the denominator, that are tried; and the largest degree of the numerators.
WEIGHTS = (2, 3)
DENOMINATOR_DEGREES = (7, 10, 12)
LARGEST_DEGREE = 18
#: Models that are kept at most: two may agree by chance where few samples are, as in the corners of the box.
MODELS = 3
#: Unknowns that a fit may have for each equation.
FILLING = 0.7
#: Models with fewer unknowns than this for each equation are not tried: the samples can tell more.
LEAST_FILLING = 0.25


@dataclass(frozen=True)
class Shape:
    """Which products of Chebyshev polynomials a model consists of.

    Attributes:
        degrees: total degrees of the numerators and of the denominator.
        weight: what a power of an axis' variable counts in them.
        variables: how many axes.
    """

    degrees: Degrees
    weight: int
    variables: int

    @property
    def unknowns(self) -> int:
        """Coefficients of two channels and their denominator."""
        above, below = self.terms
        return 2 * above + below

    @property
    def terms(self) -> tuple[int, int]:
        """Products in the numerators and in the denominator."""
        above, below = (len(_powers(degree, self.weight, self.variables)) for degree in self.degrees)
        return above, below


@dataclass(frozen=True)
class CornerSamples:
    """Solved cells anywhere in the box of sizes and axes.

    Attributes:
        width_nm: shape (n,), as made: bias included; likewise ``length_nm``.
        length_nm: see ``width_nm``.
        axes: shape (n, n_variables), each in -1..1.
        amplitudes: shape (n, 4), t_xx, t_yy, r_xx, r_yy.
    """

    width_nm: FloatArray
    length_nm: FloatArray
    axes: FloatArray
    amplitudes: ComplexArray

    def __getitem__(self, which: NDArray[np.bool_]) -> CornerSamples:
        return CornerSamples(self.width_nm[which], self.length_nm[which], self.axes[which], self.amplitudes[which])


@dataclass(frozen=True)
class CornerModel:
    """All four amplitudes as functions of sizes and axes.

    Attributes:
        width_nm: smallest and largest width; likewise ``length_nm``.
        length_nm: see ``width_nm``.
        shape: the products of polynomials.
        numerator: shape (2, terms, 2): polarisation, term, (t, r).
        denominator: shape (2, terms): polarisation, term.
    """

    width_nm: Range
    length_nm: Range
    shape: Shape
    numerator: ComplexArray
    denominator: ComplexArray

    def __call__(self, width_nm: FloatArray, length_nm: FloatArray, axes: FloatArray) -> ComplexArray:
        """Shape (n,) sizes and (n, n_variables) axes -> shape (n, 4): t_xx, t_yy, r_xx, r_yy."""
        above, below = _bases(self.shape, *_places(self.width_nm, self.length_nm, width_nm, length_nm), axes)
        x, y = (above @ n / (below @ d)[:, None] for n, d in zip(self.numerator, self.denominator, strict=True))
        return np.stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]], axis=1)

    def at(self, axes: FloatArray, bias_nm: float = 0.0) -> SizeModel:
        """The model of one corner, as a function of the sizes before the bias.

        Args:
            axes: shape (n_variables,), each in -1..1.
            bias_nm: what is added to width and length.
        """
        spans = [(low - bias_nm, high - bias_nm) for low, high in (self.width_nm, self.length_nm)]
        x, y = (
            RationalModel(
                spans[0],
                spans[1],
                self.shape.degrees,
                self._contracted(self.shape.degrees[0], n, axes),
                self._contracted(self.shape.degrees[1], d[:, None], axes)[:, 0],
            )
            for n, d in zip(self.numerator, self.denominator, strict=True)
        )
        return SizeModel(x, y)

    def _contracted(self, degree: int, coefficients: ComplexArray, axes: FloatArray) -> ComplexArray:
        """Coefficients of T_i(u) T_j(v) once the axes are numbers: shape (terms, n_channels)."""
        powers = _powers(degree, self.shape.weight, self.shape.variables)
        value = _product(axes[None, :], powers[:, 2:])[0]
        place = np.zeros((degree + 1, degree + 1), dtype=np.intp)
        i, j = exponents(degree)
        place[i, j] = np.arange(len(i))
        left = np.zeros((len(i), coefficients.shape[1]), dtype=np.complex128)
        np.add.at(left, place[powers[:, 0], powers[:, 1]], value[:, None] * coefficients)
        return left


def fit_corner_models(
    samples: CornerSamples, held_out: NDArray[np.bool_], spans_nm: tuple[Range, Range], exchange: bool
) -> tuple[CornerModel, ...]:
    """Try several shapes without the held-out samples, then fit the two or three best to all, the very best first.

    Args:
        samples: solved cells.
        held_out: shape (n,), which of them judge the shapes.
        spans_nm: widths and lengths that the models are for.
        exchange: whether t_yy(W, L) = t_xx(L, W) at every corner.
    """
    known, unseen = samples[~held_out], samples[held_out]

    def miss(shape: Shape) -> float:
        predicted = _fit(known, shape, spans_nm, exchange)(unseen.width_nm, unseen.length_nm, unseen.axes)
        return float(np.sqrt(np.mean(np.abs(predicted - unseen.amplitudes) ** 2)))

    ranked = sorted(_candidates(known.width_nm.size * (2 if exchange else 1), samples.axes.shape[1]), key=miss)
    # The poorest of all is no judge of the best.
    kept = ranked[: max(2, min(MODELS, len(ranked) - 1))]
    return tuple(_fit(samples, shape, spans_nm, exchange) for shape in kept)


def _candidates(equations: int, variables: int) -> list[Shape]:
    """Shapes that so many samples of two channels can determine, the largest numerator for each denominator."""
    largest = []
    for weight, below in product(WEIGHTS if variables else WEIGHTS[:1], DENOMINATOR_DEGREES):
        fitting = [Shape((above, below), weight, variables) for above in range(1, LARGEST_DEGREE + 1)]
        largest += [shape for shape in fitting if shape.unknowns <= FILLING * 2 * equations][-1:]
    rich = [shape for shape in largest if shape.unknowns >= LEAST_FILLING * 2 * equations]
    # Without variables (a bias alone) samples abound, and even the largest shapes have few unknowns for each.
    found = rich if len(rich) > 1 else largest
    return found if len(found) > 1 else [Shape((2, 0), 2, variables), Shape((1, 0), 2, variables)]


def _fit(samples: CornerSamples, shape: Shape, spans_nm: tuple[Range, Range], exchange: bool) -> CornerModel:
    """Fit both polarisations; with exchange, the samples and their mirror images serve each."""
    u, v = _places(*spans_nm, samples.width_nm, samples.length_nm)
    x_values, y_values = samples.amplitudes[:, [0, 2]], samples.amplitudes[:, [1, 3]]
    if exchange:
        above, below = _bases(shape, np.concatenate([u, v]), np.concatenate([v, u]), np.tile(samples.axes, (2, 1)))
        n, d = fit_coefficients(above, below, np.concatenate([x_values, y_values]))
        swapped = [_exchanged(degree, shape) for degree in shape.degrees]
        return CornerModel(*spans_nm, shape, np.stack([n, n[swapped[0]]]), np.stack([d, d[swapped[1]]]))
    above, below = _bases(shape, u, v, samples.axes)
    fits = [fit_coefficients(above, below, values) for values in (x_values, y_values)]
    return CornerModel(*spans_nm, shape, np.stack([n for n, _ in fits]), np.stack([d for _, d in fits]))


def _places(
    width_span: Range, length_span: Range, width_nm: FloatArray, length_nm: FloatArray
) -> tuple[FloatArray, FloatArray]:
    return scaled(width_nm, width_span), scaled(length_nm, length_span)


@cache
def _powers(degree: int, weight: int, variables: int) -> NDArray[np.intp]:
    """Shape (terms, 2 + variables): the degree of each factor, i + j + weight * (the others) <= degree."""
    found = []
    for others in product(range(degree // weight + 1), repeat=variables):
        left = degree - weight * sum(others)
        found += [(i, j, *others) for i in range(left + 1) for j in range(left + 1 - i)]
    return np.array(found, dtype=np.intp)


def _exchanged(degree: int, shape: Shape) -> list[int]:
    """Where each term finds the one with the powers of width and length swapped."""
    powers = [tuple(row) for row in _powers(degree, shape.weight, shape.variables).tolist()]
    place = {power: k for k, power in enumerate(powers)}
    return [place[(j, i, *others)] for i, j, *others in powers]


def _bases(shape: Shape, u: FloatArray, v: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Basis functions of numerators and denominator at scattered points, shape (n, terms) each."""
    points = np.concatenate([u[:, None], v[:, None], axes], axis=1)
    above, below = (_product(points, _powers(degree, shape.weight, shape.variables)) for degree in shape.degrees)
    return above, below


def _product(points: FloatArray, powers: NDArray[np.intp]) -> FloatArray:
    """Products of Chebyshev polynomials: points (n, d) and powers (terms, d) -> shape (n, terms)."""
    value = np.ones((points.shape[0], powers.shape[0]))
    for column, power in zip(points.T, powers.T, strict=True):
        value *= chebyshev.chebvander(column, int(power.max()))[:, power]
    return value
