"""Input files: everything that is wrong is said at once, with its place; what is right survives a round trip."""

from __future__ import annotations

import math
import os
from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.spec import Design, canonical_toml, load_design, load_scene, load_unit_cell
from metafab.spec.load import files_of

ROOT = Path(__file__).parents[3]
SMALL = ROOT / "layouts" / "helix_small.toml"
CELL = ROOT / "unitcell_lib" / "sos_800nm.toml"


def _variant(tmp_path: Path, *replacements: tuple[str, str]) -> Path:
    text = SMALL.read_text().replace("../unitcell_lib", str(CELL.parent))
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "design.toml"
    path.write_text(text)
    return path


def test_paper_design_holds_the_paper_numbers() -> None:
    design = load_design(ROOT / "layouts" / "helix_2mm.toml")
    assert design.device.aperture_um == 2000.0
    assert design.device.focal_length_mm == 20.0
    assert design.split_angle_deg == 8.0
    assert design.wavelength_um == pytest.approx(0.8)
    cell = load_unit_cell(str(CELL))
    assert cell == design.unit_cell
    assert cell.cell.period_nm == (350.0, 350.0)
    assert cell.cell.height_nm == 600.0
    assert cell.sweep.width_nm == cell.sweep.length_nm == (100.0, 250.0)
    assert design.rules.min_gap_nm == 100.0


def test_three_faults_are_reported_together_with_their_paths(tmp_path: Path) -> None:
    path = _variant(
        tmp_path,
        ("aperture_um = 200.0", "aperture_um = -3.0"),
        ("zones = 4", 'zones = "four"'),
        ("pixel_um = 2.4", "pixels_um = 2.4"),
    )
    with pytest.raises(InputError) as caught:
        load_design(path)
    fields = {fault.field for fault in caught.value.faults}
    assert {"device.aperture_um", "phase[0].spiral_zones.zones", "sensor.pixel_um", "sensor.pixels_um"} <= fields
    assert str(path) in str(caught.value)


def test_faults_of_the_unit_cell_are_reported_with_those_of_the_design(tmp_path: Path) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text(CELL.read_text().replace("height_nm = 600.0", "height_nm = 0"))
    path = _variant(tmp_path, (str(CELL), str(cell)), ("layer = 1", "layer = -1"))
    with pytest.raises(InputError) as caught:
        load_design(path)
    text = str(caught.value)
    assert "cell.height_nm" in text
    assert "mask.layer" in text


@pytest.mark.parametrize("value", ['"350"', "nan", "inf", "0.0", "-1.0", "[350.0]", "true"])
def test_a_period_must_be_a_positive_number(tmp_path: Path, value: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL.read_text().replace("period_nm = 350.0", f"period_nm = {value}"))
    with pytest.raises(InputError, match="period_nm"):
        load_unit_cell(path)


def test_the_farthest_depth_may_be_infinite(tmp_path: Path) -> None:
    old = next(line for line in SMALL.read_text().splitlines() if line.startswith("depths_m"))
    design = load_design(_variant(tmp_path, (old, "depths_m = [0.003, inf]")))
    assert design.verify.depths_m == (0.003, math.inf)
    canonical = tmp_path / "canonical.toml"
    canonical.write_text(canonical_toml(design))
    assert load_design(canonical) == design
    for wrong in ("[inf, inf]", "[0.003, nan]", "[0.003, 1e16]", "[-inf, 0.003]"):
        with pytest.raises(InputError, match="depths_m"):
            load_design(_variant(tmp_path, (old, f"depths_m = {wrong}")))


def test_a_rectangular_period_is_x_then_y(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL.read_text().replace("period_nm = 350.0", "period_nm = [350.0, 400.0]"))
    cell = load_unit_cell(path)
    assert cell.cell.period_nm == (350.0, 400.0)
    assert not cell.has_square_lattice


def test_a_sweep_beyond_the_period_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL.read_text().replace("width_nm = [100.0, 250.0]", "width_nm = [100.0, 360.0]"))
    with pytest.raises(InputError, match="beyond"):
        load_unit_cell(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no file"),
        ("", "add the key"),
        ("name = ", "invalid TOML"),
        ("a = 1", "unknown"),
        (b"\xff\xfe", "no text in UTF-8.*metafab psf"),
        pytest.param(b"\x00\x06" * 2_100_000, "no text in UTF-8.*metafab psf", id="large mask"),
    ],
)
def test_unusable_files_say_what_is_wrong(tmp_path: Path, content: str | bytes | None, message: str) -> None:
    path = tmp_path / "design.toml"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=message):
        load_design(path)


def test_canonical_toml_reads_back_as_the_same_design(tmp_path: Path, small_design: Design) -> None:
    path = tmp_path / "canonical.toml"
    path.write_text(canonical_toml(small_design))
    assert load_design(path) == small_design
    assert canonical_toml(load_design(path)) == canonical_toml(small_design)


