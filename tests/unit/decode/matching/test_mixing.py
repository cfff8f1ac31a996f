"""Products of mixtures of basis images."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from metafab.decode.matching.mixing import mixed_products, square_blocks_with


@settings(max_examples=25, deadline=None)
@given(
    n_y=st.integers(1, 17),
    n_x=st.integers(1, 17),
    block=st.integers(1, 5),
    n_basis=st.integers(1, 4),
    n_mixtures=st.integers(1, 6),
    seed=st.integers(0, 99),
)
def test_mixtures_are_sums_by_their_blocks_shares(
    n_y: int, n_x: int, block: int, n_basis: int, n_mixtures: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    passed = rng.normal(size=(2, n_basis, n_y, n_x)).astype(np.float32)
    blocks = -(-n_y // block), -(-n_x // block)
    shares = rng.normal(size=(2, *blocks, n_mixtures, n_basis)).astype(np.float32)
    lit = rng.random((n_y, n_x)) < 0.1
    wanted = square_blocks_with(lit, block)
    whole = [np.repeat(np.repeat(shares[p], block, axis=0), block, axis=1)[:n_y, :n_x] for p in (0, 1)]
    a, b = (np.einsum("yxvk,kyx->vyx", part, images) for part, images in zip(whole, passed, strict=True))
    of_lit = wanted.repeat(block, axis=0).repeat(block, axis=1)[:n_y, :n_x]
    assert of_lit[lit].all()
    got = mixed_products(passed, shares, block, lit)
    np.testing.assert_allclose(got, np.stack([a * b, a * a, b * b]) * of_lit, atol=1e-4)
    assert not got[..., ~of_lit].any()
