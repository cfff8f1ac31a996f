"""Bicubic splines on tiles: the compiled evaluation against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric.bicubic_spline import SplineTiles, bicubic_coefficients, left_out_error


def tiles_of(values: ComplexArray, cells: tuple[int, int]) -> SplineTiles:
    """Tiles of a uniform grid, every second one from a grid of twice as many steps (of the same spline's values)."""
    n_y, n_x = values.shape[0] - 1, values.shape[1] - 1
    first_row, first_column = (np.minimum(np.arange(0, n, k), n - k) for n, k in zip((n_y, n_x), cells, strict=True))
    coefficients = bicubic_coefficients(values)
    parts = 1 + (np.arange(first_row.size)[:, None] + np.arange(first_column.size)) % 2
    rng, tables, start, end = np.random.default_rng(1), [], np.zeros(parts.shape, dtype=np.int64), 0
    for a, b in np.ndindex(*parts.shape):
        if parts[a, b] == 1:
            i, j = first_row[a], first_column[b]
            table = coefficients[i : i + cells[0] + 3, j : j + cells[1] + 3].reshape(-1, 2)
        else:
            table = rng.normal(size=((2 * cells[0] + 3) * (2 * cells[1] + 3), 4)).view(np.complex128)
        start[a, b], end = end, end + len(table)
        tables.append(table)
    row = np.minimum(np.arange(n_y) // cells[0], first_row.size - 1)
    column = np.minimum(np.arange(n_x) // cells[1], first_column.size - 1)
    error = rng.uniform(size=(n_y, n_x))
    return SplineTiles(
        cells, row, column, first_row, first_column, parts.astype(np.int64), start, np.concatenate(tables), error
    )


def evaluate_plain(tiles: SplineTiles, x: FloatArray, y: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """The sum over the four by four cubic B-splines that reach each point."""
    n_y, n_x = tiles.error.shape
    i, j = np.clip(y.astype(np.int64), 0, n_y - 1), np.clip(x.astype(np.int64), 0, n_x - 1)
    a, b = tiles.row[i], tiles.column[j]
    parts = tiles.parts[a, b]
    fine_y, fine_x = (y - tiles.first_row[a]) * parts, (x - tiles.first_column[b]) * parts
    k = np.clip(fine_y.astype(np.int64), 0, tiles.cells[0] * parts - 1)
    m = np.clip(fine_x.astype(np.int64), 0, tiles.cells[1] * parts - 1)
    stride = tiles.cells[1] * parts + 3
    first = tiles.start[a, b] + k * stride + m
    weights_y, weights_x = weights(fine_y - k), weights(fine_x - m)
    values = np.zeros((x.size, 2), dtype=np.complex128)
    for c in range(4):
        for d in range(4):
            values += (weights_y[c] * weights_x[d])[:, None] * tiles.coefficients[first + c * stride + d]
    return values, tiles.error[i, j]


def weights(f: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The four cubic B-splines at the fraction ``f`` of an interval."""
    g = 1.0 - f
    return g**3 / 6.0, (4.0 - 6.0 * f**2 + 3.0 * f**3) / 6.0, (4.0 - 6.0 * g**2 + 3.0 * g**3) / 6.0, f**3 / 6.0


def test_the_compiled_evaluation_is_the_sum_of_splines() -> None:
    rng = np.random.default_rng(3)
    nodes = rng.normal(size=(22, 30, 4)).view(np.complex128)
    tiles = tiles_of(nodes, (8, 8))
    x, y = rng.uniform(0.0, 29.0, 3000), rng.uniform(0.0, 21.0, 3000)
    x[:2], y[:2] = (0.0, 29.0), (21.0, 0.0)
    values, error = np.empty((3000, 2), dtype=np.complex128), np.empty(3000)
    tiles.evaluate(x, y, values, error)
    plain, plain_error = evaluate_plain(tiles, x, y)
    assert np.allclose(values, plain, atol=1e-13)
    assert np.array_equal(error, plain_error)


def test_a_spline_passes_through_its_nodes() -> None:
    nodes = np.random.default_rng(4).normal(size=(9, 8, 4)).view(np.complex128)
    tiles = tiles_of(nodes, (8, 7))
    y, x = (part.ravel().astype(np.float64) for part in np.mgrid[0:9, 0:8])
    values, error = np.empty((72, 2), dtype=np.complex128), np.empty(72)
    tiles.evaluate(x, y, values, error)
    assert np.allclose(values.reshape(9, 8, 2), nodes, atol=1e-12)


@pytest.mark.parametrize("half_width", [0.6, 1.0, 2.0])
@pytest.mark.parametrize("count", [7, 8, 9, 20])
def test_the_error_between_nodes_covers_a_resonance_wherever_it_lies(half_width: float, count: int) -> None:
    """Poles of 0.6 steps and wider, also in the outermost steps; leaving out odd nodes alone missed up to 4.6 times."""
    nodes, fine = np.arange(count), np.linspace(0.0, count - 1.0, 100 * (count - 1) + 1)
    cell = np.minimum(fine.astype(int), count - 2)
    for place in np.linspace(-0.5, count - 0.5, 61):

        def amplitude(u: FloatArray, place: float = float(place)) -> ComplexArray:
            return np.asarray(1.0 - 1.0 / (1.0 - 1j * (u - place) / half_width))

        error = left_out_error(np.repeat(amplitude(nodes)[None, :, None], 7, axis=0))[3]
        stated = np.maximum(error[1:], error[:-1])
        found = np.abs(CubicSpline(nodes, amplitude(nodes))(fine) - amplitude(fine))
        assert (found <= stated[cell] + 1e-9).all(), place
