"""Interpolated blur kernels."""

from __future__ import annotations

import numpy as np

from metafab.camera.kernels import PairKernels
from tests.conjugate_pair import helix_psf


def test_kernels_between_depths_are_the_pair_at_that_depth() -> None:
    """Nodes 0.17 rad of rotation apart: the measured law of cubic interpolation allows a per cent."""
    psf = helix_psf(1.0 / np.linspace(1 / 0.0034, 1 / 0.0025, 7)[::-1], window_px=32)
    middle = 2.0 / (1.0 / psf.depth_m[2] + 1.0 / psf.depth_m[3])
    exact = PairKernels(helix_psf(np.array([middle]), window_px=32)).at_depth(middle)
    got = PairKernels(psf).at_depth(middle)
    exact, got = exact / exact.sum(), got / got.sum()
    assert np.linalg.norm(got - exact) < 0.01 * np.linalg.norm(exact)
