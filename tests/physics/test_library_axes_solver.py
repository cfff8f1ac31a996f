"""Axes of a library by the real solver: corners that were not solved are within what they state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metafab import library
from metafab.cell import CellNumerics, solve
from metafab.spec import UnitCell
from metafab.spec.cell import Axes


@pytest.mark.parametrize(
    ("axis", "span", "corner"),
    [
        ("height_nm", (590.0, 610.0), 607.3),
        ("pillar_n_shift", (-0.0135, 0.0135), 0.011),
    ],
)
def test_a_corner_holds_against_the_solver(
    unit_cell: UnitCell, monkeypatch: pytest.MonkeyPatch, axis: str, span: tuple[float, float], corner: float
) -> None:
    """A small part of the sweep to 1e-2, few cells a round; six sizes at one corner, solved to a tenth of that."""
    monkeypatch.setattr("metafab.library.corner_rounds.FIRST_ROUND", 16)
    monkeypatch.setattr("metafab.library.corner_rounds.SEQUENCE", 512)
    sweep = replace(unit_cell.sweep, width_nm=(100.0, 130.0), length_nm=(100.0, 130.0), size_grid_nm=5.0)
    cell = replace(unit_cell, sweep=replace(sweep, target_error=1e-2, axes=Axes(**{axis: span})))
    built = library.build(cell)
    assert built.details["corner_target"] == "reached"
    there = built.at(**{axis: corner})
    width_nm, length_nm = np.random.default_rng(3).uniform(100.0, 130.0, (2, 6))
    held = there.surface(width_nm, length_nm)
    answers = [
        solve(there.pillar(float(w), float(h)), CellNumerics(1e-3)) for w, h in zip(width_nm, length_nm, strict=True)
    ]
    t = np.array([np.diagonal(answer.t) for answer in answers])
    miss = np.abs(np.stack([held.t_xx, held.t_yy], axis=-1) - t).max(axis=-1)
    assert np.all(miss <= held.error + [answer.error for answer in answers])
    assert held.error.max() <= 2e-2
    # The same sizes of the nominal library are other pillars: the axis is felt.
    nominal = built.surface(width_nm, length_nm)
    assert np.abs(nominal.t_xx - held.t_xx).max() > 2e-2
