"""``metafab propose``: a helix for a range of depths, on stdout, as JSON and as a picture."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.main_job import metafab

RANGE = ("--range-m", "0.25", "0.6", "--aperture-um", "2000")


@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_it_explains_itself(flag: str) -> None:
    answer = metafab("propose", flag)
    assert answer.code == 0
    assert answer.stdout.startswith("Usage: ")


def test_the_papers_range_and_its_picture(tmp_path: Path) -> None:
    picture = tmp_path / "helix.png"
    answer = metafab("propose", *RANGE, "-o", picture, "--json")
    assert answer.code == 0, answer.stderr
    found = answer.json
    assert found["zones"] >= 2
    assert found["rotation_deg_per_dioptre"] == pytest.approx(-225.0 / found["zones"], rel=1e-3)
    assert found["depth_m"][0] == pytest.approx(0.25) and found["depth_m"][-1] == pytest.approx(0.6)
    assert len(found["crlb_m"]) == len(found["phi_deg"]) == len(found["depth_m"])
    assert found["phi_deg"] == sorted(found["phi_deg"])
    assert all(found["relative_error"] <= other["relative_error"] for other in found["alternatives"])
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["helix.png"]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--range-m", "0.6", "0.25", "--aperture-um", "2000"), "nearest < farthest"),
        (("--range-m", "0.05", "10", "--aperture-um", "20000"), "allow L >= "),
        (("--range-m", "0.25", "0.6", "--aperture-um", "-1"), "a number above zero"),
        ((*RANGE, "--electrons", "0"), "a number above zero"),
        ((*RANGE, "-o", "helix.txt"), ".png"),
    ],
)
def test_what_cannot_be_served_exits_with_2(arguments: tuple[str, ...], word: str) -> None:
    answer = metafab("propose", *arguments)
    assert answer.code == 2
    assert word in answer.stderr
    assert answer.stdout == ""


def test_a_range_that_a_lens_cannot_measure_is_told() -> None:
    """The second aperture is that of the first in millimetres."""
    for aperture, is_told in (("50000", False), ("50", True)):
        answer = metafab("propose", "--range-m", "150", "250", "--aperture-um", aperture)
        assert answer.code == 0
        assert ("is `--aperture-um` in micrometres?" in answer.stderr) == is_told
