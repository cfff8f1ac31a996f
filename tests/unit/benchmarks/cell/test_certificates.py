"""The audit of certificates: what it draws, what counts as broken, and its table."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.cell import certificates
from benchmarks.cell.certificates import KINDS, TARGETS, Case, audit, draw
from metafab.benchmark import rows_of
from metafab.cell import CellNumerics, solve
from metafab.cell.curved import is_treated
from metafab.cell.validation import check
from metafab.cli.entry import app
from metafab.core.errors import InputError
from tests.paper_cell import SILICON

CASE = Case(0, "rectangle", 1e-3, 6, True, 1e-3, 1.2e-3, 1e-4, 0.01)


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificates, "KEPT", tmp_path / "kept")


def test_cells_of_all_kinds_are_drawn_and_physical() -> None:
    drawn = [draw(1, number) for number in range(600)]
    for _, cell in drawn:
        check(cell)
    assert {kind for kind, _ in drawn} == set(KINDS)
    assert all(
        is_treated(cell) for _, cell in (*drawn, draw(300, 103)) if cell.shape == "ellipse" and cell.is_staggered
    )
    assert sum(KINDS.values()) == pytest.approx(1.0)
    cells = [cell for _, cell in drawn]
    assert {cell.shape for cell in cells} == {"rectangle", "ellipse", "cross", "ring"}
    assert {cell.side for cell in cells} == {"substrate", "ambient"}
    assert any(cell.height_nm > cell.wavelength_nm for cell in cells)
    assert any(cell.is_sloped for cell in cells) and any(cell.under and not cell.over for cell in cells)
    assert any(cell.is_staggered and cell.shape == "ellipse" for cell in cells)


def test_an_answer_is_broken_beyond_the_error_of_its_reference() -> None:
    assert CASE.judged and CASE.broken and CASE.ratio == pytest.approx(1.2)
    uncertain = replace(CASE, reference_error=3e-4)
    assert uncertain.judged and not uncertain.broken
    assert not replace(CASE, reference_error=4e-4).judged
    assert not replace(CASE, true=math.nan, reference_error=math.inf).judged
    assert not replace(CASE, stated=math.inf).judged


def test_ellipses_under_light_at_an_angle_are_judged() -> None:
    """Their power law says nothing below 7 cosines."""
    cases = list(certificates.judge(300, 655))
    assert [case.kind for case in cases] == ["shapes at an angle"] * 3
    assert all(case.judged and case.truncation == 7 for case in cases)


def test_answers_are_kept_by_seed_and_number(monkeypatch: pytest.MonkeyPatch) -> None:
    first = list(audit(3, 3))
    assert [case.target_error for case in first] == list(TARGETS)
    (kept,) = certificates.KEPT.iterdir()
    kept.write_text(kept.read_text() + '\n[{"number": 1, ')  # cut short by a kill
    again = list(audit(3, 4))
    assert again[:3] == first and again[3].number == 1
    monkeypatch.setattr(certificates, "judge", lambda *_: pytest.fail("solved again"))
    assert list(audit(3, 2)) == first[:2]


def test_kinds_are_chosen_by_name_and_kept_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificates, "judge", lambda seed, number, kind: [replace(CASE, number=number, kind=kind)] * 3)
    chosen = audit(3, 9, ("ring", "light at an angle"))
    assert [case.kind for case in chosen][::3] == ["ring", "light at an angle", "ring"]
    assert {case.kind for case in audit(3, 3, ("cross",))} == {"cross"}
    assert len(list(certificates.KEPT.iterdir())) == 2
    monkeypatch.undo()
    for number in range(40):
        check(draw(3, number, "ring")[1])
    with pytest.raises(InputError, match=r"one of rectangle, .*got 'rings'"):
        certificates.rows(quick=True, only=["rings"])


def test_a_kept_line_that_was_cut_short_is_solved_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificates, "judge", lambda seed, number, kind: [replace(CASE, number=number)] * 3)
    assert len(list(audit(3, 6))) == 6
    (kept,) = certificates.KEPT.iterdir()
    kept.write_text(kept.read_text()[:-9])
    assert [case.number for case in audit(3, 9)] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert [case.number for case in audit(3, 9)] == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_targets_share_truncations_and_the_reference_is_finer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificates, "draw", lambda *_: ("rectangle", SILICON))
    alone = [solve(SILICON, CellNumerics(target_error=target)) for target in TARGETS]
    cases = list(certificates.judge(0, 16))
    assert [case.stated for case in cases] == [answer.error for answer in alone]
    assert all(case.judged and not case.broken for case in cases)
    assert cases[0].truncation == 6 and cases[0].reference_error <= 0.2 * cases[0].stated


def test_the_command_counts_the_broken(tmp_path: Path) -> None:
    arguments = ["benchmark", "certificates", "--seed", "8", "--samples", "4", "--json", "-o", str(tmp_path)]
    answer = CliRunner().invoke(app, arguments)
    assert answer.exit_code == 0, answer.output
    table = json.loads(answer.stdout)
    assert table["samples"] == 4 and table["broken"] == 0 and 0.0 < table["worst_ratio"] < 1.0
    kinds = [row for row in table["rows"] if row["name"] in KINDS]
    assert sum(row["samples"] for row in kinds) == 4
    with pytest.raises(InputError, match="certificates or files or films or faults with --samples"):
        rows_of("psf", samples=6)
