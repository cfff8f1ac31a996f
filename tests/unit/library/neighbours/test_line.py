"""Parameters of chains: growth by weakly coupled modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.library.neighbours.line import LineShape, grown, initial_model, paired
from metafab.library.neighbours.solve import scattered_corrections

SPAN = (100.0, 250.0)


@pytest.mark.parametrize("old", [LineShape(2, 2, 3), LineShape(1, 0, 3), LineShape(3, 3, 3)])
def test_new_modes_change_the_light_little(old: LineShape) -> None:
    rng = np.random.default_rng(1)
    model = initial_model(old, SPAN, SPAN, 1)
    more = grown(model, LineShape(3, 3, 3), 2)
    terms = model.polynomials(rng.uniform(*SPAN, (5, 7, 2)))
    before, after = scattered_corrections(model, terms), scattered_corrections(more, terms)
    change = np.linalg.norm(after - before) / np.linalg.norm(before)
    # 0.05 squared, times some modes: light goes into a new mode and back.
    assert change < 0.05
    assert (change > 1e-4) == (old != more.shape)
    known = np.r_[: old.even, 3 : 3 + old.odd]
    assert np.abs(more.site_matrix(terms)[..., known[:, None], known] - model.site_matrix(terms)).max() < 1e-14
    assert np.array_equal(more.hop_matrix[np.ix_(known, known)], model.hop_matrix)


def test_a_higher_degree_leaves_the_light_unchanged() -> None:
    model = initial_model(LineShape(2, 1, 2), SPAN, SPAN, 1)
    raised = grown(model, LineShape(2, 1, 4), 2)
    size_nm = np.random.default_rng(1).uniform(*SPAN, (5, 7, 2))
    light = [scattered_corrections(each, each.polynomials(size_nm)) for each in (model, raised)]
    assert raised.site.shape == (15, 4)
    assert np.abs(light[1] - light[0]).max() < 1e-12


@pytest.mark.parametrize("modes", [(3, 3), (4, 2), (2, 4), (1, 0), (2, 0), (1, 1)])
def test_paired_modes_have_the_same_light(modes: tuple[int, int]) -> None:
    """Their hop is 1 on the diagonal and couples pairs; sources and taps follow."""
    model = initial_model(LineShape(*modes, 2), SPAN, SPAN, 3)
    found, pairing = paired(model)
    even, pairs = modes[0], min(modes)
    expected = np.eye(sum(modes), dtype=np.complex128)
    at = np.arange(pairs)
    expected[at, even + at], expected[even + at, at] = pairing, -pairing
    assert pairing.shape == (pairs,)
    assert np.abs(found.hop_matrix - expected).max() < 1e-9
    terms = model.polynomials(np.random.default_rng(4).uniform(*SPAN, (3, 5, 2)))
    both = [scattered_corrections(each, terms) for each in (model, found)]
    assert np.abs(both[0]).max() > 1e-3
    assert np.abs(both[1] - both[0]).max() < 1e-9


def test_a_singular_hop_is_refused() -> None:
    model = initial_model(LineShape(2, 1, 2), SPAN, SPAN, 3)
    with pytest.raises(ValueError, match="singular"):
        paired(replace(model, hop=0.0 * model.hop))


def test_a_hop_with_equal_eigenvalues_is_refused() -> None:
    """Eigenvectors of equal eigenvalues need not be orthogonal; pairs would leave out what then couples the modes."""
    model = initial_model(LineShape(3, 1, 2), SPAN, SPAN, 3)
    rotation = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    hop = model.hop_matrix.copy()
    hop[:3, :3] = rotation @ np.diag([1.0, 1.0, 2.0]) @ rotation.T
    with pytest.raises(ValueError, match="equal eigenvalues"):
        paired(replace(model, hop=hop[model.shape.hop_pairs[:2]]))
