"""A lens and a beam that the tests of the exposure share."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import owens_t

from metafab.exposure import BeamPsf, BeamTerm
from metafab.layout import Lattice, PillarMap

#: All three ranges: within a pillar, among neighbours, and over the lens.
BEAM = BeamPsf.of(
    [BeamTerm("gauss", 0.55, 8.0), BeamTerm("power", 0.12, 20.0, 3.2), BeamTerm("gauss", 0.33, 9000.0)], "assumption"
)
PERIOD_NM = 350.0


def pattern(sizes_nm: np.ndarray, index: np.ndarray) -> PillarMap:
    """Pillars on the paper's lattice, in units of half a nanometre."""
    table = np.concatenate([[(0.0, 0.0)], sizes_nm])
    lattice = Lattice(period_dbu=(700, 700), shape=index.shape, database_unit_nm=0.5)
    return PillarMap.from_array(lattice, (2.0 * table).astype(np.int32), index.astype(np.uint16), 512)


def polygon_energy(beam: BeamPsf, corners_nm: np.ndarray) -> float:
    """Energy at the origin of a polygon at dose 1, corners counter-clockwise: shape (n, 2).

    A side at the distance d that is seen under the angles a to b from its perpendicular gives the integral of
    [1 - exp(-d^2 / (beta cos)^2)] / (2 pi), Owen's function.
    """
    beta, start = beam.range_nm[:, None], corners_nm
    along = np.roll(start, -1, axis=0) - start
    along = along / np.hypot(*along.T)[:, None]
    distance = start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]
    ends = np.stack([(start * along).sum(axis=1), (np.roll(start, -1, axis=0) * along).sum(axis=1)])
    seen = np.abs(distance) > 1e-9
    ratio, distance = ends[:, seen] / np.abs(distance[seen]), distance[seen]
    angle = np.diff(np.arctan(ratio), axis=0)[0] / (2.0 * np.pi)
    tails = np.diff(owens_t(math.sqrt(2.0) * np.abs(distance) / beta, ratio[:, None]), axis=0)[0]
    return float(beam.weight @ ((angle - tails) @ np.sign(distance)))


def disc(sites: int, kinds: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    index = rng.integers(1, kinds + 1, (sites, sites))
    y, x = np.mgrid[:sites, :sites] - 0.5 * (sites - 1)
    return np.where(np.hypot(x, y) <= 0.5 * sites, index, 0)


@pytest.fixture(scope="session")
def lens() -> PillarMap:
    rng = np.random.default_rng(3)
    return pattern(2.0 * rng.integers(50, 126, (300, 2)), disc(700, 300))
