"""Structural similarity against its closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.evaluation import structural_similarity


def test_structural_similarity_against_its_closed_forms() -> None:
    """Equal images give 1; a constant offset leaves the luminance term alone (Wang et al. 2004, Eq. 6)."""
    image = np.random.default_rng(6).normal(100.0, 10.0, size=(60, 60))
    assert structural_similarity(image, image, 200.0) == pytest.approx(1.0)
    flat, raised = np.full((60, 60), 100.0), np.full((60, 60), 120.0)
    low = (0.01 * 200.0) ** 2
    want = (2.0 * 100.0 * 120.0 + low) / (100.0**2 + 120.0**2 + low)
    assert structural_similarity(raised, flat, 200.0) == pytest.approx(want)
    # Independent noise of equal variance: the structure term is the constant's share alone, near 1/7 for 10 in 200.
    other = np.random.default_rng(7).normal(100.0, 10.0, size=(60, 60))
    high = (0.03 * 200.0) ** 2
    assert structural_similarity(image, other, 200.0) == pytest.approx(high / (2.0 * 100.0 + high), abs=0.05)
