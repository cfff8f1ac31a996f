"""Light that closed lines (periods of unlike pillars) reflect and transmit, and its derivatives by all parameters.

It is a holomorphic function of the parameters, so that its Jacobian is one complex matrix. It follows from one inverse
of each line's matrix: with q_m the row of taps of output m, y_m = q_m A^-1 c, and lambda_m = q_m A^-1,

    dy_m = dq_m a + lambda_m (dc - dA a).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import bsr_matrix
from scipy.sparse.linalg import splu

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.neighbours.line import IntArray, LineModel

#: Steps of the power iteration for the norm of an inverse, which starts from the amplitudes.
_POWER_STEPS = 20
#: Longer lines are solved one by one, by the elimination of a sparse matrix: 200 sites in a thirtieth of the time. Rows
#: of a training are shorter.
_DENSE_SITES = 20
#: Outputs of a long line whose taps are solved at once: 2000 sites of 12 modes would fill 0.8 GB several times over.
_OUTPUTS_AT_ONCE = 64


def uniform_field(model: LineModel, terms: FloatArray) -> ComplexArray:
    """y(s) of lines of equal pillars, shape (..., terms) to (...)."""
    amplitude, _, taps = _uniform_amplitude(model, terms)
    return np.asarray(np.sum(taps[1] * amplitude, axis=-1))


def uniform_slopes(model: LineModel, terms: FloatArray, d_terms: FloatArray) -> ComplexArray:
    """Derivatives of y(s) by both sizes, shapes (n, terms) and (2, n, terms) to (2, n), per nm."""
    even = model.shape.even
    amplitude, inverse, taps = _uniform_amplitude(model, terms)
    adjoint = np.einsum("nr,nrs->ns", taps[1], inverse)
    d_taps, d_source = d_terms @ (model.own + 2.0 * model.side[:, :even]), d_terms @ model.source
    d_site = model.site_matrix(d_terms)[..., :even, :even]
    flow = np.einsum("nr,cnrs,ns->cn", adjoint, d_site, amplitude, optimize=True)
    return np.asarray(np.sum(d_taps * amplitude + d_source * adjoint, axis=-1) - flow)


def line_corrections(model: LineModel, terms: FloatArray) -> ComplexArray:
    """t_m - t(s_m) of closed lines: :func:`scattered_corrections` of the transmitted light, shape (lines, n)."""
    return np.asarray(scattered_corrections(model, terms)[1])


def scattered_corrections(model: LineModel, terms: FloatArray, mirrored: bool = False) -> ComplexArray:
    """r_m - r(s_m) and t_m - t(s_m) of closed lines, shape (2, lines, n).

    Args:
        model: the chain.
        terms: polynomial values of each site, shape (lines, n, terms).
        mirrored: whether each line is its own mirror image; the first (n + 1) // 2 sites are returned then.
    """
    before, after = _next_sites(terms, mirrored)
    if terms.shape[1] > _DENSE_SITES:
        a = np.array([_eliminated(model, line).solve(_source(model, line)) for line in terms])
        a = a.reshape(*terms.shape[:2], -1)
    else:
        matrix, source = _half_line(model, terms, before.size)
        a = _unfolded(np.asarray(np.linalg.solve(matrix, source), dtype=np.complex128), model, terms)
    fields = []
    for own, of_side in _faces(model):
        side = (terms @ of_side) * a
        y = np.sum((terms @ own) * a[..., : model.shape.even], axis=-1)[:, : before.size]
        fields.append(y + side.sum(axis=-1)[:, before] + (side * model.shape.parity).sum(axis=-1)[:, after])
    amplitude, _, taps = _uniform_amplitude(model, terms[:, : before.size])
    return np.asarray(np.stack(fields) - np.sum(taps * amplitude, axis=-1))


def corrections_and_jacobian(
    model: LineModel, terms: FloatArray, faces: tuple[int, ...] = (0, 1), mirrored: bool = False
) -> tuple[ComplexArray, ComplexArray]:
    """:func:`scattered_corrections` and their derivatives by :attr:`LineModel.vector`, of n parameters.

    ``terms``: shape (lines, sites, terms). ``faces``: 0 for reflected and 1 for transmitted light. Shapes
    (faces, lines, sites) and (faces, lines, sites, n), of the first half of the sites with ``mirrored``.
    """
    modes, even, parity = model.shape.modes, model.shape.even, model.shape.parity
    before, after = _next_sites(terms, mirrored)
    lines, half = len(terms), before.size
    matrix, source = _half_line(model, terms, half)
    inverse = np.linalg.inv(matrix)
    a = _unfolded(inverse @ source, model, terms)
    flow = terms[..., :, None] * a[..., None, :]
    by_own, by_side = flow[:, :half, :, :even], flow[:, before] + flow[:, after] * parity
    fields, jacobians = [], []
    for face in faces:
        taps = _line_taps(model, terms, face, range(half))
        outputs = _folded(taps, half, parity).reshape(lines, half, -1)
        fields.append(np.asarray(taps.reshape(lines, half, -1) @ a.reshape(lines, -1, 1))[..., 0])
        adjoint = (outputs @ inverse).reshape(lines, half, half, modes)
        by_source = adjoint[..., :even].transpose(0, 1, 3, 2) @ terms[:, None, :half].astype(np.complex128)
        by_matrices = (
            _site_derivatives(model, terms[:, :half], a[:, :half], adjoint),
            _hop_derivatives(model, (a[:, before], a[:, after]), adjoint),
        )
        jacobians.append(_gathered(face, by_matrices, by_own, by_side, by_source.swapaxes(-1, -2)))
    uniform, d_uniform = _uniform_jacobian(model, terms[:, :half], faces)
    return np.stack(fields) - uniform, np.stack(jacobians) - d_uniform


def line_gains(model: LineModel, terms: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sensitivity of closed lines to errors of their matrix A.

    ``terms``: shape (lines, sites, terms). Returns two arrays of shape (lines,): the norm over the sites of the rms
    change of the transmitted field by independent unit errors of all elements of the site matrices H, and the spectral
    norm of A^-1 by power iteration.
    """
    lines, sites, _ = terms.shape
    if sites > _DENSE_SITES:
        gain, norm = np.transpose([_gains_of_long(model, line) for line in terms])
        return gain, norm
    matrix, source = _half_line(model, terms, sites)
    inverse = np.linalg.inv(matrix)
    a = (inverse @ source).reshape(lines, sites, -1)
    taps = _line_taps(model, terms, 1, range(sites)).reshape(lines, sites, -1)
    adjoint = (taps @ inverse).reshape(lines, sites, sites, -1)
    squared = np.einsum("lknr,lns->l", np.abs(adjoint) ** 2, np.abs(a) ** 2, optimize=True)
    strongest, adjoint_inverse = np.asarray(inverse @ source), inverse.conj().swapaxes(1, 2)
    for _ in range(_POWER_STEPS):
        strongest = adjoint_inverse @ (inverse @ (strongest / np.linalg.norm(strongest, axis=1, keepdims=True)))
    return np.sqrt(squared), np.asarray(np.sqrt(np.linalg.norm(strongest, axis=(1, 2))))


