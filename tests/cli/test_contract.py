"""The command-line contract: names, keys, exit codes, and stdout that holds one JSON object or nothing."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import gdstk
import h5py
import numpy as np
import pytest

from metafab import __version__
from metafab.cli.entry import spread_depths
from metafab.core.errors import InputError
from metafab.optics import load as load_psf
from tests.conftest import MainJob
from tests.main_job import ROOT, SMALL, UNIT_CELL, metafab

COMMANDS = [
    ["run"], ["cell"], ["library"], ["library", "build"], ["library", "check"], ["library", "show"],
    ["library", "import"], ["layout"], ["drc"], ["expose"], ["fullwave"], ["coupling"], ["patch"], ["psf"],
    ["capture"], ["decode"], ["report"], ["benchmark"], ["doctor"],
]  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_every_command_explains_itself(command: list[str], flag: str) -> None:
    answer = metafab(*command, flag)
    assert answer.code == 0
    assert answer.stdout.startswith("Usage: ")
    assert "``" not in answer.stdout


def test_help_before_a_command_lists_all_commands() -> None:
    assert metafab("--help", "run").stdout == metafab("--help").stdout


def test_cell_answers_with_the_contract_keys() -> None:
    answer = metafab("cell", UNIT_CELL, "--width-nm", "150", "--length-nm", "210", "--target-error", "1e-3", "--json")
    assert answer.code == 0, answer.stderr
    keys = {"t_xx", "t_yy", "t_xy", "t_yx", "r_xx", "r_yy", "transmittance_x", "transmittance_y"}
    assert keys | {"error", "orders", "seconds", "solver"} <= answer.json.keys()
    assert answer.json["solver"] == "rcwa"
    assert answer.json["error"] <= 1e-3
    re, im = answer.json["t_xx"]
    # |t|^2 n_out / n_in is the transmittance (conventions); n_in = 1.7601 is the sapphire of the file.
    assert answer.json["transmittance_x"] == pytest.approx((re**2 + im**2) / 1.7601, rel=1e-9)


def test_a_patch_says_what_it_takes_and_refuses_too_much(main_job: MainJob, tmp_path: Path) -> None:
    """Before anything is simulated: no Meep is needed for it."""
    out = tmp_path / "patch.h5"
    answer = metafab(
        "patch", main_job.folder / "layout.oas", "--design", SMALL, "--at-um", "5", "-5", "--size-um", "12",
        "-o", out, "--json",
    )  # fmt: skip
    assert answer.code == 2
    assert answer.stdout == ""
    first, *_ = answer.stderr.splitlines()
    # 34 sites and 3 on either side.
    assert first.startswith("metafab: 40 x 40 pillars, ")
    assert "min and" in first and "MB" in first
    assert "--force" in answer.stderr
    assert not out.exists()


def test_places_of_rows_are_two_numbers(main_job: MainJob) -> None:
    mask = main_job.folder / "layout.oas"
    answer = metafab("coupling", mask, "--design", SMALL, "--at-um", "5;3", "--json")
    assert (answer.code, answer.stdout) == (2, "")
    assert "two numbers X,Y" in answer.stderr


def test_the_version_is_that_of_the_code() -> None:
    """One source: stale metadata of an installation in place used to be printed."""
    answer = metafab("--version")
    assert (answer.code, answer.stdout) == (0, f"metafab {__version__}\n")
    assert subprocess.check_output([sys.executable, "-m", "metafab", "--version"], cwd=ROOT, text=True) == answer.stdout
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == __version__


def test_doctor_lists_what_is_there() -> None:
    answer = metafab("doctor", "--json")
    assert answer.code == 0, answer.stderr
    assert {"found", "version", "python"} <= answer.json["meep"].keys()
    assert all(answer.json["self_test"].values())


def test_layout_writes_what_it_says(tmp_path: Path) -> None:
    answer = metafab("layout", SMALL, "-o", tmp_path, "--json")
    assert answer.code == 0, answer.stderr
    keys = {"pillars", "distinct_sizes", "min_gap_nm", "phase_rms_error_rad", "files", "seconds", "peak_rss_mb"}
    assert keys <= answer.json.keys()
    assert answer.json["min_gap_nm"] >= 100.0
    for file in answer.json["files"]:
        assert (tmp_path / file["name"]).stat().st_size == file["bytes"]


def test_the_same_design_gives_the_same_mask_bytes(tmp_path: Path, main_job: MainJob) -> None:
    answer = metafab("layout", SMALL, "-o", tmp_path, "--json")
    assert answer.code == 0, answer.stderr
    for name in ("layout.gds", "layout.oas"):
        assert (tmp_path / name).read_bytes() == (main_job.folder / name).read_bytes()


@pytest.mark.parametrize("engine", ["lattice", "polygons"])
@pytest.mark.parametrize("name", ["layout.gds", "layout.oas"])
def test_drc_passes_the_written_file(main_job: MainJob, engine: str, name: str) -> None:
    answer = metafab("drc", main_job.folder / name, "--design", SMALL, "--engine", engine, "--json")
    assert answer.code == 0, answer.stderr
    assert answer.json["pillars"] == main_job.answer.json["layout"]["pillars"]
    assert set(answer.json["violations"].values()) == {0}


def test_drc_exits_with_2_where_a_rule_is_violated(tmp_path: Path, main_job: MainJob) -> None:
    strict = tmp_path / "strict.toml"
    text = SMALL.read_text().replace("../unitcell_lib", str(UNIT_CELL.parent))
    strict.write_text(text.replace("min_gap_nm = 100.0", "min_gap_nm = 130.0"))
    answer = metafab("drc", main_job.folder / "layout.oas", "--design", strict, "--json")
    assert answer.code == 2
    assert answer.json["violations"]["min_gap"] > 0


def test_psf_capture_and_decode_work_one_by_one(tmp_path: Path, main_job: MainJob) -> None:
    psf = tmp_path / "psf.h5"
    layout = main_job.folder / "layout.gds"
    depths = ["0.0025", "0.0028", "0.0031"]
    answer = metafab("psf", layout, "--design", SMALL, "--depths-m", *depths, "-o", psf, "--json")
    assert answer.code == 0, answer.stderr
    keys = {"phi_deg", "depth_m", "efficiency_x", "efficiency_y", "extinction_ratio", "error", "seconds"}
    assert keys <= answer.json.keys()
    assert answer.json["depth_m"] == [float(z) for z in depths]
    calibration = main_job.folder / "psf.h5"
    raw, decoded = tmp_path / "raw.h5", tmp_path / "decoded.h5"
    answer = metafab("capture", SMALL, "--psf", calibration, "-o", raw, "--json")
    assert answer.code == 0, answer.stderr
    assert {"shape", "photons", "seconds"} <= answer.json.keys()
    answer = metafab("decode", raw, "--psf", calibration, "-o", decoded, "--json")
    assert answer.code == 0, answer.stderr
    assert {"seconds", "segments", "nmae"} <= answer.json.keys()
    assert answer.json["nmae"] < 0.01


def test_decode_takes_a_camera_frame_without_truth(tmp_path: Path, main_job: MainJob) -> None:
    with h5py.File(main_job.folder / "raw.h5") as file:
        np.save(tmp_path / "raw.npy", np.asarray(file["frame"]))
    answer = metafab(
        "decode", tmp_path / "raw.npy", "--psf", main_job.folder / "psf.h5", "-o", tmp_path / "d.h5", "--json"
    )
    assert answer.code == 0, answer.stderr
    assert "nmae" not in answer.json


def test_ideal_psf_needs_no_mask() -> None:
    answer = metafab("psf", "--ideal", "--design", SMALL, "--depths-m", "0.003", "--json")
    assert answer.code == 0, answer.stderr
    assert len(answer.json["phi_deg"]) == 1
    for p, efficiency in zip("xy", (answer.json["efficiency_x"], answer.json["efficiency_y"]), strict=True):
        transmitted, stray, lost = (answer.json[f"{part}_{p}"] for part in ("transmitted", "stray", "lost"))
        assert efficiency[0] + stray + lost == pytest.approx(1.0) and efficiency[0] <= transmitted


def test_an_ideal_psf_reaches_to_infinity_but_not_beside_the_axis_there(tmp_path: Path) -> None:
    command = ("psf", "--ideal", "--design", SMALL, "--window-px", "32", "--depths-m", "0.003", "--depths-m", "inf")
    answer = metafab(*command, "-o", tmp_path / "psf.h5", "--json")
    assert answer.code == 0, answer.stderr
    assert answer.json["depth_m"] == [0.003, "inf"]
    assert load_psf(tmp_path / "psf.h5").depth_m.tolist() == [0.003, math.inf]
    answer = metafab(*command, "--object-mm", "0.1", "0")
    assert answer.code == 2 and "`--object-mm`: expected an object at a finite depth" in answer.stderr


def test_pixels_too_coarse_to_add_up_are_refused() -> None:
    answer = metafab("psf", "--ideal", "--design", SMALL, "--depths-m", "0.003", "--pixel-um", "30")
    assert answer.code == 2 and "`--pixel-um`: expected below" in answer.stderr and "sample finer" in answer.stderr


def test_report_makes_the_page_again(main_job: MainJob) -> None:
    answer = metafab("report", main_job.folder, "--json")
    assert answer.code == 0, answer.stderr
    assert Path(answer.json["file"]).name == "report.html"


def test_psf_refuses_a_mask_whose_pillars_it_cannot_place(tmp_path: Path, main_job: MainJob) -> None:
    library = gdstk.read_gds(main_job.folder / "layout.gds")
    cell = next(cell for cell in library.cells if cell.polygons)
    for polygon in cell.polygons[:3]:
        polygon.translate(0.005, 0.0)
    moved = tmp_path / "moved.gds"
    library.write_gds(moved)
    answer = metafab("psf", moved, "--design", SMALL, "--depths-m", "0.003")
    assert answer.code == 2
    assert "off the lattice" in answer.stderr
    answer = metafab("drc", moved, "--design", SMALL, "--json")
    assert answer.code == 2
    assert answer.json["violations"]["lattice_site"] >= 3


def test_a_changed_mask_changes_the_psf(tmp_path: Path, main_job: MainJob) -> None:
    library = gdstk.read_gds(main_job.folder / "layout.gds")
    cells = [cell for cell in library.cells if cell.polygons]
    for cell in cells[: len(cells) // 2]:
        cell.remove(*cell.polygons)
    half = tmp_path / "half.gds"
    library.write_gds(half)
    arguments = ("--design", SMALL, "--depths-m", "0.003", "--json")
    whole, cut = (metafab("psf", path, *arguments).json for path in (main_job.folder / "layout.gds", half))
    assert cut["efficiency_x"][0] < 0.8 * whole["efficiency_x"][0]


def test_what_the_design_alone_can_tell_is_said_at_once(tmp_path: Path) -> None:
    path = tmp_path / "wide.toml"
    text = SMALL.read_text().replace("../unitcell_lib", str(UNIT_CELL.parent))
    text = text.replace("field_px = [160, 128]", "field_px = [160, 512]").replace("499.8", "500.0")
    path.write_text(text.replace("depths_m = [0.0025", "depths_m = [0.0005"))
    answer = metafab("run", path, "-o", tmp_path / "out")
    assert answer.code == 2
    for name in ("mask.write_field_um", "verify.depths_m[0]"):
        assert name in answer.stderr
    assert not (tmp_path / "out").exists()


# --- bad input: one clear message, exit code 2 ---------------------------------------------------------------------


def test_a_design_with_three_faults_reports_all_three(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    text = SMALL.read_text().replace("../unitcell_lib", str(UNIT_CELL.parent))
    text = text.replace("aperture_um = 200.0", "aperture_um = -1.0").replace("zones = 4", "zones = 0")
    path.write_text(text.replace("layer = 1", "layr = 1"))
    answer = metafab("run", path, "--json")
    assert answer.code == 2
    assert answer.stdout == ""
    for place in ("device.aperture_um", "phase[0].spiral_zones.zones", "mask.layr"):
        assert place in answer.stderr
    assert "Traceback" not in answer.stderr


BAD_CALLS = {
    "no design": ["run", "nowhere.toml"],
    "no library": ["library", "check", "nowhere.h5"],
    "no mask": ["drc", "nowhere.gds", "--design", str(SMALL)],
    "no psf": ["capture", str(SMALL), "--psf", "nowhere.h5"],
    "no frame": ["decode", "nowhere.h5", "--psf", "nowhere.h5"],
    "unknown solver": ["cell", str(UNIT_CELL), "--width-nm", "150", "--length-nm", "150", "--solver", "x"],
    "wider than the period": ["cell", str(UNIT_CELL), "--width-nm", "400", "--length-nm", "150"],
    "neither mask nor ideal": ["psf", "--design", str(SMALL)],
    "depth zero": ["psf", "--ideal", "--design", str(SMALL), "--depths-m", "0"],
    "depth not a number": ["psf", "--ideal", "--design", str(SMALL), "--depths-m", "nan"],
    "pixel zero": ["psf", "--ideal", "--design", str(SMALL), "--pixel-um", "0"],
    "window of a whole sensor": ["psf", "--ideal", "--design", str(SMALL), "--window-px", "4096"],
    "no run folder": ["report", str(ROOT / "tests")],
    "unknown room": ["benchmark", "x"],
    "unknown command": ["fly"],
    "not a design": ["run", str(ROOT / "README.md")],
}


@pytest.mark.parametrize("call", BAD_CALLS.values(), ids=BAD_CALLS.keys())
def test_bad_input_exits_with_2_and_one_message(call: list[str], tmp_path: Path) -> None:
    answer = metafab(*call, cwd=tmp_path)
    assert answer.code == 2, answer.stderr
    assert answer.stdout == ""
    assert "Traceback" not in answer.stderr
    assert answer.stderr.strip()


@pytest.mark.parametrize("name", ["layout.gds", "layout.oas", "psf.h5", "raw.h5"])
@pytest.mark.parametrize("damage", ["empty", "truncated", "foreign"])
def test_damaged_files_are_refused(tmp_path: Path, main_job: MainJob, name: str, damage: str) -> None:
    content = (main_job.folder / name).read_bytes()
    path = tmp_path / name
    path.write_bytes({"empty": b"", "truncated": content[: len(content) // 2], "foreign": b"hello" * 100}[damage])
    if name.startswith("layout"):
        answer = metafab("drc", path, "--design", SMALL)
    elif name == "psf.h5":
        answer = metafab("decode", main_job.folder / "raw.h5", "--psf", path, "-o", tmp_path / "d.h5")
    else:
        answer = metafab("decode", path, "--psf", main_job.folder / "psf.h5", "-o", tmp_path / "d.h5")
    assert answer.code == 2, answer.stderr
    assert str(path) in answer.stderr
    assert "Traceback" not in answer.stderr
    assert not (tmp_path / "d.h5").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("delay_s", [1.0, 2.5])
def test_an_interrupted_run_leaves_no_half_written_file(tmp_path: Path, number: int, delay_s: float) -> None:
    command = [sys.executable, "-m", "metafab.cli", "run", str(SMALL), "-o", str(tmp_path)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    time.sleep(delay_s)
    process.send_signal(number)
    _, stderr = process.communicate(timeout=60)
    # 0 where the run was faster than the signal, the signal where it met what Python does after the last line.
    assert process.returncode in (0, 128 + number, -number), stderr
    assert "Traceback" not in stderr or process.returncode == -number
    assert [p.name for p in tmp_path.rglob("*.part")] == []
    for path in tmp_path.glob("*.h5"):
        with h5py.File(path) as file:
            assert file.attrs["kind"]


def test_depths_may_stand_in_any_of_three_ways() -> None:
    wanted = ["--depths-m=0.25", "--depths-m=0.3", "--json"]
    assert spread_depths(["--depths-m", "0.25", "0.3", "--json"]) == wanted
    assert spread_depths(["--depths-m", "0.25,0.3", "--json"]) == wanted
    assert spread_depths(["--depths-m=0.25", "--depths-m", "0.3", "--json"]) == wanted


@pytest.mark.parametrize("rest", [[], ["--json"], ["mask.oas"], ["="], ["0.3,"]])
def test_an_option_without_depths_is_told(rest: list[str]) -> None:
    with pytest.raises(InputError, match=r"depths\.m"):
        spread_depths(["psf", "--depths-m", *rest])
