"""Sizes chosen jointly: gaps kept, nothing lost, no seams, and the best there is where that can be counted out."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab import drc, layout, mask
from metafab.core.figures import MappingFigures
from metafab.layout import Lattice
from metafab.layout.joint import JointSizes
from metafab.library import Library, build_size_table
from metafab.phase.terms.profile import PhaseProfile
from metafab.spec import Design, UnitCell
from tests.conftest import ROOT
from tests.gaps_by_numpy import gaps_by_numpy
from tests.layout.conftest import sizes_at_sites

GAP_DBU = 280.0  # 140 nm: plain pillars up to 210 nm, joint ones up to 320 nm beside the smallest


@pytest.fixture(scope="module")
def wide_library(unit_cell: UnitCell) -> Library:
    """Sides from 100 to 320 nm by 20 nm; more than half a turn of phase lies beyond 210 nm."""
    side_nm = np.arange(100.0, 321.0, 20.0)
    own = np.linspace(0.0, 1.0, side_nm.size)
    width, length = own[None, :], own[:, None]
    t_xx, t_yy = (
        (1.2 - 0.2 * a * b)[None] * np.exp(2.2j * np.pi * (0.8 * a + 0.2 * b))[None]
        for a, b in ((width, length), (length, width))
    )
    r = np.full(t_xx.shape, 0.1)
    wavelength_nm = np.array([unit_cell.illumination.wavelength_nm])
    return Library(
        unit_cell, wavelength_nm, side_nm, side_nm.copy(), t_xx, t_yy, r, r.copy(), np.full(r.shape, 1e-3), "closed"
    )


@pytest.fixture(scope="module")
def joint(wide_library: Library) -> JointSizes:
    limits = {"max_width_nm": 210.0, "max_length_nm": 210.0}
    plain = build_size_table(wide_library, database_unit_nm=0.5, **limits)
    wide = build_size_table(wide_library, database_unit_nm=0.5, cells=2)
    return JointSizes.of(wide, plain, Lattice(period_dbu=(700, 700), shape=(1, 1), database_unit_nm=0.5), GAP_DBU)


def _block(
    joint: JointSizes, seed: int, shape: tuple[int, int], empty: float
) -> tuple[np.ndarray, np.ndarray, Lattice]:
    """Plain sizes of random targets, which lie on the grid of phases that candidates are kept for; a lattice."""
    random = np.random.default_rng(seed)
    target_rad = 2.0 * np.pi / len(joint.candidates) * random.integers(0, len(joint.candidates), (2, *shape))
    size_index = joint.table.sizes_for(*target_rad)
    size_index[random.random(shape) < empty] = 0
    return size_index, target_rad, Lattice(period_dbu=(700, 700), shape=shape, database_unit_nm=0.5)


def _overlap(joint: JointSizes, size_index: np.ndarray, target_rad: np.ndarray) -> float:
    t = np.moveaxis(joint.table.t[size_index], -1, 0) * (size_index > 0)
    return float(np.sum(t * np.exp(-1j * target_rad)).real)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10**6),
    shape=st.tuples(st.integers(1, 14), st.integers(1, 14)),
    empty=st.sampled_from([0.0, 0.2]),
    corner=st.tuples(st.integers(0, 7), st.integers(0, 7)),
)
def test_every_gap_is_kept_and_nothing_is_lost(
    joint: JointSizes, seed: int, shape: tuple[int, int], empty: float, corner: tuple[int, int]
) -> None:
    size_index, target_rad, lattice = _block(joint, seed, shape, empty)
    before = size_index.copy()
    joint.improve(size_index, target_rad, lattice, corner)
    assert np.array_equal(size_index > 0, before > 0)
    gaps = gaps_by_numpy(size_index, joint.table.size_dbu, lattice, GAP_DBU - 1e-6, shape[0])
    assert gaps.below == 0
    assert _overlap(joint, size_index, target_rad) >= _overlap(joint, before, target_rad) - 1e-9


def test_larger_pillars_are_used_and_pay(joint: JointSizes) -> None:
    size_index, target_rad, lattice = _block(joint, 5, (40, 40), 0.0)
    before = _overlap(joint, size_index, target_rad)
    joint.improve(size_index, target_rad, lattice, (0, 0))
    assert joint.table.size_dbu[size_index].max() > 420  # 210 nm, the plain limit
    assert _overlap(joint, size_index, target_rad) > 1.02 * before


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), across=st.booleans())
def test_two_pillars_get_the_best_pair_of_candidates(joint: JointSizes, seed: int, across: bool) -> None:
    """Every pair of the two lists is counted out."""
    size_index, target_rad, lattice = _block(joint, seed, (1, 2) if across else (2, 1), 0.0)
    lists = []
    for phase_x, phase_y, held in zip(*target_rad.reshape(2, -1), size_index.ravel(), strict=True):
        column, row = np.rint(np.array([phase_x, phase_y]) * len(joint.candidates) / (2.0 * np.pi)).astype(int)
        lists.append([*joint.candidates[row, column][joint.candidates[row, column] > 0], held])
    best = -np.inf
    for pair in product(*lists):
        block = np.array(pair, dtype=np.uint16).reshape(size_index.shape)
        gaps = gaps_by_numpy(block, joint.table.size_dbu, lattice, GAP_DBU - 1e-6, len(block))
        if gaps.below == 0:
            best = max(best, _overlap(joint, block, target_rad))
    joint.improve(size_index, target_rad, lattice, (0, 0))
    assert _overlap(joint, size_index, target_rad) == pytest.approx(best, abs=1e-9)


_PLAIN_PYTHON = """
import pickle, sys
with open(sys.argv[1], "rb") as stream:
    joint, size_index, target_rad, lattice = pickle.load(stream)
