"""Extremes of the solver: sound cells pass, and an answer that is off by more than it states is counted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from benchmarks.cell import stability


def test_the_papers_cell_is_sound() -> None:
    found = stability.check(stability.BASE, 7)
    assert found.sound
    assert 0.0 < found.true < found.stated < stability.TARGET
    assert max(found.power, found.reciprocity) < 1e-12


def test_wrong_answers_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(*of_cell: Any) -> Any:
        answer = solve(*of_cell)
        return replace(answer, t=answer.t + 0.01)

    solve = stability.solve
    monkeypatch.setattr(stability, "FAMILIES", {"plain": (stability.BASE,)})
    (row,) = stability.rows(True)
    assert (row["cells"], row["unmet"], row["broken"]) == (1, 0, 0)
    monkeypatch.setattr(stability, "solve", wrong)
    (row,) = stability.rows(True)
    assert row["broken"] == 1
    assert row["error"] == pytest.approx(0.01, rel=0.1)
