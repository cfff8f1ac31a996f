"""Field of a mask among its neighbours: tiles, workers, and refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import pillar_cell
from metafab.cell.supercell import Supercell
from metafab.core.conventions import ComplexArray
from metafab.core.errors import InputError
from metafab.core.figures import LineStatistics
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library.library import Library
from metafab.library.neighbours.evaluation import block_corrections, solve_supercell
from metafab.library.neighbours.line import LineShape, initial_model
from metafab.library.neighbours.model import Neighbours, TrainedLine
from metafab.library.use.oblique import ObliqueChange, powers
from metafab.optics import Source, neighbour_field, written_field
from metafab.optics.sources import neighbours
from metafab.optics.sources.oblique import ObliqueField, neighbour_map_of
from metafab.optics.sources.source import ApodisedField

SPAN = (100.0, 250.0)


@pytest.fixture
def library(smooth_library: Library) -> Library:
    """A library with chains of random parameters."""
    along, across = (
        TrainedLine(
            initial_model(LineShape(4, 2, 3), SPAN, SPAN, seed), LineStatistics(error_floor=0.0, error_slope=0.1)
        )
        for seed in (1, 2)
    )
    return replace(smooth_library, neighbours=Neighbours((along, along), (across, across)))


def _map(index: np.ndarray, tile_sites: int) -> PillarMap:
    sizes = 2 * np.random.default_rng(3).integers(100, 251, (41, 2)).astype(np.int32)
    sizes[0] = 0
    return PillarMap.from_array(
        Lattice(period_dbu=(700, 700), shape=index.shape, database_unit_nm=0.5), sizes - sizes % 4, index, tile_sites
    )


def _whole(field: Source) -> ComplexArray:
    whole = np.zeros((2, *field.lattice.shape), dtype=np.complex128)
    for tile in field.tiles():
        for polarisation in (0, 1):
            amplitude = tile.amplitude(polarisation)
            n_y, n_x = amplitude.shape
            whole[polarisation, tile.row : tile.row + n_y, tile.column : tile.column + n_x] = amplitude
    return whole


def test_light_at_an_angle_adds_its_change(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the first pass and on later ones, whose tiles are read from a file; tiles without pillars are left out."""
    monkeypatch.setattr(neighbours, "_TILE_SITES", 32)
    index = np.random.default_rng(1).integers(0, 41, (90, 70)).astype(np.uint16)
    index[32:64, :32] = 0
    coefficients = np.random.default_rng(2).normal(size=(41, 4, 2)) * (1.0 + 1j)
    coefficients[0] = 0.0
    straight, tangent = neighbour_field(_map(index, 90), library, workers=1), (0.3, -0.2)
    change = np.einsum("k,nkp->pn", powers(tangent), coefficients)[:, index]
    oblique = ObliqueField(straight, ObliqueChange(coefficients, 0.3, 0.0, 0.0), tangent)
    for _ in range(2):
        assert _whole(oblique) == pytest.approx(_whole(straight) + change, abs=1e-12)
    assert next(oblique.tiles()).polarisations == 10


