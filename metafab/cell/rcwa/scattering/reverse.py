"""The doubling of a layer in reverse: derivatives of F by P and Q, for weights of low rank.

F and G of every thickness are functions of A and commute, so that a doubling has, with R = G F^-1,

    G' = R G / 2,    dG' = (dG R + R dG - R dF R) / 2,    F' = F - G'.

Weights U C V^T of F and U D V^T of G' then have a reverse with the columns [U, R^T U] and [V, R V] and small matrices
in place of C and D: a doubling in reverse costs a few matrix-vector products. Columns double at each, and the weights
become full matrices where there are as many columns as rows. In the thin slab F = D^-1 N, with N and D polynomials of
A, the columns are multiplied by powers of A.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from metafab.cell.rcwa.basis.coordinates import Matrix
from metafab.cell.rcwa.scattering.doubling import Doubling, DoublingSteps, cotangent_terms


def pull_back_doubled(layer: Doubling, left: Matrix, right: Matrix) -> Matrix:
    """Derivatives of sum(f_bar * F) by A = P Q, shape (k, n, n), for k weights f_bar = ``left``[k] ``right``^T.

    ``layer`` holds F with its steps, which were kept; ``left`` has the shape (k, n, r) and ``right`` (n, r). With a_bar
    the result, the derivatives by P and Q are a_bar Q^T and P^T a_bar.
    """
    steps = layer.steps
    assert steps is not None  # kept for this
    n, rank = right.shape
    left = np.ascontiguousarray(left.transpose(1, 0, 2))
    of_f, of_g = np.eye(rank), np.zeros((rank, rank))
    ratios = list(steps.ratios)
    while len(ratios) > 1 and 2 * right.shape[1] <= n:
        ratio, of_next = ratios.pop(), of_g - of_f  # weights of G', as F' is F - G'
        left, right = _with_products(ratio.T, left), _with_products(ratio, right)
        nothing = np.zeros_like(of_next)
        of_g = 0.5 * np.block([[nothing, of_next], [of_next, nothing]])
        of_f = np.block([[of_f, nothing], [nothing, -0.5 * of_next]])
    if len(ratios) > 1:
        return _pull_back_full(steps, ratios, *((left @ core @ right.T).transpose(1, 0, 2) for core in (of_f, of_g)))
    if not ratios:
        return _pull_back_thin_slab(steps, left, right, (left[..., :0], right[:, :0]))
    # G' = (F + A F^-1) / 2 of the thin slab.
    of_next, over = 0.5 * (of_g - of_f), _solved(steps.factors[1], right, transposed=True)
    both = _with_products(steps.ratios[0].T, left)
    weighted = np.concatenate([left @ (of_f + of_next), -both[..., right.shape[1] :] @ of_next], axis=-1)
    return _pull_back_thin_slab(steps, weighted, np.hstack([right, over]), (left @ of_next, over))


def _pull_back_full(steps: DoublingSteps, ratios: list[Matrix], f_bar: Matrix, g_bar: Matrix) -> Matrix:
    """The reverse from weights of F and G as full matrices, shape (k, n, n); ``ratios`` of the doublings before."""
    for ratio in reversed(ratios[1:]):
        of_next = g_bar - f_bar
        turned = ratio.T @ of_next
        g_bar, f_bar = 0.5 * (of_next @ ratio.T + turned), f_bar - 0.5 * turned @ ratio.T
    of_next = 0.5 * (g_bar - f_bar)
    # The rows of of_next F^-T are columns of F^-1 of_next^T.
    over = _solved(steps.factors[1], of_next.transpose(2, 0, 1), transposed=True).transpose(1, 2, 0)
    left = (f_bar + of_next - ratios[0].T @ over).transpose(1, 0, 2)
    nothing = np.zeros((len(of_next[0]), 0))
    return over + _pull_back_thin_slab(steps, left, np.eye(len(nothing)), (left[..., :0], nothing))


def _pull_back_thin_slab(steps: DoublingSteps, left: Matrix, right: Matrix, more: tuple[Matrix, Matrix]) -> Matrix:
    """Derivative by A of sum(f_bar * F) of the thin slab, shape (k, n, n), and the weights of A itself in ``more``.

    Weights of both are products of columns (n, k, r) and (n, r). With N = sum c_k A^k and D = sum d_k A^k,
    dF = D^-1 (dN - dD F) and d(A^k) = sum A^j dA A^(k - 1 - j).
    """
    (n, count), rank = left.shape[:2], right.shape[1]
    solved = _solved(steps.factors[0], left).reshape(n, -1)
    left_powers = np.concatenate([solved[None], steps.powers[:3].transpose(0, 2, 1) @ solved]).reshape(
        4, n, count, rank
    )
    right_powers = _with_products(steps.thin, right)
    right_powers = np.concatenate([right_powers[None], steps.powers[:3] @ right_powers])
    # Rows: the power of A to the left of dA; columns: that to the right.
    power = 1 + np.add.outer(np.arange(4), np.arange(4))
    of_n, of_d = (np.where(power < 5, each[np.minimum(power, 4)], 0.0) for each in cotangent_terms(steps.thin_k0))
    mixed = np.tensordot(
        np.hstack([of_n, -of_d]), np.concatenate([right_powers[..., :rank], right_powers[..., rank:]]), axes=1
    )
    columns = np.concatenate([*left_powers, more[0]], axis=-1).transpose(1, 0, 2)
    rows = np.concatenate([*mixed, more[1]], axis=-1)
    return np.asarray(columns.reshape(count * n, -1) @ rows.T).reshape(count, n, n)


def _with_products(matrix: Matrix, columns: Matrix) -> Matrix:
    """``columns``, shape (n, .., r), followed by their products with ``matrix``: shape (n, .., 2 r)."""
    products = (matrix @ columns.reshape(len(columns), -1)).reshape(columns.shape)
    return np.concatenate([columns, products], axis=-1)


def _solved(factors: tuple[Matrix, Matrix], columns: Matrix, *, transposed: bool = False) -> Matrix:
    """Solve for ``columns``, shape (n, ..), by the LU factors of a matrix, or of its transpose."""
    lu, pivots = factors
    getrs = lapack.zgetrs if np.iscomplexobj(lu) or np.iscomplexobj(columns) else lapack.dgetrs
    solution = getrs(lu, pivots, columns.reshape(len(columns), -1), trans=int(transposed))[0]
    return np.asarray(solution).reshape(columns.shape)
