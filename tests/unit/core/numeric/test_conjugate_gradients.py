"""Passes of conjugate gradients against a direct solution and NumPy's sums."""

from __future__ import annotations

import numpy as np

from metafab.core.numeric.conjugate_gradients import advance, inner_products, parts, precondition, turn, twice

SIZE = (12, 10)


def _white(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.fft.rfft2(rng.normal(size=(count, *SIZE))).astype(np.complex64)


def test_products_are_those_of_the_pictures() -> None:
    """Two problems of one and of two pictures."""
    one, other = _white(np.random.default_rng(1), 3), _white(np.random.default_rng(2), 3)
    sums = (parts(one) * parts(other)).sum(axis=1)
    got = inner_products(sums, np.array([0, 1]), SIZE[0] * SIZE[1])
    pictures = np.fft.irfft2(one, SIZE) * np.fft.irfft2(other, SIZE)
    # Single precision, over sums of 240 products of order 1.
    assert np.allclose(got, [pictures[:1].sum(), pictures[1:].sum()], atol=1e-4)


def test_steps_reach_the_solution() -> None:
    """Of (1 + texture^2) white = texture gradient, which the exact preconditioner reaches in one step."""
    rng = np.random.default_rng(3)
    ky, kx = np.fft.fftfreq(SIZE[0])[:, None], np.fft.rfftfreq(SIZE[1])
    gradient, texture = _white(rng, 2), (0.2 / (0.1 + ky**2 + kx**2)).astype(np.float32)
    inverse = np.broadcast_to(1.0 / (1.0 + texture**2), gradient.shape).astype(np.float32)
    white, scaled = np.zeros_like(gradient), gradient.copy()
    direction, textured = np.zeros_like(gradient), np.empty_like(gradient)
    sums = np.empty((2, 2 * gradient.shape[2]), dtype=np.float32)
    precondition(parts(scaled), twice(texture), parts(white), twice(inverse), sums)
    norm = inner_products(sums, np.array([0, 1]), SIZE[0] * SIZE[1])
    turn(parts(scaled), np.zeros(2, dtype=np.float32), parts(direction), twice(texture), parts(textured), sums)
    along = inner_products(sums, np.array([0, 1]), SIZE[0] * SIZE[1])
    curvature = along + (np.fft.irfft2(textured, SIZE) ** 2).sum(axis=(1, 2))
    advance(parts(white), (norm / curvature).astype(np.float32), parts(direction))
    assert np.allclose(textured, texture * direction)
    # Single precision: 2^-24 of coefficients of order 10, after ten roundings.
    assert np.abs(white - texture * gradient / (1.0 + texture**2)).max() < 1e-5 * np.abs(gradient).max()