def test_tiles_and_workers_do_not_change_the_field(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    index = np.random.default_rng(1).integers(0, 41, (90, 150)).astype(np.uint16)
    index[:20, :30] = 0
    whole = _whole(neighbour_field(_map(index, 90), library, workers=1))
    assert np.array_equal(whole == 0.0, np.broadcast_to(index == 0, whole.shape))
    monkeypatch.setattr(neighbours, "_TILE_SITES", 48)
    tiled = _whole(neighbour_field(_map(index, 24), library, workers=1))
    assert np.array_equal(tiled, _whole(neighbour_field(_map(index, 24), library, workers=3)))
    lone = written_field(_map(index, 90), library).table[index].transpose(2, 0, 1)
    assert np.abs(whole - lone).max() > 1e-2
    # Tiles end with 24 neighbours a side.
    assert np.abs(tiled - whole).max() < 1e-4 * np.abs(whole - lone).max()


@pytest.mark.parametrize("in_memory_bytes", [1 << 26, 0])
def test_the_first_pass_keeps_the_field_for_those_that_follow(
    library: Library, monkeypatch: pytest.MonkeyPatch, in_memory_bytes: int
) -> None:
    index = np.random.default_rng(4).integers(0, 41, (30, 70)).astype(np.uint16)
    index[:, 16:32] = 0  # a tile without pillars
    monkeypatch.setattr(neighbours, "_TILE_SITES", 16)
    monkeypatch.setattr(neighbours, "_IN_MEMORY_BYTES", in_memory_bytes)
    field = neighbour_field(_map(index, 30), library)
    next(field.tiles())  # a pass that is given up keeps nothing
    whole = _whole(field)
    monkeypatch.setattr(neighbours, "_passive", None)  # no tile can be solved any more
    assert np.array_equal(_whole(field), whole)


def test_the_map_sums_blocks_of_the_field(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over tiles, with NaN where no pillar stands, and behind a stop."""
    monkeypatch.setattr(neighbours, "_TILE_SITES", 32)
    index = np.random.default_rng(1).integers(1, 41, (50, 70)).astype(np.uint16)
    index[16:32, 32:48] = 0
    field = neighbour_field(_map(index, 50), library, workers=2)
    assert neighbour_map_of(field) is None
    among, lone = _whole(field)[1], written_field(_map(index, 50), library).table[index, 1]
    found = neighbour_map_of(ApodisedField(field, lambda x, y: np.ones((y.size, x.size))))
    assert found is not None and found.change.shape == (2, 4, 5)
    assert np.isnan(found.change[:, 1, 2]).all() and np.isfinite(found.kept).sum() == 2 * 19
    block = np.s_[32:48, 64:]  # at an end
    power = np.sum(np.abs(lone[block]) ** 2)
    assert found.change[1, 2, 4] == pytest.approx(np.sqrt(np.sum(np.abs(among - lone)[block] ** 2) / power))
    assert found.kept[1, 2, 4] == pytest.approx(np.abs(np.vdot(lone[block], among[block]) / power) ** 2)
    assert (found.x_um[4], found.y_um[2]) == pytest.approx((field.lattice.x_um()[64:].mean(), 0.35 * (39.5 - 24.5)))


def test_a_periodic_mask_has_the_field_of_its_period(library: Library) -> None:
    assert library.neighbours is not None
    period = np.random.default_rng(2).integers(1, 41, (3, 4)).astype(np.uint16)
    pillars = _map(np.tile(period, (35, 30)), 100)
    field = _whole(neighbour_field(pillars, library))
    sizes = pillars.size_nm()[period]
    stored = library.at_sizes(sizes[..., 0], sizes[..., 1])
    for axis, t in enumerate((stored.t_xx, stored.t_yy)):
        closed = t + block_corrections(library.neighbours, sizes, axis).sum(axis=0)
        # Scaled to power, n_out / n_in = 1 / 1.7601, and to no more light than arrives.
        inner = field[axis, 51:54, 60:64]
        ratio = inner / closed
        assert np.abs(ratio - ratio[0, 0]).max() < 1e-4
        assert abs(ratio[0, 0]) <= 1.7601**-0.5 + 1e-6


def test_a_block_of_equal_rows_is_as_certain_as_one_of_them(library: Library) -> None:
    assert library.neighbours is not None
    cell = pillar_cell(library.unit_cell, 0.0, 0.0)
    row = np.array([[(120.0, 180.0), (150.0, 150.0), (200.0, 140.0)]])
    alone, equal = (solve_supercell(library, Supercell(cell, np.tile(row, (rows, 1, 1)))) for rows in (1, 2))
    # The block's columns are lines of equal pillars: they add the error of such a line, 0 in these statistics.
    assert equal.error == pytest.approx(alone.error, rel=1e-9)
    unlike = solve_supercell(library, Supercell(cell, np.concatenate([row, row[:, ::-1]])))
    assert unlike.error > 2.0 * equal.error


def test_libraries_without_a_model_and_turned_pillars_are_refused(library: Library, smooth_library: Library) -> None:
    pillars = _map(np.ones((4, 4), dtype=np.uint16), 4)
    with pytest.raises(InputError, match="a model of neighbours"):
        neighbour_field(pillars, smooth_library)
    with pytest.raises(InputError, match="upright pillars in a rectangular lattice"):
        neighbour_field(replace(pillars, angle_deg=np.zeros(41)), library)


def test_windows_are_full_and_spread_over_the_mask() -> None:
    """Across tiles; none meets a gap or the rim."""
    index = np.random.default_rng(1).integers(1, 41, (90, 70)).astype(np.uint16)
    index[:, 30:40] = index[:20] = 0
    pillars = _map(index, 16)
    windows = neighbours.filled_windows(pillars, 12, 3)
    assert windows.shape == (12, 3, 3, 2)
    blocks = np.lib.stride_tricks.sliding_window_view(pillars.size_nm()[index], (3, 3), axis=(0, 1))
    places = [np.argwhere(np.all(blocks == window.transpose(2, 0, 1), axis=(2, 3, 4))) for window in windows]
    assert all(len(found) == 1 for found in places)
    rows, columns = np.concatenate(places).T
    assert np.ptp(rows) > 40 and (columns < 28).any() and (columns >= 40).any()
    assert len(neighbours.filled_windows(_map(np.eye(30, dtype=np.uint16), 16), 4, 3)) == 0
    assert len(neighbours.filled_windows(_map(index[:2], 16), 4, 3)) == 0
