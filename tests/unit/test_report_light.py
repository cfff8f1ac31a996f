"""Figures of merit and corners on the page: in readers' words, and whatever a summary holds."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from metafab.report.figures import depth_text, loss_chain
from metafab.report.run_folder import RunFolder
from metafab.report.sections import tolerances
from metafab.report.style import depth_unit, panel


def _row(corner: str, **changed: Any) -> dict[str, Any]:
    row = {
        "corner": corner, "change": 0.2291, "peak_ratio": 1.0, "efficiency": 0.8569, "extinction_ratio": 2396.35,
        "turn_deg": -0.4876, "depth_error_m": 0.0005, "relative_error": 0.0029,
    }  # fmt: skip
    return row | changed


def _page(*rows: dict[str, Any]) -> str:
    return tolerances(RunFolder(Path(), summary={"tolerance": {"depth_m": [0.25, 0.34], "rows": list(rows)}}))


@pytest.mark.parametrize(
    ("corner", "text"),
    [
        ("cd_bias_nm -10", "CD bias −10 nm"),
        ("height_nm +10", "height +10 nm"),
        ("sidewall_angle_deg -2", "sidewall −2°"),
        ("pillar_n_shift +0.0135", "pillar index +0.0135"),
        ("missing 1 per mille", "missing 1 per mille"),
    ],
)
def test_corners_are_named_for_readers(corner: str, text: str) -> None:
    assert f">{text}</td>" in _page(_row(corner))


def test_figures_of_corners_stand_in_line() -> None:
    page = _page(_row("cd_bias_nm -10"))
    for cell in ("1.000", "0.857", "2\u202f396", "−0.49", "0.2", "0.29\u202f%"):
        assert f">{cell}</td>" in page


def test_what_is_no_number_is_shown_as_such() -> None:
    """A summary has null where a pair does not turn, and "inf" where nothing is unwanted."""
    page = _page(_row("height_nm +10", extinction_ratio="inf", depth_error_m=None))
    assert ">inf</td>" in page
    assert ">–</td>" in page


def test_a_change_below_the_error_is_told_so() -> None:
    page = _page(_row("missing 1 per mille", below_error=True))
    assert ">below error</td>" in page and ">0.29\u202f%</td>" not in page


def test_an_infinite_depth_has_a_sign_and_sets_no_unit() -> None:
    assert depth_text("inf") == depth_text(math.inf) == "∞"
    assert depth_text(0.003) == "3 mm" and depth_unit([0.003, math.inf]) == (1e3, "mm")


def test_nobody_asked_for_corners() -> None:
    assert tolerances(RunFolder(Path())) == ""


def test_each_stage_names_its_factor_but_the_first() -> None:
    _, axes = panel()
    loss_chain([("at the aperture", 1.0), ("through the pillars", 0.8), ("in the window", 0.6)], axes)
    texts = [text.get_text() for text in axes.texts]
    assert "100.0 %" in texts
    assert "80.0 %  × 0.800" in texts
    assert "60.0 %  × 0.750" in texts
