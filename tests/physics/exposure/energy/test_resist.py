"""Energy in the resist against closed forms and direct sums."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.special import erf

from metafab.core.errors import InputError
from metafab.exposure import BeamPsf, BeamTerm, ResistEnergy
from metafab.layout import Lattice, PillarMap
from tests.physics.exposure.conftest import BEAM, PERIOD_NM, pattern


def test_every_energy_agrees_with_a_direct_sum(lens: PillarMap) -> None:
    """At random pillars and at the rim; 2e-4 is a tenth of what the correction needs."""
    rng = np.random.default_rng(1)
    dose = rng.uniform(0.8, 1.2, lens.lattice.shape).astype(np.float32)
    resist = ResistEnergy(lens, BEAM)
    centre = np.zeros(lens.lattice.shape)
    with ThreadPoolExecutor(2) as threads:
        for (rows, columns), values in resist.map_tiles(dose, threads, lambda tile: tile.centre.astype(np.float64)):
            centre[rows, columns] = values
    places = [tuple(p) for p in rng.permutation(np.argwhere(resist.size_index > 0))[:12]]
    rim = next(int(c) for c in range(700) if resist.size_index[350, c])
    for row, column in [*places, (350, rim)]:
        assert centre[row, column] == pytest.approx(resist.direct(dose, row, column)[0], abs=2e-4)


def test_a_pad_of_touching_pillars_is_a_rectangle() -> None:
    """Squares as wide as the period make one pad, whose energy is known; far from the rim it is 1."""
    n = 101
    pad = pattern(np.array([(PERIOD_NM, PERIOD_NM)]), np.ones((n, n)))
    beam = BeamPsf.of([BeamTerm("gauss", 0.7, 30.0), BeamTerm("gauss", 0.3, 6000.0)], "assumption")
    resist = ResistEnergy(pad, beam)
    dose = np.ones((n, n), dtype=np.float32)
    half = 0.5 * n * PERIOD_NM
    whole = 0.7 + 0.3 * erf(half / 6000.0) ** 2
    assert resist.direct(dose, n // 2, n // 2)[0] == pytest.approx(whole, rel=1e-9)
    with ThreadPoolExecutor(1) as threads:
        (_, centre), *_ = resist.map_tiles(dose, threads, lambda tile: tile.centre.astype(np.float64))
    assert centre[n // 2, n // 2] == pytest.approx(whole, rel=2e-4)
    # At the corner site: the pad is a quarter plane from half a period on.
    near, far = 0.5 * PERIOD_NM, 2.0 * half - 0.5 * PERIOD_NM
    along = [0.5 * (erf(far / beta) + erf(near / beta)) for beta in (30.0, 6000.0)]
    assert centre[0, 0] == pytest.approx(0.7 * along[0] ** 2 + 0.3 * along[1] ** 2, abs=1e-3)


def test_a_hexagonal_lattice_is_refused_by_name() -> None:
    lattice = Lattice((350, 606), (4, 4), 0.5, hexagonal=True)
    pillars = PillarMap.from_array(lattice, np.array([(0, 0), (200, 200)], np.int32), np.eye(4, dtype=np.uint16), 512)
    with pytest.raises(InputError, match="hexagonal"):
        ResistEnergy(pillars, BEAM)
