"""Energy in the resist against closed forms and direct sums."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.special import erf, erfc

from metafab.exposure import BeamPsf, BeamTerm, Beside, ResistEnergy
from metafab.exposure.printing import EdgeTables
from metafab.layout import Lattice, PillarMap
from metafab.layout.outlines import Outline, Shape
from tests.physics.exposure.conftest import BEAM, PERIOD_NM, pattern, polygon_energy


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


def test_lines_are_a_fourier_series() -> None:
    """Pillars that touch along y: far from the rim E = share + sum 2 / (pi n) sin(pi n share) cos(2 pi n x / p) f_n.

    f_n = exp(-(pi n beta / p)^2) is the transform of a Gaussian.
    """
    beam = BeamPsf.of([BeamTerm("gauss", 0.8, 60.0), BeamTerm("gauss", 0.2, 2500.0)], "assumption")
    lines = pattern(np.array([(160.0, PERIOD_NM)]), np.ones((81, 81)))
    resist, dose = ResistEnergy(lines, beam), np.ones((81, 81), dtype=np.float32)
    own = EdgeTables.of(beam, resist.shapes).at_edge[0, 1]
    with ThreadPoolExecutor(1) as threads:
        (_, found), *_ = resist.map_tiles(dose, threads, lambda tile: np.stack([tile.centre, tile.others[0] + own]))
    share, n = 160.0 / PERIOD_NM, np.arange(1, 30)[:, None]
    kept = (beam.weight * np.exp(-((np.pi * n * beam.range_nm / PERIOD_NM) ** 2))).sum(axis=1)
    waves = 2.0 / (np.pi * n[:, 0]) * np.sin(np.pi * n[:, 0] * share) * kept
    for value, x_nm in zip(found[:, 40, 40], (0.0, 80.0), strict=True):
        series = share + float((waves * np.cos(2.0 * np.pi * n[:, 0] * x_nm / PERIOD_NM)).sum())
        assert value == pytest.approx(series, abs=1e-4)


@pytest.mark.parametrize("distance_nm", [200.0, 3000.0, 20000.0])
def test_a_half_plane_is_an_error_function(distance_nm: float) -> None:
    """A plane that ends beside a lone pillar gives it erfc(distance / range) / 2 of each Gaussian."""
    lone = np.zeros((9, 9))
    lone[4, 4] = 1
    plane = np.array([[distance_nm, -3e5, 3e5, 3e5]])
    resist = ResistEnergy(pattern(np.array([(150.0, 150.0)]), lone), BEAM)
    dose = np.ones((9, 9), dtype=np.float32)
    with ThreadPoolExecutor(1) as threads:
        with_plane, alone = (
            next(iter(one.map_tiles(dose, threads, lambda tile: tile.centre.astype(np.float64))))[1][4, 4]
            for one in (resist.among(Beside(rectangles_nm=plane)), resist)
        )
    expected = float((0.5 * BEAM.weight * erfc(distance_nm / BEAM.range_nm)).sum())
    assert with_plane - alone == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize(
    ("hexagonal", "shape"), [(True, "ellipse"), (True, "rectangle"), (False, "ellipse"), (False, "rounded")]
)
def test_other_lattices_and_outlines_agree_with_sums_over_polygons(hexagonal: bool, shape: Shape) -> None:
    """At random pillars and at the rim of a disc: polygons of the mask, each by Owen's function."""
    rng = np.random.default_rng(7)
    lattice = (
        Lattice(period_dbu=(380, 658), shape=(27, 45), database_unit_nm=0.5, hexagonal=True)
        if hexagonal
        else Lattice(period_dbu=(700, 700), shape=(25, 25), database_unit_nm=0.5)
    )
    rows, columns = (np.arange(n) for n in lattice.shape)
    inside = np.hypot(lattice.x_um(), lattice.y_um()[:, None]) < 4.3
    index = np.where(inside & lattice.carries(rows, columns), rng.integers(1, 9, lattice.shape), 0).astype(np.uint16)
    sides = (
        4 * rng.integers(50, 130, (8, 2))
        if shape != "ellipse" or not hexagonal
        else 4 * np.repeat(rng.integers(50, 130, (8, 1)), 2, axis=1)
    )
    sizes = np.concatenate([[(0, 0)], sides]).astype(np.int32)
    outline = Outline(shape, 0.5, 80.0 if shape == "rounded" else 0.0)
    pillars = PillarMap.from_array(lattice, sizes, index, 512)
    dose = rng.uniform(0.8, 1.2, lattice.shape).astype(np.float32)
    resist = ResistEnergy(pillars, BEAM, outline)
    tables = EdgeTables.of(BEAM, resist.shapes)
    polygons = [0.5 * polygon for polygon in outline.polygons(sizes.astype(np.int64))]
    places = [tuple(place) for place in rng.permutation(np.argwhere(index))[:1]]
    places.append((12, int(np.flatnonzero(index[12])[0])))
    with ThreadPoolExecutor(1) as threads:
        ((_, found),) = resist.map_tiles(dose, threads, lambda tile: np.concatenate([tile.centre[None], tile.others]))
    x_nm, y_nm = 1e3 * lattice.x_um(), 1e3 * lattice.y_um()
    for row, column in places:
        size, corners = index[row, column], []
        for y, x in np.argwhere(index):
            corners.append(((x_nm[x], y_nm[y]) + polygons[index[y, x]], dose[y, x]))

        def energy(x: float, y: float, corners: list[tuple[np.ndarray, float]] = corners) -> float:
            return sum(d * polygon_energy(BEAM, polygon - (x, y)) for polygon, d in corners)

        x, y, (w, length) = x_nm[column], y_nm[row], 0.25 * sizes[size]
        exact = [energy(x, y)]
        exact += [0.5 * (energy(x + dx, y + dy) + energy(x - dx, y - dy)) for dx, dy in ((w, 0.0), (0.0, length))]
        np.testing.assert_allclose(resist.direct(dose, row, column), exact, rtol=0.0, atol=5e-5)
        own = [0.0, *tables.at_edge[:, size] * dose[row, column]]
        np.testing.assert_allclose(found[:, row, column] + own, exact, rtol=0.0, atol=2e-4)
