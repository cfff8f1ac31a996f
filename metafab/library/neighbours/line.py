"""A line of unlike pillars as a chain of coupled modes: the transmitted field of each pillar among its neighbours.

Each site m carries the amplitudes a_m of a few modes, even or odd under the mirror that exchanges the two directions of
the line. They obey

    H(s_m) a_m - W a_{m-1} - W^T a_{m+1} = c(s_m).

The symmetric matrix H and the source c (even modes only) depend on the size s, along the line and across it; the hop W
is constant. Reciprocity makes the left side symmetric. The mirror makes W^T = Pi W Pi, with Pi = +1 for even and -1 for
odd modes. Light reaches far although only adjacent sites couple: it is guided from site to site. Pillar m transmits

    t_m = t(s_m) + y_m - y(s_m),      y_m = e(s_m) a_m + g(s_{m-1}) a_{m-1} + Pi g(s_{m+1}) a_{m+1}.

Here t(s) is the library's value and y(s) the same sum in a line of equal pillars of size s, so that equal pillars are
exact. It reflects r_m, likewise from r(s), with e' and g' of its own. Reciprocity ties the source to them: light along
the axis excites what radiates along the axis, c = e' + 2 g' of the even modes. H and the taps e, g, e' and g' are
polynomials of the size. Their coefficients and the hop are the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebval, chebvander, chebvander2d
from numpy.typing import NDArray
from scipy.linalg import block_diag

from metafab.core.conventions import ComplexArray, FloatArray

IntArray = NDArray[np.intp]
Span = tuple[float, float]

#: Names of the parameters, in the order of :attr:`LineModel.vector`.
PARAMETERS = ("site", "own", "side", "back_own", "back_side", "hop")


@dataclass(frozen=True)
class LineShape:
    """Number of modes and polynomial terms of a line model."""

    even: int = 3  #: Even modes of a site.
    odd: int = 2  #: Odd modes of a site.
    degree: int = 4  #: Total degree of the polynomials of width and length.

    @property
    def modes(self) -> int:
        """Modes of a site."""
        return self.even + self.odd

    def with_more(self, count: int) -> LineShape:
        """The shape with ``count`` more modes of each parity, fewer if negative; at least one even mode."""
        return replace(self, even=max(1, self.even + count), odd=max(0, self.odd + count))

    @property
    def terms(self) -> int:
        """Terms of each polynomial."""
        return (self.degree + 1) * (self.degree + 2) // 2

    @property
    def parity(self) -> FloatArray:
        """+1 of even, -1 of odd modes, shape (modes,)."""
        return np.concatenate([np.ones(self.even), -np.ones(self.odd)])

    @property
    def powers(self) -> IntArray:
        """Degrees (i, j) of T_i(width) T_j(length) of each term, shape (terms, 2)."""
        i, j = np.meshgrid(np.arange(self.degree + 1), np.arange(self.degree + 1), indexing="ij")
        inside = (i + j).ravel() <= self.degree
        return np.stack([i.ravel()[inside], j.ravel()[inside]], axis=1)

    @property
    def pairs(self) -> tuple[IntArray, IntArray]:
        """(r, s), r <= s, of modes of equal parity: the free elements of H; shape (n,) each."""
        row, column = np.triu_indices(self.modes)
        equal = (row < self.even) == (column < self.even)
        return row[equal], column[equal]

    @property
    def hop_pairs(self) -> tuple[IntArray, IntArray, FloatArray]:
        """(r, s), r <= s, and the sign of element (s, r): the free elements of W; shape (n,) each."""
        row, column = np.triu_indices(self.modes)
        return row, column, self.parity[row] * self.parity[column]


@dataclass(frozen=True)
class LineModel:
    """Parameters of a chain of coupled modes."""

    shape: LineShape  #: Numbers of modes and terms.
    along_nm: Span  #: Range of sizes along the row that maps to -1..1.
    across_nm: Span  #: Range of sizes across the row that maps to -1..1.
    site: ComplexArray  #: Shape (terms, n_pairs), coefficients of the free elements of H.
    own: ComplexArray  #: Shape (terms, even), of e.
    side: ComplexArray  #: Shape (terms, modes), of g.
    back_own: ComplexArray  #: Shape (terms, even), of e'.
    back_side: ComplexArray  #: Shape (terms, modes), of g'.
    hop: ComplexArray  #: Shape (n_hop_pairs,), free elements of W.

    @property
    def source(self) -> ComplexArray:
        """Coefficients of c, shape (terms, even)."""
        return self.back_own + 2.0 * self.back_side[:, : self.shape.even]

    @property
    def vector(self) -> ComplexArray:
        """All parameters, shape (n,), in the order of the fields."""
        return np.concatenate([getattr(self, name).ravel() for name in PARAMETERS])

    def with_vector(self, vector: ComplexArray) -> LineModel:
        """The model with other parameters, shape (n,)."""
        olds = [getattr(self, name) for name in PARAMETERS]
        ends = np.cumsum([old.size for old in olds])
        parts = np.split(np.asarray(vector, dtype=np.complex128), ends[:-1])
        site, own, side, back_own, back_side, hop = (
            part.reshape(old.shape) for part, old in zip(parts, olds, strict=True)
        )
        return replace(self, site=site, own=own, side=side, back_own=back_own, back_side=back_side, hop=hop)

    def polynomials(self, size_nm: FloatArray) -> FloatArray:
        """Values of the terms at sizes, shape (..., 2) to (..., terms)."""
        along, across = (
            (2.0 * size_nm[..., k] - span[0] - span[1]) / max(span[1] - span[0], 1e-9)
            for k, span in enumerate((self.along_nm, self.across_nm))
        )
        i, j = self.shape.powers.T
        degree = self.shape.degree
        return np.asarray(chebvander2d(along, across, (degree, degree))[..., i * (degree + 1) + j], dtype=np.float64)

    def polynomial_slopes(self, size_nm: FloatArray) -> FloatArray:
        """Derivatives of the terms by both sizes, shape (n, 2) to (2, n, terms), per nm."""
        degree = self.shape.degree
        i, j = self.shape.powers.T
        values, slopes = [], []
        for k, span in enumerate((self.along_nm, self.across_nm)):
            scale = 2.0 / max(span[1] - span[0], 1e-9)
            at = scale * (size_nm[:, k] - 0.5 * (span[0] + span[1]))
            values.append(chebvander(at, degree))
            slopes.append(scale * chebval(at, chebder(np.eye(degree + 1))).T)
        return np.stack([slopes[0][:, i] * values[1][:, j], values[0][:, i] * slopes[1][:, j]])

    def site_matrix(self, terms: FloatArray) -> ComplexArray:
        """H at sites with polynomial values ``terms``, shape (..., terms) to (..., modes, modes)."""
        r, s = self.shape.pairs
        matrix = np.zeros((*terms.shape[:-1], self.shape.modes, self.shape.modes), dtype=np.complex128)
        matrix[..., r, s] = terms @ self.site
        matrix[..., s, r] = matrix[..., r, s]
        return matrix

    @cached_property
    def hop_matrix(self) -> ComplexArray:
        """W, shape (modes, modes)."""
        r, s, sign = self.shape.hop_pairs
        matrix = np.zeros((self.shape.modes, self.shape.modes), dtype=np.complex128)
        matrix[s, r] = self.hop * sign
        matrix[r, s] = self.hop
        return matrix

    def periodic_matrix(self, terms: FloatArray) -> ComplexArray:
        """Matrix of closed lines, shape (..., n, terms) to (..., n modes, n modes)."""
        count, modes = terms.shape[-2], self.shape.modes
        matrix = np.zeros((*terms.shape[:-2], count, modes, count, modes), dtype=np.complex128)
        site = np.arange(count)
        # The advanced indices come first: (n, ..., modes, modes).
        matrix[..., site, :, site, :] = np.moveaxis(self.site_matrix(terms), -3, 0)
        for m in range(count):
            matrix[..., m, :, (m - 1) % count, :] -= self.hop_matrix
            matrix[..., m, :, (m + 1) % count, :] -= self.hop_matrix.T
        return matrix.reshape(*terms.shape[:-2], count * modes, count * modes)

    @property
    def uniform_hop(self) -> ComplexArray:
        """Sum of both hops between the even modes of equal pillars, shape (even, even)."""
        even = self.shape.even
        return np.asarray(2.0 * self.hop_matrix[:even, :even])


def initial_model(shape: LineShape, along_nm: Span, across_nm: Span, seed: int) -> LineModel:
    """Random model to start a fit from: damped modes, weak sources and hops."""
    rng = np.random.default_rng(seed)

    def noise(scale: float, *of: int) -> ComplexArray:
        return np.asarray(scale * (rng.normal(size=of) + 1j * rng.normal(size=of)), dtype=np.complex128)

    r, s = shape.pairs
    site = noise(0.05, shape.terms, r.size)
    detuning = np.concatenate([np.linspace(0.8, 1.5, shape.even), np.linspace(0.9, 1.4, shape.odd)])
    site[0] = np.where(r == s, (detuning * np.exp(0.6j))[r], 0.0)
    own, side = noise(0.01, shape.terms, shape.even), noise(0.01, shape.terms, shape.modes)
    back_own, back_side = noise(0.1, shape.terms, shape.even), noise(0.01, shape.terms, shape.modes)
    own[0] += 0.03
    back_own[0] += 0.5
    hop = noise(0.15, shape.hop_pairs[0].size)
    return LineModel(shape, along_nm, across_nm, site, own, side, back_own, back_side, hop)


#: Smallest eigenvalue of the hop's blocks over their norm; that of trained chains is 1e-4.
_SINGULAR = 1e-12
#: Largest deviation of the hop from pairs: rounding stays many orders below, eigenvectors of equal eigenvalues do not.
_UNPAIRED = 1e-6


def paired(model: LineModel) -> tuple[LineModel, ComplexArray]:
    """The same chain in other modes, whose hop couples each mode to itself, by 1, and to one mode of the other parity.

    Returns:
        The chain, and elements of its hop, shape (n,), from odd mode k to even mode k; those back are minus these.

    Raises:
        ValueError: the hop among the even modes, among the odd modes, or between them is singular or has equal
            eigenvalues.
    """
    even, hop = model.shape.even, model.hop_matrix
    bases = [_unit_basis(hop[:even, :even]), _unit_basis(hop[even:, even:])]
    between = bases[0].T @ hop[:even, even:] @ bases[1]
    few = int(np.argmin(between.shape))
    between = between if few == 1 else between.T
    # Singular vectors that are orthogonal without conjugation, and those that complete the larger basis.
    turn = _unit_basis(between.T @ between)
    pairing = 1.0 / np.sqrt(np.sum(turn**2, axis=0))
    turn = turn * pairing
    image = between @ turn / pairing
    rest = np.linalg.svd(image.T)[2][len(turn) :].conj().T
    bases[few] = bases[few] @ turn
    bases[1 - few] = bases[1 - few] @ np.concatenate([image, rest @ _unit_basis(rest.T @ rest)], axis=1)
    change = block_diag(*bases)
    row, column = model.shape.pairs
    site = change.T @ model.site_matrix(np.eye(model.shape.terms)) @ change
    changed = replace(
        model,
        site=site[:, row, column],
        own=model.own @ bases[0],
        side=model.side @ change,
        back_own=model.back_own @ bases[0],
        back_side=model.back_side @ change,
        hop=(change.T @ hop @ change)[model.shape.hop_pairs[:2]],
    )
    k, exact = np.arange(pairing.size), np.eye(model.shape.modes, dtype=np.complex128)
    exact[k, even + k], exact[even + k, k] = pairing, -pairing
    if not np.abs(changed.hop_matrix - exact).max() <= _UNPAIRED:
        raise ValueError("the hop of a chain has equal eigenvalues, whose modes cannot be paired")
    return changed, np.asarray(pairing)


def _unit_basis(matrix: ComplexArray) -> ComplexArray:
    """Basis V, in columns, with V^T A V = 1 for a complex symmetric matrix A; ValueError if A is singular."""
    value, vector = np.linalg.eig(matrix)
    scale = np.sum(vector**2, axis=0) * value + 0.0j
    if np.any(np.abs(scale) <= _SINGULAR * np.linalg.norm(matrix)):
        raise ValueError("the hop of a chain is singular")
    return np.asarray(vector / np.sqrt(scale))


#: Scale of the random sources and taps of new modes, and of their coupling to the others. Measured on a chain of 4 + 4
#: modes with a loss of 6.4 that got 5 + 5: after 15 steps 3.1 with 0.05, but 40 with 0.3.
_WEAK = 0.05


def grown(model: LineModel, shape: LineShape, seed: int) -> LineModel:
    """Add modes to a chain, weakly coupled to those that it has, with random parameters; raise its degree.

    Of the modes that it has, coefficients of the terms beyond its degree are 0. ``shape`` has at least the degree of
    the chain, and at least as many even and odd modes.
    """
    new = initial_model(shape, model.along_nm, model.across_nm, seed)
    known_terms = shape.powers.sum(axis=1) <= model.shape.degree
    is_even = np.arange(shape.even) < model.shape.even
    is_known = np.concatenate([is_even, np.arange(shape.odd) < model.shape.odd])

    def pairs(values: ComplexArray, olds: ComplexArray, row: IntArray, column: IntArray) -> ComplexArray:
        values[..., is_known[row] != is_known[column]] *= _WEAK
        values[..., is_known[row] & is_known[column]] = olds
        return values

    def of_degree(name: str) -> ComplexArray:
        olds = getattr(model, name)
        values = np.zeros((shape.terms, olds.shape[1]), dtype=np.complex128)
        values[known_terms] = olds
        return values

    def modes(name: str, known: NDArray[np.bool_]) -> ComplexArray:
        values = _WEAK * getattr(new, name)
        values[:, known] = of_degree(name)
        return np.asarray(values)

    return replace(
        new,
        site=pairs(new.site.copy(), of_degree("site"), *shape.pairs),
        own=modes("own", is_even),
        side=modes("side", is_known),
        back_own=modes("back_own", is_even),
        back_side=modes("back_side", is_known),
        hop=pairs(new.hop.copy(), model.hop, *shape.hop_pairs[:2]),
    )
