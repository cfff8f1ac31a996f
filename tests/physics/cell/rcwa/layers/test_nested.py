"""Cross-sections of several rectangles: symmetry, limits in closed form, and modes that know no rectangles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import j1

from benchmarks.cell.fourier_limit import fourier_limit
from metafab.cell import CellNumerics, PillarCell, rcwa, solve
from metafab.cell.rcwa.derivatives import derivatives
from metafab.cell.rcwa.jones import distance, zero_order
from metafab.cell.rcwa.layers.nested import rectangles
from metafab.core.errors import InputError
from tests.plain_modes import transmitted

TITANIA = PillarCell(
    period_nm=(400.0, 400.0),
    width_nm=250.0,
    length_nm=180.0,
    height_nm=600.0,
    n_pillar=2.4,
    n_substrate=(1.46, 1.46),
    n_ambient=1.0,
    wavelength_nm=633.0,
)
SHAPES = [{"shape": "ellipse"}, {"shape": "cross"}, {"corner_radius_nm": 30.0}]
ROUNDING = 1e-11


def _area(cell: PillarCell, orders: int = 8) -> float:
    total, shorter = 0.0, 0.0
    for width, length in rectangles(cell, cell.width_nm, cell.length_nm, orders):
        total, shorter = total + width * (length - shorter), length
    return total


@given(
    width=st.floats(20.0, 400.0), length=st.floats(20.0, 400.0), radius=st.floats(0.1, 9.9), orders=st.integers(1, 12)
)
@settings(max_examples=50, deadline=None)
def test_rectangles_are_nested_fit_and_have_the_area_of_the_outline(
    width: float, length: float, radius: float, orders: int
) -> None:
    round_off = replace(TITANIA, width_nm=width, length_nm=length, corner_radius_nm=radius)
    ellipse = replace(round_off, shape="ellipse", corner_radius_nm=0.0)
    cut_off = (4.0 - math.pi) * radius**2
    for cell, area in ((round_off, width * length - cut_off), (ellipse, 0.25 * math.pi * width * length)):
        found = np.array(rectangles(cell, width, length, orders))
        assert np.all(np.diff(found[:, 0]) < 0.0)
        assert np.all(np.diff(found[:, 1]) > 0.0)
        assert found[0, 0] <= width * (1.0 + 1e-12)
        assert found[-1, 1] <= length * (1.0 + 1e-12)
        assert _area(cell, orders) == pytest.approx(area, rel=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("angle_deg", [0.0, 12.0])
def test_power_is_kept_and_both_sides_transmit_alike(shape: dict[str, float], angle_deg: float) -> None:
    cell = replace(TITANIA, n_substrate=(1.0, 1.0), angle_deg=angle_deg, **shape)
    up, down = (zero_order(replace(cell, side=side), 4) for side in ("substrate", "ambient"))
    np.testing.assert_allclose(up.transmitted_power + up.reflected_power, 1.0, atol=1e-10)
    np.testing.assert_allclose(np.diag(up.t), np.diag(down.t), atol=1e-10)


@pytest.mark.parametrize("shape", SHAPES)
def test_exchanging_the_axes_exchanges_the_polarisations(shape: dict[str, float]) -> None:
    cell = replace(TITANIA, **shape)
    turned = replace(cell, width_nm=cell.length_nm, length_nm=cell.width_nm)
    one, other = zero_order(cell, 5), zero_order(turned, 5)
    assert np.abs(one.t - other.t[::-1, ::-1]).max() < ROUNDING


def test_a_cross_answers_both_polarisations_alike_and_is_its_rectangles() -> None:
    cross = zero_order(replace(TITANIA, shape="cross"), 6)
    assert abs(cross.t[0, 0] - cross.t[1, 1]) < ROUNDING
    # One rectangle turned onto itself.
    square = replace(TITANIA, length_nm=TITANIA.width_nm)
    assert distance(zero_order(replace(square, shape="cross"), 5), zero_order(square, 5)) < ROUNDING
    # Arms as long as the period: bars, and what they are together is between one of them and a closed film.
    bar, film = (replace(TITANIA, width_nm=400.0, length_nm=size) for size in (180.0, 400.0))
    phases = [float(np.angle(zero_order(each, 6).t[0, 0])) for each in (bar, replace(bar, shape="cross"), film)]
    assert phases[0] != pytest.approx(phases[1], abs=0.1)


@pytest.mark.parametrize("shape", SHAPES)
def test_plain_fourier_modes_see_the_same_change_from_a_square_of_its_size(shape: dict[str, float]) -> None:
    """The direct rule is off by several hundredths at this truncation, but by nearly the same for both."""
    square = PillarCell(
        period_nm=(350.0, 350.0),
        width_nm=220.0,
        length_nm=220.0,
        height_nm=300.0,
        n_pillar=1.6,
        n_substrate=(1.0, 1.0),
        n_ambient=1.0,
        wavelength_nm=450.0,
    )
    cell = replace(square, **shape, **({"length_nm": 90.0} if shape.get("shape") == "cross" else {}))

    def sinc(size_nm: float, order: np.ndarray) -> np.ndarray:
        return np.asarray(size_nm / 350.0 * np.sinc(order * size_nm / 350.0))

    def circle(diameter_nm: float, m: np.ndarray, n: np.ndarray) -> np.ndarray:
        q = np.maximum(np.pi * diameter_nm / 350.0 * np.hypot(m, n), 1e-9)
        return np.asarray(0.25 * np.pi * (diameter_nm / 350.0) ** 2 * 2.0 * j1(q) / q)

    def rectangle(width_nm: float, length_nm: float, m: np.ndarray, n: np.ndarray) -> np.ndarray:
        return sinc(width_nm, m) * sinc(length_nm, n)

    def indicator(m: np.ndarray, n: np.ndarray) -> np.ndarray:
        w, h = cell.width_nm, cell.length_nm
        if cell.shape == "ellipse":
            return circle(w, m, n)
        if cell.shape == "cross":
            return rectangle(w, h, m, n) + rectangle(h, w, m, n) - rectangle(h, h, m, n)
        # Rounded: the square without its corners, each a small square without a quarter of a circle; the four quarters
        # stand 2 (w / 2 - r) apart, and by symmetry only the even part of each remains.
        radius = cell.corner_radius_nm
        x = np.linspace(0.0, radius, 401)
        x = 0.5 * (x[1:] + x[:-1])
        height = radius - np.sqrt(radius**2 - x**2)
        at = 0.5 * w - radius + x
        shape_m, shape_n = m.ravel()[:, None], n.ravel()[:, None]
        low, high = 0.5 * h - height, np.full_like(x, 0.5 * h)
        q_m, q_n = 2.0 * np.pi * shape_m / 350.0, 2.0 * np.pi * shape_n / 350.0
        with np.errstate(divide="ignore", invalid="ignore"):
            along = np.where(q_n == 0.0, high - low, (np.sin(q_n * high) - np.sin(q_n * low)) / q_n)
        cut = 4.0 * np.sum(np.cos(q_m * at) * along, axis=1) * (x[1] - x[0]) / 350.0**2
        return rectangle(w, h, m, n) - cut.reshape(m.shape)

    def plain(of: object) -> np.ndarray:
        return transmitted((350.0, 350.0), (6, 6), of, square.n_pillar, 300.0, 450.0)  # type: ignore[arg-type]

    expected = plain(indicator) - plain(lambda m, n: rectangle(220.0, 220.0, m, n))
    change = np.diagonal(zero_order(cell, 9).t - zero_order(square, 9).t)
    assert np.abs(change).max() > 0.01
    assert np.abs(expected - change).max() < 0.06 * np.abs(change).max()


def test_thin_rods_in_the_long_wave_limit_are_a_film_of_maxwell_garnetts_index() -> None:
    """Cylinders that fill f of the plane: eps = 1 + 2 f b / (1 - f b), b = (eps_p - 1) / (eps_p + 1), to f^4."""
    cell = PillarCell(
        period_nm=(40.0, 40.0),
        width_nm=18.0,
        length_nm=18.0,
        height_nm=400.0,
        n_pillar=1.8,
        n_substrate=(1.0, 1.0),
        n_ambient=1.0,
        wavelength_nm=2000.0,
        shape="ellipse",
    )
    fill = 0.25 * math.pi * (18.0 / 40.0) ** 2
    b = (1.8**2 - 1.0) / (1.8**2 + 1.0)
    n_film = math.sqrt((1.0 + fill * b) / (1.0 - fill * b))
    film = replace(cell, width_nm=40.0, length_nm=40.0, n_pillar=n_film, shape="rectangle")
    found, expected = zero_order(cell, 10), zero_order(film, 2)
    assert abs(found.t[0, 0] - expected.t[0, 0]) < 0.02 * abs(1.0 - expected.t[0, 0])


@pytest.mark.parametrize("shape", SHAPES)
def test_the_stated_error_holds(shape: dict[str, float]) -> None:
    cell = replace(TITANIA, **shape)
    response = rcwa.solve(cell, CellNumerics(target_error=1e-2, max_orders=10))
    assert distance(response, zero_order(cell, 15)) <= response.error


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"shape": "ellipse", "corner_radius_nm": 5.0}, "corner_radius_nm"),
        ({"corner_radius_nm": -1.0}, "corner_radius_nm"),
        ({"corner_radius_nm": math.nan}, "corner_radius_nm"),
        ({"shape": "star"}, "shape"),
        ({"shape": "cross", "period_nm": (400.0, 200.0)}, "width_nm, length_nm"),
        ({"shape": "cross", "is_staggered": True}, "shape, corner_radius_nm"),
    ],
)
def test_what_cannot_be_solved_is_refused(change: dict[str, object], field: str) -> None:
    with pytest.raises(InputError, match=f"`{field}`"):
        solve(replace(TITANIA, **change))  # type: ignore[arg-type]


def test_derivatives_and_the_fourier_limit_are_of_rectangles() -> None:
    for call in (derivatives, fourier_limit):
        with pytest.raises(InputError, match="corner_radius_nm"):
            call(replace(TITANIA, corner_radius_nm=5.0), 3 if call is derivatives else (3, 4, 5))  # type: ignore[operator]
