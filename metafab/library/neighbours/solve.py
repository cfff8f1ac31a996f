"""Field of closed lines (periods of unlike pillars), and its derivatives by all parameters of the model.

The field is a holomorphic function of the parameters, so that its Jacobian is one complex matrix. It follows from one
inverse of each line's matrix: with q_m the row of taps of output m, y_m = q_m A^-1 c, and lambda_m = q_m A^-1,

    dy_m = dq_m a + lambda_m (dc - dA a).
"""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.neighbours.line import IntArray, LineModel


def uniform_field(model: LineModel, terms: FloatArray) -> ComplexArray:
    """y(s) of lines of equal pillars, shape (..., terms) to (...)."""
    even = model.shape.even
    amplitude = _uniform_amplitude(model, terms)[0]
    return np.asarray(np.sum((terms @ (model.own + 2.0 * model.side[:, :even])) * amplitude, axis=-1))


def uniform_slopes(model: LineModel, terms: FloatArray, d_terms: FloatArray) -> ComplexArray:
    """Derivatives of y(s) by both sizes, shapes (n, terms) and (2, n, terms) to (2, n), per nm."""
    even = model.shape.even
    amplitude, inverse, taps = _uniform_amplitude(model, terms)
    adjoint = np.einsum("nr,nrs->ns", taps, inverse)
    d_taps, d_source = d_terms @ (model.own + 2.0 * model.side[:, :even]), d_terms @ model.source
    d_site = model.site_matrix(d_terms)[..., :even, :even]
    flow = np.einsum("nr,cnrs,ns->cn", adjoint, d_site, amplitude, optimize=True)
    return np.asarray(np.sum(d_taps * amplitude + d_source * adjoint, axis=-1) - flow)


def line_corrections(model: LineModel, terms: FloatArray) -> ComplexArray:
    """t_m - t(s_m) of closed lines.

    Args:
        model: parameters.
        terms: shape (..., n, terms), polynomial values of each site.

    Returns:
        Shape (..., n).
    """
    count, modes, even = terms.shape[-2], model.shape.modes, model.shape.even
    source = np.zeros((*terms.shape[:-1], modes), dtype=np.complex128)
    source[..., :even] = terms @ model.source
    flat = source.reshape(*terms.shape[:-2], count * modes, 1)
    a = np.linalg.solve(model.periodic_matrix(terms), flat).reshape(source.shape)
    side = (terms @ model.side) * a
    y = np.sum((terms @ model.own) * a[..., :even], axis=-1)
    y = y + np.roll(side.sum(axis=-1), 1, axis=-1) + np.roll((side * model.shape.parity).sum(axis=-1), -1, axis=-1)
    return np.asarray(y - uniform_field(model, terms))


