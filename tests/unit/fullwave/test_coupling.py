"""Rows of one local period: planted coupling is measured, and results survive their file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from metafab import fullwave
from metafab.cell.elements import ElementNumerics
from metafab.core.errors import InputError
from metafab.fullwave.coupling import CouplingNumerics, CouplingRow
from metafab.layout import Lattice, PillarMap
from metafab.library import Library
from metafab.spec import load_design, write_new
from metafab.spec.new import NewLens
from metafab.steps.orders import ORDERS
from tests.fake_meep import UncoupledPillars, response
from tests.unit.fullwave.conftest import QUICK

MEEP = CouplingNumerics(solvers=("meep",), meep=QUICK)


def test_pillars_that_do_not_couple_are_found_not_to(pillars: PillarMap, ramp_library: Library) -> None:
    pool = UncoupledPillars()
    found = fullwave.measure_coupling(pillars, ramp_library, [(0.0, 0.0), (3.0, 2.0)], "mask", numerics=MEEP, pool=pool)
    assert [(row.x_um, row.polarisation, row.sites, row.order) for row in found.rows] == [
        (0.0, "x", 7, 1),
        (0.0, "y", 7, -1),
        (3.0, "x", 7, 1),
        (3.0, "y", 7, -1),
    ]
    for row in found.rows:
        assert row.coupling_error < 1e-12
        assert row.efficiency == pytest.approx(row.local_period_efficiency)
        assert row.angle_deg == pytest.approx(np.degrees(np.arcsin(0.8 / (7 * 0.35))))
    assert found.efficiency_ratio == pytest.approx(1.0)


def test_planted_coupling_is_found(pillars: PillarMap, ramp_library: Library) -> None:
    pool = UncoupledPillars({(1, 0): 0.03, (-2, 0): 0.04j})
    found = fullwave.measure_coupling(
        pillars, ramp_library, [(0.0, 0.0)], "mask", polarisations=("x",), numerics=MEEP, pool=pool
    )
    row = found.rows[0]
    assert row.wanted_error == pytest.approx(0.03)
    sizes = np.stack([110.0 + 20.0 * np.arange(7), 200.0 - 10.0 * np.arange(7)], axis=-1)
    own = np.array([response(*size) for size in sizes])
    # All seven orders propagate but the outermost two: 7 x 350 nm are 3.06 wavelengths.
    assert row.coupling_error == pytest.approx(0.05 / np.sqrt(np.mean(np.abs(own) ** 2)), rel=1e-3)
    assert found.coupling_error == row.coupling_error


def test_rows_along_y_are_the_same_rows_turned(pillars: PillarMap, ramp_library: Library) -> None:
    """The turned mask under turned light, by RCWA: the same figures."""
    numerics = CouplingNumerics(rcwa=ElementNumerics(1.0, (2.0, 2.5)))
    turned = PillarMap.from_array(
        Lattice(period_dbu=(700, 700), shape=(80, 60), database_unit_nm=0.5),
        np.ascontiguousarray(pillars.size_dbu[:, ::-1]),
        np.ascontiguousarray(pillars.to_array().T),
        16,
    )
    swapped = replace(
        ramp_library,
        width_nm=ramp_library.length_nm,
        length_nm=ramp_library.width_nm,
        t_xx=ramp_library.t_yy.transpose(0, 2, 1),
        t_yy=ramp_library.t_xx.transpose(0, 2, 1),
    )
    along_x = fullwave.measure_coupling(
        pillars, ramp_library, [(0.0, 0.0)], "", polarisations=("x",), numerics=numerics
    ).rows[0]
    along_y = fullwave.measure_coupling(
        turned, swapped, [(0.0, 0.0)], "", axis="y", polarisations=("y",), numerics=numerics
    ).rows[0]
    assert (along_y.sites, along_y.order) == (along_x.sites, along_x.order)
    assert along_y.efficiency == pytest.approx(along_x.efficiency, rel=1e-9)
    assert along_y.coupling_error == pytest.approx(along_x.coupling_error, rel=1e-9)
    assert along_x.coupling_error > 1e-3


def test_a_row_that_is_too_short_for_its_order_is_refused(pillars: PillarMap, ramp_library: Library) -> None:
    """Half a turn from site to site: 700 nm at a wavelength of 800 nm, as of 2.4 sites beyond NA 0.93."""
    index = np.where(np.arange(80) % 2 == 0, 1, 2).astype(np.uint16)
    sizes = np.array([[0, 0], [220, 400], [360, 400]], dtype=np.int32)
    steep = PillarMap.from_array(pillars.lattice, sizes, np.tile(index, (60, 1)), 16)
    with pytest.raises(InputError, match=r"longer than a wavelength.*got 2 sites"):
        fullwave.measure_coupling(steep, ramp_library, [(0.0, 0.0)], "mask")


def test_rings_of_a_lens_have_a_row_each(
    pillars: PillarMap, ramp_library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = Mock()
    monkeypatch.setattr("metafab.fullwave.coupling.measure_coupling", asked)
    fullwave.coupling.measure_rings(pillars, ramp_library, 3.0, "mask")
    places = np.array(asked.call_args.args[2])
    assert not places[:, 1].any()
    # Rings of a third of the area each; a row stands where half of its ring lies inside.
    assert (places[:, 0] / 3.0) ** 2 == pytest.approx([1.0 / 6.0, 0.5, 5.0 / 6.0])


@pytest.mark.parametrize(("aperture", "reason"), [(0.9, None), (0.2, "the design focuses light")])
def test_a_steep_lens_needs_its_rows(aperture: float, reason: str | None, tmp_path: Path) -> None:
    lens = NewLens(numerical_aperture=aperture, aperture_um=20.0)
    found = ORDERS.not_needed(load_design(write_new("own", "metalens", tmp_path, lens=lens)[0]))
    assert (found or "").startswith(reason or "") and (found is None) == (reason is None)


def test_what_was_measured_is_kept(tmp_path: Path) -> None:
    row = CouplingRow(600.0, 0.0, "x", "y", "rcwa", 21, 1, 6.2, 0.8, 0.9, 0.03, 0.12, 0.01, 2.0)
    kept = fullwave.Coupling("abc", (row, replace(row, polarisation="x", coupling_error=0.16, efficiency=0.7)))
    path = tmp_path / "coupling.json"
    fullwave.save_coupling(kept, path)
    assert fullwave.load_coupling(path) == kept
    assert json.loads(path.read_text())["coupling_error"] == pytest.approx(np.sqrt((0.12**2 + 0.16**2) / 2.0))
    assert kept.efficiency_ratio == pytest.approx(1.5 / 1.8)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"kind": "metafab coupling", "format_version": 99, "rows": []}'])
def test_what_is_no_record_is_none(tmp_path: Path, text: str) -> None:
    path = tmp_path / "coupling.json"
    assert fullwave.load_coupling(path) is None
    path.write_text(text)
    assert fullwave.load_coupling(path) is None
