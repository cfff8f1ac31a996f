"""Elements along curved outlines: against fibres and thin rods in closed form, by symmetry, and RCWA in the limit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import jv, jvp, kv, kvp

from metafab.cell import PillarCell, Slice
from metafab.cell.curved.functions import functions_of
from metafab.cell.curved.layers import MeshMatrices, zero_order
from metafab.cell.curved.mesh import quarter_mesh
from metafab.cell.rcwa import jones
from metafab.cell.rcwa.jones import distance

CIRCLE = PillarCell(
    period_nm=(330.0, 330.0),
    width_nm=180.0,
    length_nm=180.0,
    height_nm=800.0,
    n_pillar=2.461,
    n_substrate=(1.461, 1.461),
    n_ambient=1.0,
    wavelength_nm=532.0,
    shape="ellipse",
)
ELLIPSE = replace(CIRCLE, period_nm=(340.0, 300.0), width_nm=110.0, length_nm=200.0)
ROUNDED = replace(CIRCLE, shape="rectangle", length_nm=120.0, corner_radius_nm=25.0)
RING = replace(CIRCLE, shape="ring", hole_nm=80.0)
ROUNDING = 1e-9
#: Symmetries and stacks hold at any order.
ANY = pytest.mark.parametrize(
    ("cell", "order"), [(CIRCLE, 3), (ELLIPSE, 3), (ROUNDED, 2), (RING, 2)], ids=["o", "0", "[]", "oo"]
)


def _he11_index(radius_nm: float, n: float, wavelength_nm: float) -> float:
    """Effective index of the HE11 mode of a rod in vacuum (Snyder and Love, Optical Waveguide Theory, table 12-4)."""
    k_radius = 2.0 * math.pi * radius_nm / wavelength_nm

    def mismatch(index: float) -> float:
        u, w = k_radius * math.sqrt(n**2 - index**2), k_radius * math.sqrt(index**2 - 1.0)
        j, k = jvp(1, u) / (u * jv(1, u)), kvp(1, w) / (w * kv(1, w))
        return float((j + k) * (n**2 * j + k) - index**2 * (u**-2 + w**-2) ** 2)

    # The fundamental mode has the largest index: below the first zero of J1 there is no pole.
    least = math.sqrt(max(1.0, n**2 - (3.8317 / k_radius) ** 2))
    return float(brentq(mismatch, least + 1e-6, n - 1e-6))


def test_the_fundamental_mode_of_a_rod_is_that_of_a_fibre() -> None:
    """A cell so wide that the mode's tail in its neighbours, exp(-2 w) of it, shifts the index by less than 1e-6."""
    rod = replace(CIRCLE, period_nm=(900.0, 900.0), width_nm=300.0, length_nm=300.0)
    matrices = MeshMatrices.of(functions_of(quarter_mesh(rod), "x", 7), axes=[0])
    p, q = matrices.grams.p_and_q(Slice(800.0, 2.461, 1.0), rod.k0_per_nm)
    index = math.sqrt(np.linalg.eigvals(p @ q).real.max())
    assert index == pytest.approx(_he11_index(150.0, 2.461, 532.0), abs=3e-6)


