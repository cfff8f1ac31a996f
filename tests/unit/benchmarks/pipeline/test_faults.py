"""The benchmark of faults: what it finds in folders and processes, and that its project is a sound design."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.pipeline import faults
from metafab.spec import load_design


def test_differences_are_named(tmp_path: Path) -> None:
    for name, content in {"a.txt": b"1", "run/steps.json": b"{}", "run/summary.json": b"2"}.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    whole = faults._results(tmp_path)
    assert list(whole) == ["a.txt", "run/steps.json"]
    (tmp_path / "run" / "steps.json").write_bytes(b"[]")
    (tmp_path / "run" / ".layout.gds.part").write_bytes(b"half")
    (tmp_path / "run" / "summary.json").write_bytes(b"3")
    assert faults._differences(tmp_path, whole, unfinished=True) == []
    assert faults._differences(tmp_path, whole) == [
        "run/.layout.gds.part in one of them only",
        "run/steps.json differs",
    ]
    (tmp_path / "a.txt").write_bytes(b"0")
    assert faults._differences(tmp_path, whole, unfinished=True) == ["a.txt differs"]


def test_an_exit_code_and_a_traceback_are_faults() -> None:
    done = subprocess.CompletedProcess([], 1, "", "Traceback (most recent call last)\nboom")
    assert [fault.partition(":")[0] for fault in faults._ended(done, 2)] == ["exit 1", "a traceback"]
    assert faults._ended(subprocess.CompletedProcess([], 2, "", "metafab: no"), 2) == []


def test_the_project_is_a_small_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "_metafab", lambda *_: subprocess.CompletedProcess([], 0, "", ""))
    project, _ = faults._project(tmp_path / "project")
    assert load_design(project.design).device.aperture_um == 30.0
    monkeypatch.setattr(faults, "_metafab", lambda *_: subprocess.CompletedProcess([], 1, "", "metafab: no"))
    with pytest.raises(RuntimeError, match="metafab: no"):
        faults._project(tmp_path / "another")


def test_a_process_that_has_just_ended_needs_no_kill() -> None:
    faults._kill((1 << 22) + 1)  # Linux gives no such number


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_process_that_outlives_its_parent_is_found_and_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "OUTLIVED_S", 0.2)
    orphan = "import subprocess, sys; subprocess.Popen(['sleep', '60']); print('begun', flush=True)"
    parent = subprocess.Popen([sys.executable, "-c", orphan], start_new_session=True, stdout=subprocess.PIPE)
    parent.wait()
    assert len(faults._left_over(parent.pid)) == 1
    assert faults._left_over(parent.pid) == []


def test_every_damage_changes_the_file(tmp_path: Path) -> None:
    for name, kinds in {"a.json": 6, "a.h5": 2, "a.png": 1}.items():
        path = tmp_path / name
        path.write_bytes(b'{"a": [1, 2, 3]}')
        damages = faults._damages(path)
        assert len(damages) == kinds and path.read_bytes() not in damages.values()
