"""The worker program without Meep: limits of decaying tails, and its end."""

from __future__ import annotations

import cmath
import subprocess
import sys

import numpy as np

from metafab.cell.meep import finding
from metafab.cell.meep_worker import tail_limit


def test_a_tail_of_few_modes_has_its_limit_at_once() -> None:
    rng = np.random.default_rng(1)
    limit = rng.normal(size=3) + 1j * rng.normal(size=3)
    decay = np.array([0.97 * cmath.exp(0.3j), 0.9 * cmath.exp(-1.1j), 0.6 * cmath.exp(2j)])
    strength = rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))
    samples = limit + np.array([(strength * decay**j).sum(axis=1) for j in range(18)])
    assert np.abs(samples[-1] - limit).max() > 0.5, "waiting alone has not got there"
    # Three of the six modes are left over: they may only pick up round-off.
    np.testing.assert_allclose(tail_limit(samples, 6), limit, atol=1e-4)
    np.testing.assert_allclose(tail_limit(samples, 3), limit, atol=1e-6)


def test_a_tail_that_has_ended_is_its_own_limit() -> None:
    samples = np.full((18, 2), 1.0 + 2.0j)
    np.testing.assert_array_equal(tail_limit(samples), samples[-1])


def test_a_worker_whose_starter_is_gone_leaves() -> None:
    """The real worker reads stdin to its end, with or without Meep, and then exits."""
    finished = subprocess.run(
        [sys.executable, "-I", str(finding.WORKER)], input="", text=True, capture_output=True, timeout=60, check=False
    )
    assert finished.returncode == 0
    assert finished.stdout == ""
