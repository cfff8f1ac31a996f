"""Field of closed lines (periods of unlike pillars), and its derivatives by all parameters of the model.

The field is a holomorphic function of the parameters, so that its Jacobian is one complex matrix. It follows from one
inverse of each line's matrix: with q_m the row of taps of output m, y_m = q_m A^-1 c, and lambda_m = q_m A^-1,

    dy_m = dq_m a + lambda_m (dc - dA a).
"""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.neighbours.line import LineModel


def uniform_field(model: LineModel, terms: FloatArray) -> ComplexArray:
    """y(s) of lines of equal pillars, shape (..., terms) to (...)."""
    even = model.shape.even
    amplitude = _uniform_amplitude(model, terms)[0]
    return np.asarray(np.sum((terms @ (model.own + 2.0 * model.side[:, :even])) * amplitude, axis=-1))


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

    uniform, inverse_even, taps_even = _uniform_amplitude(model, terms)
    adjoint_even = np.einsum("bmr,bmrs->bms", taps_even, inverse_even)
    y_even = np.sum(taps_even * uniform, axis=-1)

    d_site = _site_derivatives(model, terms, a, adjoint, uniform, adjoint_even)
    d_source = (adjoint[..., :even].transpose(0, 1, 3, 2) @ terms[:, None]).swapaxes(-1, -2)
    d_source = d_source - terms[..., :, None] * adjoint_even[..., None, :]
    d_own = terms[..., :, None] * (a[..., :even] - uniform)[..., None, :]
    flow = terms[..., :, None] * a[..., None, :]
    d_side = flow[:, before] + flow[:, after] * parity
    d_side[..., :even] -= 2.0 * terms[..., :, None] * uniform[..., None, :]

    d_hop = _hop_derivatives(model, a, adjoint, uniform, adjoint_even)
    parts = (d_site, d_source, d_own, d_side, d_hop)
    return y - y_even, np.concatenate([part.reshape(lines, count, -1) for part in parts], axis=-1)


def _uniform_amplitude(model: LineModel, terms: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Even amplitudes (..., even) in lines of equal pillars, inverse matrix (..., even, even), and taps (..., even)."""
    even = model.shape.even
    matrix = model.site_matrix(terms)[..., :even, :even] - model.uniform_hop
    inverse = np.linalg.inv(matrix)
    amplitude = (inverse @ (terms @ model.source)[..., None])[..., 0]
    return amplitude, np.asarray(inverse, dtype=np.complex128), terms @ (model.own + 2.0 * model.side[:, :even])


def _site_derivatives(
    model: LineModel,
    terms: FloatArray,
    a: ComplexArray,
    adjoint: ComplexArray,
    uniform: ComplexArray,
    adjoint_even: ComplexArray,
) -> ComplexArray:
    """Derivatives by the coefficients of the site matrix, shape (lines, sites, terms, pairs)."""
    lines, count, n_terms = terms.shape
    modes, even = model.shape.modes, model.shape.even
    r, s = model.shape.pairs
    both = adjoint.transpose(0, 1, 3, 2).reshape(lines, count * modes, count)
    weighted = (terms[..., :, None] * a[..., None, :]).reshape(lines, count, n_terms * modes)
    outer = (both @ weighted).reshape(lines, count, modes, n_terms, modes)
    d_site = -(outer[:, :, r, :, s] + np.where(r != s, 1.0, 0.0)[:, None, None, None] * outer[:, :, s, :, r])
    d_site = d_site.transpose(1, 2, 3, 0)  # (lines, sites, terms, pairs)
    in_even = np.flatnonzero(s < even)
    re, se = r[in_even], s[in_even]
    pair = adjoint_even[..., re] * uniform[..., se] + np.where(re != se, adjoint_even[..., se] * uniform[..., re], 0.0)
    d_site = np.ascontiguousarray(d_site)
    d_site[..., in_even] += terms[..., :, None] * pair[..., None, :]
    return d_site


def _hop_derivatives(
    model: LineModel, a: ComplexArray, adjoint: ComplexArray, uniform: ComplexArray, adjoint_even: ComplexArray
) -> ComplexArray:
    """Derivatives by the free elements of the hop, shape (lines, sites, pairs)."""
    shape, even = model.shape, model.shape.even
    hr, hs, sign = shape.hop_pairs
    # W[r, s] and sign W[s, r], of a_{m-1}; and of a_{m+1} with W^T.
    by_mode = adjoint.transpose(0, 1, 3, 2)
    left, right = (by_mode @ np.roll(a, shift, axis=1)[:, None] for shift in (1, -1))
    by_element = left + right.swapaxes(-1, -2)
    d_hop = by_element[..., hr, hs] + np.where(hr == hs, 0.0, sign * by_element[..., hs, hr])
    within = np.flatnonzero((hr < even) & (hs < even))
    wr, ws = hr[within], hs[within]
    product = adjoint_even[..., wr] * uniform[..., ws]
    product = product + np.where(wr != ws, adjoint_even[..., ws] * uniform[..., wr], 0.0)
    d_hop[..., within] -= 2.0 * product
    return d_hop
