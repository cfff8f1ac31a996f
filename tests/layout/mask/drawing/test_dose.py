"""Dose classes by proximity: one datatype for each class, and every pillar found again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metafab import drc, mask
from metafab.core.errors import InputError
from metafab.core.parallel.work import Work
from metafab.layout import Assignment
from metafab.spec import Design, Dose, Mask
from metafab.steps.preflight import preflight
from tests.layout.conftest import sizes_at_sites

CLASSES = 64


@pytest.fixture(scope="module")
def dosed(tiny_design: Design) -> Design:
    return replace(tiny_design, mask=replace(tiny_design.mask, dose=Dose(by="proximity", classes=CLASSES)))


@pytest.fixture(scope="module")
def dose_class(tiny: Assignment) -> np.ndarray:
    """All classes, in no order that tiles or sizes share."""
    rng = np.random.default_rng(5)
    return rng.integers(0, CLASSES, tiny.pillars.lattice.shape).astype(np.uint8)


@pytest.fixture(scope="module")
def files(
    tiny: Assignment, dosed: Design, dose_class: np.ndarray, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    """The written mask by suffix."""
    written = mask.write(tiny.pillars, tmp_path_factory.mktemp("dosed"), dosed, dose_class=(dose_class,))
    return {file.path.suffix[1:]: file.path for file in written}


@pytest.mark.parametrize("suffix", ["gds", "oas"])
def test_every_pillar_is_found_again(suffix: str, files: dict[str, Path], tiny: Assignment, dosed: Design) -> None:
    back = mask.read(files[suffix], dosed)
    assert np.array_equal(sizes_at_sites(back.pillars), sizes_at_sites(tiny.pillars))
    assert not back.other_layers
    assert sum(drc.check(files[suffix], dosed, work=Work(1)).violations.values()) == 0


@pytest.mark.parametrize("suffix", ["gds", "oas"])
def test_klayout_finds_no_difference_from_the_plain_mask(
    suffix: str, files: dict[str, Path], tiny_files: dict[str, Path]
) -> None:
    """XOR of all datatypes together with the plain mask is empty; the classes share no area."""
    kdb = pytest.importorskip("klayout.db")
    together, areas = [], []
    for path in (files[suffix], tiny_files[suffix]):
        opened = kdb.Layout()
        opened.read(str(path))
        (top,) = opened.top_cells()
        region = kdb.Region()
        parts = [kdb.Region(top.begin_shapes_rec(index)).merged() for index in opened.layer_indexes()]
        for part in parts:
            region += part
        areas.append(sum(part.area() for part in parts))
        together.append(region.merged())
    assert (together[0] ^ together[1]).is_empty()
    assert areas[0] == areas[1] > 0


def test_each_pillar_lies_on_the_datatype_of_its_class(
    files: dict[str, Path], tiny: Assignment, dosed: Design, dose_class: np.ndarray
) -> None:
    """Reading one datatype alone gives the pillars of that class."""
    for number in (0, 1, CLASSES - 1):
        single = replace(dosed, mask=replace(dosed.mask, dose=None, datatype=dosed.mask.datatype + number))
        expected = np.where((dose_class == number)[..., None], sizes_at_sites(tiny.pillars), 0)
        assert np.array_equal(sizes_at_sites(mask.read(files["oas"], single).pillars), expected)


@pytest.mark.parametrize("case", ["missing", "shape", "class", "by", "lenses"])
def test_classes_that_do_not_fit_are_refused(
    case: str, tiny: Assignment, dosed: Design, dose_class: np.ndarray, tmp_path: Path
) -> None:
    given = {
        "missing": (),
        "shape": (dose_class[1:],),
        "class": (dose_class + np.uint8(1),),
        "by": (dose_class,),
        "lenses": (dose_class, dose_class),
    }[case]
    design = replace(dosed, mask=replace(dosed.mask, dose=Dose(by="size"))) if case == "by" else dosed
    with pytest.raises(InputError, match="dose"):
        mask.write(tiny.pillars, tmp_path, design, dose_class=given)
    assert not list(tmp_path.glob("layout.*"))


def test_doses_as_datatypes_go_with_the_mask_that_they_are_of(
    tiny: Assignment, dosed: Design, dose_class: np.ndarray, tmp_path: Path
) -> None:
    class_dose = np.linspace(0.9, 1.1, CLASSES)
    options: dict[str, Any] = {"dose_class": (dose_class,), "class_dose": class_dose}
    written = mask.write(tiny.pillars, tmp_path, dosed, dose_datatypes=True, **options)
    assert tmp_path / "doses.gds" in {file.path for file in written}
    mask.write(tiny.pillars, tmp_path, dosed, **options)
    assert not (tmp_path / "doses.gds").exists()


def test_many_classes_are_for_proximity_only() -> None:
    assert Mask(dose=Dose(by="proximity", classes=256)).datatypes == (0, 255)
    with pytest.raises(ValueError, match="at most 32"):
        Dose(by="density", classes=33)


def test_a_run_refuses_classes_that_only_an_exposure_gives(dosed: Design) -> None:
    with pytest.raises(InputError, match=r"mask\.dose\.by.*metafab expose"):
        preflight(dosed)
