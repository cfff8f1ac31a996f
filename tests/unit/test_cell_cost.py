"""The cost model: an order of things, not a stopwatch."""

from __future__ import annotations

import numpy as np
import pytest

from metafab.cell.rcwa import cost, seconds_estimate


@pytest.fixture(autouse=True)
def a_millisecond_for_five_cosines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost, "_seconds_of_five", lambda: 1e-3)


def test_more_orders_cost_more() -> None:
    seconds = [cost.seconds_of_truncation(orders) for orders in range(3, 25)]
    assert (np.diff(seconds) > 0.0).all()
    assert cost.seconds_of_truncation(5) == pytest.approx(1e-3)
    # Twice the orders beyond the curve: four times the unknowns, 64 times the work.
    assert cost.seconds_of_truncation(40) == pytest.approx(64.0 * cost.seconds_of_truncation(20))


def test_tighter_targets_cost_more() -> None:
    loose, middle, tight = (seconds_estimate(target) for target in (1e-2, 1e-3, 1e-4))
    assert loose == pytest.approx(cost.seconds_of_truncation(3) + cost.seconds_of_truncation(5))
    assert middle == pytest.approx(cost.seconds_of_truncation(4) + cost.seconds_of_truncation(6))
    assert tight == pytest.approx(cost.seconds_of_truncation(6) + cost.seconds_of_truncation(8))


def test_the_machine_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    assert 0.0 < seconds_estimate(1e-2) < 10.0
