"""The sequence of truncations that the certified solver tries."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from metafab.cell import CellNumerics, PillarCell
from metafab.cell.pillar import Slice
from metafab.cell.rcwa.certificate import bound, ladder
from metafab.cell.rcwa.convergence import convergence
from tests.paper_cell import SILICON


def test_seven_cosines_are_skipped_where_claims_were_measured() -> None:
    """Pillars that six cosines did not serve go on to eight, unless seven are all that may be had."""
    measured, other = convergence(SILICON), convergence(replace(SILICON, angle_deg=10.0))
    assert measured.is_measured and not other.is_measured
    assert ladder(CellNumerics(target_error=1e-3), measured)[:4] == (4, 6, 8, 9)
    assert ladder(CellNumerics(target_error=1e-3), other)[:5] == (4, 5, 6, 7, 8)
    assert ladder(CellNumerics(target_error=1e-2), other)[:4] == (3, 4, 5, 6) and ladder(
        CellNumerics(target_error=1e-2), measured
    )[:3] == (
        3,
        5,
        6,
    )
    assert ladder(CellNumerics(target_error=1e-3, max_orders=7), measured) == (4, 6, 7)


def test_seven_cosines_are_tried_where_pillars_stand_close() -> None:
    """Their claims have a margin that grows with the size, so that eight would often be more than they need."""
    near, close = convergence(replace(SILICON, width_nm=220.0)), convergence(replace(SILICON, width_nm=250.0))
    assert near.claims_margin == 1.0
    assert close.is_measured and close.claims_margin == pytest.approx(1.0 + 16.0 * (250.0 / 350.0 - 0.63))
    for target_error in (1e-2, 1e-3):
        assert ladder(CellNumerics(target_error=target_error), close)[:4] == (4, 6, 7, 8)


def test_a_strong_near_field_raises_the_bound_of_measured_cells_alone() -> None:
    measured, other = convergence(SILICON), convergence(replace(SILICON, angle_deg=10.0))
    close = convergence(replace(SILICON, width_nm=250.0))
    claimed, raised = (bound(6, {4: 1e-4}, measured, near_field=each) for each in (1.0, 20.0))
    assert claimed == bound(6, {4: 1e-4}, measured) == 3e-4
    # The margin of close pillars is one of the claims: their near field tells as much as that of others.
    assert raised == bound(6, {4: 1e-4}, close, near_field=20.0) == pytest.approx(2.4e-3)
    # Eight cosines have a claim that no resonance broke, and other cells rules of their own.
    assert bound(8, {6: 1e-4}, measured, near_field=20.0) == bound(8, {6: 1e-4}, measured)
    assert bound(6, {5: 1e-4, 4: 1e-4}, other, near_field=20.0) == bound(6, {5: 1e-4, 4: 1e-4}, other)


def test_waves_in_a_dense_cap_must_be_resolved() -> None:
    """With 7 and 8 cosines this cell's amplitudes differ by 0.001, and both are off by 0.08; with 10, by 0.003."""
    cap = Slice(62.0333, 4.21017, 1.0)
    plain = PillarCell(
        period_nm=(357.8265, 532.793),
        width_nm=264.114,
        length_nm=481.213,
        height_nm=1243.31,
        n_pillar=3.25397,
        n_substrate=(1.7601, 1.7601),
        n_ambient=1.0,
        wavelength_nm=602.559,
    )
    capped = replace(plain, over=(cap,))
    assert [convergence(capped).least_error(orders) for orders in (8, 9, 10)] == [1.0, 1.0, 0.0]
    assert convergence(plain).least_error(8) == 0.0
    assert convergence(plain).least_error(7) == pytest.approx(1e-3 * 2.25397 * 2.0 * math.pi * 1243.31 / 602.559)
