"""`metafab new`: every kind of device begins with a design file that loads and could run as it is."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from metafab import layout
from metafab.core.errors import InputError
from metafab.core.storage.pictures import read_grey
from metafab.spec import UnitCell, kinds, load_design, write_new
from metafab.spec.new import NewLens, sample_picture, write_field_um
from metafab.steps import preflight

UNIT_CELL = Path(__file__).parents[3] / "unitcell_lib" / "sos_800nm.toml"


@pytest.mark.parametrize("kind", kinds())
def test_a_new_design_passes_all_checks_that_come_before_the_work(tmp_path: Path, kind: str) -> None:
    design_file, *samples = write_new("mine", kind, tmp_path)
    design = load_design(design_file)
    preflight(design)
    assert design.name == "mine"
    assert design.library == tmp_path / "sos_800nm.toml"
    assert design.library.read_bytes() == UNIT_CELL.read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {design_file.name, *(path.name for path in samples)}
    assert kinds()[kind] in " ".join(
        line.removeprefix("# ") for line in design_file.read_text(encoding="utf-8").splitlines()
    )


@pytest.mark.parametrize("cell", sorted(UNIT_CELL.parent.glob("*_*.*")), ids=lambda path: path.name)
@pytest.mark.parametrize("kind", kinds())
def test_a_design_on_any_unit_cell_passes_all_checks_that_come_before_the_work(
    tmp_path: Path, kind: str, cell: Path
) -> None:
    design = load_design(write_new("mine", kind, tmp_path, cell)[0])
    preflight(design)
    assert design.mask.write_field_um == pytest.approx(500.0, rel=0.01)
    assert layout.tile_sites(design) > 100


@pytest.mark.parametrize(
    ("period_nm", "field_um"), [((350.0, 350.0), 499.8), ((400.0, 300.0), 504.0), ((0.5, 0.5), 499.998)]
)
def test_a_write_field_holds_whole_periods_along_both_axes(
    unit_cell: UnitCell, period_nm: tuple[float, float], field_um: float
) -> None:
    cell = dataclasses.replace(unit_cell.cell, period_nm=period_nm)
    changed = SimpleNamespace(cell=cell)
    assert write_field_um(cast(UnitCell, changed)) == pytest.approx(field_um, abs=1e-9)


def test_a_unit_cell_that_is_there_is_used(tmp_path: Path) -> None:
    first = write_new("first", "metalens", tmp_path)
    second = write_new("second", "metalens", tmp_path)
    assert [path.name for path in first] == ["first.toml", "sos_800nm.toml"]
    assert [path.name for path in second] == ["second.toml"]
    inner = tmp_path / "unitcell_lib" / "sos_800nm.toml"
    inner.parent.mkdir()
    inner.write_bytes(UNIT_CELL.read_bytes())
    third = write_new("third", "metalens", tmp_path / "deep" / "er")
    assert load_design(third[0]).library == inner


def test_a_misspelt_kind_gets_its_neighbour() -> None:
    with pytest.raises(InputError, match="did you mean `hologram`"):
        write_new("mine", "holograms", Path())


def test_a_library_that_cannot_be_read_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no file at that path"):
        write_new("mine", "metalens", tmp_path, tmp_path / "none.toml")
    assert list(tmp_path.iterdir()) == []


def test_the_unit_cell_is_named_as_seen_from_the_design(tmp_path: Path) -> None:
    cell = tmp_path / "unitcell_lib" / "sos_800nm.toml"
    cell.parent.mkdir()
    cell.write_bytes(UNIT_CELL.read_bytes())
    (found,) = write_new("near", "metalens", tmp_path / "layouts")
    assert 'library = "../unitcell_lib/sos_800nm.toml"' in found.read_text(encoding="utf-8")
    other = tmp_path / "other.toml"
    other.write_bytes(UNIT_CELL.read_bytes())
    (chosen,) = write_new("chosen", "metalens", tmp_path / "layouts", other)
    assert load_design(chosen).library == other


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine.png").write_bytes(b"a picture")
    with pytest.raises(InputError, match="a name that is free"):
        write_new("mine", "hologram", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.png"]
    write_new("mine", "metalens", tmp_path)
    with pytest.raises(InputError, match="a name that is free"):
        write_new("mine", "vortex_lens", tmp_path)


@pytest.mark.parametrize(
    ("name", "kind"),
    [*((name, "metalens") for name in ("a b", "", "../up", "_a", "\u00e9", "a" * 65)), ("a", "x")],
)
def test_unfit_names_and_unknown_kinds_are_refused(tmp_path: Path, name: str, kind: str) -> None:
    with pytest.raises(InputError, match="expected"):
        write_new(name, kind, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_sample_picture_survives_its_file(tmp_path: Path) -> None:
    _, _, picture = write_new("mine", "hologram", tmp_path)
    read = read_grey(picture) / 255.0
    # One grey level of 255 is the file's resolution.
    assert np.abs(read - sample_picture()).max() <= 0.5 / 255.0 + 1e-12
    assert read[0, 0] == 0.0


@pytest.mark.parametrize("aperture_um", [0.01, 1e9, float("nan")])
def test_an_aperture_that_no_design_takes_is_refused(aperture_um: float, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"one period, 0\.35, to 300000"):
        write_new("mine", "metalens", tmp_path, lens=NewLens(aperture_um=aperture_um))
    assert list(tmp_path.iterdir()) == []
