"""Phase error by the uncertainty of the pillar's index."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from metafab.library.use.error_terms import halton


def test_halton_points_are_scipys() -> None:
    np.testing.assert_array_equal(halton(100), qmc.Halton(2, scramble=False).random(100))
    assert halton(0).shape == (0, 2)
