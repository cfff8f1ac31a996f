"""Cross-polarised light of a block: its equations, its symmetries, and its derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray
from metafab.core.figures import LineStatistics
from metafab.library.neighbours.blocks.cross import COUPLINGS, CrossLight, coupling_matrices, free_elements
from metafab.library.neighbours.blocks.lattice import SolvedLines, coupling_matrix
from metafab.library.neighbours.line import LineShape, initial_model
from metafab.library.neighbours.model import Neighbours, TrainedLine

SPAN = (100.0, 250.0)
RNG = np.random.default_rng(7)


def noise(*shape: int) -> ComplexArray:
    return np.asarray(RNG.normal(size=shape) + 1j * RNG.normal(size=shape))


def chains(*, square: bool) -> Neighbours:
    """Coupled chains of a square cell, or of one whose rows along x and along y differ."""
    shapes = (LineShape(3, 2, 1), LineShape(2, 2, 2), LineShape(2, 1, 1), LineShape(3, 1, 1))
    models = [initial_model(shape, SPAN, SPAN, seed) for seed, shape in enumerate(shapes)]
    lines = [TrainedLine(each, LineStatistics(), 0.05 * noise(each.shape.pairs[0].size)) for each in models]
    return Neighbours((lines[0], lines[0 if square else 2]), (lines[1], lines[1 if square else 3]))


def light_of(neighbours: Neighbours, size_nm: FloatArray) -> CrossLight:
    """Its lines, solved; ``size_nm`` of shape (n_y, n_x, 2)."""

    def solved(direction: int, light: str) -> SolvedLines:
        line = neighbours.line(direction, "x" if light == "x" else "y")
        along = size_nm.transpose(1, 0, 2)[..., ::-1] if direction else size_nm
        assert line.coupling is not None
        return SolvedLines.of(line.model, line.coupling, line.model.polynomials(along))

    return CrossLight(neighbours, [[solved(direction, light) for direction in (0, 1)] for light in POLARISATIONS])


@pytest.mark.parametrize("square", [True, False])
def test_modes_of_both_polarisations_obey_the_equations_of_the_module(square: bool) -> None:
    """All four chains in one dense matrix, assembled site by site; light linear in a small M."""
    neighbours, shape = chains(square=square), (3, 4)
    size_nm, vector = RNG.uniform(*SPAN, (*shape, 2)), noise(free_elements(chains(square=square)))
    keys = [(light, direction) for light in POLARISATIONS for direction in (0, 1)]
    lines = {(light, direction): neighbours.line(direction, light) for light, direction in keys}
    number = np.arange(12).reshape(shape)
    starts = np.cumsum([0, *(12 * lines[key].model.shape.modes for key in keys)])
    place = {key: (int(start), lines[key].model.shape.modes) for key, start in zip(keys, starts, strict=False)}
    matrix, taps = np.zeros((starts[-1],) * 2, dtype=complex), np.zeros((2, 12, starts[-1]), dtype=complex)
    source = np.zeros((2, starts[-1]), dtype=complex)

    def at(key: tuple[str, int], j: int, m: int) -> slice:
        start, modes = place[key]
        first = start + modes * int(number[j % shape[0], m % shape[1]])
        return slice(first, first + modes)

    for (light, direction), line in lines.items():
        key, model = (light, direction), line.model
        assert line.coupling is not None
        k, hop, axis = coupling_matrix(model, line.coupling), model.hop_matrix, POLARISATIONS.index(light)
        along, across = ((0, 1), (1, 0)) if direction == 0 else ((1, 0), (0, 1))
        for j in range(shape[0]):
            for m in range(shape[1]):
                terms = model.polynomials(size_nm[j, m, ::-1] if direction else size_nm[j, m]).ravel()
                here = at(key, j, m)
                before, after = at(key, j - along[0], m - along[1]), at(key, j + along[0], m + along[1])
                matrix[here, here] += model.site_matrix(terms) + 2.0 * k
                matrix[here, before] -= hop
                matrix[here, after] -= hop.T
                for sign in (-1, 1):
                    matrix[here, at(key, j + sign * across[0], m + sign * across[1])] -= k
                source[axis, here][: model.shape.even] = terms @ model.source
                taps[axis, number[j, m], here][: model.shape.even] += terms @ model.own
                # A mode radiates at the site after it, and with its parity at the site before it.
                site_after = number[(j + along[0]) % shape[0], (m + along[1]) % shape[1]]
                site_before = number[(j - along[0]) % shape[0], (m - along[1]) % shape[1]]
                taps[axis, site_after, here] += terms @ model.side
                taps[axis, site_before, here] += (terms @ model.side) * model.shape.parity
    small = 1e-7
    coupled = matrix.copy()
    for coupling, m_of in zip(COUPLINGS, coupling_matrices(neighbours, vector), strict=True):
        of_x, of_y = ("x", coupling.of_x), ("y", coupling.of_y)
        step = (0, 1) if coupling.axis == 0 else (1, 0)
        for j in range(shape[0]):
            for m in range(shape[1]):
                for sign in (-1, 1):
                    to = j + sign * step[0], m + sign * step[1]
                    coupled[at(of_x, j, m), at(of_y, *to)] += 0.5 * sign * small * m_of
                    coupled[at(of_y, j, m), at(of_x, *to)] -= 0.5 * sign * small * m_of.T
    np.testing.assert_allclose(coupled, coupled.T, atol=1e-14)  # Reciprocity.
    found = light_of(neighbours, size_nm).field(vector)
    for axis in (0, 1):
        field = taps[1 - axis] @ np.linalg.solve(coupled, source[axis]) / small
        np.testing.assert_allclose(found[axis].ravel(), field, atol=1e-5 * np.abs(field).max())
    assert np.abs(found).max() > 1e-3


def test_mirrors_turn_the_sign_and_the_exchange_of_axes_exchanges_the_lights() -> None:
    neighbours, size_nm = chains(square=True), RNG.uniform(*SPAN, (3, 4, 2))
    vector = noise(free_elements(neighbours))
    field = light_of(neighbours, size_nm).field(vector)
    for axis in (0, 1):
        flipped = light_of(neighbours, np.flip(size_nm, axis)).field(vector)
        np.testing.assert_allclose(np.flip(flipped, 1 + axis), -field, atol=1e-12)
    exchanged = light_of(neighbours, size_nm.transpose(1, 0, 2)[..., ::-1]).field(vector)
    np.testing.assert_allclose(exchanged[::-1].swapaxes(1, 2), field, atol=1e-12)


def test_equal_rows_or_columns_turn_no_light() -> None:
    neighbours, size_nm = chains(square=False), RNG.uniform(*SPAN, (3, 4, 2))
    vector = noise(free_elements(neighbours))
    for sizes in (size_nm[:1], size_nm[:, :1]):
        field = light_of(neighbours, np.broadcast_to(sizes, size_nm.shape)).field(vector)
        assert np.abs(field).max() < 1e-12 * np.abs(vector).max()


@pytest.mark.parametrize("square", [True, False])
def test_derivatives_are_exact(square: bool) -> None:
    neighbours, size_nm = chains(square=square), RNG.uniform(*SPAN, (3, 4, 2))
    vector, to_orders = noise(free_elements(neighbours)), noise(5, 12)
    light = light_of(neighbours, size_nm)
    orders = light.field(vector).reshape(2, -1) @ to_orders.T
    np.testing.assert_allclose(light.slopes(to_orders) @ vector, orders, atol=1e-12 * np.abs(orders).max())


def test_couplings_of_unlike_directions_are_free() -> None:
    square, other = chains(square=True), chains(square=False)
    assert [each.pairs(square).sum() for each in COUPLINGS[:3]] == [each.pairs(square).sum() for each in COUPLINGS[3:]]
    assert free_elements(other) == sum(each.pairs(other).sum() for each in COUPLINGS)
    doubled = replace(square, along=(square.along[0], replace(square.along[0])))
    assert free_elements(doubled) == 2 * free_elements(square)
