"""What must hold of any cell, at any truncation: properties over random cells, with few orders to stay fast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from metafab.cell import PillarCell, Slice
from metafab.cell.fresnel import admittance, film_jones
from metafab.cell.rcwa import zero_order
from metafab.cell.rcwa.basis.coordinates import Formulation

#: Rounding; lossless cells may be resonant, with a quality of a hundred or so.
ROUNDING = 1e-10
ORDERS = 3

fills = st.floats(0.02, 0.98)
lengths_nm = st.floats(200.0, 700.0)
lossless = st.floats(1.2, 4.0)
lossy = st.builds(complex, lossless, st.floats(1e-3, 1.0))
formulations: st.SearchStrategy[Formulation] = st.sampled_from(("adaptive", "fourier"))


@st.composite
def cells(draw: st.DrawFn, index: st.SearchStrategy[complex]) -> PillarCell:
    """Any rectangle in any cell, with a cap of another outline on every third, light along the axis."""
    period = draw(lengths_nm), draw(lengths_nm)
    substrate = draw(st.floats(1.0, 2.0))
    cap = Slice(draw(st.floats(0.0, 100.0)), 1.41, 1.0, draw(fills) * period[0], draw(fills) * period[1])
    return PillarCell(
        period_nm=period,
        width_nm=draw(fills) * period[0],
        length_nm=draw(fills) * period[1],
        height_nm=draw(st.floats(1.0, 1500.0)),
        n_pillar=draw(index),
        n_substrate=(substrate, substrate),
        n_ambient=1.0,
        wavelength_nm=800.0,
        side=draw(st.sampled_from(("substrate", "ambient"))),
        over=(cap,) if draw(st.integers(0, 2)) == 0 else (),
    )


angles = st.tuples(st.floats(0.5, 60.0), st.sampled_from([0.0, 90.0, 180.0, 33.0, 200.0]))
often = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
fewer = settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def _tilted(cell: PillarCell, angle: tuple[float, float]) -> PillarCell:
    return replace(cell, angle_deg=angle[0], azimuth_deg=angle[1])


@given(cells(lossless), formulations)
@often
def test_lossless_cells_conserve_power(cell: PillarCell, formulation: Formulation) -> None:
    solved = zero_order(cell, ORDERS, formulation)
    np.testing.assert_allclose(solved.transmitted_power + solved.reflected_power, 1.0, rtol=0.0, atol=ROUNDING)


@given(cells(lossless), angles, formulations)
@fewer
def test_lossless_cells_conserve_power_at_an_angle(
    cell: PillarCell, angle: tuple[float, float], formulation: Formulation
) -> None:
    solved = zero_order(_tilted(cell, angle), 2, formulation)
    np.testing.assert_allclose(solved.transmitted_power + solved.reflected_power, 1.0, rtol=0.0, atol=ROUNDING)


@given(cells(lossy), formulations)
@often
def test_absorbing_cells_take_power(cell: PillarCell, formulation: Formulation) -> None:
    solved = zero_order(cell, ORDERS, formulation)
    assert (solved.transmitted_power + solved.reflected_power <= 1.0 + ROUNDING).all()
    assert min(solved.transmitted_power.min(), solved.reflected_power.min()) >= 0.0


@given(cells(lossy), formulations)
@often
def test_transmission_is_reciprocal(cell: PillarCell, formulation: Formulation) -> None:
    up, down = (zero_order(replace(cell, side=side), ORDERS, formulation).t for side in ("substrate", "ambient"))
    n = complex(cell.n_substrate[0]).real
    np.testing.assert_allclose(up, n * down.T, rtol=0.0, atol=1e-9)


@given(cells(lossy), angles, formulations)
@fewer
def test_transmission_is_reciprocal_at_an_angle(
    cell: PillarCell, angle: tuple[float, float], formulation: Formulation
) -> None:
    # Lorentz: Y_out t = (Y_in t back)^T with light back along the same wave; the cell's mirrors make -k equal to k.
    up = _tilted(replace(cell, side="ambient"), angle)
    k = np.array(up.in_plane)
    n = complex(cell.n_substrate[0]).real
    inside = float(np.degrees(np.arcsin(np.hypot(*k) / n)))
    down = replace(up, side="substrate", angle_deg=inside)
    y_ambient, y_substrate = (admittance((index, index, index), k) for index in (1.0, n))
    there, back = (zero_order(each, 2, formulation).t for each in (up, down))
    np.testing.assert_allclose(y_substrate @ there, (y_ambient @ back).T, rtol=0.0, atol=1e-8)


@given(cells(lossy), formulations)
@often
def test_turning_the_cell_swaps_the_polarisations(cell: PillarCell, formulation: Formulation) -> None:
    turned = replace(
        cell,
        period_nm=cell.period_nm[::-1],
        width_nm=cell.length_nm,
        length_nm=cell.width_nm,
        over=tuple(replace(each, width_nm=each.length_nm, length_nm=each.width_nm) for each in cell.over),
    )
    one, other = (zero_order(each, ORDERS, formulation) for each in (cell, turned))
    np.testing.assert_allclose(one.t, other.t[::-1, ::-1], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(one.r, other.r[::-1, ::-1], rtol=0.0, atol=1e-9)


@given(cells(lossy), st.floats(0.5, 60.0), st.floats(1.0, 89.0), formulations)
@fewer
def test_mirrored_light_gives_mirrored_matrices(
    cell: PillarCell, angle_deg: float, azimuth_deg: float, formulation: Formulation
) -> None:
    # x -> -x takes azimuth a to 180 - a and E_x to -E_x: what couples x and y changes its sign, the rest stays.
    cell = replace(cell, side="ambient")
    signs = np.array([[1.0, -1.0], [-1.0, 1.0]])
    one, mirrored, through = (
        zero_order(_tilted(cell, (angle_deg, azimuth)), 2, formulation)
        for azimuth in (azimuth_deg, 180.0 - azimuth_deg, 180.0 + azimuth_deg)
    )
    np.testing.assert_allclose(one.t, signs * mirrored.t, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(one.r, signs * mirrored.r, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(one.t, through.t, rtol=0.0, atol=1e-9)


@given(cells(lossy), st.sampled_from([0.0, 90.0, 180.0, 270.0]), st.floats(0.5, 60.0), formulations)
@fewer
def test_light_in_a_mirror_plane_keeps_its_polarisation(
    cell: PillarCell, azimuth_deg: float, angle_deg: float, formulation: Formulation
) -> None:
    solved = zero_order(_tilted(replace(cell, side="ambient"), (angle_deg, azimuth_deg)), 2, formulation)
    assert solved.t[0, 1] == solved.t[1, 0] == solved.r[0, 1] == solved.r[1, 0] == 0.0


@given(cells(lossy), angles, st.booleans(), formulations)
@often
def test_uniform_layers_equal_the_closed_form(
    cell: PillarCell, angle: tuple[float, float], closed: bool, formulation: Formulation
) -> None:
    width, length = cell.period_nm if closed else (0.0, 0.0)
    cell = _tilted(replace(cell, width_nm=width, length_nm=length, over=(), side="ambient"), angle)
    solved = zero_order(cell, 2, formulation)
    t, r = film_jones(cell, cell.n_pillar if closed else cell.n_ambient)
    # A thin slab whose modes reach x = 2.2 leaves up to 3.4e-12 in 3700 random films (5.4e-13 up to x = 1.5).
    np.testing.assert_allclose(solved.t, t, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(solved.r, r, rtol=0.0, atol=1e-11)


@given(cells(lossy), st.floats(0.01, 0.99), formulations)
@often
def test_cutting_a_pillar_changes_nothing(cell: PillarCell, share: float, formulation: Formulation) -> None:
    lower = Slice(share * cell.height_nm, cell.n_pillar, cell.n_ambient)
    cut = replace(cell, height_nm=(1.0 - share) * cell.height_nm, under=(lower,))
    one, other = (zero_order(each, ORDERS, formulation) for each in (cell, cut))
    np.testing.assert_allclose(one.t, other.t, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(one.r, other.r, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("scale", [0.37, 2.0])
@given(cell=cells(lossy), formulation=formulations)
@fewer
def test_maxwell_has_no_length_of_its_own(cell: PillarCell, formulation: Formulation, scale: float) -> None:
    scaled = replace(
        cell,
        period_nm=(scale * cell.period_nm[0], scale * cell.period_nm[1]),
        width_nm=scale * cell.width_nm,
        length_nm=scale * cell.length_nm,
        height_nm=scale * cell.height_nm,
        wavelength_nm=scale * cell.wavelength_nm,
        over=tuple(
            Slice(scale * s.height_nm, s.n_inside, s.n_around, scale * s.width_nm, scale * s.length_nm)
            for s in cell.over
            if s.width_nm is not None and s.length_nm is not None
        ),
    )
    one, other = (zero_order(each, ORDERS, formulation) for each in (cell, scaled))
    np.testing.assert_allclose(one.t, other.t, rtol=0.0, atol=1e-9)
