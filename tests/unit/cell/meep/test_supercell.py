"""Grids of supercells: which numbers of pixels fit both periods."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell.meep.supercell import SupercellSettings, plan
from metafab.cell.supercell import Supercell
from metafab.core.errors import InputError
from tests.paper_cell import EMPTY


@pytest.mark.parametrize(
    ("y_period_nm", "remedy"), [(360.0, "take 20, 40, 60"), (361.0, "none up to 100 does: change a period")]
)
def test_a_grid_that_does_not_fit_the_y_period_is_refused_with_those_that_do(y_period_nm: float, remedy: str) -> None:
    cells = Supercell(replace(EMPTY, period_nm=(400.0, y_period_nm)), np.array([[(120.0, 150.0), (200.0, 150.0)]]))
    with pytest.raises(InputError, match=f"an even number from 8 .* got 16; {remedy}"):
        plan(cells, "x", SupercellSettings(16))
