"""Which steps are stale: only those whose inputs, code or files changed, and what follows from them."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from metafab import run as run_module
from metafab.core.errors import InputError
from metafab.core.storage.provenance import contents_sha256
from metafab.run import Record, run
from metafab.spec import Design
from metafab.steps.job import Job, Step


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Three small steps in a row that record when they work; the real ones are tested end to end."""
    import metafab.steps as real

    done: list[str] = []

    def step(name: str, after: tuple[str, ...], inputs: Any) -> Step:
        def work(job: Job) -> dict[str, Any]:
            done.append(name)
            (job.folder / f"{name}.txt").write_text(name + repr(inputs(job.design)))
            return {"violations": {}} if name == "drc" else {"value": name}

        return Step(name, (), after, inputs, lambda job: (job.folder / f"{name}.txt",), work)

    chain = (
        step("layout", (), lambda d: d.device),
        step("drc", ("layout",), lambda d: d.rules),
        step("psf", ("layout",), lambda d: d.sensor),
    )

    report = replace(step("report", ("layout", "drc", "psf"), lambda d: d.name), reads=("left.json",))
    monkeypatch.setattr(real, "STEPS", chain)
    monkeypatch.setattr(real, "REPORT", report)
    monkeypatch.setattr(real, "error_budget", lambda figures: [])
    return done


def _changed(design: Design, **tables: Any) -> Design:
    return replace(design, **{name: replace(getattr(design, name), **keys) for name, keys in tables.items()})


def test_nothing_changed_nothing_done(tmp_path: Path, small_design: Design, steps: list[str]) -> None:
    run(small_design, tmp_path)
    assert steps == ["layout", "drc", "psf", "report"]
    steps.clear()
    outcome = run(small_design, tmp_path)
    assert steps == []
    assert [entry["step"] for entry in outcome.summary["skipped"]] == ["layout", "drc", "psf", "report"]


def test_a_file_that_another_command_left_reaches_the_step_that_reads_it(
    tmp_path: Path, small_design: Design, steps: list[str]
) -> None:
    run(small_design, tmp_path)
    for text in ("first", "second"):
        (tmp_path / "left.json").write_text(text)
        steps.clear()
        run(small_design, tmp_path)
        assert steps == ["report"]
        run(small_design, tmp_path)
        assert steps == ["report"], "and only once"


def test_a_changed_input_reaches_its_step_and_no_other(tmp_path: Path, small_design: Design, steps: list[str]) -> None:
    run(small_design, tmp_path)
    steps.clear()
    run(_changed(small_design, sensor={"pixel_um": 3.0}), tmp_path)
    assert steps == ["psf", "report"]


def test_a_step_redone_with_the_same_result_disturbs_nobody(
    tmp_path: Path, small_design: Design, steps: list[str]
) -> None:
    run(small_design, tmp_path)
    steps.clear()
    (tmp_path / "layout.txt").unlink()
    run(small_design, tmp_path)
    assert steps == ["layout"]


def test_a_named_file_counts_by_its_content(tmp_path: Path, small_design: Design, steps: list[str]) -> None:
    file = tmp_path / "phase.npy"
    file.write_bytes(b"first")
    assert contents_sha256({"phase": [file]}) != contents_sha256({"phase": []})
    before = contents_sha256({"phase": [file]})
    file.write_bytes(b"other")
    assert contents_sha256({"phase": [file]}) != before
    assert contents_sha256([str(tmp_path / "n.csv")]) == ["missing"]


