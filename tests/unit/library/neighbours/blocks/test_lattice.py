"""Coupled chains of a block: their equations, what they leave as it is, and the exact derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.core.conventions import ComplexArray
from metafab.library.neighbours.blocks.lattice import BlockLight, SolvedLines, coupling_matrix
from metafab.library.neighbours.line import LineModel, LineShape, initial_model
from metafab.library.neighbours.solve import line_corrections, uniform_field

SPAN = (100.0, 250.0)
RNG = np.random.default_rng(5)


def block(lines: int, sites: int) -> tuple[LineModel, ComplexArray, np.ndarray]:
    """A chain, a coupling of its lines, and sizes of shape (lines, sites, 2)."""
    model = initial_model(LineShape(3, 2, 2), SPAN, SPAN, 2)
    coupling = 0.05 * (RNG.normal(size=(2, model.shape.pairs[0].size)) * [[1.0], [1.0j]]).sum(axis=0)
    return model, coupling, RNG.uniform(*SPAN, (lines, sites, 2))


@pytest.mark.parametrize(("lines", "sites"), [(3, 4), (2, 3), (4, 1)])
def test_modes_obey_the_equations_of_the_module(lines: int, sites: int) -> None:
    """Assembled site by site, against the field less that of each column beside equal ones."""
    model, coupling, size_nm = block(lines, sites)
    terms, k, hop = model.polynomials(size_nm), coupling_matrix(model, coupling), model.hop_matrix
    parity, even, modes = model.shape.parity, model.shape.even, model.shape.modes

    def field(terms: np.ndarray) -> ComplexArray:
        lines, sites, _ = terms.shape
        matrix = np.zeros((lines, sites, modes, lines, sites, modes), dtype=complex)
        source = np.zeros((lines, sites, modes), dtype=complex)
        for j in range(lines):
            for m in range(sites):
                matrix[j, m, :, j, m] += model.site_matrix(terms[j, m]) + 2.0 * k
                matrix[j, m, :, j, (m - 1) % sites] -= hop
                matrix[j, m, :, j, (m + 1) % sites] -= hop.T
                for beside in (j - 1, j + 1):
                    matrix[j, m, :, beside % lines, m] -= k
                source[j, m, :even] = terms[j, m] @ model.source
        size = source.size
        a = np.linalg.solve(matrix.reshape(size, size), source.ravel()).reshape(source.shape)
        own, side = np.sum((terms @ model.own) * a[..., :even], axis=-1), (terms @ model.side) * a
        return own + np.roll(side, 1, axis=1).sum(axis=-1) + np.roll(side * parity, -1, axis=1).sum(axis=-1)

    columns = np.concatenate([field(terms[:, m : m + 1]) for m in range(sites)], axis=1)
    np.testing.assert_allclose(SolvedLines.of(model, coupling, terms).corrections, field(terms) - columns, atol=1e-12)


def test_rows_and_columns_alone_are_those_of_the_chains_with_any_coupling() -> None:
    model, coupling, size_nm = block(3, 4)
    rows = model.polynomials(np.broadcast_to(size_nm[:1], size_nm.shape))
    found = SolvedLines.of(model, coupling, rows).corrections
    np.testing.assert_allclose(found, line_corrections(model, rows), atol=1e-12)
    columns = model.polynomials(np.broadcast_to(size_nm[:, :1], size_nm.shape))
    assert np.abs(SolvedLines.of(model, coupling, columns).corrections).max() < 1e-12
    terms = model.polynomials(size_nm)
    uncoupled = SolvedLines.of(model, 0.0 * coupling, terms).corrections
    np.testing.assert_allclose(uncoupled, line_corrections(model, terms), atol=1e-12)
    assert (
        np.abs(SolvedLines.of(model, coupling, terms).corrections - uncoupled).max()
        > 1e-3 * np.abs(uniform_field(model, terms)).max()
    )


def test_derivatives_are_those_of_differences() -> None:
    model, coupling, size_nm = block(3, 3)
    to_orders = RNG.normal(size=(5, 9)) + 1j * RNG.normal(size=(5, 9))
    light = BlockLight.of(model, model.polynomials(size_nm), to_orders)
    orders, slopes = light.orders(coupling)
    expected = to_orders @ SolvedLines.of(model, coupling, model.polynomials(size_nm)).corrections.ravel()
    np.testing.assert_allclose(orders, expected, atol=1e-12)
    step = 1e-6 * (RNG.normal(size=coupling.size) + 1j * RNG.normal(size=coupling.size))
    change = 0.5 * (light.orders(coupling + step)[0] - light.orders(coupling - step)[0])
    assert np.abs(change - slopes @ step).max() < 1e-7 * np.abs(slopes @ step).max()
