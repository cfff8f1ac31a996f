"""Open lines by block elimination in double precision, against a dense solve."""

from __future__ import annotations

import numpy as np

from metafab.core.conventions import ComplexArray
from metafab.library.neighbours.line import LineModel, LineShape, initial_model
from metafab.library.neighbours.mask.open_lines import open_line_corrections, open_line_slopes
from metafab.library.neighbours.mask.size_tables import SizeTables
from metafab.library.neighbours.solve import line_corrections, uniform_field

SPAN = (100.0, 250.0)


def _dense(model: LineModel, size_nm: np.ndarray) -> ComplexArray:
    """Corrections of one open line, shape (sites, 2) to (sites,)."""
    terms, count, modes = model.polynomials(size_nm), len(size_nm), model.shape.modes
    matrix = np.zeros((count, modes, count, modes), dtype=np.complex128)
    for m in range(count):
        matrix[m, :, m] = model.site_matrix(terms[m])
        if m > 0:
            matrix[m, :, m - 1] = -model.hop_matrix
            matrix[m - 1, :, m] = -model.hop_matrix.T
    source = np.zeros((count, modes), dtype=np.complex128)
    source[:, : model.shape.even] = terms @ model.source
    a = np.linalg.solve(matrix.reshape(count * modes, -1), source.ravel()).reshape(count, modes)
    side = (terms @ model.side) * a
    field = np.sum(terms @ model.own * a[:, : model.shape.even], axis=1)
    field[1:] += side.sum(axis=1)[:-1]
    field[:-1] += (side * model.shape.parity).sum(axis=1)[1:]
    return np.asarray(field - uniform_field(model, terms))


def test_lines_with_gaps_are_those_of_a_dense_solve() -> None:
    rng = np.random.default_rng(1)
    model = initial_model(LineShape(4, 2, 3), SPAN, SPAN, 1)
    sizes = np.concatenate([[[0.0, 0.0]], rng.uniform(*SPAN, (50, 2))])
    index = rng.integers(1, 51, (70, 24)).astype(np.uint16)
    index[3, 10] = 0
    found = open_line_corrections(SizeTables.of(model, sizes), index)
    assert found.dtype == np.complex128
    for line in (0, 1, 64, 69):
        assert np.abs(found[line] - _dense(model, sizes[index[line]])).max() < 1e-10
    # A site without a pillar is dark and cuts the line into two.
    assert found[3, 10] == 0.0
    assert np.abs(found[3, :10] - _dense(model, sizes[index[3, :10]])).max() < 1e-10
    assert np.abs(found[3, 11:] - _dense(model, sizes[index[3, 11:]])).max() < 1e-10


def test_long_lines_end_in_closed_ones() -> None:
    """Far from its ends an open line of repeated periods has the field of the closed period."""
    rng = np.random.default_rng(2)
    model = initial_model(LineShape(4, 2, 3), SPAN, SPAN, 1)
    period = rng.uniform(*SPAN, (6, 2))
    closed = line_corrections(model, model.polynomials(period[None]))[0]
    tables = SizeTables.of(model, np.concatenate([[[0.0, 0.0]], period]))
    line = np.tile(np.arange(1, 7, dtype=np.uint16), 15)[None]
    middle = open_line_corrections(tables, line)[0, 42:48]
    assert np.abs(closed).max() > 1e-3
    assert np.abs(middle - closed).max() < 1e-10


def test_parts_of_long_lines_are_those_of_a_dense_solve() -> None:
    """Each part is substituted back from sites beyond it, where the amplitudes have an error that decays."""
    rng = np.random.default_rng(3)
    model = initial_model(LineShape(3, 2, 2), SPAN, SPAN, 1)
    sizes = np.concatenate([[[0.0, 0.0]], rng.uniform(*SPAN, (50, 2))])
    index = rng.integers(1, 51, (1, 170)).astype(np.uint16)
    tables, dense = SizeTables.of(model, sizes), _dense(model, sizes[index[0]])
    assert np.abs(open_line_corrections(tables, index)[0] - dense).max() < 1e-10
    again, _ = open_line_slopes(tables, index, np.ones((1, 170)))
    assert np.abs(again[0] - dense).max() < 1e-10


def test_slopes_are_those_of_a_weighted_sum() -> None:
    """Derivatives at the sites of a line with a gap against differences of a dense solve."""
    rng = np.random.default_rng(3)
    model = initial_model(LineShape(3, 2, 3), SPAN, SPAN, 1)
    sizes = np.concatenate([[[0.0, 0.0]], rng.uniform(120.0, 230.0, (12, 2))])
    index = np.arange(1, 13, dtype=np.uint16)[None]
    index[0, 4] = 0
    weight = (rng.normal(size=12) + 1j * rng.normal(size=12)) * (index[0] > 0)
    tables = SizeTables.of(model, sizes)
    corrections, slopes = open_line_slopes(tables, index, weight[None])
    assert np.array_equal(corrections, open_line_corrections(tables, index))

    def total(moved: np.ndarray) -> complex:
        return complex(sum(weight[part] @ _dense(model, moved[part]) for part in (slice(0, 4), slice(5, 12))))

    scale = np.abs(slopes).max()
    for site in (0, 3, 5, 8, 11):
        for axis in (0, 1):
            up, down = sizes[index[0]], sizes[index[0]]
            up[site, axis] += 0.05
            down[site, axis] -= 0.05
            # Truncation of the differences over 0.1 nm.
            assert abs(slopes[0, site, axis] - (total(up) - total(down)) / 0.1) < 1e-4 * scale
    assert not slopes[0, 4].any()
