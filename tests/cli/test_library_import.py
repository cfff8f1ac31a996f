"""``metafab library import``: a sweep of another program becomes a library that a design can use."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from metafab.library import load
from tests.main_job import UNIT_CELL, metafab


def test_a_sweep_becomes_a_library_and_says_its_error(tmp_path: Path) -> None:
    width, length = (axis.ravel() for axis in np.meshgrid(np.arange(100.0, 251.0, 10.0), np.arange(100.0, 251.0, 10.0)))
    rows = np.random.default_rng(1).permutation(width.size)
    turn = 7.0 * (width - 100.0) / 150.0 + 1.0 * (length - 100.0) / 150.0
    table = np.stack([width, length, np.full(width.size, 0.9), np.degrees(turn)], axis=1)[rows]
    sweep = tmp_path / "sweep.csv"
    np.savetxt(sweep, table, delimiter=",", header="width_nm,length_nm,t_abs,t_phase_deg", comments="")
    answer = metafab("library", "import", sweep, "--unit-cell", UNIT_CELL, "--quantity", "field", "--json")
    assert answer.code == 0, answer.stderr
    assert {"points_solved", "points_total", "max_error", "held_out_error", "coverage_rad"} <= answer.json.keys()
    assert answer.json["points_solved"] == 256
    assert 0.0 < answer.json["max_error"] < 0.05
    library = load(tmp_path / "sweep.library.h5")
    assert abs(np.abs(library.at_sizes(150.0, 210.0).t_xx) - 0.9) < 1e-9
    missing = metafab("library", "import", sweep, "--unit-cell", UNIT_CELL)
    assert (missing.code, missing.stdout) == (2, "")
    assert "--quantity" in missing.stderr
