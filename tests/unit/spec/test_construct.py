"""Unit cells and designs made in Python equal those read from files."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.spec import Sensor, UnitCell, load_design, load_unit_cell, make_design, make_unit_cell
from metafab.spec.cell import Axes, CellGeometry, CellMaterials, Illumination, Layer, Material
from metafab.spec.design import Tolerances
from metafab.spec.device import Device
from metafab.spec.terms import Lens, SpiralZones, SplitLens
from metafab.spec.toml import canonical_toml, parse_toml

ROOT = Path(__file__).parents[3]


def paper_cell() -> UnitCell:
    return make_unit_cell(
        period_nm=350,
        height_nm=600,
        pillar=3.6941 + 0.0065j,
        substrate=1.7601,
        wavelength_nm=800,
        sizes_nm=(100, 250),
    )


def test_a_cell_in_python_is_the_cell_of_the_file() -> None:
    made, read = paper_cell(), load_unit_cell(ROOT / "unitcell_lib" / "sos_800nm.toml")
    assert made.cell == replace(read.cell, lattice="rectangular")
    assert made.illumination == read.illumination
    assert made.sweep == read.sweep
    assert (made.materials.pillar.n, made.materials.pillar.k) == (read.materials.pillar.n, read.materials.pillar.k)


def test_the_other_keys_are_set_by_replacement() -> None:
    """And refused like those of a file."""
    cell = paper_cell()
    film = Layer(height_nm=20.0, material=Material(n=1.46))
    built = replace(cell, cell=replace(cell.cell, sidewall_angle_deg=88.0, film=(film,)))
    assert parse_toml(canonical_toml(built), ROOT)["cell"]["film"][0]["height_nm"] == 20.0
    swept = replace(cell, sweep=replace(cell.sweep, axes=Axes(height_nm=(580.0, 620.0))))
    assert swept.sweep.axes is not None and swept.sweep.axes.spans == {"height_nm": (580.0, 620.0)}
    with pytest.raises(InputError, match=r"`sweep.axes.height_nm` must contain the cell's own 600"):
        replace(cell, sweep=replace(cell.sweep, axes=Axes(height_nm=(610.0, 620.0))))


def test_a_ring_in_python_has_a_wall_or_a_hole() -> None:
    ring = partial(
        make_unit_cell,
        period_nm=400,
        height_nm=600,
        pillar=2.0,
        substrate=1.46,
        wavelength_nm=633,
        sizes_nm=(200, 300),
        shape="ring",
    )
    assert ring(wall_nm=60).cell.hole_nm(200.0) == 80.0
    assert ring(inner_diameter_nm=90).cell.hole_nm(200.0) == 90.0
    with pytest.raises(InputError, match="got neither"):
        ring()


def test_a_design_in_python_is_the_design_of_the_file() -> None:
    read = load_design(ROOT / "layouts" / "helix_small.toml")
    made = make_design(
        paper_cell(),
        name="helix_small",
        aperture_um=200,
        focal_length_mm=1,
        phase=[SpiralZones(zones=4, exponent=0.5, optimise="peak"), SplitLens(angle_deg=8.0)],
        pixel_um=2.4,
        focus_depth_m=0.003,
        depths_m=(0.0025, 0.0028, 0.0031, 0.0034),
        formats=("gds", "oas"),
        scene=read.scene,
    )
    for part in ("name", "device", "phase", "rules", "mask", "sensor", "scene", "numerics"):
        assert getattr(made, part) == getattr(read, part), part
    assert made.verify.depths_m == read.verify.depths_m


def test_a_record_stands_for_an_index() -> None:
    assert make_unit_cell(
        period_nm=350, height_nm=600, pillar="Si_Green2008", substrate=1.76, wavelength_nm=800, sizes_nm=(100, 250)
    ).materials.pillar == Material(record="Si_Green2008")


def test_all_faults_are_reported_at_once() -> None:
    with pytest.raises(InputError) as caught:
        make_unit_cell(period_nm=-350, height_nm=0, pillar=3.7, substrate=1.76, wavelength_nm=800, sizes_nm=(100, 250))
    assert {fault.field for fault in caught.value.faults} == {
        "cell.period_nm[0]",
        "cell.period_nm[1]",
        "cell.height_nm",
    }


def test_specs_are_dataclasses_with_units_in_their_names() -> None:
    assert Device(aperture_um=10.0, focal_length_mm=1.0).aperture_shape == "circle"
    assert Sensor(pixel_um=2.0, focus_depth_m=0.3).pixel_um == 2.0
    cell = UnitCell(
        cell=CellGeometry(period_nm=(350.0, 350.0), height_nm=600.0),
        materials=CellMaterials(pillar=Material(n=3.7), substrate=Material(n=1.76)),
        illumination=Illumination(wavelength_nm=800.0),
        sweep=paper_cell().sweep,
    )
    assert cell.cell.height_nm == 600.0


def test_whole_numbers_of_numpy_are_whole_numbers() -> None:
    design = make_design(
        paper_cell(), aperture_um=np.int64(100), focal_length_mm=1, phase=[Lens()], pixel_um=2.4, focus_depth_m=0.003,
        window_px=np.arange(40, 80, 8)[1],
    )  # fmt: skip
    assert (design.device.aperture_um, design.verify.window_px) == (100.0, 48)


def test_single_values_in_place_of_sequences_are_refused_by_name() -> None:
    make = partial(make_design, paper_cell(), aperture_um=100, focal_length_mm=1, pixel_um=2.4, focus_depth_m=0.003)
    singles = (
        ("phase", Lens()),
        ("phase", {"term": "lens"}),
        ("depths_m", 0.003),
        ("depths_m", np.array(0.003)),
        ("formats", "gds"),
    )
    for key, single in singles:
        with pytest.raises(InputError, match=rf"`\w*\.?{key}`: expected a list.*, got"):
            make(**{"phase": [Lens()], key: single})
    with pytest.raises(InputError, match=r"`materials.pillar`: expected a table, got None"):
        make_unit_cell(
            period_nm=350,
            height_nm=600,
            pillar=None,
            substrate=1.76,
            wavelength_nm=800,
            sizes_nm=(100, 250),  # type: ignore[arg-type]
        )


def test_a_spec_that_python_makes_by_itself_states_all_faults_in_our_words() -> None:
    """They also are a ValueError, as those of Python's own types."""
    with pytest.raises(InputError) as refused:
        Tolerances(cd_bias_nm=-1.0, draws=1, missing=0.1)  # type: ignore[call-arg]
    assert isinstance(refused.value, ValueError)
    assert refused.value.source == "Tolerances"
    assert [fault.field for fault in refused.value.faults] == ["cd_bias_nm", "draws", "missing"]
    assert "did you mean `missing_share`?" in str(refused.value)
    with pytest.raises(InputError, match=r"SplitLens:\n  `angle_deg`: expected a number less than 90, got 95.0"):
        SplitLens(angle_deg=95.0)
    with pytest.raises(InputError, match=r"Sensor:\n  `focus_depth_m`: expected a value, got nothing"):
        Sensor(pixel_um=1.0)  # type: ignore[call-arg]
    with pytest.raises(InputError, match="at least 2 to be optimised"):
        replace(SpiralZones(), zones=1, optimise="peak")
    assert pickle.loads(pickle.dumps(refused.value)).faults == refused.value.faults
