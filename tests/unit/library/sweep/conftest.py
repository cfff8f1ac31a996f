"""Fixtures of the adaptive sampling: a coarse grid, and the closed-form solver with ridges."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeAlias

import pytest

from metafab.cell import CellNumerics, CellSolver, PillarCell
from metafab.core.parallel.executor import SerialExecutor
from metafab.core.parallel.progress import silent
from metafab.library.fit.size_grid import SizeGrid
from metafab.library.sweep.adaptive_sampling import PointSolver
from metafab.library.sweep.checkpoint import Checkpoint
from metafab.spec import UnitCell
from tests import library_ridges as ridges

Solving: TypeAlias = Callable[..., PointSolver]


@pytest.fixture(scope="module")
def cell(unit_cell: UnitCell) -> UnitCell:
    return replace(unit_cell, sweep=replace(unit_cell.sweep, size_grid_nm=5.0))


@pytest.fixture(scope="module")
def grid(cell: UnitCell) -> SizeGrid:
    return SizeGrid.of(cell)


@pytest.fixture(scope="module")
def solving() -> Iterator[Solving]:
    """Makes a solver of points from a function number -> cell, without a checkpoint."""

    def solving(cell_of: Callable[[int], PillarCell], solver: CellSolver = ridges.solve) -> PointSolver:
        return PointSolver(
            cell_of, CellNumerics(target_error=1e-3), solver, SerialExecutor(), Checkpoint(None, ""), silent
        )

    yield solving
