"""Chains of coupled modes along all lines of a block, coupled from line to line.

A chain is trained on lines between equal ones: it knows what its modes do where all lines are in phase, and not how
they travel across the lines. On a periodic block of lines j its modes obey

    H(s) a_j,m - W a_j,m-1 - W^T a_j,m+1 - K (a_j+1,m + a_j-1,m - 2 a_j,m) = c(s),

with one constant matrix K: symmetric by reciprocity, and without elements between even and odd modes by the mirror
along the line. Equal lines have no second difference, so that the chain's own rows stay as they are. What this changes
in a block whose columns are equal is known from the chains along the columns, and is taken off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.neighbours.line import IntArray, LineModel


def coupling_matrix(model: LineModel, coupling: ComplexArray) -> ComplexArray:
    """K, shape (modes, modes), of its free elements, shape (n_pairs,) in the order of :attr:`LineShape.pairs`."""
    r, s = model.shape.pairs
    matrix = np.zeros((model.shape.modes, model.shape.modes), dtype=np.complex128)
    matrix[r, s] = matrix[s, r] = coupling
    return matrix


@dataclass(frozen=True)
class SolvedLines:
    """Modes on the coupled lines of a periodic block."""

    amplitude: ComplexArray  #: Shape (lines, sites, modes).
    corrections: ComplexArray  #: Of the transmitted field by the lines, shape (lines, sites).
    _factors: Any
    _taps: csc_array

    @classmethod
    def of(cls, model: LineModel, coupling: ComplexArray, terms: FloatArray) -> SolvedLines:
        """Solve a block.

        Args:
            model: the chain along the lines.
            coupling: free elements of K, shape (n_pairs,).
            terms: polynomial values of the sizes (:meth:`LineModel.polynomials`), shape (lines, sites, terms).
        """
        matrix = coupling_matrix(model, coupling)
        lattice, columns = (_Lattice.of(model, terms, equal=equal) for equal in (False, True))
        factors: Any = splu(lattice.coupled(matrix))
        amplitude = np.asarray(factors.solve(lattice.source), dtype=np.complex128)
        corrections = np.asarray(lattice.taps @ amplitude - columns.field(matrix), dtype=np.complex128)
        lines, sites, _ = terms.shape
        return cls(amplitude.reshape(lines, sites, -1), corrections.reshape(lines, sites), factors, lattice.taps)

    def field_of(self, source: ComplexArray) -> ComplexArray:
        """Field that a further source of the modes, shape (lines, sites, modes), sends out: shape (lines, sites)."""
        return np.asarray(self._taps @ self._factors.solve(source.ravel())).reshape(source.shape[:2])

    def adjoint(self, to_orders: ComplexArray) -> ComplexArray:
        """Derivatives of orders by sources of the modes, shape (orders, lines, sites, modes).

        ``to_orders``, shape (orders, lines sites), maps the field of the sites to the orders.
        """
        rows = np.asarray(self._taps.T @ to_orders.T, dtype=np.complex128)
        return np.asarray(self._factors.solve(rows, "T").T).reshape(len(to_orders), *self.amplitude.shape)


@dataclass(frozen=True)
class BlockLight:
    """Amplitudes of a block's orders by its chains along one direction, and their derivatives by K."""

    lattice: _Lattice
    columns: _Lattice
    to_orders: ComplexArray  #: Shape (orders, sites of the block), from the field of the sites to the orders.

    @classmethod
    def of(cls, model: LineModel, terms: FloatArray, to_orders: ComplexArray) -> BlockLight:
        """Light of a block, ``terms`` of shape (lines, sites, terms)."""
        lattice, columns = (_Lattice.of(model, terms, equal=equal) for equal in (False, True))
        return cls(lattice, columns, to_orders)

    def orders(self, coupling: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Corrections of the orders, shape (orders,), and derivatives by ``coupling``, shape (orders, n_pairs)."""
        matrix = coupling_matrix(self.lattice.model, coupling)
        (light, slopes), (known, known_slopes) = (
            each.orders(matrix, self.to_orders) for each in (self.lattice, self.columns)
        )
        return light - known, slopes - known_slopes


@dataclass(frozen=True)
class _Lattice:
    """The equations of a block without K, its taps, and the second difference across the lines."""

    model: LineModel
    matrix: csc_array  #: Shape (n, n), n = lines sites modes.
    source: ComplexArray  #: Shape (n,).
    taps: csc_array  #: Shape (lines sites, n).
    across: csc_array  #: Shape (lines sites, lines sites), second difference from line to line.

    @classmethod
    def of(cls, model: LineModel, terms: FloatArray, *, equal: bool) -> _Lattice:
        """Equations of a block, ``terms`` of shape (lines, sites, terms); with ``equal``, of each column, repeated."""
        number = np.arange(terms.shape[0] * terms.shape[1]).reshape(terms.shape[:2])
        before, after = (number, number) if equal else (np.roll(number, 1, axis=1), np.roll(number, -1, axis=1))
        hop, parity, even = model.hop_matrix, model.shape.parity, model.shape.even
        source, own = (np.zeros((*number.shape, model.shape.modes), dtype=np.complex128) for _ in range(2))
        source[..., :even], own[..., :even] = terms @ model.source, terms @ model.own
        side = (terms @ model.side).reshape(-1, model.shape.modes)
        blocks = ((number, model.site_matrix(terms)), (before, -hop), (after, -hop.T))
        taps = ((number, own), (before, side[before]), (after, side[after] * parity))
        neighbours = ((number, -2.0), (np.roll(number, 1, axis=0), 1.0), (np.roll(number, -1, axis=0), 1.0))
        return cls(
            model,
            _assembled(number, [(to, values) for to, values in blocks]),
            source.ravel(),
            _assembled(number, [(to, values[..., None, :]) for to, values in taps]),
            _assembled(number, [(to, np.full((1, 1), value)) for to, value in neighbours]),
        )

    def field(self, coupling: ComplexArray) -> ComplexArray:
        """Field that the modes add to the sites, shape (lines sites,), with K of shape (modes, modes)."""
        return np.asarray(self.taps @ splu(self.coupled(coupling)).solve(self.source))

    def orders(self, coupling: ComplexArray, to_orders: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Its orders, shape (orders,), and derivatives by the free elements of K, shape (orders, n_pairs)."""
        factors: Any = splu(self.coupled(coupling))
        r, s = self.model.shape.pairs
        amplitude = factors.solve(self.source)
        rows = np.asarray(self.taps.T @ to_orders.T, dtype=np.complex128)
        adjoint = factors.solve(rows, "T").T.reshape(len(to_orders), -1, self.model.shape.modes)
        change = np.asarray(self.across @ amplitude.reshape(-1, self.model.shape.modes))
        both = np.einsum("omr,ms->ors", adjoint, change, optimize=True)
        slopes = both[:, r, s] + np.where(r != s, both[:, s, r], 0.0)
        return np.asarray(to_orders @ (self.taps @ amplitude)), np.asarray(slopes)

    def coupled(self, coupling: ComplexArray) -> csc_array:
        """The matrix with K."""
        r, s = np.indices(coupling.shape)
        across, modes = self.across.tocoo(), len(coupling)
        values = across.data[:, None, None] * coupling
        row, column = (place[:, None, None] * modes + at for place, at in zip(across.coords, (r, s), strict=True))
        return csc_array(self.matrix - coo_array((values.ravel(), (row.ravel(), column.ravel())), self.matrix.shape))


def _assembled(number: IntArray, blocks: list[tuple[IntArray, Any]]) -> csc_array:
    """Sparse sum of blocks from sites ``to`` (columns) to all sites (rows), shape (..., rows, columns) each."""
    values, rows, columns = [], [], []
    for to, block in blocks:
        height, width = block.shape[-2:]
        found = np.broadcast_to(block, (*number.shape, height, width))
        i, j = np.indices((height, width))
        values.append(found.ravel())
        rows.append((number[..., None, None] * height + i).ravel())
        columns.append((to[..., None, None] * width + j).ravel())
    shape = (number.size * height, number.size * width)
    return coo_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape).tocsc()