def _gains_of_long(model: LineModel, terms: FloatArray) -> tuple[float, float]:
    """:func:`line_gains` of one line, shape (sites, terms): A is symmetric, so that its solutions for taps are rows."""
    sites, inverse = len(terms), _eliminated(model, terms)
    a = inverse.solve(_source(model, terms))
    adjoint = np.zeros(a.size)
    for first in range(0, sites, _OUTPUTS_AT_ONCE):
        outputs = range(first, min(first + _OUTPUTS_AT_ONCE, sites))
        taps = _line_taps(model, terms[None], 1, outputs).reshape(len(outputs), -1)
        adjoint += np.square(np.abs(inverse.solve(np.ascontiguousarray(taps.T)))).sum(axis=1)
    squared = adjoint.reshape(sites, -1).sum(axis=1) @ np.square(np.abs(a)).reshape(sites, -1).sum(axis=1)
    strongest = a
    for _ in range(_POWER_STEPS):
        strongest = inverse.solve(inverse.solve(strongest / np.linalg.norm(strongest)), "H")
    return float(np.sqrt(squared)), float(np.sqrt(np.linalg.norm(strongest)))


def _eliminated(model: LineModel, terms: FloatArray) -> Any:
    """Sparse factors of the matrix of one closed line, shape (sites, terms); the ends fill one more block a site."""
    sites, hop = len(terms), model.hop_matrix
    site = np.arange(sites)
    columns = np.stack([(site - 1) % sites, site, (site + 1) % sites], axis=1)
    before, after = (np.broadcast_to(-each, (sites, *hop.shape)) for each in (hop, hop.T))
    blocks = np.stack([before, model.site_matrix(terms), after], axis=1)
    matrix = bsr_matrix((blocks.reshape(-1, *hop.shape), columns.ravel(), 3 * np.arange(sites + 1)))
    return splu(matrix.tocsc())


