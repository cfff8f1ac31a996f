"""Turned pillars in mask files: what is written is read back, on any lattice and with every option of the mask."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from metafab.core.errors import InputError
from metafab.layout import PillarMap
from metafab.layout.turned import TurnedAssignment, assign_turned
from metafab.library.library import Library
from metafab.mask.turned import read_turned
from metafab.mask.write import biased, write_drawings
from metafab.phase.jones_target import JonesTarget
from metafab.spec import Copy, Design, Dose, Mask
from tests.stokes_lens import ROW_ANGLE_DEG, hexagonal_lens, quarter_lens

kdb = pytest.importorskip("klayout.db")

ANGLES = 8


def assigned(design: Design, library: Library) -> TurnedAssignment:
    return assign_turned(JonesTarget.of(design, ROW_ANGLE_DEG), library, design, angles=ANGLES, size_step_nm=16.0)


def small(design: Design, **options: object) -> Design:
    """A lens of 20 um with other options of its mask."""
    device = dataclasses.replace(design.device, aperture_um=20.0)
    return dataclasses.replace(design, device=device, mask=dataclasses.replace(design.mask, **options))


def kinds_at_sites(pillars: PillarMap) -> np.ndarray:
    """(width, length, angle) at every site, however the table is ordered."""
    assert pillars.angle_deg is not None
    return np.concatenate([pillars.size_dbu, pillars.angle_deg[:, None]], axis=1)[pillars.to_array()]


def written(pillars: PillarMap, design: Design, folder: Path, suffix: str) -> Path:
    path = folder / f"turned.{suffix}"
    write_drawings(pillars, {suffix: path}, design)
    return path


def region(path: Path, mask: Mask) -> kdb.Region:
    """All polygons on the pillar layer, every datatype."""
    layout, region = kdb.Layout(), kdb.Region()
    layout.read(str(path))
    first, last = mask.datatypes
    for datatype in range(first, last + 1):
        region.insert(layout.top_cell().begin_shapes_rec(layout.layer(mask.layer, datatype)))
    return region


@pytest.mark.parametrize("suffix", ["oas", "gds"])
@pytest.mark.parametrize("lens", [quarter_lens, hexagonal_lens])
def test_the_file_holds_every_pillar(
    lens: Callable[[], Design], smooth_library: Library, tmp_path: Path, suffix: str
) -> None:
    design = small(lens())
    pillars = assigned(design, smooth_library).pillars
    path = written(pillars, design, tmp_path, suffix)
    back = read_turned(path, design, ANGLES)
    assert not any(left.count for left in (back.off_site, back.off_grid, back.duplicates, *back.foreign.values()))
    assert (kinds_at_sites(back.pillars) == kinds_at_sites(pillars)).all()
    assert region(path, design.mask).count() == np.count_nonzero(pillars.to_array())
    first = path.read_bytes()
    assert written(pillars, design, tmp_path, suffix).read_bytes() == first


@pytest.mark.parametrize("suffix", ["oas", "gds"])
def test_copies_biases_and_dose_classes_hold_every_pillar(smooth_library: Library, tmp_path: Path, suffix: str) -> None:
    design = small(
        quarter_lens(),
        bias_nm=10.0,
        tone="positive",
        dose=Dose(by="size", classes=3),
        copies=(Copy((0.0, 0.0)), Copy((30.0, 0.0), bias_nm=-6.0)),
    )
    pillars = assigned(design, smooth_library).pillars
    path = written(pillars, design, tmp_path, suffix)
    for copy, bias_nm in ((1, 10.0), (2, 4.0)):
        back = read_turned(path, design, ANGLES, copy=copy)
        assert not any(left.count for left in (back.off_site, back.off_grid, back.duplicates, *back.foreign.values()))
        assert (kinds_at_sites(back.pillars) == kinds_at_sites(biased(pillars, bias_nm))).all()
        assert back.other_copies == {3 - copy: np.count_nonzero(pillars.to_array())}
    assert back.other_layers == {f"{design.mask.field_layer}/0": 2}
    assert region(path, design.mask).count() == 2 * np.count_nonzero(pillars.to_array())


def test_a_biased_mask_is_wider_by_its_bias(smooth_library: Library, tmp_path: Path) -> None:
    plain = small(quarter_lens())
    wide = small(quarter_lens(), bias_nm=10.0)
    pillars = assigned(wide, smooth_library).pillars
    drawn = region(written(pillars, wide, tmp_path, "oas"), wide.mask)
    exact = region(written(pillars, plain, tmp_path, "gds"), plain.mask).sized(10)  # 5 nm to each side
    per_vertex = 4.0 * 0.5 * 2.0 * 300.0  # vertices are rounded by half a unit, along sides of some 300 units
    assert (drawn ^ exact).area() / drawn.count() < per_vertex


def test_pillars_of_other_angles_are_counted_as_foreign(smooth_library: Library, tmp_path: Path) -> None:
    design = small(quarter_lens())
    pillars = assigned(design, smooth_library).pillars
    assert pillars.angle_deg is not None
    oblique = dataclasses.replace(pillars, angle_deg=pillars.angle_deg + np.where(pillars.angle_deg == 45.0, 5.0, 0.0))
    back = read_turned(written(oblique, design, tmp_path, "oas"), design, ANGLES)
    count = int(np.count_nonzero(pillars.angle_deg[pillars.to_array()] == 45.0))
    assert {name: left.count for name, left in back.foreign.items()} == {"polygon": count}


def test_files_of_other_things_are_refused(tmp_path: Path) -> None:
    (tmp_path / "broken.oas").write_bytes(b"nothing")
    with pytest.raises(InputError, match="GDSII or OASIS"):
        read_turned(tmp_path / "broken.oas", quarter_lens(), ANGLES)
