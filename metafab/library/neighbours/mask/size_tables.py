"""A chain with paired modes, and its polynomials at the sizes of a mask: the input of the kernels of open lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.library.neighbours.line import LineModel, paired
from metafab.library.neighbours.solve import uniform_field, uniform_slopes

#: Diagonal of the matrix of a site without a pillar, which thereby carries no light.
_NO_PILLAR = 1e12


@dataclass(frozen=True)
class SizeTables:
    """A chain of paired modes, and its polynomials at each size."""

    even: int  #: Number of even modes, which come first.
    modes: int  #: Number of all modes.
    pairing: ComplexArray  #: Shape (pairs,), element of the hop from odd mode k to even mode k.
    #: Shape (rows, terms + 1, 2), real and imaginary parts: free elements of H of the even and of the odd modes, c, e,
    #: g and Pi g. The last term is 1 at a site without a pillar.
    coefficients: FloatArray
    #: Shape (sizes, 3, terms + 1), polynomials of each size, and their derivatives by the size along and across the
    #: line, per nm.
    terms: FloatArray
    uniform: ComplexArray  #: Shape (sizes, 3), y in a line of equal pillars, and its derivatives likewise.

    @classmethod
    def of(cls, model: LineModel, size_nm: FloatArray) -> SizeTables:
        """Tables of sizes, shape (sizes, 2), along and across the line; (0, 0) is a site without a pillar."""
        chain, pairing = paired(model)
        shape, even = chain.shape, chain.shape.even
        pillar = np.all(size_nm > 0.0, axis=1)
        filled_nm = np.where(pillar[:, None], size_nm, chain.along_nm[0])
        at, d_at = chain.polynomials(filled_nm), chain.polynomial_slopes(filled_nm)
        terms = np.zeros((len(size_nm), 3, shape.terms + 1))
        terms[pillar, 0, :-1], terms[pillar, 1:, :-1] = at[pillar], d_at.transpose(1, 0, 2)[pillar]
        terms[~pillar, 0, -1] = 1.0
        uniform = np.zeros((len(size_nm), 3), dtype=np.complex128)
        uniform[:, 0], uniform[:, 1:] = uniform_field(chain, at), uniform_slopes(chain, at, d_at).T
        uniform[~pillar] = 0.0
        parameters = (chain.site, chain.source, chain.own, chain.side, chain.side * shape.parity)
        coefficients = np.zeros((sum(each.shape[1] for each in parameters), shape.terms + 1), dtype=np.complex128)
        coefficients[:, :-1] = np.concatenate(parameters, axis=1).T
        row, column = shape.pairs
        coefficients[: row.size, -1] = np.where(row == column, _NO_PILLAR, 0.0)
        parts = np.stack([coefficients.real, coefficients.imag], axis=-1)
        return cls(even, shape.modes, pairing, parts, terms, uniform)
