"""Symmetric complex matrices of compiled kernels on lanes (:mod:`metafab.core.numeric.lanes`), one a lane.

A matrix takes size x size elements of a lane array, row by row, of which the upper triangle counts. Kernels can only
subtract products, so that an inverse is stored negated.
"""

from __future__ import annotations

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.core.numeric.lanes import ELEMENT, LANES, copy, subtract_dot, subtract_multiple, subtract_multiples


@compiled
def clear(values: FloatArray, first: int, count: int) -> None:
    """Set ``count`` elements of a lane array, shape (n,), to 0, from ``first`` on."""
    for k in range(first * ELEMENT, (first + count) * ELEMENT):
        values[k] = 0.0


@compiled
def add(into: FloatArray, first: int, values: FloatArray, begin: int, count: int) -> None:
    """into[first + k] += values[begin + k], k = 0 to ``count`` - 1, elements of lane arrays, shape (n,)."""
    for k in range(count * ELEMENT):
        into[first * ELEMENT + k] += values[begin * ELEMENT + k]


@compiled
def invert_symmetric(matrix: FloatArray, at: int, size: int, work: FloatArray) -> None:
    """Replace the upper triangle of a symmetric matrix by that of its inverse times -1.

    The matrix begins at element ``at`` of a lane array, shape (n,); ``work`` holds 4 ``size`` elements.

    Symmetric sweeps without pivots, two rows at a time, which halves the reads and writes. On 6144 random sites of each
    of four trained chains of coupled modes the least diagonal element of sweeps by single rows was 7e-5 of the largest
    element, and answers were those of an elimination with pivots to 3e-11.
    """
    for k in range(0, size, 2):
        rows = min(2, size - k)
        # The rows of the pivots, and below them their products with the pivots' inverse.
        clear(work, 0, 4 * size)
        for row in range(rows):
            for i in range(k):
                copy(work, row * size + i, 1, matrix, at + i * size + k + row, 1)
            copy(work, row * size + k + rows, 1, matrix, at + (k + row) * size + k + rows, size - k - rows)
        pivots = at + k * size + k
        _invert_pivots(matrix, pivots, size, rows)
        for row in range(rows):
            step = size if row else rows - 1
            subtract_multiples(work, (2 + row) * size, matrix, pivots + row, step, work, 0, size, size)
        for i in range(size):
            if i < k or i >= k + rows:
                subtract_multiples(matrix, at + i * size + i, work, i, size, work, 2 * size + i, size, size - i)
        for row in range(rows):
            copy(matrix, at + k + row, size, work, (2 + row) * size, k)
            end = (2 + row) * size + k + rows
            copy(matrix, at + (k + row) * size + k + rows, 1, work, end, size - k - rows)


@compiled
def _invert_pivots(matrix: FloatArray, first: int, size: int, rows: int) -> None:
    """Replace one diagonal element, or the upper triangle of two rows, by that of the inverse times -1."""
    for lane in range(first * ELEMENT, first * ELEMENT + LANES):
        a = complex(matrix[lane], matrix[lane + LANES])
        b, d, minor = 0.0j, 1.0 + 0.0j, lane + (size + 1) * ELEMENT
        if rows == 2:
            b = complex(matrix[lane + ELEMENT], matrix[lane + ELEMENT + LANES])
            d = complex(matrix[minor], matrix[minor + LANES])
        determinant = a * d - b * b
        inverse = determinant.conjugate() / (determinant.real**2 + determinant.imag**2)
        a, b, d = -d * inverse, b * inverse, -a * inverse
        matrix[lane], matrix[lane + LANES] = a.real, a.imag
        if rows == 2:
            matrix[lane + ELEMENT], matrix[lane + ELEMENT + LANES] = b.real, b.imag
            matrix[minor], matrix[minor + LANES] = d.real, d.imag


@compiled
def multiply_symmetric(
    matrix: FloatArray, at: int, values: FloatArray, first: int, into: FloatArray, begin: int, size: int
) -> None:
    """Write a vector times a symmetric matrix, of which the upper triangle is stored, times -1.

    They begin at elements ``first``, ``at`` and, the product, ``begin`` of lane arrays, shape (n,).
    """
    clear(into, begin, size)
    for i in range(size):
        row = at + i * size + i
        subtract_dot(into, begin + i, matrix, row, values, first + i, size - i)
        subtract_multiple(into, begin + i + 1, values, first + i, matrix, row + 1, size - i - 1)
