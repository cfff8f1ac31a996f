"""The transmittance that figures show is that of the solver, substrates given by the name of a record included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab.cell import CellNumerics, pillar_cell, solve
from metafab.library import build
from metafab.library.library import Library
from metafab.report.figures.library import phase_map, transmittance
from metafab.report.style import panel
from metafab.spec import load_unit_cell
from tests.main_job import ROOT


@pytest.mark.parametrize("name", ["tio2_532nm", "sos_800nm"])
def test_shown_transmittance_is_the_solvers(name: str) -> None:
    whole = load_unit_cell(ROOT / "unitcell_lib" / f"{name}.toml")
    sweep = replace(whole.sweep, width_nm=(120.0, 128.0), length_nm=(140.0, 148.0), size_grid_nm=4.0)
    library = build(replace(whole, sweep=sweep))
    row, column = 1, 2
    cell = pillar_cell(library.unit_cell, float(library.width_nm[column]), float(library.length_nm[row]))
    solved = solve(cell, CellNumerics(target_error=1e-3))
    for polarisation, expected in zip(("x", "y"), solved.transmittance, strict=True):
        shown = transmittance(library, polarisation)[row, column]  # type: ignore[arg-type]
        # |t|^2 n_out / n_in is off by twice the error of t at most, times |t| and the ratio of indices (below 1.5).
        tolerance = 3.0 * (solved.error + float(library.error.reshape(-1, *library.t_xx.shape[1:])[0, row, column]))
        assert shown == pytest.approx(expected, abs=tolerance)
        assert tolerance < 0.05


def test_phase_map_shows_the_angle_of_t(smooth_library: Library) -> None:
    _, axes = panel()
    phase_map(smooth_library, axes, "y")
    (image,) = axes.images
    np.testing.assert_allclose(image.get_array(), np.angle(smooth_library.t_yy[0]))
    left, right, low, high = image.get_extent()
    # Pixels are centred on the sizes, 2 nm apart.
    assert (left, right, low, high) == (99.0, 251.0, 99.0, 251.0)
