"""Electrons in solids against published backscatter coefficients."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.exposure.monte_carlo import SILICON, Layer, simulate

BULK_SILICON = [Layer(SILICON, 2.329, math.inf)]


@pytest.mark.slow
def test_backscatter_of_silicon() -> None:
    """0.165 for 20 to 30 keV (Drescher, Reimer and Seidel, Z. angew. Phys. 29, 331, 1970), within 5 % and statistics.

    8000 electrons leave a standard error of 0.004.
    """
    assert simulate(BULK_SILICON, 20.0, 8000).backscattered == pytest.approx(0.165, abs=0.05 * 0.165 + 0.008)


def test_energy_is_deposited_or_leaves() -> None:
    """In bulk all energy stays but what backscattered electrons carry away."""
    found = simulate(BULK_SILICON, 10.0, 1000)
    assert 10.0 * (1.0 - found.backscattered) < found.deposited_kev < 10.0
    area = math.pi * np.diff(np.concatenate([[0.0], 10.0 ** ((np.arange(found.radius_nm.size) + 1) / 8.0)]) ** 2)
    assert float((found.density * area).sum()) == pytest.approx(found.deposited_kev, rel=1e-6)


def test_the_same_seed_gives_the_same_histories() -> None:
    first, second = (simulate(BULK_SILICON, 5.0, 1000, seed=4) for _ in range(2))
    np.testing.assert_array_equal(first.density, second.density)


def test_a_stack_needs_a_substrate() -> None:
    with pytest.raises(InputError, match="infinite"):
        simulate([Layer(SILICON, 2.329, 100.0)], 10.0)
