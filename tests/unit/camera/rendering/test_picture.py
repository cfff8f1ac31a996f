"""Rays from a picture with its depth: which of them need not be followed."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.camera.rendering.picture import highest_met
from metafab.core.conventions import FloatArray

SHAPE = (40, 56)
#: Reach of the aperture, pixels per 1/m, and the jump that is an outline, 1/m.
REACH_PX_M, JUMP = 9.0, 0.12


def steps(seed: int) -> FloatArray:
    """Vergences of a slope with boxes before it, 1.5 to 4 per m."""
    rng = np.random.default_rng(seed)
    vergence = np.add.outer(np.linspace(1.5, 2.0, SHAPE[0]), np.linspace(0.0, 0.3, SHAPE[1]))
    for _ in range(6):
        row, column = (int(rng.integers(n - 9)) for n in SHAPE)
        vergence[row : row + 9, column : column + 9] = rng.uniform(2.0, 4.0)
    return vergence


def met(vergence: FloatArray, start: FloatArray) -> FloatArray:
    """Highest vergence below which rays in eight directions pass, followed in steps of a tenth of a pixel."""
    found = np.full(SHAPE, -np.inf)
    rows, columns = np.indices(SHAPE)
    for angle in 0.25 * np.pi * np.arange(8):
        for length in np.arange(0.1, REACH_PX_M * np.ptp(vergence), 0.1):
            row = np.clip(np.floor(rows + length * np.sin(angle) + 0.5), 0, SHAPE[0] - 1).astype(int)
            column = np.clip(np.floor(columns + length * np.cos(angle) + 0.5), 0, SHAPE[1] - 1).astype(int)
            here = vergence[row, column]
            found = np.where(start + length / REACH_PX_M < here - 0.5 * JUMP, np.maximum(found, here), found)
    return found


@pytest.mark.parametrize("behind", [0.0, 0.8])
def test_what_a_ray_can_pass_below_is_known_before_it_is_followed(behind: float) -> None:
    """Rays from the surface, or from one behind it. Of those that pass above everything, 0.31 to 0.71 are left out."""
    for seed in (1, 2, 3):
        vergence = steps(seed)
        start = vergence - behind
        bound = highest_met(vergence, start, REACH_PX_M, JUMP)
        far = met(vergence, start)
        assert (far <= bound)[bound > -np.inf].all()
        hidden = (far > -np.inf) & (far - start > JUMP)
        assert hidden.any()
        assert (bound > -np.inf)[hidden].all()
        if behind == 0.0:
            assert (bound == -np.inf)[far == -np.inf].mean() > 0.2
