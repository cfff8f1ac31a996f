"""The verdict of a check follows the error of the library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab import library
from metafab.cell import CellNumerics, CellResponse, PillarCell
from metafab.spec import UnitCell
from tests import library_ridges as ridges


def test_check_judges_against_the_solver(unit_cell: UnitCell) -> None:
    built = library.build(unit_cell, solver=ridges.solve)
    fair = library.check(built, samples=60, solver=ridges.solve)
    assert (fair.verdict, fair.beyond_stated, fair.samples) == ("holds", 0, 60)
    assert fair.max_abs_error <= built.unit_cell.sweep.target_error

    def disagreeing(cell: PillarCell, numerics: CellNumerics) -> CellResponse:
        answer = ridges.solve(cell, numerics)
        return replace(answer, t=answer.t + 0.01 * np.eye(2))

    judged = library.check(built, samples=60, solver=disagreeing)
    assert judged.verdict == "fails"
    assert judged.max_abs_error == pytest.approx(0.01, abs=fair.max_abs_error)