def test_a_step_without_a_point_is_skipped_with_its_reason(
    tmp_path: Path, small_design: Design, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import metafab.steps as real

    *others, last = real.STEPS
    monkeypatch.setattr(real, "STEPS", (*others, replace(last, pointless=lambda design: "nothing to see")))
    outcome = run(small_design, tmp_path)
    assert {"step": "psf", "why": "nothing to see"} in outcome.summary["skipped"]
    assert outcome.summary["psf"] == {}


def test_files_of_a_step_that_lost_its_point_are_removed(
    tmp_path: Path, small_design: Design, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import metafab.steps as real

    run(small_design, tmp_path)
    assert (tmp_path / "psf.txt").is_file()
    *others, last = real.STEPS
    monkeypatch.setattr(real, "STEPS", (*others, replace(last, pointless=lambda design: "nothing to see")))
    steps.clear()
    run(small_design, tmp_path)
    assert not (tmp_path / "psf.txt").exists()
    assert (tmp_path / "drc.txt").is_file()
    assert steps == ["report"]


def test_a_report_that_was_not_finished_is_made_again(
    tmp_path: Path, small_design: Design, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import metafab.steps as real

    def killed(job: Job) -> dict[str, Any]:
        raise KeyboardInterrupt

    run(small_design, tmp_path)
    whole = real.REPORT
    monkeypatch.setattr(real, "REPORT", replace(whole, work=killed))
    changed = _changed(small_design, sensor={"pixel_um": 3.0})
    with pytest.raises(KeyboardInterrupt):
        run(changed, tmp_path)
    monkeypatch.setattr(real, "REPORT", whole)
    steps.clear()
    run(changed, tmp_path)
    assert steps == ["report"]


def test_a_changed_input_reaches_all_that_follows(tmp_path: Path, small_design: Design, steps: list[str]) -> None:
    run(small_design, tmp_path)
    steps.clear()
    run(_changed(small_design, device={"aperture_um": 100.0}), tmp_path)
    assert steps == ["layout", "drc", "psf", "report"]


@pytest.mark.parametrize("damage", ["missing", "edited", "same length"])
def test_a_file_that_is_not_as_it_was_left_is_made_again(
    tmp_path: Path, small_design: Design, steps: list[str], damage: str
) -> None:
    run(small_design, tmp_path)
    steps.clear()
    victim = tmp_path / "drc.txt"
    if damage == "missing":
        victim.unlink()
    else:
        victim.write_text(victim.read_text().swapcase() if damage == "same length" else "other")
        os.utime(victim, ns=(1, 1))
    run(small_design, tmp_path)
    assert steps == ["drc"]  # the same file again: the page shows nothing new


def test_a_touched_file_with_the_same_bytes_still_stands(
    tmp_path: Path, small_design: Design, steps: list[str]
) -> None:
    run(small_design, tmp_path)
    steps.clear()
    os.utime(tmp_path / "psf.txt", ns=(1, 1))
    run(small_design, tmp_path)
    assert steps == []


def test_changed_code_makes_its_steps_stale(
    tmp_path: Path, small_design: Design, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run(small_design, tmp_path)
    steps.clear()
    monkeypatch.setattr(run_module, "code_sha256", lambda rooms: "another")
    run(small_design, tmp_path)
    assert steps == ["layout", "drc", "psf", "report"]


@pytest.mark.parametrize("content", ["", "{", "[]", '{"layout": {"wrong": 1}}'])
def test_a_damaged_record_means_doing_it_again(
    tmp_path: Path, small_design: Design, steps: list[str], content: str
) -> None:
    run(small_design, tmp_path)
    steps.clear()
    (tmp_path / "steps.json").write_text(content)
    run(small_design, tmp_path)
    assert steps == ["layout", "drc", "psf", "report"]


def test_a_copied_folder_is_judged_by_its_own_files(tmp_path: Path, small_design: Design, steps: list[str]) -> None:
    first, copy = tmp_path / "first", tmp_path / "copy"
    run(small_design, first)
    shutil.copytree(first, copy)
    (copy / "psf.txt").unlink()
    steps.clear()
    run(small_design, copy)
    assert steps == ["psf"]


def test_a_record_without_files_stands(tmp_path: Path) -> None:
    assert Record("", {}, {}, 0.0, 0.0).stands(tmp_path)


def test_what_the_design_alone_tells_is_found_once(
    tmp_path: Path, small_design: Design, steps: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import metafab.steps as real

    looked: list[str] = []

    def look(job: Job) -> dict[str, Any]:
        looked.append(job.design.name)
        return {"announcements": ["a large file"]}

    monkeypatch.setattr(real, "PREFLIGHT", replace(real.PREFLIGHT, work=look))
    said: list[str] = []
    for _ in range(2):
        run(small_design, tmp_path, say=said.extend)
    assert (len(looked), said) == (1, ["a large file"])
    run(_changed(small_design, sensor={"pixel_um": 3.0}), tmp_path, say=said.extend)
    assert len(looked) == 2


def test_a_design_that_cannot_work_leaves_no_folder(tmp_path: Path, small_design: Design, steps: list[str]) -> None:
    near = _changed(small_design, verify={"depths_m": (1e-5,)})
    with pytest.raises(InputError, match="focal length"):
        run(near, tmp_path / "run")
    assert not (tmp_path / "run").exists()
