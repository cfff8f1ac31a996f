"""Repeats of a pattern, found among the pillars of a mask, and their orders by full wave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell.elements import orders_at
from metafab.cell.supercell import Supercell
from metafab.core.figures import OrdersFigures
from metafab.core.parallel.executor import SerialExecutor
from metafab.core.parallel.progress import silent
from metafab.core.storage.files import plain
from metafab.core.storage.tables import typed
from metafab.fullwave import repeats
from metafab.fullwave.repeats import measure_orders
from metafab.fullwave.written import site_cell, sizes_at
from metafab.layout import PillarMap
from metafab.library import Library
from tests.unit.fullwave.conftest import PERIOD_SITES


def _block(turns: np.ndarray) -> np.ndarray:
    """Responses of x and of y polarised light for phases in turns, of opposite signs; shape (2, n_y, n_x)."""
    ramp = np.exp(2j * np.pi * turns)
    return np.array([ramp, ramp.conj()])


@pytest.mark.parametrize(
    ("turns_x", "sites"),
    [
        (1.0 / 7.0, 7),
        (1.0 / 13.127, 13),
        (1.0 / 5.45, 11),  # 5 and 6 are 0.08 and 0.1 turns off
        (1.0 / 8.83, 9),  # 0.02 turns off, and 0.14 after seven times
        (0.0, 1),
        (1.0 / 250.0, 0),  # equal neighbours are no repeat of a slow phase
    ],
)
def test_a_repeat_is_exact_or_nearly_so(turns_x: float, sites: int) -> None:
    x, y = np.meshgrid(np.arange(100), np.arange(80))
    block = _block(x * turns_x + y / 4.0)
    assert repeats.repeat_sites([block], 1) == sites
    assert repeats.repeat_sites([block], 0) == 4


def test_neither_a_lens_nor_noise_repeats() -> None:
    x, y = np.meshgrid(np.arange(100) - 50.0, np.arange(100) - 50.0)
    noise = np.random.default_rng(3).random((100, 100))
    for turns in (2e-3 * (x**2 + y**2), 2e-4 * (x**2 + y**2), noise):
        assert repeats.repeat_sites([_block(turns)], 1) == 0
    # A ramp that differs from place to place repeats in each block, and not in both.
    ramps = [_block(x / sites) for sites in (7.0, 9.0)]
    assert [repeats.repeat_sites([ramp], 1) for ramp in ramps] == [7, 9]
    assert repeats.repeat_sites(ramps, 1) == 0


def test_the_orders_of_a_repeat_are_those_of_the_periodic_row(pillars: PillarMap, ramp_library: Library) -> None:
    found = measure_orders(pillars, ramp_library)
    assert (found.sites, found.windows, found.reason) == ((PERIOD_SITES, 1), 1, None)
    supercell = Supercell(site_cell(ramp_library), sizes_at(pillars, 0, 3, (1, PERIOD_SITES)))
    order = supercell.propagating_orders("x")
    t = orders_at(supercell, ("x", "y"), 4.0)
    assert {row.polarisation for row in found.orders} == {"x", "y"}
    for row in found.orders:
        p = "xy".index(row.polarisation)
        power = supercell.relative_power(order, t[:, :, p], row.polarisation)
        expected = power[np.all(order == row.order, axis=1)].item()
        assert row.efficiency == pytest.approx(expected, abs=min(row.error, 0.01))
        # The library holds ramps of one turn in seven sites, with |t| = 0.9, into the air from sapphire.
        wanted = row.order == ((1, 0) if row.polarisation == "x" else (-1, 0))
        assert row.wanted == wanted
        assert row.library_efficiency == pytest.approx(0.81 / 1.7601 if wanted else 0.0, rel=1e-3, abs=1e-6)
        sine = row.order[0] * 800.0 / (PERIOD_SITES * 350.0)
        assert np.sin(np.radians(row.angle_x_deg)) == pytest.approx(sine, abs=1e-9)
    assert typed(OrdersFigures, plain(found)) == found
    assert f"by full wave of {PERIOD_SITES} x 1 pillars" in found.sentence


@pytest.mark.parametrize(("uneven", "fine"), [(0.002, 3.0), (0.2, 7.0)])
def test_windows_whose_change_is_alike_are_solved_finely_by_the_few(
    uneven: float, fine: float, ramp_library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Efficiencies of 0.7 to 0.84 that fall by 0.02 from order 2 to order 3, by more or less in each window."""
    windows, random = [Supercell(site_cell(ramp_library), np.full((1, 4, 2), 100.0 + i)) for i in range(8)], np.zeros(8)
    truth, weight, draws = 0.7 + 0.02 * np.arange(8), np.ones(8), np.random.default_rng(2)

    def solved(work: tuple[Supercell, float]) -> tuple[np.ndarray, np.ndarray]:
        i, resolution = round(work[0].size_nm[0, 0, 0]) - 100, work[1]
        return np.zeros((3, 2, 2), complex), np.full((2, 3), truth[i] + (0.02 + random[i]) * (3.0 - resolution))

    monkeypatch.setattr(repeats, "solve_window", solved)
    counts, within = [], []
    for _ in range(50):
        random = uneven * draws.standard_normal(8)
        found = repeats.solve_windows(windows, weight, SerialExecutor(), silent)
        change, error, bound = repeats.mean_change(found, weight, windows[0].cell)
        assert np.all(error <= 0.5 * bound)
        assert len(set(found.fine)) == len(found.change)
        counts.append(len(found.fine))
        within.append(np.all(np.abs(found.coarse.mean(axis=0) + change - truth.mean()) <= 2.0 * error + 1e-12))
    assert np.median(counts) == fine
    # Two standard errors of three draws hold 82 %.
    assert np.mean(within) > 0.7


def test_wanted_orders_are_listed_and_summed_however_faint(
    pillars: PillarMap, ramp_library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A splitter into many orders has none of 3 %; here the least that is listed is raised instead."""
    monkeypatch.setattr(repeats, "_LISTED", 0.99)
    found = measure_orders(pillars, ramp_library)
    assert [(row.polarisation, row.order, row.wanted) for row in found.orders] == [
        ("x", (1, 0), True),
        ("y", (-1, 0), True),
    ]
    assert found.wanted("x")[2] == pytest.approx(0.81 / 1.7601, rel=1e-3)


def test_what_is_not_solved_says_why(pillars: PillarMap, ramp_library: Library) -> None:
    for changed, limit_s, why in (
        (pillars, 1e-3, "processor time"),
        (replace(pillars, angle_deg=np.zeros(len(pillars.size_dbu))), 60.0, "upright"),
    ):
        found = measure_orders(changed, ramp_library, limit_s=limit_s)
        assert found.sites is None and found.orders == ()
        assert found.reason is not None and why in found.reason
        assert found.sentence.startswith("by the library alone: ")
    index = np.random.default_rng(1).integers(1, PERIOD_SITES + 1, pillars.lattice.shape).astype(np.uint16)
    random = PillarMap.from_array(pillars.lattice, pillars.size_dbu, index, 16)
    assert "do not repeat within 40 sites along x and y" in (measure_orders(random, ramp_library).reason or "")