def _source(model: LineModel, terms: FloatArray) -> ComplexArray:
    """Sources of all modes of one line, shape (sites, terms) to (sites modes,)."""
    source = np.zeros((len(terms), model.shape.modes), dtype=np.complex128)
    source[:, : model.shape.even] = terms @ model.source
    return source.ravel()


def _line_taps(model: LineModel, terms: FloatArray, face: int, outputs: range) -> ComplexArray:
    """Rows q_m of some outputs of one face, shape (lines, outputs, sites, modes)."""
    own, of_side = _faces(model)[face]
    row, site, count = np.arange(len(outputs)), np.array(outputs), terms.shape[1]
    side = terms @ of_side
    taps = np.zeros((len(terms), row.size, count, model.shape.modes), dtype=np.complex128)
    taps[:, row, site, : model.shape.even] += terms[:, site] @ own
    for m, (before, after) in enumerate(zip((site - 1) % count, (site + 1) % count, strict=True)):
        taps[:, m, before] += side[:, before]
        taps[:, m, after] += side[:, after] * model.shape.parity
    return taps


def _next_sites(terms: FloatArray, mirrored: bool) -> tuple[IntArray, IntArray]:
    """Numbers of the sites before and after each site, shape (n,); of the first (n + 1) // 2 with ``mirrored``."""
    count = terms.shape[1]
    site = np.arange((count + 1) // 2 if mirrored else count)
    return (site - 1) % count, (site + 1) % count


def _half_line(model: LineModel, terms: FloatArray, half: int) -> tuple[ComplexArray, ComplexArray]:
    """Matrix and source of the first ``half`` sites: the others are their mirror images.

    Shapes (lines, half modes, half modes) and (lines, half modes, 1).
    """
    lines, count, _ = terms.shape
    modes = model.shape.modes
    matrix = model.periodic_matrix(terms).reshape(lines, count, modes, count, modes)[:, :half]
    source = np.zeros((lines, half, modes), dtype=np.complex128)
    source[..., : model.shape.even] = terms[:, :half] @ model.source
    folded = _folded(matrix, half, model.shape.parity)
    return folded.reshape(lines, half * modes, half * modes), source.reshape(lines, -1, 1)


def _folded(values: ComplexArray, half: int, parity: FloatArray) -> ComplexArray:
    """Values of the first ``half`` sites plus those of their mirror images, shape (..., n, modes)."""
    folded = values[..., :half, :].copy()
    folded[..., : values.shape[-2] - half, :] += values[..., : half - 1 : -1, :] * parity
    return folded


def _unfolded(amplitude: ComplexArray, model: LineModel, terms: FloatArray) -> ComplexArray:
    """Amplitudes of all sites, shape (lines, n, modes), from those of the first half."""
    lines, count, _ = terms.shape
    first = amplitude.reshape(lines, -1, model.shape.modes)
    images = first[:, : count - first.shape[1]][:, ::-1] * model.shape.parity
    return np.concatenate([first, images], axis=1)


def _faces(model: LineModel) -> tuple[tuple[ComplexArray, ComplexArray], ...]:
    """(e', g') of the reflected and (e, g) of the transmitted light."""
    return (model.back_own, model.back_side), (model.own, model.side)


def _gathered(
    face: int,
    by_matrices: tuple[ComplexArray, ComplexArray],
    by_own: ComplexArray,
    by_side: ComplexArray,
    by_source: ComplexArray,
) -> ComplexArray:
    """Derivatives of one face's light by :attr:`LineModel.vector`, shape (lines, sites, n).

    Args:
        face: 0 for reflected, 1 for transmitted light.
        by_matrices: by the site matrix H, shape (lines, sites, terms, pairs), and by the hop W, shape (lines, sites,
            n_hop_pairs).
        by_own: by e or e' of this face, shape (lines, sites, terms, even).
        by_side: by g or g' of this face, shape (lines, sites, terms, modes).
        by_source: by c, shape of ``by_own``; it moves with e' and g'.
    """
    d_own, d_side = (np.zeros((2, *values.shape), dtype=np.complex128) for values in (by_own, by_side))
    d_own[face], d_side[face] = by_own, by_side
    d_own[0] += by_source
    d_side[0, ..., : by_own.shape[-1]] += 2.0 * by_source
    parts = (by_matrices[0], d_own[1], d_side[1], d_own[0], d_side[0], by_matrices[1])
    return np.concatenate([part.reshape(*by_own.shape[:2], -1) for part in parts], axis=-1)


def _uniform_jacobian(model: LineModel, terms: FloatArray, faces: tuple[int, ...]) -> tuple[ComplexArray, ComplexArray]:
    """Light of lines of equal pillars, reflected and transmitted, and its derivatives by :attr:`LineModel.vector`.

    Arguments and shapes as :func:`corrections_and_jacobian`.
    """
    shape, even = model.shape, model.shape.even
    amplitude, inverse, taps = _uniform_amplitude(model, terms)

    def pairs(adjoint: ComplexArray, row: IntArray, column: IntArray) -> ComplexArray:
        """Derivatives by the elements (row, column) = (column, row) of a symmetric matrix; 0 for odd modes."""
        found = np.zeros((*terms.shape[:-1], row.size), dtype=np.complex128)
        within = np.flatnonzero((row < even) & (column < even))
        r, s = row[within], column[within]
        found[..., within] = adjoint[..., r] * amplitude[..., s]
        found[..., within] += np.where(r != s, adjoint[..., s] * amplitude[..., r], 0.0)
        return found

    by_own = terms[..., :, None] * amplitude[..., None, :]
    by_side = np.zeros((*terms.shape, shape.modes), dtype=np.complex128)
    by_side[..., :even] = 2.0 * by_own
    jacobians = []
    for face in faces:
        adjoint = np.einsum("...r,...rs->...s", taps[face], inverse)
        d_site = -terms[..., :, None] * pairs(adjoint, *shape.pairs)[..., None, :]
        by_matrices = d_site, 2.0 * pairs(adjoint, *shape.hop_pairs[:2])
        jacobians.append(_gathered(face, by_matrices, by_own, by_side, terms[..., :, None] * adjoint[..., None, :]))
    return np.sum(taps[list(faces)] * amplitude, axis=-1), np.stack(jacobians)


def _uniform_amplitude(model: LineModel, terms: FloatArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Even amplitudes in lines of equal pillars, shape (..., even), inverse matrix, and taps of both faces.

    The inverse has shape (..., even, even), the taps (2, ..., even).
    """
    even = model.shape.even
    matrix = model.site_matrix(terms)[..., :even, :even] - model.uniform_hop
    inverse = np.linalg.inv(matrix)
    amplitude = (inverse @ (terms @ model.source)[..., None])[..., 0]
    taps = np.stack([terms @ (own + 2.0 * side[:, :even]) for own, side in _faces(model)])
    return amplitude, np.asarray(inverse, dtype=np.complex128), taps


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


def _hop_derivatives(
    model: LineModel, next_to: tuple[ComplexArray, ComplexArray], adjoint: ComplexArray
) -> ComplexArray:
    """Derivatives of y by the free elements of the hop, shape (lines, sites, pairs).

    ``next_to`` holds the amplitudes of the sites before and after each site.
    """
    r, s, sign = model.shape.hop_pairs
    # W[r, s] = sign W[s, r] multiplies a_{m-1}, its transpose a_{m+1}.
    by_mode = adjoint.transpose(0, 1, 3, 2)
    left, right = by_mode @ next_to[0][:, None], by_mode @ next_to[1][:, None]
    by_element = left + right.swapaxes(-1, -2)
    return np.asarray(by_element[..., r, s] + np.where(r == s, 0.0, sign * by_element[..., s, r]))
