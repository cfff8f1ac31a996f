"""Tables of measured sizes: what an engineer's table gets wrong is named with its remedy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.layout import Lattice, PillarMap
from metafab.mask.measured import read_measured
from metafab.spec.cell import CellGeometry


@pytest.mark.parametrize(
    ("row", "named"),
    [
        ("0.0,0.0,,150", "row 2 without width_nm; leave out pillars that were not measured"),
        ("0.0,0.0,0.14,0.15", "sizes that are 0.001 times those in the median; check the unit"),
    ],
)
def test_missing_sizes_and_wrong_units_are_named(row: str, named: str, tmp_path: Path) -> None:
    table = tmp_path / "cd.csv"
    first = "0.35,0.0,0.14,0.15" if "0.14" in row else "0.35,0.0,140,150"
    table.write_text(f"x_um,y_um,width_nm,length_nm\n{first}\n{row}\n", encoding="utf-8")
    units = np.array([[0, 0], [280, 300]], dtype=np.int32)
    pillars = PillarMap.from_array(
        Lattice(period_dbu=(700, 700), shape=(3, 3), database_unit_nm=0.5), units, np.ones((3, 3), dtype=np.uint16), 64
    )
    with pytest.raises(InputError, match=named):
        read_measured(table).sites(pillars)


def test_diameters_are_sizes_of_round_pillars(tmp_path: Path) -> None:
    table = tmp_path / "sem.csv"
    table.write_text("x_um,y_um,diameter_nm\n0.0,0.0,140\n0.35,0.0,150\n", encoding="utf-8")
    measured = read_measured(table)
    assert measured.size_nm.tolist() == [[140.0, 140.0], [150.0, 150.0]]
    circle, rectangle = CellGeometry((350.0, 350.0), 300.0, "circle"), CellGeometry((350.0, 350.0), 300.0)
    circle.require_sides(table, measured.has_diameters)
    with pytest.raises(InputError, match="`width_nm` and `length_nm` for the shape 'rectangle', got `diameter_nm`"):
        rectangle.require_sides(table, measured.has_diameters)
    table.write_text("x_um,y_um,width_nm,length_nm\n0.0,0.0,140,140\n0.35,0.0,150,151\n", encoding="utf-8")
    sizes_nm = read_measured(table).size_nm
    rectangle.require_diameters(table, sizes_nm)
    with pytest.raises(InputError, match="got 1 that differ, such as 150 x 151 nm"):
        circle.require_diameters(table, sizes_nm)