def test_thin_rods_in_the_long_wave_limit_are_a_film_of_maxwell_garnetts_index() -> None:
    """Cylinders that fill f of the plane: eps = 1 + 2 f b / (1 - f b), b = (eps_p - 1) / (eps_p + 1), to f^4.

    The finite period over the wavelength, squared, leaves 4e-4 of the phase.
    """
    rods = PillarCell(
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
    fill, b = 0.25 * math.pi * (18.0 / 40.0) ** 2, (1.8**2 - 1.0) / (1.8**2 + 1.0)
    n_film = math.sqrt((1.0 + fill * b) / (1.0 - fill * b))
    film = replace(rods, width_nm=40.0, length_nm=40.0, n_pillar=n_film, shape="rectangle")
    found, expected = zero_order(rods, 5).t[0, 0], jones.zero_order(film, 2).t[0, 0]
    assert abs(found - expected) < 2e-3 * abs(1.0 - expected)


def test_thin_tubes_in_the_long_wave_limit_are_a_film_of_maxwell_garnetts_index() -> None:
    """As of rods, with the polarisability b of a coated cylinder (Bohren and Huffman, section 5.4)."""
    tubes = PillarCell(
        period_nm=(40.0, 40.0),
        width_nm=18.0,
        length_nm=18.0,
        height_nm=400.0,
        n_pillar=1.8,
        n_substrate=(1.0, 1.0),
        n_ambient=1.0,
        wavelength_nm=2000.0,
        shape="ring",
        hole_nm=12.0,
    )
    fill, eps, inner = 0.25 * math.pi * (18.0 / 40.0) ** 2, 1.8**2, (12.0 / 18.0) ** 2
    b = (eps - 1.0) * (eps + 1.0) * (1.0 - inner) / ((eps + 1.0) ** 2 - inner * (eps - 1.0) ** 2)
    n_film = math.sqrt((1.0 + fill * b) / (1.0 - fill * b))
    film = replace(tubes, width_nm=40.0, length_nm=40.0, n_pillar=n_film, shape="rectangle", hole_nm=0.0)
    found, expected = zero_order(tubes, 4).t[0, 0], jones.zero_order(film, 2).t[0, 0]
    assert abs(found - expected) < 2e-3 * abs(1.0 - expected)


def test_a_ring_between_circles_of_its_two_diameters() -> None:
    """A vanishing hole leaves the circle, off by 1e-3 of order 4; a ring in a liquid of its own index is the liquid."""
    assert distance(zero_order(replace(RING, hole_nm=0.2), 4), zero_order(CIRCLE, 4)) < 1e-3
    liquid = replace(RING, n_ambient=2.461)
    assert distance(zero_order(liquid, 2), zero_order(replace(CIRCLE, n_ambient=2.461), 2)) < 1e-6


@ANY
def test_power_is_kept_both_sides_transmit_alike_and_axes_exchange(cell: PillarCell, order: int) -> None:
    up, down = (zero_order(replace(cell, side=side), order) for side in ("substrate", "ambient"))
    np.testing.assert_allclose(up.transmitted_power + up.reflected_power, 1.0, atol=ROUNDING)
    np.testing.assert_allclose(1.461 * np.diag(down.t), np.diag(up.t), atol=ROUNDING)
    turned = replace(cell, period_nm=cell.period_nm[::-1], width_nm=cell.length_nm, length_nm=cell.width_nm)
    np.testing.assert_allclose(zero_order(turned, order).t, up.t[::-1, ::-1], atol=ROUNDING)


def test_absorbed_power_is_missing() -> None:
    lossy = zero_order(replace(CIRCLE, n_pillar=2.461 + 0.01j), 4)
    assert 0.02 < 1.0 - lossy.transmitted_power[0] - lossy.reflected_power[0] < 0.3


def test_a_hexagonal_lattice_of_square_symmetry_is_the_square_lattice() -> None:
    """Turned by 45 degrees, a square lattice of period a is a centred one of period sqrt(2) a and rows a / sqrt(2)."""
    square = replace(CIRCLE, period_nm=(300.0, 300.0), width_nm=170.0, length_nm=170.0)
    centred = replace(square, period_nm=(300.0 * math.sqrt(2.0), 300.0 / math.sqrt(2.0)), is_staggered=True)
    one, other = zero_order(square, 5), zero_order(centred, 5)
    assert distance(one, other) < 1e-6  # both are off by 2e-5, and their elements differ
    np.testing.assert_allclose(other.transmitted_power, one.transmitted_power, atol=1e-6)


def test_a_square_of_full_radius_is_a_circle() -> None:
    """The elements are the same, their orders are not: each is off by 1e-4."""
    rounded = replace(CIRCLE, shape="rectangle", corner_radius_nm=90.0)
    assert distance(zero_order(rounded, 5), zero_order(CIRCLE, 6)) < 2e-4


@ANY
def test_a_pillar_cut_in_two_is_the_whole_and_a_film_may_lie_under_it(cell: PillarCell, order: int) -> None:
    whole = zero_order(cell, order)
    part = replace(cell, height_nm=300.0, over=(Slice(500.0, cell.n_pillar, 1.0),))
    assert distance(zero_order(part, order), whole) < ROUNDING
    # A film of the substrate's index only turns the phase.
    film = replace(cell, under=(Slice(100.0, 1.461, 1.461),))
    turn = np.exp(1j * 1.461 * cell.k0_per_nm * 100.0)
    np.testing.assert_allclose(zero_order(film, order).t, whole.t * turn, atol=ROUNDING)


def test_plain_rcwa_tends_to_the_same_amplitudes() -> None:
    """Staircases of RCWA err as the power -1.3 to -1.6 of the cosines: two truncations extrapolated leave a tenth."""
    found = zero_order(CIRCLE, 5)
    coarse, fine = (jones.zero_order(CIRCLE, orders) for orders in (8, 14))
    assert distance(fine, found) < 0.6 * distance(coarse, found)
    limits = [fine.t[0, 0] + (fine.t[0, 0] - coarse.t[0, 0]) / ((14.0 / 8.0) ** power - 1.0) for power in (1.3, 1.6)]
    assert min(abs(limit - found.t[0, 0]) for limit in limits) < 0.2 * distance(fine, found)
