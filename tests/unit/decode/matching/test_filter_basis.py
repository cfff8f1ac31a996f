"""The low-rank basis of the filters."""

from __future__ import annotations

import numpy as np

from metafab.decode.matching.filter_basis import range_basis


def test_the_basis_leaves_out_what_it_may() -> None:
    """Rows of falling strength: the least number of columns that hold them, and no more missing than asked."""
    rng = np.random.default_rng(6)
    directions, _ = np.linalg.qr(rng.normal(size=(200, 12)))
    strengths = 2.0 ** -np.arange(12.0)
    table = (rng.permutation(np.eye(60))[:, :12] * strengths @ directions.T).astype(np.float32)
    counts = []
    for error in (0.3, 0.05, 0.01):
        columns = range_basis(table, error)
        np.testing.assert_allclose(columns.T @ columns, np.eye(columns.shape[1]), atol=1e-5)
        missing = np.linalg.norm(table - columns @ (columns.T @ table)) / np.linalg.norm(table)
        assert missing <= error * 1.001
        left = np.sqrt((strengths[columns.shape[1] - 1 :] ** 2).sum() / (strengths**2).sum())
        assert left > error  # one column less would not do
        counts.append(columns.shape[1])
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]
