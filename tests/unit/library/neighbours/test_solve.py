"""Chains of coupled modes: symmetries that hold for any parameters, and the exact derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.library.neighbours import solve
from metafab.library.neighbours.line import LineModel, LineShape, initial_model
from metafab.library.neighbours.solve import (
    corrections_and_jacobian,
    line_corrections,
    line_gains,
    scattered_corrections,
    uniform_field,
)

SPAN = (100.0, 250.0)
SHAPES = [LineShape(3, 2, 3), LineShape(4, 2, 3), LineShape(2, 0, 2), LineShape(1, 1, 1)]


def _lines(shape: LineShape, sites: int, seed: int = 1) -> tuple[LineModel, np.ndarray]:
    model = initial_model(shape, SPAN, SPAN, seed)
    sizes = np.random.default_rng(seed).uniform(*SPAN, (3, sites, 2))
    return model, model.polynomials(sizes)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("sites", [2, 3, 5])
def test_jacobian_is_that_of_differences(shape: LineShape, sites: int) -> None:
    model, terms = _lines(shape, sites)
    field, jacobian = corrections_and_jacobian(model, terms)
    assert np.abs(field - scattered_corrections(model, terms)).max() < 1e-14
    rng = np.random.default_rng(2)
    step = 1e-6 * (rng.normal(size=model.vector.size) + 1j * rng.normal(size=model.vector.size))
    up, down = (scattered_corrections(model.with_vector(model.vector + sign * step), terms) for sign in (1, -1))
    # Central differences: truncation 1e-12, rounding 1e-16 over steps that change the field by 1e-9 and more.
    assert np.abs(0.5 * (up - down) - jacobian @ step).max() < 1e-7 * np.abs(jacobian @ step).max()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("sites", [1, 2, 5, 6])
def test_half_of_a_mirrored_line_has_the_field_of_the_whole(shape: LineShape, sites: int) -> None:
    model, terms = _lines(shape, (sites + 1) // 2)
    terms = np.concatenate([terms, terms[:, ::-1][:, sites % 2 :]], axis=1)
    half = (sites + 1) // 2
    for folded, whole in zip(
        corrections_and_jacobian(model, terms, mirrored=True), corrections_and_jacobian(model, terms), strict=True
    ):
        assert np.abs(folded - whole[:, :, :half]).max() < 1e-12 * np.abs(whole).max() + 1e-14
    whole = scattered_corrections(model, terms)
    assert np.abs(scattered_corrections(model, terms, mirrored=True) - whole[..., :half]).max() < 1e-14


@pytest.mark.parametrize("shape", SHAPES)
def test_equal_pillars_are_exact(shape: LineShape) -> None:
    model, terms = _lines(shape, 5)
    equal = np.repeat(terms[:, :1], 5, axis=1)
    assert np.abs(scattered_corrections(model, equal)).max() < 1e-14
    assert np.abs(scattered_corrections(model, terms)).min(axis=(1, 2)).min() > 0.0
    assert np.abs(line_corrections(model, terms)).max() > 1e-4


@pytest.mark.parametrize("shape", SHAPES)
def test_mirrored_lines_have_mirrored_fields(shape: LineShape) -> None:
    model, terms = _lines(shape, 5)
    mirrored = line_corrections(model, terms[:, ::-1])[:, ::-1]
    assert np.abs(mirrored - line_corrections(model, terms)).max() < 1e-14


@pytest.mark.parametrize("shape", SHAPES)
def test_coupling_is_reciprocal(shape: LineShape) -> None:
    model, terms = _lines(shape, 4)
    matrix = model.periodic_matrix(terms)
    assert np.array_equal(matrix, np.swapaxes(matrix, -1, -2))


def test_shifted_lines_have_shifted_fields() -> None:
    model, terms = _lines(SHAPES[1], 6)
    shifted = line_corrections(model, np.roll(terms, 2, axis=1))
    assert np.abs(shifted - np.roll(line_corrections(model, terms), 2, axis=1)).max() < 1e-14


def test_uniform_field_is_that_of_the_even_modes() -> None:
    """The closed form against a line of equal pillars, whose matrix knows nothing of parity."""
    model, terms = _lines(SHAPES[0], 5)
    line = np.repeat(terms[0, :1], 5, axis=0)
    source = np.zeros((5, model.shape.modes), dtype=np.complex128)
    source[:, : model.shape.even] = line @ model.source
    a = np.linalg.solve(model.periodic_matrix(line), source.ravel()).reshape(5, -1)
    side = line @ model.side
    field = (line @ model.own * a[:, : model.shape.even]).sum(1) + (side * a * (1.0 + model.shape.parity)).sum(1)
    assert np.abs(field - uniform_field(model, line)).max() < 1e-13


def test_vector_holds_every_parameter() -> None:
    model = initial_model(SHAPES[0], SPAN, SPAN, 1)
    again = initial_model(SHAPES[0], SPAN, SPAN, 2).with_vector(model.vector)
    assert all(np.array_equal(getattr(again, name), getattr(model, name)) for name in ("site", "own", "side", "hop"))


@pytest.mark.parametrize("sites", [3, 8])
def test_the_elimination_of_long_lines_agrees_with_the_whole_inverse(
    sites: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for shape in SHAPES:
        model, terms = _lines(shape, sites)
        inverse = line_corrections(model, terms), *line_gains(model, terms)
        monkeypatch.setattr(solve, "_DENSE_SITES", 2)
        monkeypatch.setattr(solve, "_OUTPUTS_AT_ONCE", 3)  # parts of 3, 3 and 2 outputs of 8
        monkeypatch.setattr(solve, "_half_line", None)
        for whole, eliminated in zip(inverse, (line_corrections(model, terms), *line_gains(model, terms)), strict=True):
            assert eliminated == pytest.approx(whole, rel=1e-11, abs=1e-14)
        monkeypatch.undo()
