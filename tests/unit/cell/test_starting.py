"""A unit cell by rules of thumb: no order in the substrate, a gap that the rules keep, and a full turn of phase."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from metafab.cell import CellNumerics, pillar_cell, solve
from metafab.cell.open_orders import open_orders
from metafab.cell.starting import starting_cell
from metafab.core.conventions import wrap_phase
from metafab.core.errors import InputError
from metafab.spec import UnitCell, load_unit_cell


def _cell(tmp_path: Path, *arguments: object, **options: object) -> UnitCell:
    file = tmp_path / "cell.toml"
    file.write_text(starting_cell(*arguments, **options), encoding="utf-8")  # type: ignore[arg-type]
    return load_unit_cell(file)


@pytest.mark.parametrize(
    ("wavelength_nm", "material", "sine"),
    [
        (532.0, "TiO2", 0.6),
        (1550.0, "Si", 0.9),
        (940.0, "a-Si", 0.2),
        (633.0, "SiN", 0.95),
        (460.0, "TiO2/Devore-o", 0.3),
    ],
)
def test_a_cell_keeps_its_light_and_samples_its_lens(
    wavelength_nm: float, material: str, sine: float, tmp_path: Path
) -> None:
    cell = _cell(tmp_path, wavelength_nm, material, numerical_aperture=sine)
    assert open_orders(cell) == ()
    assert 2.0 * sine * cell.cell.period_nm[0] < wavelength_nm
    low, high = cell.sweep.width_nm
    assert low >= 40.0
    assert cell.cell.period_nm[0] - high >= 50.0
    # The phase of the widest pillar is about a turn beyond that of the narrowest, or more.
    turn = 0.0
    numerics = CellNumerics(0.05)
    sizes = [low + k * (high - low) / 12 for k in range(13)]
    answers = [solve(pillar_cell(cell, size, size), numerics).t[0, 0] for size in sizes]
    for before, after in pairwise(answers):
        turn += float(wrap_phase(np.angle(after / before)))
    assert turn > 4.4


def test_what_cannot_work_is_refused() -> None:
    for arguments, message in (
        ((532.0, "unobtainium"), "a material such as"),
        ((2500.0, "TiO2"), "a record with 2500 nm"),
        ((532.0, "SiO2"), "index above that of the substrate"),
    ):
        with pytest.raises(InputError, match=message):
            starting_cell(*arguments)
    with pytest.raises(InputError, match="one of rectangle"):
        starting_cell(532.0, "TiO2", shape="star")
