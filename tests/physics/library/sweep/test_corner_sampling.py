"""Axes of a library by the real solver: corners that were not solved are within what they state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab import library
from metafab.cell import CellNumerics, solve
from metafab.library.sweep.build import BuildNumerics
from metafab.library.sweep.corner_sampling import CornerNumerics
from metafab.spec import UnitCell
from metafab.spec.cell import Axes, Material

SILICON, TITANIA = None, 2.4


@pytest.mark.parametrize(
    ("axis", "span", "corner", "n_pillar", "target_error"),
    [
        ("height_nm", (590.0, 610.0), 607.3, SILICON, 1e-2),
        ("pillar_n_shift", (-0.0135, 0.0135), 0.011, SILICON, 1e-2),
        ("corner_radius_nm", (0.0, 25.0), 18.0, TITANIA, 2e-2),
        ("angle_x_deg", (0.0, 8.0), 6.1, TITANIA, 1e-2),
        ("sidewall_angle_deg", (88.5, 90.0), 89.1, TITANIA, 2e-2),  # steps of sloped walls are dear
    ],
)
def test_a_corner_holds_against_the_solver(
    unit_cell: UnitCell,
    axis: str,
    span: tuple[float, float],
    corner: float,
    n_pillar: float | None,
    target_error: float,
) -> None:
    """A small part of the sweep, few cells a round; six sizes at one corner, solved to a better error."""
    sweep = replace(unit_cell.sweep, width_nm=(100.0, 120.0), length_nm=(100.0, 120.0), size_grid_nm=5.0)
    cell = replace(unit_cell, sweep=replace(sweep, target_error=target_error, axes=Axes(**{axis: span})))
    if n_pillar is not None:
        materials = replace(cell.materials, pillar=Material(n=n_pillar), substrate=Material(n=1.46))
        cell = replace(cell, materials=materials, cell=replace(cell.cell, height_nm=400.0))
    built = library.build(cell, numerics=BuildNumerics(corners=CornerNumerics(sequence=256, first_round=12)))
    assert built.corners is not None
    assert built.corners.statistics.target == "reached"
    there = built.at(**{axis: corner})
    width_nm, length_nm = np.random.default_rng(3).uniform(100.0, 120.0, (2, 6))
    held = there.surface(width_nm, length_nm)
    answers = [
        solve(there.pillar(float(w), float(h)), CellNumerics(target_error=0.4 * target_error))
        for w, h in zip(width_nm, length_nm, strict=True)
    ]
    t = np.array([np.diagonal(answer.t) for answer in answers])
    miss = np.abs(np.stack([held.t_xx, held.t_yy], axis=-1) - t).max(axis=-1)
    assert np.all(miss <= held.error + [answer.error for answer in answers])
    assert held.error.max() <= 2.0 * target_error
    # The same sizes of the nominal library are other pillars: the axis is felt.
    nominal = built.surface(width_nm, length_nm)
    assert np.abs(nominal.t_xx - held.t_xx).max() > 3.0 * miss.max()
