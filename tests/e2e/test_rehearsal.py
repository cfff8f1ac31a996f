"""The set-up's rehearsal: passes here, and would not where masks or depths are wrong."""

from __future__ import annotations

import pytest

from metafab import rehearsal
from metafab.doctor import examine
from metafab.rehearsal import Rehearsal, rehearse


def test_the_sample_camera_is_taken_from_unit_cell_to_depths() -> None:
    done = rehearse()
    assert done.passed
    assert done.nmae > 0.0


def test_wrong_depths_and_broken_rules_do_not_pass() -> None:
    assert Rehearsal(0.01, 0).passed
    assert not Rehearsal(0.01, 1).passed
    assert not Rehearsal(0.1, 0).passed
    assert not Rehearsal(float("nan"), 0).passed


@pytest.mark.parametrize("violations", [0, 1])
def test_the_doctor_tells_how_the_rehearsal_went(violations: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "rehearse", lambda progress: Rehearsal(0.01, violations))
    assert examine(rehearse=True).self_test["rehearsal"] is (violations == 0)
    assert "rehearsal" not in examine().self_test
