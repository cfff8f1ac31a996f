"""Unit cells on offer (``unitcell_lib``)."""

from __future__ import annotations

from pathlib import Path

import pytest

from metafab.materials import refractive_index
from metafab.spec import load_unit_cell

SPECS = sorted((Path(__file__).parents[2] / "unitcell_lib").glob("*.toml"))


@pytest.mark.parametrize("path", SPECS, ids=[path.stem for path in SPECS])
def test_the_unit_cells_on_offer_are_complete(path: Path) -> None:
    """Every spec loads, says its source, has indices at its wavelength and no diffraction orders in the substrate."""
    cell = load_unit_cell(path)
    wavelength_nm = cell.illumination.wavelength_nm
    index = refractive_index(cell.materials.substrate, wavelength_nm)[0]
    assert cell.source
    assert refractive_index(cell.materials.pillar, wavelength_nm)[0].real > index.real
    if path.stem != "sos_800nm":
        assert max(cell.cell.period_nm) * index.real < wavelength_nm
    assert cell.sweep.width_nm[1] <= cell.cell.period_nm[0] - 80.0
