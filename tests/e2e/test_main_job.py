"""The main job on the small design, from outside: what it promises and what it leaves in its folder."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np

from metafab import mask
from metafab.spec import load_design
from tests.conftest import MainJob
from tests.main_job import SMALL, metafab

FILES = {
    "design.toml": None,
    "layout.gds": None,
    "layout.oas": None,
    "layout.lyp": None,
    "layout.json": None,
    "drc.json": None,
    "report.html": None,
    "summary.json": None,
    "psf.h5": {"depth_m", "pixel_um", "psf", "centre_um", "phi_deg", "error"},
    "raw.h5": {"frame", "truth/depth_m", "truth/intensity_x", "truth/intensity_y", "truth/label"},
    "decoded.h5": {"intensity_x", "intensity_y", "contrast", "depth_m", "confidence", "segment"},
}
KEYS = {
    "library", "phase", "layout", "drc", "psf", "decode", "error_budget", "seconds", "skipped", "versions",
}  # fmt: skip


def test_the_run_folder_holds_every_promised_file(main_job: MainJob) -> None:
    for name, datasets in FILES.items():
        path = main_job.folder / name
        assert path.stat().st_size > 0, name
        if datasets:
            with h5py.File(path) as file:
                for dataset in datasets:
                    assert file[dataset].attrs["units"], f"{name}:{dataset}"
                    assert file[dataset].attrs["description"], f"{name}:{dataset}"
                assert file.attrs["metafab_version"]
                assert file.attrs["inputs_sha256"]
    assert len(list((main_job.folder / "figures").glob("*.png"))) >= 6


def test_the_summary_has_its_keys_and_goes_to_stdout(main_job: MainJob) -> None:
    stored = json.loads((main_job.folder / "summary.json").read_text())
    assert stored == main_job.answer.json
    assert stored.keys() >= KEYS
    assert {"peak_gain", "rotation_deg"} <= stored["phase"].keys()
    assert all(seconds >= 0.0 for seconds in stored["seconds"].values())


def test_what_was_measured_is_good(main_job: MainJob) -> None:
    summary = main_job.answer.json
    assert set(summary["drc"]["violations"].values()) == {0}
    assert summary["layout"]["min_gap_nm"] >= 100.0
    assert summary["library"]["max_error"] <= 2e-3
    assert summary["decode"]["nmae"] < 0.01
    assert max(summary["psf"]["error"]) <= 1e-3
    # The written mask turns as the target phases do: its pixels and phase errors move the lobe by little.
    difference = np.subtract(summary["psf"]["phi_deg"], summary["psf"]["ideal_phi_deg"])
    assert np.abs((difference + 180.0) % 360.0 - 180.0).max() < 5.0


def test_the_simulated_pillars_are_those_of_the_file(main_job: MainJob) -> None:
    design = load_design(SMALL)
    gds, oas = (mask.read(main_job.folder / f"layout.{s}", design).pillars for s in ("gds", "oas"))
    first, second = gds.size_dbu[gds.to_array()], oas.size_dbu[oas.to_array()]
    assert np.array_equal(first, second)
    assert np.count_nonzero(first[..., 0]) == main_job.answer.json["layout"]["pillars"]


def test_a_second_run_skips_everything(main_job: MainJob, tmp_path: Path) -> None:
    folder = tmp_path / "again"
    shutil.copytree(main_job.folder, folder)
    first = metafab("run", SMALL, "-o", folder, "--json")
    assert first.code == 0, first.stderr
    second = metafab("run", SMALL, "-o", folder, "--json")
    assert {entry["step"] for entry in second.json["skipped"]} == {
        "library", "phase", "study", "layout", "drc", "exposure", "psf", "orders", "merit", "tolerance", "lights",
        "capture", "decode", "report",
    }  # fmt: skip
    assert second.json["decode"] == first.json["decode"]
    # The pipeline gives the answer that was kept, to the last byte.
    summary = (folder / "summary.json").read_bytes()
    (folder / ".rerun.json").unlink()
    by_pipeline = metafab("run", SMALL, "-o", folder, "--json")
    assert by_pipeline.stdout == second.stdout
    assert (folder / "summary.json").read_bytes() == summary


def test_a_run_with_nothing_to_do_starts_no_room(main_job: MainJob, tmp_path: Path) -> None:
    """What a second run costs is what it imports."""
    folder = tmp_path / "again"
    shutil.copytree(main_job.folder, folder)
    assert metafab("run", SMALL, "-o", folder, "--json").code == 0
    code = (
        "import sys; from metafab.cli.again import answer_again; print(answer_again(sys.argv[1:])); "
        "print([m for m in ('numpy', 'pydantic', 'typer', 'metafab.spec') if m in sys.modules])"
    )
    command = [sys.executable, "-c", code, "run", SMALL, "-o", folder]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    assert answer.stdout.splitlines()[-2:] == ["0", "[]"]
    assert f"{folder / 'report.html'}" in answer.stdout
    code = (
        "import sys; from pathlib import Path; from metafab.spec import load_design; from metafab.run import run; "
        "run(load_design(Path(sys.argv[1])), Path(sys.argv[2])); "
        "print([m for m in ('scipy', 'numba', 'matplotlib', 'h5py', 'metafab.optics') if m in sys.modules])"
    )
    answer = subprocess.run([sys.executable, "-c", code, SMALL, folder], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


def test_a_stated_process_prints_the_mask_of_the_same_run(main_job: MainJob, tmp_path: Path) -> None:
    folder = tmp_path / "exposed"
    shutil.copytree(main_job.folder, folder)
    # The sample under the name of the run, so that its mask is not written again.
    sample = SMALL.with_name("helix_exposed.toml").read_text(encoding="utf-8")
    named = sample.replace("helix_exposed", "helix_small").replace('"../', f'"{SMALL.parent.parent}/')
    (tmp_path / "exposed.toml").write_text(named, encoding="utf-8")
    answer = metafab("run", tmp_path / "exposed.toml", "-o", folder, "--json")
    assert answer.code == 0, answer.stderr
    assert {entry["step"] for entry in answer.json["skipped"]} >= {"layout", "drc", "psf", "decode"}
    printed = answer.json["exposure"]
    # The sample asks for as few classes as change printed sizes by 0.1 nm at most.
    assert printed["corrected_rms_nm"] < 0.1
    assert printed["cd_error_rms_nm"] > 0.1
    assert 1 < printed["classes"] <= 64 and printed["dose_min"] < 1.0 < printed["dose_max"]
    record = json.loads((folder / "exposure.json").read_text())
    assert record["plain"]["figures"]["cd_error_rms_nm"] == printed["cd_error_rms_nm"]
    assert "Exposure: printed sizes" in (folder / "report.html").read_text(encoding="utf-8")