def test_a_scene_is_read_from_a_design_or_a_file(tmp_path: Path, small_design: Design) -> None:
    assert load_scene(SMALL) == small_design.scene
    path = tmp_path / "scene.toml"
    path.write_text("[[objects]]\ndepth_m = 0.3\n")
    assert math.isclose(load_scene(path).objects[0].depth_m, 0.3)


def test_fields_that_do_not_go_together_are_told_in_one_sentence(tmp_path: Path) -> None:
    cell = CELL.with_name("sin_circles_633nm.toml").read_text(encoding="utf-8")
    path = tmp_path / "cell.toml"
    path.write_text(cell.replace("length_nm = [100.0, 250.0]", "length_nm = [100.0, 240.0]"), encoding="utf-8")
    with pytest.raises(InputError) as told:
        load_unit_cell(path)
    sentence = "`sweep.length_nm` of circles must equal `sweep.width_nm`: both are the diameter"
    assert str(told.value) == f"{path}:\n  {sentence}"
    design = tmp_path / "design.toml"
    text = SMALL.read_text(encoding="utf-8").replace("../unitcell_lib/sos_800nm.toml", "cell.toml")
    design.write_text(text.replace('aperture_shape = "circle"', 'aperture_shape = "ring"'), encoding="utf-8")
    with pytest.raises(InputError) as told:
        load_design(design)
    assert f"  `library -> {path}`: {sentence}" in str(told.value).splitlines()
    assert "  `device`: `inner_um` must be between 0 and `aperture_um`" in str(told.value)
    assert "{" not in str(told.value)


def test_files_without_an_end_and_huge_ones_are_refused_at_once(tmp_path: Path) -> None:
    pipe, huge = tmp_path / "pipe.toml", tmp_path / "huge.toml"
    os.mkfifo(pipe)
    with huge.open("wb") as file:
        file.write(b"#" * 4096)
        file.truncate(1 << 40)  # sparse: takes no disk, but more than any memory to read
    for path, got in ((pipe, "a folder, pipe or device"), (tmp_path, "a folder"), (huge, "1099511627776 bytes")):
        with pytest.raises(InputError, match=f"`file`: expected a TOML file.*got {got}"):
            load_design(path)


def test_a_link_to_itself_is_no_file(tmp_path: Path) -> None:
    (tmp_path / "loop.npy").symlink_to("loop.npy")
    (tmp_path / "loop.toml").symlink_to("loop.toml")
    array = '[[phase]]\nterm = "array"\nfile = "loop.npy"\npitch_um = 0.5\n[rules]'
    design = tmp_path / "lens.toml"
    design.write_text(SMALL.read_text().replace("../unitcell_lib", CELL.parent.as_posix()).replace("[rules]", array))
    assert load_design(design).phase[-1].file == tmp_path / "loop.npy"  # whoever opens it says that there is none
    design.write_text(SMALL.read_text().replace("../unitcell_lib/sos_800nm.toml", "loop.toml"))
    with pytest.raises(InputError, match=r"library -> .*loop.toml: file"):
        load_design(design)


def test_a_file_of_another_kind_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a design file, got a unit-cell file .*`metafab library build`"):
        load_design(CELL)
    with pytest.raises(InputError, match=r"expected a unit-cell file, got a design file .*`metafab run`"):
        load_unit_cell(SMALL)
    scene = tmp_path / "scene.toml"
    scene.write_text("field_px = [64, 64]\n[[objects]]\ndepth_m = 0.3\n")
    with pytest.raises(InputError, match=r"expected a design file, got a scene file .*`metafab capture`"):
        load_design(scene)


def test_the_files_of_a_design_are_all_that_it_names(tmp_path: Path) -> None:
    (tmp_path / "cells").mkdir()
    (tmp_path / "index_2024.csv").write_text("800, 1.5\n")
    (tmp_path / "index.csv").symlink_to("index_2024.csv")
    (tmp_path / "cells" / "cell.toml").write_text('pillar = "../index.csv"\nsource = "lens.toml"\n')
    (tmp_path / "photo.png").write_bytes(b"")
    far = 40 * "cells/../" + "photo.png"
    objects = f'[[scene.objects]]\ntexture_file = "photo.png"\nlabel = "no file"\nfar = "{far}"\n'
    design = tmp_path / "lens.toml"
    design.write_text(f'name = "lens.toml"\nnote = "{300 * "x"}"\nlibrary = "cells/cell.toml"\n{objects}')
    named = ("lens.toml", "cells/cell.toml", "cells/../index.csv", "photo.png", far)
    assert files_of(design) == {tmp_path / name for name in named}


def test_a_library_that_is_no_path_is_one_fault(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        load_design(_variant(tmp_path, (f'library = "{CELL}"', "library = 3"), ('"circle"', '"oval"')))
    assert [fault.field for fault in refused.value.faults] == ["library", "device.aperture_shape"]
