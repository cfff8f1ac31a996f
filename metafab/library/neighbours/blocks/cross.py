"""Cross-polarised light of a periodic block: chains of both polarisations, coupled from site to site.

What radiates x polarised light along the axis is odd under the mirror that exchanges -x and x, and even under that of
y; for y polarised light it is the other way round. An odd mode of a chain has the other parity under the mirror along
it. The central difference along an axis exchanges the parity under the mirror of that axis. So it couples modes a of a
chain of x polarised light with modes b of a chain of y polarised light whose parities differ under that mirror alone.
By reciprocity one constant matrix M serves both ways,

    (A a)_m + M (b_m+1 - b_m-1) / 2 = c,        (B b)_m - M^T (a_m+1 - a_m-1) / 2 = c',

with the matrices A and B of the coupled lines of each polarisation (:mod:`metafab.library.neighbours.blocks.lattice`).
Cross-polarised light is followed to first order in M. Where rows along x and along y have the same chains, the exchange
of x and y maps each coupling to another, whose matrix is -M^T.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray
from metafab.library.neighbours.blocks.lattice import SolvedLines
from metafab.library.neighbours.line import LineShape
from metafab.library.neighbours.model import Neighbours


@dataclass(frozen=True)
class CrossCoupling:
    """A chain of each polarisation, and the axis of the difference that couples them; 0 along x, 1 along y."""

    of_x: int  #: Direction of the chain of x polarised light.
    of_y: int  #: Direction of the chain of y polarised light.
    axis: int  #: Axis of the difference.

    def pairs(self, neighbours: Neighbours) -> NDArray[np.bool_]:
        """Which modes couple, shape (modes of the chain of x polarised light, modes of that of y polarised light)."""
        of_x, of_y = (
            _parities(neighbours.line(direction, light).model.shape, direction, number)
            for number, (direction, light) in enumerate(zip((self.of_x, self.of_y), POLARISATIONS, strict=True))
        )
        differ = of_x[:, None] != of_y[None]
        return np.asarray(differ[..., self.axis] & ~differ[..., 1 - self.axis])


#: All couplings. The exchange of x and y maps the first half to the second, in turn.
COUPLINGS = tuple(CrossCoupling(*each) for each in ((0, 0, 1), (0, 1, 1), (1, 0, 1), (1, 1, 0), (0, 1, 0), (1, 0, 0)))


@dataclass(frozen=True)
class CrossLight:
    """The solved lines of a block, from which its cross-polarised light follows."""

    neighbours: Neighbours
    #: By polarisation of the light, then by direction of the lines.
    lines: Sequence[Sequence[SolvedLines]]

    def field(self, vector: ComplexArray) -> ComplexArray:
        """Cross-polarised field of the sites for x and for y polarised incident light, shape (2, n_y, n_x).

        ``vector`` holds the free elements of all M, shape (n,).
        """
        sources = [[np.zeros_like(_by_site(each.amplitude, d)) for d, each in enumerate(lines)] for lines in self.lines]
        for coupling, matrix in zip(COUPLINGS, coupling_matrices(self.neighbours, vector), strict=True):
            a, b = self._differences(coupling)
            sources[1][coupling.of_y] += a @ matrix
            sources[0][coupling.of_x] -= b @ matrix.T
        fields = [
            np.sum([_by_site(each.field_of(_by_site(part, d)), d) for d, (each, part) in enumerate(both)], axis=0)
            for both in (zip(lines, parts, strict=True) for lines, parts in zip(self.lines, sources, strict=True))
        ]
        return np.stack(fields[::-1])

    def slopes(self, to_orders: ComplexArray) -> ComplexArray:
        """Derivatives of the cross-polarised orders by the free elements of all M, shape (2, orders, n).

        For x and for y polarised incident light; ``to_orders`` maps the field of the sites, (n_y, n_x) in turn, to the
        orders.
        """
        n_y, n_x = _by_site(self.lines[0][0].amplitude, 0).shape[:2]
        of_lines = [to_orders, to_orders.reshape(-1, n_y, n_x).swapaxes(1, 2).reshape(to_orders.shape)]
        adjoints = [
            [_by_site(each.adjoint(of_lines[d]), d, first=1) for d, each in enumerate(lines)] for lines in self.lines
        ]
        found = []
        for coupling in COUPLINGS:
            a, b = self._differences(coupling)
            out_x, out_y = adjoints[0][coupling.of_x], adjoints[1][coupling.of_y]
            by_x = np.einsum("ojms,jmr->ors", out_y, a, optimize=True)
            by_y = -np.einsum("ojmr,jms->ors", out_x, b, optimize=True)
            found.append(np.stack([by_x, by_y]))
        free = _free(self.neighbours)
        if len(free) < len(COUPLINGS):
            found = [
                one - image.swapaxes(-1, -2) for one, image in zip(found[: len(free)], found[len(free) :], strict=True)
            ]
        return np.concatenate(
            [each[..., coupling.pairs(self.neighbours)] for each, coupling in zip(found, free, strict=True)], axis=-1
        )

    def _differences(self, coupling: CrossCoupling) -> tuple[ComplexArray, ComplexArray]:
        """Differences of the modes of both chains of a coupling, shape (n_y, n_x, modes) each."""
        a, b = (
            0.5 * (np.roll(values, -1, 1 - coupling.axis) - np.roll(values, 1, 1 - coupling.axis))
            for values in (
                _by_site(self.lines[0][coupling.of_x].amplitude, coupling.of_x),
                _by_site(self.lines[1][coupling.of_y].amplitude, coupling.of_y),
            )
        )
        return np.asarray(a), np.asarray(b)


def coupling_matrices(neighbours: Neighbours, vector: ComplexArray) -> list[ComplexArray]:
    """M of each of :data:`COUPLINGS`, from the free elements of all, shape (n,)."""
    masks = [each.pairs(neighbours) for each in _free(neighbours)]
    ends = np.cumsum([int(mask.sum()) for mask in masks])
    matrices = []
    for mask, part in zip(masks, np.split(vector, ends[:-1]), strict=True):
        matrix = np.zeros(mask.shape, dtype=np.complex128)
        matrix[mask] = part
        matrices.append(matrix)
    return matrices if len(matrices) == len(COUPLINGS) else [*matrices, *(-matrix.T for matrix in matrices)]


def free_elements(neighbours: Neighbours) -> int:
    """Number of free elements of all M."""
    return sum(int(each.pairs(neighbours).sum()) for each in _free(neighbours))


def _free(neighbours: Neighbours) -> tuple[CrossCoupling, ...]:
    """Couplings whose matrices are free; the exchange of x and y gives the others."""
    return COUPLINGS[: len(COUPLINGS) // 2] if neighbours.shares_directions else COUPLINGS


def _parities(shape: LineShape, direction: int, light: int) -> FloatArray:
    """Parities of the modes of a chain under the mirrors of x and of y, shape (modes, 2)."""
    parities = np.ones((shape.modes, 2))
    parities[:, light] = -1.0
    parities[shape.even :, direction] *= -1.0
    return parities


def _by_site(values: ComplexArray, direction: int, first: int = 0) -> ComplexArray:
    """Values of lines along x or y, shape (lines, sites, ...) from axis ``first`` on, to (n_y, n_x, ...), and back."""
    return values.swapaxes(first, first + 1) if direction else values
