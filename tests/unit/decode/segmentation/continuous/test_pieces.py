"""Planes and quadrics of the pieces of a surface."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.decode.matching.depth import PixelDepth
from metafab.decode.segmentation.continuous.pieces import surfaces_of_pieces

SHAPE = (90, 160)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
LIT = np.ones(SHAPE, dtype=bool)


def pixels_of(surface: np.ndarray) -> PixelDepth:
    """Own depths of pixels, with errors of 0.3 %."""
    noise = np.random.default_rng(2).normal(0.0, 3e-3, SHAPE)
    return PixelDepth(surface * (1.0 + noise), np.full(SHAPE, 3e-3), LIT)


def test_a_steep_wall_a_card_and_a_ball_are_three_pieces() -> None:
    wall = 1.8 + 2e-3 * COLUMN
    card, away = (np.abs(ROW - 45) < 25) & (np.abs(COLUMN - 40) < 22), np.hypot(ROW - 45, COLUMN - 115)
    ball = away < 30
    true = np.where(card, 3.0, np.where(ball, 3.4 - 2e-4 * away**2, wall))
    found = surfaces_of_pieces(true, LIT, pixels_of(true), 0.05, 3)
    assert [(one.tilted, one.curved) for one in found] == [(True, False), (True, True), (False, False)]
    for one, mask in zip(found, (~card & ~ball, ball, card), strict=True):
        # Some 300 pixels of 0.3 % are fitted: 0.0006 / m on their mean, a few times that at the edge.
        assert np.abs(one.over(SHAPE) - true)[mask].max() < 8e-3


def test_what_changes_by_less_than_a_step_is_one_piece_and_specks_are_none() -> None:
    true = np.where(COLUMN < 80, 2.0, 2.04)
    assert len(surfaces_of_pieces(true, LIT, pixels_of(true), 0.05, 3)) == 1
    assert len(surfaces_of_pieces(true, LIT, pixels_of(true), 0.03, 3)) == 2
    speck = np.where((np.abs(ROW - 20) < 4) & (np.abs(COLUMN - 20) < 4), 3.0, 2.0)
    (only,) = surfaces_of_pieces(speck, LIT, pixels_of(speck), 0.05, 3)
    assert only.vergence_per_m == pytest.approx(2.0, rel=1e-3)


def test_darkness_has_no_piece() -> None:
    true = np.full(SHAPE, 2.0)
    assert surfaces_of_pieces(true, ~LIT, pixels_of(true), 0.05, 3) == []
