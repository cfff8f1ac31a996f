"""Parameters of chains: growth by weakly coupled modes."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.library.neighbours.line import LineShape, grown, initial_model
from metafab.library.neighbours.solve import scattered_corrections

SPAN = (100.0, 250.0)


@pytest.mark.parametrize("old", [LineShape(2, 2, 3), LineShape(1, 0, 3), LineShape(3, 3, 3)])
def test_new_modes_change_the_light_little(old: LineShape) -> None:
    rng = np.random.default_rng(1)
    model = initial_model(old, SPAN, SPAN, 1)
    more = grown(model, LineShape(3, 3, 3), 2)
    terms = model.polynomials(rng.uniform(*SPAN, (5, 7, 2)))
    before, after = scattered_corrections(model, terms), scattered_corrections(more, terms)
    change = np.linalg.norm(after - before) / np.linalg.norm(before)
    # 0.05 squared, times some modes: light goes into a new mode and back.
    assert change < 0.05
    assert (change > 1e-4) == (old != more.shape)
    known = np.r_[: old.even, 3 : 3 + old.odd]
    assert np.abs(more.site_matrix(terms)[..., known[:, None], known] - model.site_matrix(terms)).max() < 1e-14
    assert np.array_equal(more.hop_matrix[np.ix_(known, known)], model.hop_matrix)
