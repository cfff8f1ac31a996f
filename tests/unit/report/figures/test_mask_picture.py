"""Pictures of a mask: area of all pillars, and the pillars of the zooms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.layout.outlines import Outline
from metafab.layout.pillars import Lattice, PillarMap
from metafab.report.figures.mask import picture_of
from tests.closed_form_run import pillar_map


def test_mask_picture_counts_every_pillar_once() -> None:
    """Tiles of 40 sites do not divide 101: area over blocks must be the area of all pillars all the same."""
    pillars = pillar_map()
    picture = picture_of(pillars)
    period_nm = 350.0
    covered_nm2 = np.nansum(picture.fill) * (period_nm * picture.sites_a_pixel) ** 2
    index = pillars.to_array()
    expected_nm2 = np.prod(pillars.size_nm(), axis=1)[index].sum()
    assert covered_nm2 == pytest.approx(expected_nm2, rel=1e-12)
    assert picture.half_side_um == pytest.approx((0.175 * 101, 0.175 * 101))


@pytest.mark.parametrize("tile_sites", [7, 40, 101])
def test_mask_zoom_shows_the_pillars_of_the_map(tile_sites: int) -> None:
    whole = pillar_map()
    pillars = PillarMap.from_array(whole.lattice, whole.size_dbu, whole.to_array(), tile_sites)
    close = picture_of(pillars).zooms[1]
    assert close.shape == (100, 4)
    index, size_nm = whole.to_array(), whole.size_nm()
    x_um, y_um = whole.lattice.x_um(), whole.lattice.y_um()
    for x, y, width, length in close:
        row, column = int(np.argmin(abs(y_um - y))), int(np.argmin(abs(x_um - x)))
        assert (x_um[column], y_um[row]) == (x, y)
        np.testing.assert_allclose(1e3 * np.array([width, length]), size_nm[index[row, column]])


def test_big_lenses_are_binned() -> None:
    """More sites than pixels: blocks of sites share a pixel, and a full lattice is covered evenly."""
    whole = pillar_map()
    lattice = replace(whole.lattice, shape=(401, 801))
    pillars = PillarMap.from_array(lattice, whole.size_dbu, np.ones(lattice.shape, dtype=np.uint16), 286)
    picture = picture_of(pillars)
    assert picture.sites_a_pixel == 3
    assert picture.fill.shape == (134, 267)
    share = 100.0 * 200.0 / 350.0**2
    np.testing.assert_allclose(picture.fill[:-1], share, rtol=1e-12)


def test_mask_picture_of_a_hexagonal_lattice_shows_as_many_pillars_of_their_own_area() -> None:
    lattice = Lattice(period_dbu=(380, 658), shape=(61, 121), database_unit_nm=0.5, hexagonal=True)
    index = lattice.carries(np.arange(61), np.arange(121)).astype(np.uint16)
    circle = Outline("ellipse", 0.5)
    pillars = PillarMap.from_array(lattice, np.array([[0, 0], [300, 300]], dtype=np.int32), index, 40)
    picture = picture_of(pillars, circle)
    assert len(picture.zooms[1]) == 100
    across, along = np.ptp(picture.zooms[1][:, :2], axis=0)
    assert across == pytest.approx(along, rel=0.25)
    # Each block of two columns and two rows holds two pillars: even grey, of the circle's own area.
    share = np.pi / 4.0 * 300.0**2 / (380.0 * 658.0) / 2.0
    assert picture.fill[:-1, :-1] == pytest.approx(share, rel=0.01)
