"""The error that the solver states against the error that it has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, CellResponse, PillarCell
from metafab.cell.pillar import Slice
from metafab.cell.rcwa import certificate, solve, zero_order
from metafab.cell.rcwa.convergence import convergence, is_measured
from metafab.cell.rcwa.jones import ZeroOrder, distance
from metafab.core.conventions import Side
from tests.paper_cell import SILICON

TITANIA = PillarCell(
    period_nm=(300.0, 300.0),
    width_nm=110.0,
    length_nm=190.0,
    height_nm=600.0,
    n_pillar=2.42,
    n_substrate=(1.46, 1.46),
    n_ambient=1.0,
    wavelength_nm=532.0,
)
#: Resonances of the silicon pillar (the first five lie on guided modes, the sixth is the sharpest found by search),
#: smooth ones, and another material.
CELLS = [
    *(
        replace(SILICON, width_nm=width, length_nm=length)
        for width, length in (
            (250.0, 250.0),
            (150.0, 210.0),
            (145.0, 245.0),
            (155.0, 185.0),
            (220.0, 195.0),
            (220.8, 244.6),
            (100.0, 100.0),
            (188.4, 103.7),
        )
    ),
    TITANIA,
]
#: References of 14 orders moved by at most 1e-5 when raised to 20.
REFERENCE_ORDERS, REFERENCE_ERROR = 14, 1e-5


@pytest.fixture(scope="module")
def references() -> list[ZeroOrder]:
    return [zero_order(cell, REFERENCE_ORDERS) for cell in CELLS]


@pytest.mark.slow
@pytest.mark.parametrize("target_error", [1e-2, 1e-3, 1e-4])
def test_stated_error_bounds_the_true_error(references: list[ZeroOrder], target_error: float) -> None:
    for cell, reference in zip(CELLS, references, strict=True):
        response = solve(cell, CellNumerics(target_error=target_error))
        true_error = max(np.abs(response.t - reference.t).max(), np.abs(response.r - reference.r).max())
        assert response.converged
        assert true_error <= response.error + REFERENCE_ERROR
        assert response.error <= target_error


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        {"n_pillar": 0.15 + 4.9j, "height_nm": 50.0},
        {"n_pillar": 0.036 + 5.6j, "height_nm": 100.0},
        {"period_nm": (700.0, 700.0), "width_nm": 300.0, "length_nm": 400.0},
        {"period_nm": (350.0, 500.0)},
        {"width_nm": 2.0, "length_nm": 2.0},
        {"width_nm": 350.0, "length_nm": 200.0},
        {"width_nm": 349.0, "length_nm": 340.0},
        {"height_nm": 5_000.0},
        {"n_pillar": 1.0, "n_ambient": 3.6941},
        {"n_pillar": 6.0},
        {"n_pillar": 4.4 + 0.6j, "wavelength_nm": 532.0},
        {"angle_deg": 10.0},
    ],
    ids=[
        "gold",
        "silver",
        "diffracting",
        "oblong",
        "2 nm",
        "ridge",
        "1 nm slits",
        "tall",
        "hole",
        "n = 6",
        "lossy",
        "oblique",
    ],
)
def test_bound_holds_far_from_where_it_was_measured(change: dict[str, object]) -> None:
    cell = replace(SILICON, **change)  # type: ignore[arg-type]
    response = solve(cell, CellNumerics(target_error=1e-2, max_orders=8))
    reference = zero_order(cell, 9 if cell.angle_deg else 12)
    true_error = max(np.abs(response.t - reference.t).max(), np.abs(response.r - reference.r).max())
    # Differences of 12 orders to more are below a tenth of these bounds, except for gold, which does not converge.
    assert true_error <= response.error


#: Found by search, when the shorter period had fewer cosines and wide cells counted as measured.
HARD_CELLS = {
    "1 : 2.6": (
        PillarCell(
            period_nm=(495.755, 190.865),
            width_nm=221.242,
            length_nm=143.223,
            height_nm=302.025,
            n_pillar=3.7604,
            n_substrate=(1.7601, 1.7601),
            n_ambient=1.0,
            wavelength_nm=800.0,
        ),
        5.9e-3,
    ),
    "2.6 : 1": (
        PillarCell(
            period_nm=(178.44, 467.24),
            width_nm=148.61,
            length_nm=289.65,
            height_nm=296.97,
            n_pillar=2.4175,
            n_substrate=(1.7601, 1.7601),
            n_ambient=1.0,
            wavelength_nm=800.0,
            side="ambient",
        ),
        2.4e-3,
    ),
    "narrow": (replace(SILICON, period_nm=(140.0, 350.0), width_nm=60.0), 1e-2),
    "427 nm": (
        replace(SILICON, period_nm=(427.0, 427.0), width_nm=196.0, length_nm=181.0, height_nm=419.0, side="ambient"),
        1e-3,
    ),
    "399 nm": (
        replace(SILICON, period_nm=(399.155, 399.155), width_nm=289.14, length_nm=213.63, height_nm=349.856),
        1.5e-4,
    ),
    "close": (
        replace(
            SILICON,
            period_nm=(340.437, 335.096),
            width_nm=249.651,
            length_nm=252.868,
            height_nm=279.513,
            side="ambient",
        ),
        1e-3,
    ),
}


#: Answers that were off by more than stated: 5 cosines in tall, narrow or staggered cells may be worse than 3.
TALL_CELLS = {
    "2.2 wavelengths": PillarCell(
        period_nm=(182.2364, 182.2364), width_nm=112.5117, length_nm=27.1462, height_nm=1489.57, n_pillar=3.7377,
        n_substrate=(1.76, 1.76), n_ambient=1.0, wavelength_nm=902.384, side="ambient"
    ),
    "0.7 wavelengths": PillarCell(
        period_nm=(233.909, 233.909), width_nm=46.18, length_nm=149.89, height_nm=1104.04, n_pillar=3.797,
        n_substrate=(1.76, 1.76), n_ambient=1.0, wavelength_nm=1570.04, side="ambient"
    ),
    "low index": PillarCell(
        period_nm=(367.0, 367.0), width_nm=190.0, length_nm=170.0, height_nm=980.0, n_pillar=1.98,
        n_substrate=(1.45, 1.45), n_ambient=1.0, wavelength_nm=527.0
    ),
    "absorbing": PillarCell(
        period_nm=(230.8335, 230.8335), width_nm=49.1195, length_nm=122.3776, height_nm=1176.28,
        n_pillar=3.2923 + 0.0033j, n_substrate=(1.45, 1.45), n_ambient=1.0, wavelength_nm=789.257, side="ambient"
    ),
    "hexagonal": PillarCell(
        period_nm=(283.7444, 245.7299), width_nm=242.2916, length_nm=163.5195, height_nm=913.688, n_pillar=3.34965,
        n_substrate=(1.0, 1.0), n_ambient=1.0, wavelength_nm=1320.177, side="ambient",
        is_staggered=True,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TALL_CELLS)
@pytest.mark.parametrize("side", ["ambient", "substrate"])
def test_bound_has_a_margin_in_tall_cells(name: str, side: Side) -> None:
    cell = replace(TALL_CELLS[name], side=side)
    assert not is_measured(cell)
    response = solve(cell, CellNumerics(target_error=1e-2))
    assert response.converged
    reference = zero_order(cell, 14 if cell.is_staggered else 12)
    true_error = max(np.abs(response.t - reference.t).max(), np.abs(response.r - reference.r).max())
    assert 1.4 * true_error <= response.error <= 1e-2


#: Cells of the measured kind that the claims from 173 pillars bounded by 0.8 to 1.3 times the error.
WEAK_CELLS = {
    "1.3 wavelengths": (
        PillarCell(
            period_nm=(283.477, 283.477),
            width_nm=126.707,
            length_nm=78.472,
            height_nm=767.876,
            n_pillar=2.77945,
            n_substrate=(2.1606, 2.3241),
            n_ambient=1.0,
            wavelength_nm=601.997,
        ),
        (1e-2, 1e-3, 1e-4),
    ),
    "1.2 wavelengths": (
        PillarCell(
            period_nm=(322.906, 322.906),
            width_nm=100.334,
            length_nm=149.826,
            height_nm=706.37,
            n_pillar=2.8576,
            n_substrate=(2.3779, 2.3779),
            n_ambient=1.0,
            wavelength_nm=600.0,
        ),
        (1e-2, 1e-3),
    ),
    "1.1 wavelengths": (
        PillarCell(
            period_nm=(321.757, 321.757),
            width_nm=209.051,
            length_nm=121.496,
            height_nm=669.69,
            n_pillar=2.8615,
            n_substrate=(1.76, 1.76),
            n_ambient=1.0,
            wavelength_nm=600.0,
            side="ambient",
        ),
        (1e-4,),
    ),
    "0.4 wavelengths": (
        PillarCell(
            period_nm=(389.066, 389.066),
            width_nm=257.25,
            length_nm=172.623,
            height_nm=215.47,
            n_pillar=2.3362,
            n_substrate=(1.45, 1.45),
            n_ambient=1.0,
            wavelength_nm=600.0,
            side="ambient",
        ),
        (1e-4,),
    ),
}


@pytest.mark.parametrize("name", WEAK_CELLS)
def test_bound_has_a_margin_in_cells_of_the_measured_kind(name: str) -> None:
    cell, targets = WEAK_CELLS[name]
    assert is_measured(cell)
    reference, known = zero_order(cell, 14), dict[tuple[int, int], ZeroOrder]()
    for target_error in targets:
        response = solve(cell, CellNumerics(target_error=target_error), known)
        assert 1.4 * distance(response, reference) <= response.error <= target_error


@pytest.mark.parametrize("wavelength_nm", [598.245, 600.245, 601.245])
def test_bound_has_a_margin_where_errors_do_not_fall_yet(wavelength_nm: float) -> None:
    """In a period of 2.0 wavelengths 3, 4 and 5 cosines agree better than any of them is right."""
    cell = PillarCell(
        period_nm=(435.168, 435.168),
        width_nm=239.948,
        length_nm=239.948,
        height_nm=1243.582,
        n_pillar=2.794,
        n_substrate=(1.0, 1.0),
        n_ambient=1.0,
        wavelength_nm=wavelength_nm,
    )
    response = solve(cell, CellNumerics(target_error=1e-2))
    assert 1.4 * distance(response, zero_order(cell, 9)) <= response.error <= 1e-2


#: Random cells that stated 1.2 to 1.9 times their errors: target, largest truncation, and that of the reference.
FRESH_CELLS = {
    "index of 4.7": (
        PillarCell(
            period_nm=(306.373, 306.373), width_nm=202.4297, length_nm=149.6526, height_nm=178.7377, n_pillar=4.658657,
            n_substrate=(1.7601, 1.7601), n_ambient=1.0, wavelength_nm=1595.949
        ),
        (1e-3, 6, 9),
    ),
    "absorbing": (
        PillarCell(
            period_nm=(557.50979, 557.50979), width_nm=169.99744, length_nm=509.04477, height_nm=1107.37346,
            n_pillar=4.861961 + 0.540906j, n_substrate=(1.00909, 1.00909), n_ambient=1.0,
            wavelength_nm=945.77428, side="ambient",
        ),
        (1e-2, 8, 10),
    ),
    "flat cross": (
        PillarCell(
            period_nm=(365.1077, 365.1077), width_nm=300.9074, length_nm=219.279, height_nm=1287.6212,
            n_pillar=1.480049, n_substrate=(1.0, 1.0), n_ambient=1.0, wavelength_nm=1084.589, side="ambient",
            shape="cross",
        ),
        (1e-2, 6, 9),
    ),
    "hexagonal lattice": (
        PillarCell(
            period_nm=(423.970836, 367.169515), width_nm=313.860684, length_nm=341.955557, height_nm=821.556846,
            n_pillar=3.40192, n_substrate=(1.599059, 1.599059), n_ambient=1.0,
            wavelength_nm=1249.27434, side="ambient", is_staggered=True,
        ),
        (1e-2, 6, 9),
    ),
    "light at an angle": (
        PillarCell(
            period_nm=(300.79536, 376.895625), width_nm=238.1679, length_nm=168.142238, height_nm=1133.676278,
            n_pillar=4.658177, n_substrate=(1.7601, 1.7601), n_ambient=1.0, wavelength_nm=634.527087,
            side="substrate", angle_deg=41.326059,
        ),
        (1e-2, 6, 9),
    ),
    "cross under light at an angle": (
        PillarCell(
            period_nm=(247.6083, 293.09226), width_nm=138.006, length_nm=235.22788, height_nm=881.0326,
            n_pillar=1.430143, n_substrate=(1.45, 1.45), n_ambient=1.0, wavelength_nm=1125.2438,
            side="substrate", angle_deg=40.64144, azimuth_deg=90.0, shape="cross",
        ),
        (1e-2, 6, 9),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FRESH_CELLS)
def test_bound_has_a_margin_in_cells_that_no_rule_had_seen(name: str) -> None:
    cell, (target_error, most, reference) = FRESH_CELLS[name]
    response = solve(cell, CellNumerics(target_error=target_error, max_orders=most))
    assert 1.6 * distance(response, zero_order(cell, reference)) <= response.error


@pytest.mark.parametrize("name", HARD_CELLS)
def test_bound_holds_in_oblong_and_in_wide_cells(name: str) -> None:
    cell, target_error = HARD_CELLS[name]
    assert not is_measured(cell)
    response = solve(cell, CellNumerics(target_error=target_error))
    assert response.converged
    reference = zero_order(cell, 13)
    true_error = max(np.abs(response.t - reference.t).max(), np.abs(response.r - reference.r).max())
    assert true_error <= response.error + REFERENCE_ERROR


def _certified(cell: PillarCell, target_error: float) -> CellResponse:
    """The answer of a cell of the measured kind, which must reach its target."""
    assert is_measured(cell)
    response = solve(cell, CellNumerics(target_error=target_error))
    assert response.converged
    return response


#: Pillars that stand close, whose error was 1.1 to 2.4 times the claims of smaller ones, and the target of that claim.
CLOSE_CELLS = {
    "2.4 times": (
        PillarCell(
            period_nm=(524.3419, 524.3419),
            width_nm=334.1125,
            length_nm=368.4792,
            height_nm=1078.7432,
            n_pillar=2.424343,
            n_substrate=(1.733748, 1.733748),
            n_ambient=1.490667,
            wavelength_nm=936.9719,
        ),
        1e-2,
    ),
    "1.6 times": (
        replace(SILICON, period_nm=(336.42028,) * 2, width_nm=235.93583, length_nm=102.82045, height_nm=491.06111),
        1e-3,
    ),
    "1.3 times": (
        replace(SILICON, period_nm=(343.87421,) * 2, width_nm=212.10271, length_nm=246.22153, height_nm=361.35389),
        1e-3,
    ),
    "1.2 times": (
        replace(SILICON, period_nm=(350.421,) * 2, width_nm=145.3951, length_nm=235.70927, height_nm=392.0221),
        1e-3,
    ),
}


@pytest.mark.parametrize("name", CLOSE_CELLS)
def test_bound_has_a_margin_where_pillars_stand_close(name: str) -> None:
    cell, target_error = CLOSE_CELLS[name]
    response = _certified(cell, target_error)
    assert 1.3 * distance(response, zero_order(cell, 14)) <= response.error


TITANIA_AT_660 = replace(TITANIA, n_pillar=2.37, n_substrate=(1.456, 1.456), wavelength_nm=660.0)

#: A pillar on glass in a period just below the wavelength in it.
ON_GLASS = replace(
    SILICON, period_nm=(400.0, 400.0), height_nm=500.0, n_pillar=3.5, n_substrate=(1.46, 1.46), wavelength_nm=850.0
)

#: Pillars found by search whose last differences are small by accident, with the target whose claim they broke: 6 and 5
#: cosines of the first agree to 4.5e-4, and 6 are off by 4.6e-3.
ACCIDENTS = {
    "6.9 times": (
        replace(
            TITANIA_AT_660,
            period_nm=(445.98485,) * 2,
            width_nm=276.02982,
            length_nm=173.09876,
            height_nm=728.25593,
        ),
        4e-3,
    ),
    "1.4 times": (
        replace(
            TITANIA_AT_660,
            period_nm=(448.03921, 452.80541),
            width_nm=145.32586,
            length_nm=315.70321,
            height_nm=648.32311,
        ),
        1e-3,
    ),
    "1.25 times": (
        replace(SILICON, period_nm=(338.1247,) * 2, width_nm=222.08583, length_nm=222.08583, height_nm=364.40068),
        1e-3,
    ),
    "1.7 times": (
        replace(SILICON, period_nm=(338.1247,) * 2, width_nm=222.08583, length_nm=222.08583, height_nm=364.40068),
        1e-4,
    ),
    "1.25 times, 6 and 4 cosines": (replace(ON_GLASS, width_nm=246.0, length_nm=150.0), 2e-3),
}

#: Pillars beside a resonance whose differences are small by accident: wavelength, sizes, target, and the true over
#: stated error by the claims alone.
RESONANT = {
    "6 cosines, 900 nm": (900.0, (232.08, 234.57), 2e-3, 2.72),
    "6 cosines, 900 nm, another pillar": (900.0, (229.45, 233.23), 2e-3, 1.79),
    "6 cosines, 870 nm": (870.0, (218.15, 218.15), 1e-3, 2.86),
    "6 cosines, 890 nm": (890.0, (206.08, 231.55), 5e-3, 1.30),
    "6 cosines, 890 nm, a size of 0.65 of the period": (890.0, (214.47, 259.93), 1e-3, 2.08),
    "6 cosines, 850 nm": (850.0, (225.6, 201.96), 5e-3, 1.59),
    "9 cosines, 850 nm": (850.0, (225.6, 201.96), 3e-4, 1.28),
}


@pytest.mark.parametrize("name", RESONANT)
def test_bound_holds_beside_resonances(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    wavelength_nm, (width_nm, length_nm), target_error, by_claims = RESONANT[name]
    cell = replace(ON_GLASS, wavelength_nm=wavelength_nm, width_nm=width_nm, length_nm=length_nm)
    response, reference = _certified(cell, target_error), zero_order(cell, 16)
    assert 1.2 * distance(response, reference) <= response.error
    # Without the rule of the near field the claims are broken: it is this rule that mends them.
    monkeypatch.setitem(certificate.OF_NEAR_FIELD, "adaptive", {})
    response = _certified(cell, target_error)
    assert distance(response, reference) / response.error == pytest.approx(by_claims, abs=0.02)


@pytest.mark.parametrize("name", ACCIDENTS)
def test_bound_holds_where_differences_are_small_by_accident(name: str) -> None:
    cell, target_error = ACCIDENTS[name]
    response = _certified(cell, target_error)
    assert distance(response, zero_order(cell, 16)) <= response.error


def test_square_cells_of_the_paper_are_measured_and_wider_or_longer_ones_are_not() -> None:
    assert is_measured(SILICON)
    assert is_measured(replace(SILICON, period_nm=(350.0, 345.0)))
    assert not is_measured(replace(SILICON, period_nm=(350.0, 330.0)))
    assert not is_measured(replace(SILICON, period_nm=(330.0, 350.0)))
    # 1.65 wavelengths in silicon are 357 nm.
    assert not is_measured(replace(SILICON, period_nm=(360.0, 360.0)))
    # 0.72 of the period are 252 nm.
    assert is_measured(replace(SILICON, width_nm=250.0))
    assert not is_measured(replace(SILICON, length_nm=253.0))


def test_plain_harmonics_approach_the_same_answer() -> None:
    # Li's factorisation without stretching is an independent discretisation; its own bound must cover the truth.
    for size_nm in ((100.0, 250.0), (120.0, 130.0)):
        cell = replace(SILICON, width_nm=size_nm[0], length_nm=size_nm[1])
        adaptive = solve(cell, CellNumerics(target_error=1e-3))
        fourier = solve(cell, CellNumerics(target_error=1e-3, formulation="fourier", max_orders=12))
        assert not fourier.converged
        assert np.abs(adaptive.t - fourier.t).max() <= adaptive.error + fourier.error
        assert np.abs(adaptive.r - fourier.r).max() <= adaptive.error + fourier.error


def test_unreachable_target_is_confessed() -> None:
    response = solve(SILICON, CellNumerics(target_error=1e-6, max_orders=6))
    assert not response.converged
    assert response.error > 1e-6


def test_no_bound_from_a_single_truncation() -> None:
    response = solve(SILICON, CellNumerics(target_error=1e-2, max_orders=3))
    assert not response.converged
    assert response.error == np.inf


def test_truncations_that_do_not_resolve_the_waves_in_the_pillar_state_no_error_below_one() -> None:
    """5.2 wavelengths in the pillar: 5 and 6 cosines differ by 0.03, and both are off by 0.16."""
    cell = replace(
        SILICON, period_nm=(523.0, 523.0), width_nm=76.0, length_nm=223.0, height_nm=168.0, n_pillar=4.997,
        n_substrate=(2.305, 2.305), wavelength_nm=502.0, side="ambient", angle_deg=24.0, azimuth_deg=323.0,
    )  # fmt: skip
    few, more = (solve(cell, CellNumerics(target_error=1e-3, max_orders=count)) for count in (6, 8))
    assert few.error == 1.0 and not few.converged
    reference = zero_order(cell, 10)
    # 10 cosines are off by 0.01 themselves.
    assert np.abs(few.t - reference.t).max() > 0.08
    assert np.abs(more.t - reference.t).max() + 0.01 <= more.error
    assert convergence(cell).least_error(6) == 1.0 > convergence(cell).least_error(8)


def test_truncations_that_do_not_resolve_the_waves_guided_in_a_film_state_no_error_below_one() -> None:
    """3.5 wavelengths in a film of index 4.25: 5 and 6 cosines differ by 0.001, and both are off by 0.02."""
    film = Slice(69.3, 4.25 + 0j, 4.25 + 0j)
    cell = PillarCell(
        period_nm=(499.2, 499.2),
        width_nm=192.3,
        length_nm=176.3,
        height_nm=454.2,
        n_pillar=1.952,
        n_substrate=(1.46, 1.46),
        n_ambient=1.0,
        wavelength_nm=606.0,
        side="substrate",
        under=(film,),
    )
    few, more = (solve(cell, CellNumerics(target_error=1e-2, max_orders=count)) for count in (6, 10))
    reference = zero_order(cell, 12)
    assert few.error == 1.0 and not few.converged
    assert np.abs(few.t - reference.t).max() > 0.02
    assert np.abs(more.t - reference.t).max() <= more.error < 1.0
