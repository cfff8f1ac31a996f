"""Corrections of the field along many open lines of pillars at once: a block-tridiagonal solve along each line.

The matrix of a chain is symmetric. Its elimination from one end to the other needs one small symmetric matrix a site:

    D_m = H_m - W D_{m-1}^-1 W^T,    v_m = c_m + W D_{m-1}^-1 v_{m-1},    a_m = D_m^-1 (v_m + W^T a_{m+1}).

The chain is first brought to modes that hop to themselves and to one other mode (:func:`paired`): products with W are
then cheap, and the inverses of the D_m are most of the work. Lines are solved side by side, one in each lane
(:mod:`metafab.core.numeric.lanes`). Double precision: in single precision, without pivots, one site in a thousand of a
trained chain of eight modes came out wrong. H and c are summed from the polynomials of the size at each site, which is
faster than to read them from a table. Long lines are solved in parts: elimination goes on from end to end, and
amplitudes are substituted back through a part from some sites beyond it, so that memory does not grow with the line.

A sum of the field of all sites, F = sum_m w_m y_m, changes with the size of one pillar. The same elimination with the
light that each mode adds to the sum as its right side, q_m = w_m e_m + w_{m+1} g_m + w_{m-1} Pi g_m, gives the adjoint
amplitudes b, and the derivative by the size s of site m (:func:`open_line_slopes`) is that of

    w_m e(s) a_m + (w_{m+1} + w_{m-1} Pi) g(s) a_m + b_m c(s) - b_m H(s) a_m - w_m y(s).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.lane_matrices import add, clear, invert_symmetric, multiply_symmetric
from metafab.core.numeric.lanes import (
    ELEMENT,
    LANES,
    add_turned,
    copy,
    lane_array,
    subtract_dot,
    subtract_multiple,
    subtract_products,
    sum_terms,
)
from metafab.library.neighbours.mask.size_tables import SizeTables

IndexArray = NDArray[np.uint16]

#: Sites of a part of a line, and sites beyond it from which amplitudes are substituted back. Measured with 12 modes: a
#: part's inverses stay in a cache of 1 MB, those of 560 sites did not and took 1.6 times as long on loaded cores. Lines
#: of a lens that end 40 sites beyond a site change its field by 3e-4 (rms), and by 8e-5 on average over a part.
_BLOCK_SITES, _AHEAD_SITES = 40, 40


def open_line_corrections(tables: SizeTables, size_index: IndexArray) -> ComplexArray:
    """t_m - t(s_m) of lines whose ends have no neighbours, by ``size_index``; complex128, shape (lines, sites) both."""
    return _solved(tables, size_index, np.zeros((0, 0), dtype=np.complex128))[0]


def open_line_slopes(
    tables: SizeTables, size_index: IndexArray, weight: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """:func:`open_line_corrections`, and the derivatives of F, their sum by ``weight``, by the size of each pillar.

    ``weight`` is 0 where no pillar stands. Corrections and weights have shape (lines, sites); derivatives by the size
    along and across the line, per nm, shape (lines, sites, 2).
    """
    return _solved(tables, size_index, np.ascontiguousarray(weight, dtype=np.complex128))


def _solved(tables: SizeTables, size_index: IndexArray, weight: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    corrections = np.empty(size_index.shape, dtype=np.complex128)
    slopes = np.empty((*weight.shape, 2), dtype=np.complex128)
    _solve_lines(
        np.ascontiguousarray(size_index),
        tables.even,
        tables.modes,
        tables.pairing,
        tables.coefficients,
        tables.terms.reshape(len(tables.terms), -1),
        tables.uniform,
        weight,
        corrections,
        slopes,
    )
    return corrections, slopes


class _Chain(NamedTuple):
    """A chain, for the kernels."""

    even: int
    modes: int
    pairs: int  #: Modes of either parity with a partner of the other one.
    rows: FloatArray  #: Coefficients, shape (rows, n, 2) for n terms.
    own: int  #: First row of e, with those of g and Pi g behind; the rows of c end there.
    terms: FloatArray  #: Shape (sizes, 3 n).
    hop: FloatArray  #: Lane array of :func:`_hop_lanes`.


class _Workspace(NamedTuple):
    """Lane arrays of one group of lines. The kernels can only subtract products, so that some sums are held negated."""

    sides: int  #: Right sides: 1, or 2 with the adjoint one.
    kept: int  #: Number of sites whose inverses and right sides are kept; site m has the place m % kept.
    inverse: FloatArray  #: -D_m^-1, upper triangle, modes x modes a site.
    source: FloatArray  #: Right sides, modes a site, one after the other.
    amplitude: FloatArray  #: D_m^-1 times the right sides, or a_m and b_m, of one site.
    here: FloatArray  #: Sums of all rows at one site.
    weight: FloatArray  #: -w_m at element m + 1.
    light: FloatArray  #: -y_m at element m + 1.
    work: FloatArray
    at_site: FloatArray  #: Terms of one site, shape (3 n, LANES).


@compiled
def _solve_lines(
    size_index: IndexArray,
    even: int,
    modes: int,
    pairing: ComplexArray,
    rows: FloatArray,
    terms: FloatArray,
    uniform: ComplexArray,
    weight: ComplexArray,
    corrections: ComplexArray,
    slopes: ComplexArray,
) -> None:
    """Fill ``corrections``, shape (lines, sites), and ``slopes`` where there are weights; ``LANES`` lines at a time."""
    lines, sites = size_index.shape
    hop = _hop_lanes(pairing, even, modes)
    chain = _Chain(even, modes, len(pairing), rows, len(rows) - even - 2 * modes, terms, hop)
    sides = 2 if len(weight) > 0 else 1
    kept = min(sites, _BLOCK_SITES + _AHEAD_SITES)
    space = _Workspace(
        sides,
        kept,
        lane_array(kept * modes * modes),
        lane_array(sides * kept * modes),
        lane_array(sides * modes),
        lane_array(len(rows)),
        lane_array(sites + 2),
        lane_array(sites + 2),
        lane_array(2 * modes * (modes + 1)),
        np.zeros((terms.shape[1], LANES)),
    )
    for first in range(0, lines, LANES):
        space.light[:] = 0.0
        begin = reached = 0
        while begin < sites:
            ahead = min(begin + kept, sites)
            _eliminate(chain, space, size_index, first, weight, (reached, ahead))
            end = sites if ahead == sites else begin + _BLOCK_SITES
            _substitute_back(chain, space, size_index, first, weight, (begin, end, ahead), uniform, slopes)
            begin, reached = end, ahead
        for lane in range(min(LANES, lines - first)):
            for m in range(sites):
                size, at = size_index[first + lane, m], (m + 1) * ELEMENT + lane
                there = -complex(space.light[at], space.light[at + LANES]) - uniform[size, 0]
                corrections[first + lane, m] = there if size > 0 else 0.0


@compiled
def _eliminate(
    chain: _Chain,
    space: _Workspace,
    size_index: IndexArray,
    first: int,
    weight: ComplexArray,
    part: tuple[int, int],
) -> None:
    """Fill the inverse matrices and the right sides of the sites from the first to before the second of ``part``."""
    even, modes, n_terms = chain.even, chain.modes, chain.rows.shape[1]
    for m in range(*part):
        place = m % space.kept
        matrix = place * modes * modes
        _load_terms(size_index, first, m, chain.terms, n_terms, space.at_site)
        _place_site_matrix(space.inverse, matrix, chain, space.at_site, 0)
        clear(space.source, place * modes, modes)
        sum_terms(space.source, place * modes, chain.rows, chain.own - even, space.at_site, 0, even)
        if space.sides == 2:
            sum_terms(space.here, chain.own, chain.rows, chain.own, space.at_site, 0, even + 2 * modes)
            _load_weights(weight, first, m, space.weight)
            _place_adjoint_source(space.source, (space.kept + place) * modes, chain, space, m)
        if m > 0:
            previous = (m - 1) % space.kept
            before = previous * modes * modes
            _add_eliminated(space.inverse, matrix, before, chain)
            for side in range(space.sides):
                at, near = (side * space.kept + place) * modes, (side * space.kept + previous) * modes
                multiply_symmetric(space.inverse, before, space.source, near, space.amplitude, side * modes, modes)
                _add_hopped(space.source, at, chain, 0, space.amplitude, side * modes)
        invert_symmetric(space.inverse, matrix, modes, space.work)


@compiled
def _substitute_back(
    chain: _Chain,
    space: _Workspace,
    size_index: IndexArray,
    first: int,
    weight: ComplexArray,
    part: tuple[int, int, int],
    uniform: ComplexArray,
    slopes: ComplexArray,
) -> None:
    """Fill the light of the sites of ``part``, and the slopes where there are weights.

    ``part`` is (begin, end, ahead): amplitudes are substituted back from before ``ahead`` to ``begin``, those of the
    sites from ``end`` on only to end the others far away.
    """
    even, modes, n_terms, own = chain.even, chain.modes, chain.rows.shape[1], chain.own
    begin, end, ahead = part
    here, amplitude, light, work = space.here, space.amplitude, space.light, space.work
    behind = 2 * modes * modes + modes
    amplitude[:] = 0.0
    for m in range(ahead - 1, begin - 1, -1):
        place = m % space.kept
        for side in range(space.sides):
            copy(work, behind, 1, space.source, (side * space.kept + place) * modes, modes)
            _add_hopped(work, behind, chain, modes, amplitude, side * modes)
            multiply_symmetric(space.inverse, place * modes * modes, work, behind, amplitude, side * modes, modes)
        if m >= end:
            continue
        _load_terms(size_index, first, m, chain.terms, n_terms * (2 * space.sides - 1), space.at_site)
        sum_terms(here, own, chain.rows, own, space.at_site, 0, even + 2 * modes)
        subtract_dot(light, m + 1, here, own, amplitude, 0, even)
        subtract_dot(light, m + 2, here, own + even, amplitude, 0, modes)
        subtract_dot(light, m, here, own + even + modes, amplitude, 0, modes)
        if space.sides == 2:
            _fill_slopes(chain, space, size_index, first, m, weight, uniform, slopes)


@compiled
def _fill_slopes(
    chain: _Chain,
    space: _Workspace,
    size_index: IndexArray,
    first: int,
    m: int,
    weight: ComplexArray,
    uniform: ComplexArray,
    slopes: ComplexArray,
) -> None:
    """Fill the derivatives by both sizes of site ``m``, whose terms and amplitudes, adjoint ones too, are in place."""
    even, modes, n_terms, own = chain.even, chain.modes, chain.rows.shape[1], chain.own
    here, amplitude, work = space.here, space.amplitude, space.work
    slope = 2 * modes * modes
    behind = slope + modes
    for axis in range(2):
        term = (1 + axis) * n_terms
        sum_terms(here, own - even, chain.rows, own - even, space.at_site, term, 2 * (even + modes))
        _place_site_matrix(work, 0, chain, space.at_site, term)
        multiply_symmetric(work, 0, amplitude, 0, work, behind, modes)
        clear(work, slope, 1)
        subtract_dot(work, slope, work, behind, amplitude, modes, modes)
        subtract_dot(work, slope, here, own - even, amplitude, modes, even)
        _place_adjoint_source(work, behind, chain, space, m)
        subtract_dot(work, slope, work, behind, amplitude, 0, modes)
        for lane in range(min(LANES, len(size_index) - first)):
            at, fixed = slope * ELEMENT + lane, uniform[size_index[first + lane, m], 1 + axis]
            slopes[first + lane, m, axis] = -complex(work[at], work[at + LANES]) - weight[first + lane, m] * fixed


@compiled
def _hop_lanes(pairing: ComplexArray, even: int, modes: int) -> FloatArray:
    """Elements that couple each mode to its partner, 0 without one: of -W, then of -W^T; then the pairing and zeros."""
    hop = lane_array(3 * modes)
    for k in range(len(pairing)):
        elements = (k, -1.0), (even + k, 1.0), (modes + k, 1.0), (modes + even + k, -1.0), (2 * modes + k, 1.0)
        for lane in range(LANES):
            for element, sign in elements:
                hop[element * ELEMENT + lane] = sign * pairing[k].real
                hop[element * ELEMENT + LANES + lane] = sign * pairing[k].imag
    return hop


@compiled
def _load_terms(size_index: IndexArray, first: int, m: int, terms: FloatArray, count: int, at_site: FloatArray) -> None:
    """First ``count`` terms of site ``m`` of each lane, shape (count, LANES); lanes beyond the last line repeat it."""
    for lane in range(LANES):
        size = size_index[min(first + lane, len(size_index) - 1), m]
        for k in range(count):
            at_site[k, lane] = terms[size, k]


@compiled
def _load_weights(weight: ComplexArray, first: int, m: int, weights: FloatArray) -> None:
    """-w_m and -w_{m+1} of each lane, 0 beyond the end, to the elements m + 1 and m + 2."""
    lines, sites = weight.shape
    for n in range(m, m + 2):
        for lane in range(LANES):
            there = weight[min(first + lane, lines - 1), n] if n < sites else 0.0j
            weights[(n + 1) * ELEMENT + lane], weights[(n + 1) * ELEMENT + LANES + lane] = -there.real, -there.imag


@compiled
def _add_hopped(into: FloatArray, at: int, chain: _Chain, of: int, values: FloatArray, begin: int) -> None:
    """Add W (``of`` 0) or W^T (``of`` modes) times ``values`` to the modes of a site."""
    even = chain.even
    add(into, at, values, begin, chain.modes)
    subtract_products(into, at, chain.hop, of, values, begin + even, chain.pairs)
    subtract_products(into, at + even, chain.hop, of + even, values, begin, chain.pairs)


@compiled
def _place_adjoint_source(into: FloatArray, at: int, chain: _Chain, space: _Workspace, m: int) -> None:
    """Light that each mode of site ``m`` adds to the weighted sum, from e, g and Pi g in ``space.here``."""
    even, modes, own = chain.even, chain.modes, chain.own
    clear(into, at, modes)
    subtract_multiple(into, at, space.weight, m + 1, space.here, own, even)
    subtract_multiple(into, at, space.weight, m + 2, space.here, own + even, modes)
    subtract_multiple(into, at, space.weight, m, space.here, own + even + modes, modes)


@compiled
def _place_site_matrix(matrix: FloatArray, at: int, chain: _Chain, terms: FloatArray, term: int) -> None:
    """Upper triangle of H, or of its derivative: a block of even and one of odd modes."""
    modes, row = chain.modes, 0
    for i in range(modes):
        end = chain.even if i < chain.even else modes
        sum_terms(matrix, at + i * modes + i, chain.rows, row, terms, term, end - i)
        clear(matrix, at + i * modes + end, modes - end)
        row += end - i


@compiled
def _add_eliminated(inverse: FloatArray, at: int, before: int, chain: _Chain) -> None:
    """Add -W D^-1 W^T of the site before to the upper triangle of a site's matrix, by pairs of modes."""
    even, modes = chain.even, chain.modes
    odd = modes - even
    beyond = modes * (modes - 1)  # Below the diagonal, 0: stands for what the parity with fewer modes lacks.
    for i in range(max(even, odd)):
        for j in range(i, max(even, odd)):
            places = (
                i * modes + j if j < even else beyond,
                i * modes + even + j if i < even and j < odd else beyond,
                j * modes + even + i if j < even and i < odd else beyond,
                (even + i) * modes + even + j if j < odd else beyond,
            )
            add_turned(inverse, at, inverse, before, places, chain.hop, 2 * modes + i, 2 * modes + j)
