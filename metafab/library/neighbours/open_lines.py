"""Corrections of the field along many open lines of pillars at once: a block-tridiagonal solve along each line.

The matrix of a chain is symmetric. Its elimination from one end to the other needs one small symmetric matrix a site:

    D_m = H_m - W D_{m-1}^-1 W^T,    D_m (X_m, r_m) = (W^T, c_m + W r_{m-1}),    a_m = r_m + X_m a_{m+1}.

Lines are solved side by side, so that the innermost loops run over lines and use the vector units. Double precision: in
single precision, without pivots, one site in a thousand of a trained chain of eight modes came out wrong.

A sum of the field of all sites, F = sum_m w_m y_m, changes with the size of one pillar. The same elimination with the
light that each mode adds to the sum as its right side, q_m = w_m e_m + w_{m+1} g_m + w_{m-1} Pi g_m, gives the adjoint
amplitudes b, and the derivative by the size s of site m (:func:`open_line_slopes`) is that of

    w_m e(s) a_m + (w_{m+1} + w_{m-1} Pi) g(s) a_m + b_m c(s) - b_m H(s) a_m - w_m y(s).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.library.neighbours.line import LineModel
from metafab.library.neighbours.solve import uniform_field, uniform_slopes

IndexArray = NDArray[np.uint16]

#: Lines solved side by side, a few vector registers.
_LANES = 64
#: Diagonal of the matrix of a site without a pillar, which thereby carries no light.
_NO_PILLAR = 1e12


@dataclass(frozen=True)
class SizeTables:
    """Coefficients of the chain for each size, real and imaginary parts."""

    site: FloatArray  #: Shape (2, sizes, modes (modes + 1) / 2), upper triangle of H.
    source: FloatArray  #: Shape (2, sizes, modes), c; 0 for odd modes.
    own: FloatArray  #: Shape (2, sizes, modes), e; 0 for odd modes.
    side: FloatArray  #: Shape (2, sizes, modes), g.
    uniform: FloatArray  #: Shape (2, sizes), y in a line of equal pillars.
    hop: FloatArray  #: Shape (2, modes, modes), W.
    even: int  #: Number of even modes, which come first.
    pairs: NDArray[np.intp]  #: Shape (2, n_pairs), (r, s) of the free elements of H.
    #: Shape (2, sizes, 2, n), derivatives of e, g, c, the free elements of H, and y by the size along and across the
    #: line, per nm.
    slope: FloatArray

    @classmethod
    def of(cls, model: LineModel, size_nm: FloatArray) -> SizeTables:
        """Tables of sizes, shape (sizes, 2), along and across the line; (0, 0) is a site without a pillar."""
        shape = model.shape
        pillar = np.all(size_nm > 0.0, axis=1)
        filled_nm = np.where(pillar[:, None], size_nm, model.along_nm[0])
        terms, d_terms = model.polynomials(filled_nm), model.polynomial_slopes(filled_nm)
        r, s = np.triu_indices(shape.modes)
        site = model.site_matrix(terms)[:, r, s]
        site[~pillar] = np.where(r == s, _NO_PILLAR, 0.0)
        source, own = (np.zeros((len(size_nm), shape.modes), dtype=np.complex128) for _ in range(2))
        source[:, : shape.even], own[:, : shape.even] = terms @ model.source, terms @ model.own
        side, uniform = terms @ model.side, uniform_field(model, terms)
        d_uniform = uniform_slopes(model, terms, d_terms)[..., None]
        d_parameters = (d_terms @ parameter for parameter in (model.own, model.side, model.source, model.site))
        slope = np.concatenate([*d_parameters, d_uniform], axis=-1).transpose(1, 0, 2)
        for values in (source, own, side, uniform, slope):
            values[~pillar] = 0.0
        return cls(
            _parts(site),
            _parts(source),
            _parts(own),
            _parts(side),
            _parts(uniform),
            _parts(model.hop_matrix),
            shape.even,
            np.array(shape.pairs),
            _parts(slope),
        )


def open_line_corrections(tables: SizeTables, size_index: IndexArray) -> ComplexArray:
    """t_m - t(s_m) of lines whose ends have no neighbours, by ``size_index``; complex128, shape (lines, sites) both."""
    return _solved(tables, size_index, np.zeros((2, 0, 0), dtype=np.float64))[0]


def open_line_slopes(
    tables: SizeTables, size_index: IndexArray, weight: ComplexArray
) -> tuple[ComplexArray, FloatArray]:
    """:func:`open_line_corrections`, and the derivatives of F, their sum by ``weight``, by the size of each pillar.

    ``weight`` is 0 where no pillar stands. Corrections and weights have shape (lines, sites); derivatives of Re F by
    the size along and across the line, per nm, shape (lines, sites, 2).
    """
    return _solved(tables, size_index, _parts(weight))


def _solved(tables: SizeTables, size_index: IndexArray, weight: FloatArray) -> tuple[ComplexArray, FloatArray]:
    corrections = np.empty((2, *size_index.shape), dtype=np.float64)
    slopes = np.empty((*weight.shape[1:], 2), dtype=np.float64)
    _solve_lines(
        np.ascontiguousarray(size_index),
        tables.site,
        tables.source,
        tables.own,
        tables.side,
        tables.uniform,
        tables.hop,
        tables.even,
        tables.pairs,
        tables.slope,
        weight,
        corrections,
        slopes,
    )
    return np.asarray(corrections[0] + 1j * corrections[1]), slopes


def _parts(values: ComplexArray) -> FloatArray:
    return np.ascontiguousarray([values.real, values.imag], dtype=np.float64)


@compiled
def _solve_lines(
    size_index: IndexArray,
    site: FloatArray,
    source: FloatArray,
    own: FloatArray,
    side: FloatArray,
    uniform: FloatArray,
    hop: FloatArray,
    even: int,
    pairs: NDArray[np.intp],
    slope: FloatArray,
    weight: FloatArray,
    corrections: FloatArray,
    slopes: FloatArray,
) -> None:
    """Fill ``corrections``, shape (2, lines, sites), and ``slopes`` where there are weights; ``_LANES`` at a time."""
    lines, sites = size_index.shape
    modes = source.shape[2]
    sides = 2 if weight.shape[1] > 0 else 1
    # Columns 0..modes-1 hold X, the next r, and the last one that of the adjoint amplitudes.
    x = np.zeros((sites, 2, modes, modes + sides, _LANES), dtype=np.float64)
    d = np.empty((2, modes, modes, _LANES), np.float64)
    factor = np.empty((2, _LANES), np.float64)
    a, behind = np.empty((2, 2, modes, _LANES), np.float64), np.empty((2, 2, modes, _LANES), np.float64)
    around = np.zeros((2, 3, _LANES), np.float64)
    flow = np.empty((2, slope.shape[3], _LANES), np.float64)
    at = np.empty(_LANES, np.intp)
    for first in range(0, lines, _LANES):
        count = min(_LANES, lines - first)
        for m in range(sites):
            _load_sizes(size_index, first, m, at)
            _load_site(at, site, source, hop, d, x[m])
            if sides == 2:
                _load_weights(weight, first, m, around)
                _load_adjoint(at, around, own, side, even, x[m])
            if m > 0:
                _add_previous(hop, d, x[m], x[m - 1])
            _eliminate(d, x[m], factor)
        for line in range(first, first + count):
            for m in range(sites):
                corrections[0, line, m] = -uniform[0, size_index[line, m]]
                corrections[1, line, m] = -uniform[1, size_index[line, m]]
        # ``behind`` holds -a_{m+1}, so that X a_{m+1} is added.
        behind[:] = 0.0
        for m in range(sites - 1, -1, -1):
            for right in range(sides):
                _substitute_back(x[m], modes + right, a[right], behind[right])
            for lane in range(count):
                _radiate(size_index[first + lane], m, a[0], lane, own, side, even, corrections[:, first + lane])
            if sides == 2:
                _load_weights(weight, first, m, around)
                _load_sizes(size_index, first, m, at)
                _differentiate(a[0], a[1], at, around, even, pairs, slope, flow, slopes[first : first + count, m])


@compiled
def _load_sizes(size_index: IndexArray, first: int, m: int, at: NDArray[np.intp]) -> None:
    """Size of each lane at site ``m``; lanes beyond the last line repeat it."""
    for lane in range(_LANES):
        at[lane] = size_index[min(first + lane, len(size_index) - 1), m]


@compiled
def _load_weights(weight: FloatArray, first: int, m: int, around: FloatArray) -> None:
    """w_{m-1}, w_m and w_{m+1} of each lane; 0 beyond the ends."""
    _, lines, sites = weight.shape
    for step in range(3):
        n = m + step - 1
        for lane in range(_LANES):
            line = min(first + lane, lines - 1)
            inside = 0 <= n < sites
            around[0, step, lane] = weight[0, line, n] if inside else 0.0
            around[1, step, lane] = weight[1, line, n] if inside else 0.0


@compiled
def _load_adjoint(
    at: NDArray[np.intp], around: FloatArray, own: FloatArray, side: FloatArray, even: int, x: FloatArray
) -> None:
    """Light that each mode adds to the weighted sum, to the last column of ``x``."""
    modes = own.shape[2]
    for i in range(modes):
        sign = np.float64(1.0) if i < even else np.float64(-1.0)
        for lane in range(_LANES):
            e_re, e_im = own[0, at[lane], i], own[1, at[lane], i]
            g_re, g_im = side[0, at[lane], i], side[1, at[lane], i]
            w_re, w_im = around[0, 1, lane], around[1, 1, lane]
            n_re = around[0, 2, lane] + sign * around[0, 0, lane]
            n_im = around[1, 2, lane] + sign * around[1, 0, lane]
            x[0, i, modes + 1, lane] = w_re * e_re - w_im * e_im + n_re * g_re - n_im * g_im
            x[1, i, modes + 1, lane] = w_re * e_im + w_im * e_re + n_re * g_im + n_im * g_re


@compiled
def _differentiate(
    a: FloatArray,
    b: FloatArray,
    at: NDArray[np.intp],
    around: FloatArray,
    even: int,
    pairs: NDArray[np.intp],
    slope: FloatArray,
    flow: FloatArray,
    slopes: FloatArray,
) -> None:
    """Derivatives of the weighted sum by the sizes of one site, shape (count, 2), from both kinds of amplitudes."""
    modes = a.shape[1]
    # Factors of the derivatives of e, g, c, H and y, with the opposite sign until the elements of H.
    flow[:] = 0.0
    for i in range(modes):
        sign = np.float64(1.0) if i < even else np.float64(-1.0)
        re, im, beyond = a[0, i], a[1, i], around[:, 2] + sign * around[:, 0]
        if i < even:
            _subtract_product(flow[0, i], flow[1, i], around[0, 1], around[1, 1], re, im)
            flow[0, even + modes + i] -= b[0, i]
            flow[1, even + modes + i] -= b[1, i]
        _subtract_product(flow[0, even + i], flow[1, even + i], beyond[0], beyond[1], re, im)
    flow[:] = -flow
    first = 2 * even + modes
    for pair in range(pairs.shape[1]):
        r, s = pairs[0, pair], pairs[1, pair]
        _subtract_product(flow[0, first + pair], flow[1, first + pair], b[0, r], b[1, r], a[0, s], a[1, s])
        if r != s:
            _subtract_product(flow[0, first + pair], flow[1, first + pair], b[0, s], b[1, s], a[0, r], a[1, r])
    flow[0, -1] -= around[0, 1]
    flow[1, -1] -= around[1, 1]
    for lane in range(slopes.shape[0]):
        for axis in range(2):
            total = np.float64(0.0)
            for k in range(flow.shape[1]):
                total += slope[0, at[lane], axis, k] * flow[0, k, lane] - slope[1, at[lane], axis, k] * flow[1, k, lane]
            slopes[lane, axis] = total


@compiled
def _load_site(
    at: NDArray[np.intp], site: FloatArray, source: FloatArray, hop: FloatArray, d: FloatArray, x: FloatArray
) -> None:
    """H to ``d``, W^T and c to ``x``, for the size ``at`` of each lane."""
    modes, place = source.shape[2], 0
    for i in range(modes):
        for j in range(i, modes):
            for lane in range(_LANES):
                d[0, i, j, lane], d[1, i, j, lane] = site[0, at[lane], place], site[1, at[lane], place]
            place += 1
        for j in range(modes):
            x[0, i, j], x[1, i, j] = hop[0, j, i], hop[1, j, i]
        for lane in range(_LANES):
            x[0, i, modes, lane], x[1, i, modes, lane] = source[0, at[lane], i], source[1, at[lane], i]


@compiled
def _add_previous(hop: FloatArray, d: FloatArray, x: FloatArray, previous: FloatArray) -> None:
    """Subtract W X_{m-1} from ``d`` and add W r_{m-1} to the last columns of ``x``."""
    modes = hop.shape[1]
    for i in range(modes):
        for k in range(modes):
            re, im = hop[0, i, k], hop[1, i, k]
            for j in range(i, modes):
                _subtract(d[0, i, j], d[1, i, j], re, im, previous[0, k, j], previous[1, k, j])
            for j in range(modes, x.shape[2]):
                _subtract(x[0, i, j], x[1, i, j], -re, -im, previous[0, k, j], previous[1, k, j])


@compiled
def _eliminate(d: FloatArray, x: FloatArray, factor: FloatArray) -> None:
    """Replace ``x`` by D^-1 x. L D L^T without pivots: the loss of the modes keeps them away from zero."""
    modes = d.shape[1]
    for k in range(modes):
        _invert(d[0, k, k], d[1, k, k])
        for i in range(k + 1, modes):
            _product(factor[0], factor[1], d[0, k, i], d[1, k, i], d[0, k, k], d[1, k, k])
            for j in range(i, modes):
                _subtract_product(d[0, i, j], d[1, i, j], factor[0], factor[1], d[0, k, j], d[1, k, j])
            for j in range(x.shape[2]):
                _subtract_product(x[0, i, j], x[1, i, j], factor[0], factor[1], x[0, k, j], x[1, k, j])
    for i in range(modes - 1, -1, -1):
        for j in range(x.shape[2]):
            for k in range(i + 1, modes):
                _subtract_product(x[0, i, j], x[1, i, j], d[0, i, k], d[1, i, k], x[0, k, j], x[1, k, j])
            _scale(x[0, i, j], x[1, i, j], d[0, i, i], d[1, i, i])


@compiled
def _substitute_back(x: FloatArray, column: int, a: FloatArray, behind: FloatArray) -> None:
    """Fill ``a`` from the r in ``column`` of ``x`` and the amplitudes of the next site, which ``a`` then replaces."""
    modes = a.shape[1]
    for i in range(modes):
        a[0, i], a[1, i] = x[0, i, column], x[1, i, column]
        for k in range(modes):
            _subtract_product(a[0, i], a[1, i], x[0, i, k], x[1, i, k], behind[0, k], behind[1, k])
    behind[:] = -a


@compiled
def _radiate(
    size_index: IndexArray,
    m: int,
    a: FloatArray,
    lane: int,
    own: FloatArray,
    side: FloatArray,
    even: int,
    corrections: FloatArray,
) -> None:
    """Add the light of the modes of site ``m`` to the site and to its two neighbours."""
    sites, s = len(size_index), size_index[m]
    for i in range(a.shape[1]):
        re, im = a[0, i, lane], a[1, i, lane]
        corrections[0, m] += own[0, s, i] * re - own[1, s, i] * im
        corrections[1, m] += own[0, s, i] * im + own[1, s, i] * re
        g_re, g_im = side[0, s, i] * re - side[1, s, i] * im, side[0, s, i] * im + side[1, s, i] * re
        if m + 1 < sites and size_index[m + 1] > 0:
            corrections[0, m + 1] += g_re
            corrections[1, m + 1] += g_im
        if m > 0 and size_index[m - 1] > 0:
            sign = 1.0 if i < even else -1.0
            corrections[0, m - 1] += sign * g_re
            corrections[1, m - 1] += sign * g_im


@compiled
def _subtract(c_re: FloatArray, c_im: FloatArray, w_re: float, w_im: float, x_re: FloatArray, x_im: FloatArray) -> None:
    for lane in range(_LANES):
        re, im = x_re[lane], x_im[lane]
        c_re[lane] -= w_re * re - w_im * im
        c_im[lane] -= w_re * im + w_im * re


@compiled
def _subtract_product(
    c_re: FloatArray, c_im: FloatArray, f_re: FloatArray, f_im: FloatArray, x_re: FloatArray, x_im: FloatArray
) -> None:
    for lane in range(_LANES):
        re, im = x_re[lane], x_im[lane]
        c_re[lane] -= f_re[lane] * re - f_im[lane] * im
        c_im[lane] -= f_re[lane] * im + f_im[lane] * re


@compiled
def _product(
    f_re: FloatArray, f_im: FloatArray, a_re: FloatArray, a_im: FloatArray, b_re: FloatArray, b_im: FloatArray
) -> None:
    for lane in range(_LANES):
        f_re[lane] = a_re[lane] * b_re[lane] - a_im[lane] * b_im[lane]
        f_im[lane] = a_re[lane] * b_im[lane] + a_im[lane] * b_re[lane]


@compiled
def _scale(x_re: FloatArray, x_im: FloatArray, b_re: FloatArray, b_im: FloatArray) -> None:
    for lane in range(_LANES):
        re, im = x_re[lane], x_im[lane]
        x_re[lane] = re * b_re[lane] - im * b_im[lane]
        x_im[lane] = re * b_im[lane] + im * b_re[lane]


@compiled
def _invert(d_re: FloatArray, d_im: FloatArray) -> None:
    for lane in range(_LANES):
        re, im = d_re[lane], d_im[lane]
        squared = re * re + im * im
        d_re[lane], d_im[lane] = re / squared, -im / squared
