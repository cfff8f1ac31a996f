"""Pillars cut from a written mask, and the local period on a line of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.fullwave.written import library_responses, local_period_sites, sizes_at, supercell_at
from metafab.layout import PillarMap
from metafab.library import Library
from tests.unit.fullwave.conftest import LATTICE


def test_a_block_holds_the_pillars_of_its_sites_across_tiles(pillars: PillarMap) -> None:
    whole = pillars.size_nm()[pillars.to_array()]
    np.testing.assert_array_equal(sizes_at(pillars, 10, 13, (9, 24)), whole[10:19, 13:37])


def test_beyond_the_lens_there_are_no_pillars(pillars: PillarMap) -> None:
    block = sizes_at(pillars, -2, 75, (5, 8))
    assert np.all(block[:2] == 0.0)
    assert np.all(block[:, 5:] == 0.0)
    assert np.all(block[2:, :5] > 0.0)


def test_turned_pillars_and_hexagonal_lattices_are_refused_for_rows_and_patches_alike(
    pillars: PillarMap, ramp_library: Library
) -> None:
    turned = replace(pillars, angle_deg=np.zeros(len(pillars.size_dbu)))
    staggered = replace(pillars, lattice=replace(LATTICE, hexagonal=True))
    for changed, got in ((turned, "turned"), (staggered, "hexagonal")):
        with pytest.raises(InputError, match=f"upright pillars in a rectangular lattice.*{got}"):
            supercell_at(changed, ramp_library, 0.0, 0.0, (3, 3))


def test_a_place_is_the_middle_of_its_block(pillars: PillarMap, ramp_library: Library) -> None:
    supercell, x_um, y_um = supercell_at(pillars, ramp_library, 2.0, -4.0, (3, 5))
    assert supercell.shape == (3, 5)
    assert abs(x_um[2] - 2.0) <= 0.175
    assert abs(y_um[1] + 4.0) <= 0.175
    column = int(np.argmin(np.abs(LATTICE.x_um() - x_um[0])))
    np.testing.assert_allclose(LATTICE.x_um()[column : column + 5], x_um, atol=1e-12)
    row = int(np.argmin(np.abs(LATTICE.y_um() - y_um[0])))
    np.testing.assert_array_equal(supercell.size_nm, sizes_at(pillars, row, column, (3, 5)))
    assert supercell.cell.n_pillar.real == pytest.approx(3.6941)
    with pytest.raises(InputError, match="x_um"):
        supercell_at(pillars, ramp_library, 20.0, 0.0, (3, 3))


def test_responses_are_the_librarys_and_dark_where_no_pillar_stands(pillars: PillarMap, ramp_library: Library) -> None:
    supercell = supercell_at(pillars, ramp_library, 13.9, 0.0, (2, 9))[0]
    responses = library_responses(supercell, ramp_library)
    gaps = np.all(supercell.size_nm == 0.0, axis=-1)
    assert gaps.any() and not gaps.all()
    assert np.all(responses[:, gaps] == 0.0)
    stored = ramp_library.at_sizes(*supercell.size_nm[~gaps].T)
    np.testing.assert_array_equal(responses[:, ~gaps], [stored.t_xx, stored.t_yy])


@pytest.mark.parametrize("sites", [3.0, 7.0, 12.4, 24.6])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_ramp_tells_its_period_and_direction(sites: float, sign: int) -> None:
    ramp = np.exp(2j * np.pi * sign * np.arange(64) / sites)
    assert local_period_sites(ramp) == (round(sites), sign)
    # An amplitude that varies with the same period, as resonant pillars make it, does not mislead it.
    assert local_period_sites(ramp * (1.0 + 0.4 * np.cos(2 * np.pi * np.arange(64) / sites)))[1] == sign


@pytest.mark.parametrize("sites", [np.inf, 90.0])
def test_a_phase_that_hardly_changes_has_no_local_period(sites: float) -> None:
    with pytest.raises(InputError, match="local period"):
        local_period_sites(np.exp(2j * np.pi * np.arange(64) / sites))