def corrections_and_jacobian(model: LineModel, terms: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """:func:`line_corrections` and their derivatives by :attr:`LineModel.vector`.

    Args:
        model: parameters, n of them.
        terms: shape (lines, sites, terms), polynomial values of each site.

    Returns:
        Shapes (lines, sites) and (lines, sites, n).
    """
    lines, count, _ = terms.shape
    shape = model.shape
    modes, even, parity = shape.modes, shape.even, shape.parity
    source = np.zeros((lines, count, modes), dtype=np.complex128)
    source[..., :even] = terms @ model.source
    own = np.zeros_like(source)
    own[..., :even] = terms @ model.own
    side = terms @ model.side
    taps = np.zeros((lines, count, count, modes), dtype=np.complex128)
    site = np.arange(count)
    before, after = (site - 1) % count, (site + 1) % count
    taps[:, site, site] += own
    for m in range(count):
        taps[:, m, before[m]] += side[:, before[m]]
        taps[:, m, after[m]] += side[:, after[m]] * parity
    inverse = np.linalg.inv(model.periodic_matrix(terms))
    a = (inverse @ source.reshape(lines, -1, 1)).reshape(lines, count, modes)
    y = np.einsum("bmnr,bnr->bm", taps, a, optimize=True)
    adjoint = (taps.reshape(lines, count, -1) @ inverse).reshape(lines, count, count, modes)

    d_site = _site_derivatives(model, terms, a, adjoint)
    d_source = (adjoint[..., :even].transpose(0, 1, 3, 2) @ terms[:, None]).swapaxes(-1, -2)
    d_own = terms[..., :, None] * a[..., None, :even]
    flow = terms[..., :, None] * a[..., None, :]
    d_side = flow[:, before] + flow[:, after] * parity
    d_hop = _hop_derivatives(model, a, adjoint)
    parts = (d_site, d_source, d_own, d_side, d_hop)
    jacobian = np.concatenate([part.reshape(lines, count, -1) for part in parts], axis=-1)
    uniform, d_uniform = _uniform_jacobian(model, terms)
    return y - uniform, jacobian - d_uniform


def _uniform_jacobian(model: LineModel, terms: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """:func:`uniform_field` and its derivatives by :attr:`LineModel.vector`.

    Args:
        model: parameters, n of them.
        terms: shape (..., terms), polynomial values of each size.

    Returns:
        Shapes (...) and (..., n).
    """
    shape, even = model.shape, model.shape.even
    amplitude, inverse, taps = _uniform_amplitude(model, terms)
    adjoint = np.einsum("...r,...rs->...s", taps, inverse)

    def pairs(row: IntArray, column: IntArray) -> ComplexArray:
        """Derivatives by the elements (row, column) = (column, row) of a symmetric matrix; 0 for odd modes."""
        found = np.zeros((*terms.shape[:-1], row.size), dtype=np.complex128)
        within = np.flatnonzero((row < even) & (column < even))
        r, s = row[within], column[within]
        found[..., within] = adjoint[..., r] * amplitude[..., s]
        found[..., within] += np.where(r != s, adjoint[..., s] * amplitude[..., r], 0.0)
        return found

    d_site = -terms[..., :, None] * pairs(*shape.pairs)[..., None, :]
    d_source = terms[..., :, None] * adjoint[..., None, :]
    d_own = terms[..., :, None] * amplitude[..., None, :]
    d_side = np.zeros((*terms.shape, shape.modes), dtype=np.complex128)
    d_side[..., :even] = 2.0 * d_own
    parts = [part.reshape(*terms.shape[:-1], -1) for part in (d_site, d_source, d_own, d_side)]
    d_hop = 2.0 * pairs(*shape.hop_pairs[:2])
    return np.sum(taps * amplitude, axis=-1), np.concatenate([*parts, d_hop], axis=-1)


def _uniform_amplitude(model: LineModel, terms: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Even amplitudes (..., even) in lines of equal pillars, inverse matrix (..., even, even), and taps (..., even)."""
    even = model.shape.even
    matrix = model.site_matrix(terms)[..., :even, :even] - model.uniform_hop
    inverse = np.linalg.inv(matrix)
    amplitude = (inverse @ (terms @ model.source)[..., None])[..., 0]
    return amplitude, np.asarray(inverse, dtype=np.complex128), terms @ (model.own + 2.0 * model.side[:, :even])


def _site_derivatives(model: LineModel, terms: FloatArray, a: ComplexArray, adjoint: ComplexArray) -> ComplexArray:
    """Derivatives of y by the coefficients of the site matrix, shape (lines, sites, terms, pairs)."""
    lines, count, n_terms = terms.shape
    modes = model.shape.modes
    r, s = model.shape.pairs
    both = adjoint.transpose(0, 1, 3, 2).reshape(lines, count * modes, count)
    weighted = (terms[..., :, None] * a[..., None, :]).reshape(lines, count, n_terms * modes)
    outer = (both @ weighted).reshape(lines, count, modes, n_terms, modes)
    d_site = -(outer[:, :, r, :, s] + np.where(r != s, 1.0, 0.0)[:, None, None, None] * outer[:, :, s, :, r])
    return np.ascontiguousarray(d_site.transpose(1, 2, 3, 0))


def _hop_derivatives(model: LineModel, a: ComplexArray, adjoint: ComplexArray) -> ComplexArray:
    """Derivatives of y by the free elements of the hop, shape (lines, sites, pairs)."""
    r, s, sign = model.shape.hop_pairs
    # W[r, s] and sign W[s, r], of a_{m-1}; and of a_{m+1} with W^T.
    by_mode = adjoint.transpose(0, 1, 3, 2)
    left, right = (by_mode @ np.roll(a, shift, axis=1)[:, None] for shift in (1, -1))
    by_element = left + right.swapaxes(-1, -2)
    return np.asarray(by_element[..., r, s] + np.where(r == s, 0.0, sign * by_element[..., s, r]))
