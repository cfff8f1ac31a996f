"""Sizes for several lights: the largest weighted overlap of all sizes, and constant phases that no others beat."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import pillar_cell
from metafab.core.conventions import FloatArray
from metafab.library import Library, build_size_table
from metafab.library.use.amplitudes import power_ratio_of, power_transmittance
from metafab.library.use.lights import SizesOfLights

LIGHTS = 3
WEIGHTS = (1.0, 0.5, 2.0)


@pytest.fixture(scope="module")
def libraries(smooth_library: Library) -> list[Library]:
    """The smooth library at three wavelengths: the phases of its sizes grow with the wave number."""
    at = []
    for stretch in (1.0, 1.2, 0.8):
        t_xx, t_yy = (
            np.abs(t) * np.exp(1j * stretch * _unwrapped(t)) for t in (smooth_library.t_xx, smooth_library.t_yy)
        )
        at.append(replace(smooth_library, t_xx=t_xx, t_yy=t_yy))
    return at


def _unwrapped(t: np.ndarray) -> FloatArray:
    return np.asarray(np.unwrap(np.unwrap(np.angle(t), axis=1), axis=2))


@pytest.fixture(scope="module")
def sizes(libraries: list[Library]) -> SizesOfLights:
    table = build_size_table(libraries[0], database_unit_nm=0.5, cells=2)
    return SizesOfLights.of(table, libraries, WEIGHTS)


def weighted_overlaps(sizes: SizesOfLights, target_rad: FloatArray) -> FloatArray:
    """Overlap of every size with targets of shape (lights, 2), from the amplitudes of the tables."""
    return np.asarray(
        sum(
            weight * (table.t[1:] * np.exp(-1j * target)).real.sum(axis=1)
            for weight, table, target in zip(WEIGHTS, sizes.tables, target_rad, strict=True)
        )
    )


def test_each_site_gets_the_best_of_all_sizes(sizes: SizesOfLights) -> None:
    """Brute force over all sizes at 50 sites; ties may name another size, never a smaller overlap."""
    targets = np.random.default_rng(0).uniform(-20.0, 20.0, (LIGHTS, 2, 5, 10))
    index, overlap = sizes.best(targets)
    assert index.shape == overlap.shape == (5, 10)
    for place in np.ndindex(5, 10):
        every = weighted_overlaps(sizes, targets[(..., *place)])
        assert overlap[place] == pytest.approx(every.max(), abs=1e-12)
        assert every[index[place] - 1] == pytest.approx(every.max(), abs=1e-12)


@pytest.mark.parametrize("axis", ["angle_x_deg", "angle_y_deg"])
def test_slanting_light_counts_by_its_power(axis: str, smooth_library: Library) -> None:
    """Power along z per |E|^2 in the surface is n / cos for p polarised light and n cos for s, on both sides."""
    slanting = replace(smooth_library, corner={axis: 25.0})
    cell = pillar_cell(smooth_library.unit_cell, 0.0, 0.0)
    n_in, n_out = (complex(n[0]).real for n in (cell.n_in, cell.n_out))
    inside, outside = (math.sqrt(1.0 - (n_in / n * math.sin(math.radians(25.0))) ** 2) for n in (n_in, n_out))
    p, s = (n_out / outside) / (n_in / inside), (n_out * outside) / (n_in * inside)
    ratio = np.array([p, s] if axis == "angle_x_deg" else [s, p])
    assert power_ratio_of(slanting) == pytest.approx(ratio, rel=1e-12)
    assert power_transmittance(slanting) == pytest.approx(np.abs(slanting.t) ** 2 * ratio)
    table = build_size_table(smooth_library, database_unit_nm=0.5, cells=2)
    sizes = SizesOfLights.of(table, [smooth_library, slanting], (1.0, 1.0))
    targets = np.random.default_rng(4).uniform(-math.pi, math.pi, (2, 2, 30))
    chosen = sizes.best(targets)[0]
    assert np.any(chosen != SizesOfLights.of(table, [smooth_library] * 2, (1.0, 1.0)).best(targets)[0])
    for site in range(30):
        along, aslant = ((table.t[1:] * np.exp(-1j * at)).real for at in targets[..., site])
        every = (along + np.sqrt(ratio * n_in / n_out) * aslant).sum(axis=1)
        assert every[chosen[site] - 1] == pytest.approx(every.max(), abs=1e-12)


def test_a_single_light_is_mapped_as_by_the_table(smooth_library: Library) -> None:
    table = build_size_table(smooth_library, database_unit_nm=0.5)
    one = SizesOfLights.of(table, [smooth_library], [3.0])
    cell = np.random.default_rng(1).integers(0, table.cells, (2, 200))
    _, overlap = one.best((2.0 * math.pi / table.cells * cell)[None])
    assert overlap == pytest.approx(3.0 * table.overlap[cell[1], cell[0]], abs=1e-12)


def test_a_light_of_large_weight_decides_alone(libraries: list[Library]) -> None:
    table = build_size_table(libraries[0], database_unit_nm=0.5, cells=2)
    targets = np.random.default_rng(2).uniform(-math.pi, math.pi, (LIGHTS, 2, 40))
    both = SizesOfLights.of(table, libraries, (1e-9, 1.0, 1e-9)).best(targets)[0]
    alone = SizesOfLights.of(table, libraries[1:2], (1.0,)).best(targets[1:2])[0]
    assert np.array_equal(both, alone)


def test_sizes_beyond_the_target_error_count_less(libraries: list[Library]) -> None:
    """The size that suits all targets exactly loses to others once one light does not know it."""
    table = build_size_table(libraries[0], database_unit_nm=0.5, cells=2)
    known = SizesOfLights.of(table, libraries, WEIGHTS)
    wanted = 1234
    targets = np.angle(np.stack([each.t[wanted] for each in known.tables]))[..., None]
    assert known.best(targets)[0][0] == wanted
    row, column = np.nonzero(libraries[0].known)
    error = np.array(np.broadcast_to(libraries[2].error, libraries[2].t_xx.shape))
    error[0, row[wanted - 1], column[wanted - 1]] = 1.0
    doubted = SizesOfLights.of(table, [*libraries[:2], replace(libraries[2], error=error)], WEIGHTS)
    assert doubted.best(targets)[0][0] != wanted


def test_constant_phases_beat_any_draw(sizes: SizesOfLights) -> None:
    """No other constants of 60 draws reach the total overlap of those found; without any it is smaller by far."""
    radius = np.linspace(0.0, 1.0, 60)
    targets = np.stack([np.broadcast_to(-30.0 * k * radius**2, (2, 60)) for k in (1.0, 1.2, 0.8)])
    found = sizes.constant_phases(targets)
    assert found.shape == (LIGHTS, 2)
    total = sizes.best(targets + found[..., None])[1].sum()
    draws = np.random.default_rng(3).uniform(-math.pi, math.pi, (60, LIGHTS, 2))
    assert total >= max(sizes.best(targets + draw[..., None])[1].sum() for draw in draws)
    assert total > 1.02 * sizes.best(targets)[1].sum()
    assert np.all(sizes.constant_phases(targets[..., :0]) == 0.0), "no sampled site"
    kept = [True, False, True]
    together = sizes.constant_phases(targets, kept)
    assert np.array_equal(together[:, 0] == together[:, 1], kept)
    draws[:, kept, 1] = draws[:, kept, 0]
    assert sizes.best(targets + together[..., None])[1].sum() >= max(
        sizes.best(targets + draw[..., None])[1].sum() for draw in draws
    )