joint.improve(size_index, target_rad, lattice, (1, 2))
with open(sys.argv[1], "wb") as stream:
    pickle.dump(size_index, stream)
"""


def test_compiled_and_plain_python_agree(joint: JointSizes, tmp_path: Path) -> None:
    size_index, target_rad, lattice = _block(joint, 11, (12, 13), 0.1)
    block = tmp_path / "block.pickle"
    block.write_bytes(pickle.dumps((joint, size_index, target_rad, lattice)))
    joint.improve(size_index, target_rad, lattice, (1, 2))
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", _PLAIN_PYTHON, block], env=environment, check=True)
    assert np.array_equal(pickle.loads(block.read_bytes()), size_index)


def test_lists_fall_in_overlap_and_hold_a_size_that_fits_anywhere(joint: JointSizes) -> None:
    """The best of all sizes comes first; a list that is not full holds a size for beside the largest."""
    cells = len(joint.candidates)
    for row, column in np.random.default_rng(2).integers(0, cells, (50, 2)):
        phases = 2.0 * np.pi * np.array([column, row]) / cells
        overlap = np.real(joint.table.t @ np.exp(-1j * phases))
        listed = joint.candidates[row, column][joint.candidates[row, column] > 0]
        assert overlap[listed[0]] == pytest.approx(overlap[1:].max(), abs=1e-12)
        assert np.all(np.diff(overlap[listed]) <= 1e-12)
        if listed.size < joint.candidates.shape[-1]:
            assert joint.table.size_dbu[listed].max(axis=1).min() <= 2 * (700 - GAP_DBU) - 640


@pytest.fixture(scope="module")
def pairs_design(tiny_design: Design, wide_library: Library) -> Design:
    rules = replace(tiny_design.rules, min_gap_nm=140.0, gap_rule="pairs")
    return replace(tiny_design, unit_cell=wide_library.unit_cell, rules=rules)


@pytest.mark.parametrize(("tile_sites", "workers"), [(17, 1), (51, 3), (476, 2)])
def test_tiling_and_workers_change_nothing(
    tile_sites: int, workers: int, profile: PhaseProfile, wide_library: Library, pairs_design: Design
) -> None:
    reference = layout.assign(profile, wide_library, pairs_design)
    design = replace(pairs_design, numerics=replace(pairs_design.numerics, tile_sites=tile_sites))
    with ThreadPoolExecutor(workers) as threads:
        other = layout.assign(profile, wide_library, design, executor=threads)
    assert np.array_equal(other.pillars.to_array(), reference.pillars.to_array())
    assert other.figures.min_gap_nm == reference.figures.min_gap_nm >= 140.0


def stored(figures: MappingFigures) -> dict[str, object]:
    """The figures that a file holds: those that were computed."""
    return {name: value for name, value in asdict(figures).items() if value is not None}


def test_the_gain_over_the_plain_rule_is_told(
    profile: PhaseProfile, wide_library: Library, pairs_design: Design, tmp_path: Path
) -> None:
    assignment = layout.assign(profile, wide_library, pairs_design)
    pairs = assignment.figures
    each = replace(pairs_design, rules=replace(pairs_design.rules, gap_rule="each"))
    plain = layout.assign(profile, wide_library, each).figures
    assert assignment.gap_rule_each is not None
    each_figures = stored(assignment.gap_rule_each)
    assert each_figures == pytest.approx(stored(plain), rel=1e-12)
    assert pairs.efficiency > plain.efficiency
    assert pairs.phase_rms_error_rad < plain.phase_rms_error_rad
    mask.write(assignment.pillars, tmp_path, pairs_design, mapping=assignment)
    sidecar = json.loads((tmp_path / "layout.json").read_text())
    assert sidecar["mapping"]["gap_rule_each"] == each_figures
    assert sidecar["mapping"]["efficiency"] == pairs.efficiency
    report = drc.check(tmp_path / "layout.oas", pairs_design)
    assert report.clean
    assert report.min_gap_nm == pairs.min_gap_nm


def test_a_library_without_larger_sizes_is_mapped_as_ever(
    profile: PhaseProfile, smooth_library: Library, tiny_design: Design
) -> None:
    pairs = replace(tiny_design, rules=replace(tiny_design.rules, gap_rule="pairs"))
    found, plain = (layout.assign(profile, smooth_library, design) for design in (pairs, tiny_design))
    assert np.array_equal(sizes_at_sites(found.pillars), sizes_at_sites(plain.pillars))
    assert found.figures == plain.figures
