"""Upper bounds of the lobe peaks: no mask exceeds them, and the optimum nearly reaches them."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.phase import Pupil, optimise_peak
from metafab.phase.optimise.peak import PeakDesign, peak_bound

COARSE = Pupil(64)


@pytest.fixture(scope="module")
def best() -> PeakDesign:
    return optimise_peak(4, pupil=COARSE)


def test_no_mask_beats_the_bound_and_the_design_all_but_reaches_it(best: PeakDesign) -> None:
    assert best.bound.dual <= best.bound.spectral
    assert 0.995 < best.bound_fraction <= 1.0 + 1e-9
    tilt = best.term(1.0).tilt_rad
    waves = np.exp(
        1j
        * (
            np.outer(tilt[:, 0], COARSE.x)
            + np.outer(tilt[:, 1], COARSE.y)
            - np.outer(best.defocus_rad, COARSE.radius_squared)
        )
    )
    random = np.random.default_rng(7)
    for iterations in (1, 5, 50):  # a bad relaxation gives a weaker bound, never a wrong one
        bound = peak_bound(waves, np.full(len(waves), 1.0 / len(waves)), iterations, seed=3)
        assert bound.dual >= best.reached - 1e-9
    for wave in waves[::5]:
        mask = wave * np.exp(0.3j * random.normal(size=COARSE.count))
        assert np.mean(np.abs(waves.conj() @ mask / COARSE.count) ** 2) <= best.bound.dual
