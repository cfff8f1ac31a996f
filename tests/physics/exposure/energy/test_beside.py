"""Energy from other lenses and figures against direct sums that use no code of the exposure."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.special import erf

from metafab.core.conventions import FloatArray
from metafab.exposure import BeamPsf, BeamTerm, Beside, OtherLens, ResistEnergy
from metafab.exposure.energy.resist import TileEnergy
from metafab.layout import PillarMap
from metafab.layout.outlines import Outline
from metafab.mask.writing import strips
from tests.physics.exposure.conftest import PERIOD_NM, disc, pattern, polygon_energy

SITES = 60
SIDE_NM = SITES * PERIOD_NM
BEAM = BeamPsf.of(
    [BeamTerm("gauss", 0.5, 8.0), BeamTerm("power", 0.2, 20.0, 2.6), BeamTerm("gauss", 0.3, 9000.0)], "assumption"
)


def square_lens(seed: int) -> PillarMap:
    sizes = 2.0 * np.random.default_rng(3).integers(50, 126, (40, 2))
    return pattern(sizes, np.random.default_rng(seed).integers(1, 41, (SITES, SITES)))


def drawn(pillars: PillarMap, at_nm: tuple[float, float], dose: float) -> FloatArray:
    """Centre, width, length and dose of every pillar: shape (n, 5)."""
    index = pillars.to_array()
    row, column = np.nonzero(index)
    x, y = 1e3 * pillars.lattice.x_um()[column] + at_nm[0], 1e3 * pillars.lattice.y_um()[row] + at_nm[1]
    return np.column_stack([x, y, pillars.size_nm()[index[row, column]], np.full(row.size, dose)])


def direct(figures: FloatArray, x: float, y: float) -> float:
    middle_x, middle_y, width, length, dose = figures.T
    total = 0.0
    for weight, beta in zip(BEAM.weight, BEAM.range_nm, strict=True):
        along_x = erf((x - middle_x + 0.5 * width) / beta) - erf((x - middle_x - 0.5 * width) / beta)
        along_y = erf((y - middle_y + 0.5 * length) / beta) - erf((y - middle_y - 0.5 * length) / beta)
        total += float(0.25 * weight * (dose * along_x * along_y).sum())
    return total


def energies(resist: ResistEnergy, dose: np.ndarray) -> FloatArray:
    """Energy of all others at both kinds of edges, and of all at the centre, of every pillar: shape (3, n_y, n_x)."""
    found = np.zeros((3, *dose.shape))

    def keep(tile: TileEnergy) -> FloatArray:
        found[:, tile.rows, tile.columns] = [tile.centre, *tile.others]
        return np.empty(0)

    with ThreadPoolExecutor(1) as threads:
        for _ in resist.map_tiles(dose, threads, keep):
            pass
    return found


@pytest.mark.parametrize("gap_nm", [0.0, 3000.0])
def test_other_lenses_and_figures_agree_with_a_direct_sum(gap_nm: float) -> None:
    """Lenses at both sides, one off the lattice, with doses of their own; bars of 0.1 to 80 um.

    Without them the energy at the facing rim is 0.01 to 0.1 lower. 1e-4 is the error of the lens alone.
    """
    lens, right, left = square_lens(1), square_lens(2), square_lens(5)
    lenses = (OtherLens(right, (SIDE_NM + gap_nm, 130.0), 1.3), OtherLens(left, (-SIDE_NM - gap_nm, -7000.0), 0.7))
    half = 0.5 * SIDE_NM
    bars = np.array([
        [-3000.0, half + 700.0, 4000.0, half + 2700.0],
        [-40000.0, -half - 14500.0, 40000.0, -half - 9500.0],
        [5000.0, -half - 1000.0, 5100.0, -half - 300.0],
    ])  # fmt: skip
    resist = ResistEnergy(lens, BEAM).among(Beside(lenses, bars, lens_dose=1.1))
    dose = np.full(lens.lattice.shape, 1.1, dtype=np.float32)
    found = energies(resist, dose)
    own = drawn(lens, (0.0, 0.0), 1.1)
    middle, sides = 0.5 * (bars[:, :2] + bars[:, 2:]), bars[:, 2:] - bars[:, :2]
    others = [drawn(one.pillars, one.at_nm, one.dose) for one in lenses]
    figures = np.concatenate([own, *others, np.column_stack([middle, sides, np.ones(3)])])
    for row, column in ((0, 59), (30, 0), (59, 30), (0, 44)):
        pillar = own[row * SITES + column]
        x, y, w, length, _ = pillar
        places = [(x, y), (x + 0.5 * w, y), (x - 0.5 * w, y), (x, y + 0.5 * length), (x, y - 0.5 * length)]
        whole = np.array([direct(figures, *place) for place in places])
        expected = np.array([whole[0], whole[1:3].mean(), whole[3:].mean()])
        np.testing.assert_allclose(resist.direct(dose, row, column), expected, atol=1e-7)
        expected[1] -= direct(pillar[None], *places[1])
        expected[2] -= direct(pillar[None], *places[3])
        np.testing.assert_allclose(found[:, row, column], expected, atol=1e-4)


def test_round_pillars_of_another_lens_are_their_polygons() -> None:
    """Discs 100 nm beside the lens, by Owen's function of each polygon; 1e-4 is the error of a lens."""
    pillars, outline = pattern(np.array([(240.0, 240.0)]), disc(24, 1)), Outline("ellipse", 0.5)
    at_nm = (24 * PERIOD_NM + 100.0, 0.0)
    lone = np.zeros((24, 24), dtype=np.uint16)
    lone[12, 23] = 1
    target = pattern(np.array([(240.0, 240.0)]), lone)
    dose = np.ones((24, 24), dtype=np.float32)
    resist = ResistEnergy(target, BEAM, outline).among(Beside((OtherLens(pillars, at_nm),), outline=outline))
    found = energies(resist, dose)[1, 12, 23]
    x, y = 1e3 * target.lattice.x_um()[23], 1e3 * target.lattice.y_um()[12]
    polygon = 0.5 * outline.vertices(480, 480)
    figures = drawn(pillars, at_nm, 1.0)
    expected = [
        sum(polygon_energy(BEAM, polygon + row[:2] - (x + side, y)) for row in figures) for side in (120.0, -120.0)
    ]
    assert found == pytest.approx(np.mean(expected), abs=1e-4)
    assert found > 0.02


def test_strips_have_the_area_and_the_energy_of_their_polygon() -> None:
    """An octagon, a frame by a slit, and a concave arrow; energies at 0.4 um by Owen's function."""
    angle = (np.arange(8) + 0.5) * np.pi / 4.0
    octagon = 500.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    arrow = np.array([(0.0, 0.0), (400.0, -300.0), (200.0, 0.0), (400.0, 350.0)])
    square = np.array([(1.0, 0.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 0.0)])
    frame = np.concatenate([500.0 * square, 300.0 * square[::-1]])
    for polygon, count in ((octagon, None), (arrow, None), (frame, 6)):
        boxes = strips(polygon, 10.0)
        x, y = polygon.T
        area = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
        assert float(np.prod(boxes[:, 2:] - boxes[:, :2], axis=1).sum()) == pytest.approx(area, rel=1e-12)
        assert count is None or len(boxes) <= count
        sums = np.column_stack([0.5 * (boxes[:, :2] + boxes[:, 2:]), boxes[:, 2:] - boxes[:, :2], np.ones(len(boxes))])
        if polygon is not frame:
            assert direct(sums, -700.0, 60.0) == pytest.approx(
                polygon_energy(BEAM, polygon + np.array([700.0, -60.0])), abs=1e-6
            )
