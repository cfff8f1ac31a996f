"""The page of shapes: its table holds exactly what each command accepts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from metafab.cell import CellNumerics, PillarCell, pillar_cell, solve
from metafab.cell.elements import orders_at
from metafab.cell.meep import SupercellSettings
from metafab.cell.meep.solver import refuse_untreated
from metafab.cell.meep.supercell import plan
from metafab.cell.supercell import Supercell
from metafab.core.errors import InputError
from metafab.exposure.electrons.process import unavailable_keys
from metafab.fullwave.written import site_cell
from metafab.layout.outlines import Outline
from metafab.library import Library
from metafab.library.axes import corner_cell
from metafab.spec import Design, UnitCell, load_design, load_unit_cell
from metafab.spec.cell import Axes, CellGeometry, Neighbours, Sweep
from tests.main_job import ROOT

PAGE = ROOT / "docs" / "howto" / "shapes.md"
SIZE_NM = 160.0
GEOMETRIES: dict[str, dict[str, object]] = {
    "rectangle": {},
    "rectangle, rounded": {"corner_radius_nm": 30.0},
    "circle": {"shape": "circle"},
    "ellipse": {"shape": "ellipse"},
    "cross": {"shape": "cross"},
    "ring": {"shape": "ring", "wall_nm": 40.0},
    "rectangle, hexagonal": {"lattice": "hexagonal"},
    "circle, hexagonal": {"shape": "circle", "lattice": "hexagonal"},
    "ring, hexagonal": {"shape": "ring", "wall_nm": 40.0, "lattice": "hexagonal"},
}


@pytest.fixture(scope="module")
def design() -> Design:
    return load_design(ROOT / "layouts" / "tio2_metalens.toml")


def _unit_cell(geometry: dict[str, object], **tables: object) -> UnitCell:
    own = load_unit_cell(ROOT / "unitcell_lib" / "tio2_circles_532nm.toml")
    square = geometry.get("shape") in {"circle", "ring"}
    sweep = Sweep((100.0, 200.0), (100.0, 200.0) if square else (110.0, 190.0), 10.0, axes=tables.pop("axes", None))  # type: ignore[arg-type]
    cell = CellGeometry((330.0, 330.0), 700.0, **geometry)  # type: ignore[arg-type]
    return replace(own, cell=cell, sweep=sweep, **tables)


def _solved(geometry: dict[str, object], **changes: float) -> None:
    cell = pillar_cell(_unit_cell(geometry), SIZE_NM, SIZE_NM)
    solve(replace(cell, **changes), CellNumerics(target_error=0.5, max_orders=3))  # type: ignore[arg-type]


def _supercell(geometry: dict[str, object], library: Library) -> Supercell:
    return Supercell(site_cell(replace(library, unit_cell=_unit_cell(geometry))), np.full((1, 2, 2), SIZE_NM))


def _refused(*faults: object) -> None:
    if any(faults):
        raise InputError("shape", [])


def _columns(library: Library, design: Design) -> dict[str, Callable[[dict[str, object]], object]]:
    def exposed(geometry: dict[str, object]) -> None:
        own = replace(design, unit_cell=_unit_cell(geometry))
        is_printed = own.unit_cell.cell.is_hexagonal and own.unit_cell.cell.shape == "rectangle"
        _refused(unavailable_keys(own), is_printed)

    def inverted(geometry: dict[str, object]) -> None:
        own = replace(design, unit_cell=_unit_cell(geometry), mask=replace(design.mask, draw_corners=True))
        _refused(not Outline.of(own).is_rectangle, own.unit_cell.cell.is_hexagonal)

    def sloped(geometry: dict[str, object]) -> None:
        cell: PillarCell = corner_cell(_unit_cell(geometry), SIZE_NM, SIZE_NM, {"sidewall_angle_deg": 88.0})
        solve(cell, CellNumerics(target_error=0.5, max_orders=3))

    return {
        "library": _solved,
        "checked by Meep": lambda geometry: refuse_untreated(pillar_cell(_unit_cell(geometry), SIZE_NM, SIZE_NM)),
        "`coupling`, `fullwave` by RCWA": lambda geometry: orders_at(_supercell(geometry, library), ("x",), 1.5),
        "by Meep, `patch`": lambda geometry: plan(_supercell(geometry, library), "x", SupercellSettings()),
        "`[neighbours]`": lambda geometry: _unit_cell(geometry, neighbours=Neighbours()),
        "`[sweep.axes]`": lambda geometry: _unit_cell(geometry, axes=Axes(height_nm=(680.0, 720.0))),
        "light at an angle": partial(_solved, angle_deg=5.0),
        "sloped walls": sloped,
        "`expose`": exposed,
        '`tone = "inverted"`': inverted,
    }


def test_the_table_says_what_each_command_accepts(smooth_library: Library, design: Design) -> None:
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    columns = _columns(smooth_library, design)
    found = [["shape", *columns]]
    for name, geometry in GEOMETRIES.items():
        answers = []
        for accepts in columns.values():
            try:
                accepts(geometry)
            except InputError:
                answers.append("-")
            else:
                answers.append("yes")
        found.append([name, *answers])
    text = "\n".join("| " + " | ".join(row) + " |" for row in found)
    assert rows[:1] + rows[2:] == found, text
