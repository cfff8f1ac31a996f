"""Semi-global matching on slopes, jumps and noise whose levels are known."""

from __future__ import annotations

import numpy as np

from metafab.decode.matching.semi_global import summed_costs


def test_free_changes_leave_each_pixel_its_cheapest_level() -> None:
    cost = np.random.default_rng(4).random((7, 9, 5)).astype(np.float32)
    np.testing.assert_array_equal(summed_costs(cost, 0.0, 0.0).argmin(axis=-1), cost.argmin(axis=-1))


def test_a_slope_is_followed_and_a_jump_is_kept_through_noise() -> None:
    rng = np.random.default_rng(2)
    row, column = np.mgrid[:40, :60]
    true = np.where(column < 30, row // 4, 20)
    noisy = true + np.where(rng.random(true.shape) < 0.2, rng.integers(-8, 9, true.shape), 0)
    cost = 0.3 * np.minimum(np.abs(np.arange(24) - noisy[:, :, None]), 4)
    assert (noisy != true).mean() > 0.15
    for mirrored in (slice(None), slice(None, None, -1)):  # no direction is another's favourite
        total = summed_costs(cost[mirrored, mirrored].astype(np.float32), 0.5, 2.0)
        found = total.argmin(axis=-1)[mirrored, mirrored]
        assert (found != true).mean() < 0.05  # outliers by one level cost little: on the slope, some stay
        assert (found[:, 31:] == 20).mean() > 0.99


def test_a_jump_stands_where_it_is_cheap() -> None:
    """Costs that know the level of the outer columns alone: the jump between them goes to the cheap edge."""
    cost = np.zeros((20, 30, 6), dtype=np.float32)
    cost[:, :8, 1:], cost[:, 22:, :5] = 3.0, 3.0
    for edge in (11, 17):  # from this column to the next
        jump = np.full((2, 20, 30), 2.0, dtype=np.float32)
        jump[1, :, edge] = 0.2
        for across in (True, False):
            seen, prices = (cost, jump) if across else (cost.swapaxes(0, 1), jump[::-1].swapaxes(1, 2))
            for backwards in (slice(None), slice(None, None, -1)):
                # Backwards, the price of a step is that of the pixel before it.
                turned = prices[:, backwards, backwards]
                if backwards.step is not None:
                    turned = np.stack([np.roll(turned[0], -1, axis=0), np.roll(turned[1], -1, axis=1)])
                found = summed_costs(seen[backwards, backwards], 1.0, turned).argmin(axis=-1)[backwards, backwards]
                expected = np.broadcast_to(np.where(np.arange(30) <= edge, 0, 5), (20, 30))
                np.testing.assert_array_equal(found, expected if across else expected.T)
