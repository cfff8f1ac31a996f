"""``metafab fullwave``: supercells by each solver, refusals by name; pillars of ``coupling`` and ``patch``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metafab import library, mask
from metafab.cell.supercell import Supercell, SupercellOrders
from metafab.cli import entry
from metafab.cli.commands import fullwave
from metafab.core.errors import SolverError
from metafab.fullwave import blocks as solution
from metafab.layout import PillarMap, lattice_of
from metafab.library import Library
from metafab.spec import load_design
from tests.main_job import metafab

KEYS = {"orders", "t_xx", "t_xy", "t_yx", "t_yy", "error", "seconds"}
ROW = {"width_nm": [[120.0, 150.0, 180.0]], "length_nm": [[180.0, 150.0, 130.0]]}
TURNED = {"width_nm": [[180.0], [150.0], [130.0]], "length_nm": [[120.0], [150.0], [180.0]]}


@pytest.fixture(scope="module")
def library_file(smooth_library: Library, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("library") / "smooth.h5"
    library.save(smooth_library, path)
    return path


@pytest.fixture(scope="module")
def circles_file(smooth_library: Library, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("circles") / "circles.h5"
    cell = smooth_library.unit_cell
    library.save(replace(smooth_library, unit_cell=replace(cell, cell=replace(cell.cell, shape="circle"))), path)
    return path


def _asked(folder: Path, *blocks: object) -> Path:
    path = folder / "blocks.json"
    path.write_text(json.dumps({"blocks": blocks}), encoding="utf-8")
    return path


def test_lone_pillars_are_the_library_at_the_sites(library_file: Path, smooth_library: Library, tmp_path: Path) -> None:
    out = tmp_path / "answer.json"
    asked = _asked(tmp_path, ROW)
    answer = metafab("fullwave", asked, "--library", library_file, "--solver", "lone", "--json", "--out", out)
    assert answer.code == 0, answer.stderr
    (block,) = answer.json["blocks"]
    assert block.keys() == KEYS
    assert json.loads(out.read_text(encoding="utf-8"))["blocks"] == [block]
    assert block["orders"] == [[-1, 0], [0, 0], [1, 0]]
    stored = smooth_library.surface(np.array(ROW["width_nm"][0]), np.array(ROW["length_nm"][0]))
    phase = np.exp(-2j * np.pi * np.outer([-1, 0, 1], [-1, 0, 1]) / 3.0) / 3.0
    for name, t in (("t_xx", stored.t_xx), ("t_yy", stored.t_yy)):
        np.testing.assert_allclose(np.array(block[name]) @ [1.0, 1j], phase @ t, atol=1e-12)
    assert not np.any(block["t_xy"]) and not np.any(block["t_yx"])


def test_a_row_along_y_is_the_row_along_x_with_the_lights_exchanged(library_file: Path, tmp_path: Path) -> None:
    answer = metafab(
        "fullwave", _asked(tmp_path, ROW, TURNED), "--library", library_file, "--solver", "rcwa", "--json"
    )  # fmt: skip
    assert answer.code == 0, answer.stderr
    along_x, along_y = answer.json["blocks"]
    assert along_y["orders"] == [order[::-1] for order in along_x["orders"]]
    for name, other in (("t_xx", "t_yy"), ("t_yy", "t_xx"), ("t_xy", "t_yx")):
        np.testing.assert_allclose(along_x[name], along_y[other], atol=1e-9)
    assert 0.0 < along_x["error"] < 0.1


def test_a_target_that_no_elements_reach_is_told(library_file: Path, tmp_path: Path) -> None:
    options = "--library", library_file, "--solver", "rcwa", "--json"
    small = {"width_nm": [[120.0, 150.0]], "length_nm": [[150.0, 150.0]]}
    for target, told in (("1e-7", True), ("0.5", False)):
        answer = metafab("fullwave", _asked(tmp_path, small), *options, "--target-error", target)
        assert answer.code == 0, answer.stderr
        (block,) = answer.json["blocks"]
        warning = f"{float(target):g} is not reached by the finest elements in blocks 1 ({block['error']:.2g})"
        assert (warning in answer.stderr) is told


def test_a_library_without_a_model_says_how_to_make_one(library_file: Path, tmp_path: Path) -> None:
    asked = _asked(tmp_path, ROW)
    answer = metafab("fullwave", asked, "--library", library_file, "--solver", "model", "--json")
    assert (answer.code, answer.stdout) == (2, "")
    assert "[neighbours]" in answer.stderr
    answer = metafab("fullwave", tmp_path / "missing.json", "--library", library_file, "--json")
    assert (answer.code, answer.stdout) == (2, "")
    assert "JSON file" in answer.stderr


def test_a_row_of_circles_is_solved_and_keeps_its_power(circles_file: Path, tmp_path: Path) -> None:
    circles = {"width_nm": [[120.0, 180.0]], "length_nm": [[120.0, 180.0]]}
    options = "--library", circles_file, "--solver", "rcwa", "--target-error", "0.5", "--json"
    answer = metafab("fullwave", _asked(tmp_path, circles), *options)
    assert answer.code == 0, answer.stderr
    (block,) = answer.json["blocks"]
    assert block["orders"] == [[0, 0]]
    # Silicon absorbs little: what is not transmitted is reflected.
    for name in ("t_xx", "t_yy"):
        assert 0.1 < np.sum(np.square(block[name])) / 1.7601 < 1.0
    assert 0.0 < block["error"] < 0.1
    oval = {"width_nm": [[120.0, 180.0]], "length_nm": [[120.0, 130.0]]}
    answer = metafab("fullwave", _asked(tmp_path, oval), *options)
    assert (answer.code, answer.stdout) == (2, "")
    assert "`length_nm` equal to `width_nm` for circles" in answer.stderr


def test_a_failed_command_names_its_block_and_the_next_one_goes_on(
    library_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    lone, solved, fails = solution.lone_orders, list[float](), True

    def solver(supercell: Supercell, library: Library) -> SupercellOrders:
        first = float(supercell.size_nm[0, 0, 0])
        if fails and first == 130.0:
            raise SolverError("the layer of a supercell is singular")
        solved.append(first)
        return lone(supercell, library)

    monkeypatch.setattr(solution, "lone_orders", solver)
    rows = [{"width_nm": [[width, 150.0]], "length_nm": [[150.0, 180.0]]} for width in (120.0, 130.0, 140.0)]
    asked, out = _asked(tmp_path, *rows), tmp_path / "answer.json"
    command = "fullwave", asked, "--library", library_file, "--solver", "lone", "--json", "--out", out
    monkeypatch.setattr("sys.argv", ["metafab", *map(str, command)])
    with pytest.raises(SystemExit) as ended:
        entry.main()
    shown = capfd.readouterr()
    assert (ended.value.code, shown.out) == (1, "")
    assert "blocks[1]: the layer of a supercell is singular" in shown.err
    (kept,) = tmp_path.glob("answer.*.partial")
    assert str(kept) in shown.err
    assert {each.name for each in tmp_path.iterdir()} == {"blocks.json", kept.name}

    fails = False
    with pytest.raises(SystemExit) as ended:
        entry.main()
    assert ended.value.code in {0, None}
    assert solved == [120.0, 140.0, 130.0]
    answer = json.loads(out.read_text(encoding="utf-8"))["blocks"]
    assert json.loads(capfd.readouterr().out)["blocks"] == answer
    assert {each.name for each in tmp_path.iterdir()} == {"blocks.json", "answer.json"}
    whole = metafab(*command).json["blocks"]
    for block, other in zip(answer, whole, strict=True):
        assert {**block, "seconds": 0.0} == {**other, "seconds": 0.0}


@pytest.mark.parametrize("command", ["coupling", "patch"])
def test_rows_and_patches_are_the_standing_pillars_of_a_biased_mask(
    command: str, library_file: Path, smooth_library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mask draws each pillar 10 nm wider and longer than it shall stand."""
    design = tmp_path / "biased.toml"
    design.write_text(
        f"""
        name = "biased"
        library = "{library_file}"
        device = {{ aperture_um = 7.0, focal_length_mm = 0.02 }}
        phase = [{{ term = "lens" }}]
        rules = {{ min_gap_nm = 100.0, min_feature_nm = 100.0 }}
        mask = {{ formats = ["gds"], write_field_um = 499.8, bias_nm = 10.0 }}
        sensor = {{ pixel_um = 0.5, focus_depth_m = 10.0 }}
        verify = {{ depths_m = [10.0] }}
        """,
        encoding="utf-8",
    )
    spec = load_design(design)
    sizes = np.array([[0, 0], [300, 400]], dtype=np.int32)
    lattice = lattice_of(spec)
    pillars = PillarMap.from_array(lattice, sizes, np.ones(lattice.shape, dtype=np.uint16), 20)
    (file, *_) = mask.write(pillars, tmp_path, spec)
    seen = []

    def solve(standing: PillarMap, *_: object, **__: object) -> None:
        seen.append(standing.size_nm()[1:].tolist())
        raise SolverError("stopped here")

    monkeypatch.setattr("metafab.fullwave.measure_coupling", solve)
    monkeypatch.setattr("metafab.fullwave.plan_patch", solve)
    with pytest.raises(SolverError):
        if command == "coupling":
            fullwave.coupling_command(file.path, design, ["0,0"])
        else:
            fullwave.patch_command(file.path, design, (0.0, 0.0), 1.0)
    assert seen == [[[150.0, 200.0]]]
