"""The audit of certificates: what it draws, what counts as broken, and its table."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.certificates import KINDS, TARGETS, Case, audit, draw, judge
from metafab.benchmark import rows_of
from metafab.cell.validation import check
from metafab.cli.app import app
from metafab.core.errors import InputError
from tests.paper_cell import SILICON

CASE = Case("rectangle", SILICON, 1e-3, 6, True, 1e-3, 1.2e-3, 1e-4, 0.01)


def test_cells_of_all_kinds_are_drawn_and_physical() -> None:
    rng = np.random.default_rng(1)
    drawn = [draw(rng) for _ in range(400)]
    for _, cell in drawn:
        check(cell)
    assert {kind for kind, _ in drawn} == set(KINDS)
    assert sum(KINDS.values()) == pytest.approx(1.0)
    cells = [cell for _, cell in drawn]
    assert {cell.shape for cell in cells} == {"rectangle", "ellipse", "cross"}
    assert {cell.side for cell in cells} == {"substrate", "ambient"}
    assert any(cell.height_nm > cell.wavelength_nm for cell in cells)


def test_an_answer_is_broken_beyond_the_error_of_its_reference() -> None:
    assert CASE.judged and CASE.broken and CASE.ratio == pytest.approx(1.2)
    uncertain = replace(CASE, reference_error=3e-4)
    assert uncertain.judged and not uncertain.broken
    assert not replace(CASE, reference_error=4e-4).judged
    assert not replace(CASE, true=math.nan, reference_error=math.inf).judged
    assert not replace(CASE, stated=math.inf).judged


def test_the_same_seed_gives_the_same_answers() -> None:
    first, second = (list(audit(3, 3)) for _ in range(2))
    assert [case.target_error for case in first] == list(TARGETS)
    assert [replace(case, seconds=0.0) for case in first] == [replace(case, seconds=0.0) for case in second]


def test_the_reference_is_finer_than_the_answer() -> None:
    case = judge("rectangle", SILICON, 1e-2, {})
    assert case.judged and not case.broken and case.orders == 6
    assert case.reference_error <= 0.1 * case.stated


def test_the_command_counts_the_broken(tmp_path: Path) -> None:
    arguments = ["benchmark", "certificates", "--seed", "5", "--samples", "4", "--json", "-o", str(tmp_path)]
    answer = CliRunner().invoke(app, arguments)
    assert answer.exit_code == 0, answer.output
    table = json.loads(answer.stdout)
    assert table["samples"] == 4 and table["broken"] == 0 and 0.0 < table["worst_ratio"] < 1.0
    kinds = [row for row in table["rows"] if row["name"] in KINDS]
    assert sum(row["samples"] for row in kinds) == 4
    with pytest.raises(InputError, match="certificates or files with --samples"):
        rows_of("psf", samples=6)
