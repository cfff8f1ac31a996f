"""A unit cell by rules of thumb: no order in the substrate, a gap that the rules keep, and a full turn of phase."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metafab.cell import curved, pillar_cell
from metafab.cell.open_orders import open_orders
from metafab.cell.rcwa.jones import zero_order
from metafab.cell.starting import StartingCell, starting_cell
from metafab.core.conventions import covered_rad
from metafab.core.errors import InputError
from metafab.spec import UnitCell, load_unit_cell


def _loaded(begun: StartingCell, tmp_path: Path) -> UnitCell:
    file = tmp_path / "cell.toml"
    file.write_text(begun.text, encoding="utf-8")
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
    begun = starting_cell(wavelength_nm, material, numerical_aperture=sine)
    cell = _loaded(begun, tmp_path)
    assert open_orders(cell) == ()
    assert 2.0 * sine * cell.cell.period_nm[0] < wavelength_nm
    low, high = cell.sweep.width_nm
    assert low >= 40.0
    assert cell.cell.period_nm[0] - high >= 50.0
    # About a turn, at sizes that transmit half of the light or more.
    assert begun.reach_rad > 4.4


@pytest.mark.parametrize(
    ("shape", "wavelength_nm", "material", "least_rad"),
    [("cross", 633.0, "TiO2", 6.1), ("circle", 1550.0, "Si", 4.8), ("ring", 532.0, "TiO2", 5.9)],
)
def test_finer_solutions_reach_the_phases_that_the_file_states(
    shape: str, wavelength_nm: float, material: str, least_rad: float, tmp_path: Path
) -> None:
    """At 2.2 turns, crosses of amorphous silicon reached 5.6 rad, rings of titanium dioxide 5.3.

    Of the crosses half are solved, so that a gap of the circle which one size closes may stay open.
    """
    begun = starting_cell(wavelength_nm, material, shape=shape)
    cell = _loaded(begun, tmp_path)
    low, high = cell.sweep.width_nm
    sizes_nm = np.arange(low, high + 1.0, cell.sweep.size_grid_nm)
    t = []
    for width_nm in sizes_nm.tolist():
        for length_nm in sizes_nm[sizes_nm <= width_nm][::2].tolist() if shape == "cross" else [width_nm]:
            one = pillar_cell(cell, width_nm, length_nm)
            t.append((zero_order(one, 8) if shape == "cross" else curved.zero_order(one, 4)).t[0, 0])
    passed = np.abs(t) ** 2 / one.n_substrate[0].real >= 0.5
    reach_rad = covered_rad(np.angle(t)[passed])
    assert begun.reach_rad > least_rad
    assert reach_rad == pytest.approx(begun.reach_rad, abs=0.25)
    assert f"{begun.reach_rad:.2f} rad" in begun.text
    assert begun.efficiency > 0.95


def test_a_file_or_an_index_of_ones_own_serves_and_so_do_pillars_of_the_substrate(tmp_path: Path) -> None:
    """Germanium pillars on germanium at 10.6 um, from a table in another folder than the unit cell."""
    table = tmp_path / "materials" / "ge.csv"
    table.parent.mkdir()
    table.write_text("wavelength_nm,n,k\n10000,4.004,0\n11000,4.002,0\n", encoding="utf-8")
    # Through a linked folder, `..` would lead elsewhere.
    (tmp_path / "elsewhere" / "deep").mkdir(parents=True)
    (tmp_path / "linked").symlink_to(tmp_path / "elsewhere" / "deep")
    begun = starting_cell(10600.0, str(table), substrate="4.0028", shape="circle", folder=tmp_path / "linked")
    cell = _loaded(begun, tmp_path / "linked")
    assert '"../../materials/ge.csv"' in begun.text and "{ n = 4.0028, k = 0.0 }" in begun.text
    assert cell.materials.pillar.record == str(table)
    assert open_orders(cell) == ()
    assert begun.reach_rad > 4.4


def test_what_cannot_work_is_refused() -> None:
    for arguments, message in (
        ((-5.0, "2.4"), "a wavelength of 10 nm or more"),
        ((0.45, "TiO2"), "10 nm or more, got 0.45; the unit is nm"),
        ((532.0, "60"), "whose period holds sizes"),
        ((532.0, "1e300"), "k of 0 or more, at most 100"),
        ((532.0, "unobtainium"), "a material such as"),
        ((2500.0, "TiO2"), "a record that holds 2500 nm"),
        ((532.0, "1.2"), "index of 1.3 or more, got 1.2 at 532 nm"),
        ((532.0, "2.4-0.1j"), "n above 0 and k of 0 or more"),
        ((532.0, "mine.csv"), "no file|No such file"),
    ):
        with pytest.raises(InputError, match=message):
            starting_cell(*arguments, substrate="1.45")
    with pytest.raises(InputError, match="a substrate that light passes"):
        starting_cell(532.0, "TiO2", substrate="0.1+3j")
    with pytest.raises(InputError, match="one of rectangle"):
        starting_cell(532.0, "TiO2", shape="star")
