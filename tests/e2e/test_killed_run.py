"""``kill -9`` at random moments of a run: what is left is whole, and the next run ends as an undisturbed one does.

The killed run is that of a copied project, at another time: only ``summary.json`` tells the two apart.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from metafab import library
from metafab.core.storage.files import clear_parts, whole_file
from metafab.library import Library
from metafab.spec import write_new
from tests.main_job import ROOT, metafab

KILLS = 3
#: The file that holds times, and so differs between any two runs, and the lock of a killed one.
TIMED = {".rerun.json", ".run.lock", "summary.json"}


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory, smooth_library: Library) -> Path:
    """A camera of 30 micrometres with a library in closed form: every step of the main job, in seconds."""
    folder = tmp_path_factory.mktemp("design")
    built = folder / "built.h5"
    library.save(smooth_library, built)
    path = write_new("tiny", "camera", folder, built)[0]
    text = path.read_text(encoding="utf-8")
    for old, new in (
        ("aperture_um = 200.0", "aperture_um = 30.0"),
        ("focal_length_mm = 1.0", "focal_length_mm = 0.15"),
        ("field_px = [160, 128]", "field_px = [24, 16]"),
        ("pixel_um = 2.4", "pixel_um = 1.5"),
        ("[0.0025, 0.0028, 0.0031, 0.0034]", "[0.0028]\nwindow_px = 24\ntarget_error = 1e-2"),
    ):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


def results(folder: Path) -> dict[str, bytes]:
    """Bytes of every file that tells no time."""
    paths = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    return {name: path.read_bytes() for name, path in sorted(paths.items()) if name not in TIMED}


def untimed(folder: Path) -> dict[str, object]:
    """The summary without what its run cost."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    for key in ("seconds", "peak_rss_mb", "skipped", "modified_ns"):
        del summary[key]
    return dict(summary)


@pytest.mark.slow
def test_a_killed_run_is_taken_up_again(design: Path, tmp_path: Path) -> None:
    start, undisturbed = time.perf_counter(), design.parent / "run"
    # As long as those that are killed, imports included.
    whole = metafab("run", design, "-o", undisturbed, "--workers", "1", "--json", fresh=True)
    assert whole.code == 0, whole.stderr
    seconds = time.perf_counter() - start
    moments = random.Random(2023)
    moved = tmp_path / "another" / "place"
    shutil.copytree(design.parent, moved, ignore=shutil.ignore_patterns("run"))
    design, folder = moved / design.name, moved / "run"
    command = [sys.executable, "-m", "metafab.cli", "run", str(design), "-o", str(folder), "--workers", "2"]
    for _ in range(KILLS):
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            process.wait(moments.uniform(0.1, 0.9) * seconds)
        except subprocess.TimeoutExpired:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
        expected = results(undisturbed)
        for name, content in results(folder).items():
            # A part is named by its process and never like a result; records are added step by step.
            assert name.endswith((".part", "steps.json")) or content == expected[name], name
    finished = metafab("run", design, "-o", folder, "--workers", "2", "--json")
    assert finished.code == 0, finished.stderr
    assert results(folder) == results(undisturbed)
    assert untimed(folder) == untimed(undisturbed)


def test_parts_of_the_dead_are_cleared_away_and_those_of_the_living_kept(tmp_path: Path) -> None:

    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    left = tmp_path / f".layout.gds.{dead.pid}-abcdef.part"
    left.write_bytes(b"half")
    own, foreign = tmp_path / "kept.part", tmp_path / ".notes.part"
    for path in (own, foreign):
        path.write_bytes(b"a user's")
    with whole_file(tmp_path / "result") as part:
        part.write_bytes(b"whole")
        clear_parts(tmp_path)
        assert part.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".notes.part", "kept.part", "result"]
