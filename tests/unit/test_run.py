"""Which steps are stale: only those whose inputs, code or files changed, and what follows from them."""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from metafab.core.errors import InputError
from metafab.core.figures import PhaseFigures
from metafab.core.parallel.work import Work
from metafab.core.storage.files import fingerprint, whole_file
from metafab.core.storage.provenance import contents_sha256
from metafab.run import REPORT, STEPS, ReportFigures, run
from metafab.spec import Design, load_design
from metafab.steps import RESULT_STEPS
from metafab.steps.images import CaptureFigures
from metafab.steps.job import Job, Step
from metafab.steps.layout import DrcFigures
from metafab.steps.preflight import PREFLIGHT, PreflightFigures
from metafab.steps.records import FileMark, Record
from metafab.steps.summary import RunSummary, SkippedStep


class Chain:
    """Three small steps and a page, which record when they work; the real ones are tested end to end."""

    def __init__(self) -> None:
        self.done: list[str] = []
        self.steps: tuple[Step, ...] = (
            self.step("phase", (), lambda d: d.device, PhaseFigures(peak_gain=1.4)),
            self.step("drc", ("phase",), lambda d: d.rules, DrcFigures(3, {"min_gap": 0}, 100.0, "lattice", ())),
            self.step("capture", ("phase",), lambda d: d.sensor, CaptureFigures((4, 5), 1e3)),
            replace(
                self.step("report", ("phase", "drc", "capture"), lambda d: d.name, ReportFigures("report.html")),
                reads=("left.json",),
                shows_summary=True,
            ),
        )

    def step(self, name: str, after: tuple[str, ...], inputs: Any, figures: Any) -> Step:
        """A step that writes its inputs to a file."""

        def work(job: Job) -> Any:
            self.done.append(name)
            (job.folder / f"{name}.txt").write_text(name + repr(inputs(job.design)))
            return figures

        return Step(name, (), after, inputs, lambda job: (job.folder / f"{name}.txt",), work, type(figures))

    def changed(self, name: str, **fields: Any) -> tuple[Step, ...]:
        """The steps with other fields in one of them."""
        return tuple(replace(step, **fields) if step.name == name else step for step in self.steps)


@pytest.fixture
def chain() -> Chain:
    return Chain()


def _changed(design: Design, **tables: Any) -> Design:
    return replace(design, **{name: replace(getattr(design, name), **keys) for name, keys in tables.items()})


def test_nothing_changed_nothing_done(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    assert chain.done == ["phase", "drc", "capture", "report"]
    chain.done.clear()
    summary = run(small_design, tmp_path, steps=chain.steps)
    assert chain.done == []
    assert [entry.step for entry in summary.skipped] == ["phase", "drc", "capture", "report"]


@pytest.mark.alone
def test_a_step_beside_others_is_in_its_place_when_all_are_done(
    tmp_path: Path, small_design: Design, chain: Chain
) -> None:
    """The copy that runs `drc` waits for the file of the step after it."""
    alone, both = tmp_path / "alone", tmp_path / "both"
    run(small_design, alone, steps=chain.steps)
    work = chain.steps[1].work

    def waiting(job: Job) -> Any:
        while not (job.folder / "capture.txt").exists():
            time.sleep(0.01)
        return work(job)

    beside = run(small_design, both, steps=chain.changed("drc", work=waiting, is_beside=True), work=Work(2))
    assert chain.done == ["phase", "drc", "capture", "report", "phase", "capture", "report"]
    assert list(beside.seconds) == ["phase", "drc", "capture", "report"]
    assert (both / "steps.json").read_bytes() == (alone / "steps.json").read_bytes()


@pytest.mark.alone
def test_large_files_are_hashed_while_the_next_step_runs(
    tmp_path: Path, small_design: Design, chain: Chain, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hash of the file of `phase` waits for the file of `drc`, which fails: the record of `phase` is kept."""
    alone, both = tmp_path / "alone", tmp_path / "both"
    run(small_design, alone, steps=chain.steps)
    chain.done.clear()
    monkeypatch.setattr("metafab.run._HASHED_BESIDE", 0)
    of, work = FileMark.of, chain.steps[1].work

    def waiting(path: Path) -> FileMark:
        while path.name == "phase.txt" and not (path.parent / "drc.txt").exists():
            time.sleep(0.01)
        return of(path)

    def failing(job: Job) -> Any:
        work(job)
        raise InputError.single("drc", "rule", "none broken", "one")

    monkeypatch.setattr(FileMark, "of", waiting)
    with pytest.raises(InputError, match="none broken"):
        run(small_design, both, steps=chain.changed("drc", work=failing), work=Work(2))
    run(small_design, both, steps=chain.steps, work=Work(2))
    assert chain.done == ["phase", "drc", "drc", "capture", "report"]
    assert (both / "steps.json").read_bytes() == (alone / "steps.json").read_bytes()


@pytest.mark.alone
def test_nothing_is_left_of_a_copy_that_was_killed(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    mine, work = os.getpid(), chain.steps[1].work

    def killed(job: Job) -> Any:
        with whole_file(job.folder / "half.h5") as part:
            part.touch()
            if os.getpid() != mine:
                os.kill(os.getpid(), 9)
        return work(job)

    summary = run(small_design, tmp_path, steps=chain.changed("drc", work=killed, is_beside=True), work=Work(2))
    assert list(summary.seconds) == ["phase", "drc", "capture", "report"]
    assert not list(tmp_path.glob(".*.part"))


@pytest.mark.alone
def test_a_failure_ends_the_steps_beside_it(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    def working(job: Job) -> Any:
        with whole_file(job.folder / "drc.txt"):
            (job.folder / "begun").touch()
            time.sleep(600.0)

    def failing(job: Job) -> Any:
        while not (job.folder / "begun").exists():
            time.sleep(0.01)
        raise InputError.single("scene", "depth", "one", "none")

    steps = tuple(
        replace(step, work={"drc": working, "capture": failing}.get(step.name, step.work), is_beside=step.name == "drc")
        for step in chain.steps
    )
    began_s = time.monotonic()
    with pytest.raises(InputError):
        run(small_design, tmp_path, steps=steps, work=Work(2))
    assert time.monotonic() - began_s < 300.0
    assert not list(tmp_path.glob(".*.part"))


def test_a_file_that_another_command_left_reaches_the_step_that_reads_it(
    tmp_path: Path, small_design: Design, chain: Chain
) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    for text in ("first", "second"):
        (tmp_path / "left.json").write_text(text)
        chain.done.clear()
        run(small_design, tmp_path, steps=chain.steps)
        assert chain.done == ["report"]
        run(small_design, tmp_path, steps=chain.steps)
        assert chain.done == ["report"], "and only once"


def test_a_changed_input_reaches_its_step_and_no_other(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    chain.done.clear()
    run(_changed(small_design, sensor={"pixel_um": 3.0}), tmp_path, steps=chain.steps)
    assert chain.done == ["capture", "report"]


def test_a_step_redone_with_the_same_result_disturbs_nobody(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    chain.done.clear()
    (tmp_path / "phase.txt").unlink()
    run(small_design, tmp_path, steps=chain.steps)
    assert chain.done == ["phase"]


def test_a_named_file_counts_by_its_content(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    file = tmp_path / "phase.npy"
    file.write_bytes(b"first")
    assert contents_sha256({"phase": [file]}) != contents_sha256({"phase": []})
    before = contents_sha256({"phase": [file]})
    file.write_bytes(b"other")
    assert contents_sha256({"phase": [file]}) != before
    assert contents_sha256([str(tmp_path / "n.csv")]) == ["missing"]


def test_a_step_that_is_not_needed_is_skipped_with_its_reason(
    tmp_path: Path, small_design: Design, chain: Chain
) -> None:
    steps = chain.changed("capture", not_needed=lambda design: "nothing to see")
    summary = run(small_design, tmp_path, steps=steps)
    assert SkippedStep("capture", "nothing to see") in summary.skipped
    assert summary.capture is None
    assert json.loads((tmp_path / "summary.json").read_text())["capture"] == {}


def test_files_of_a_step_that_is_no_longer_needed_are_removed(
    tmp_path: Path, small_design: Design, chain: Chain
) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    assert (tmp_path / "capture.txt").is_file()
    chain.done.clear()
    run(small_design, tmp_path, steps=chain.changed("capture", not_needed=lambda design: "nothing to see"))
    assert not (tmp_path / "capture.txt").exists()
    assert (tmp_path / "drc.txt").is_file()
    assert chain.done == ["report"]


def test_a_report_that_was_not_finished_is_made_again(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    def killed(job: Job) -> Any:
        raise KeyboardInterrupt

    run(small_design, tmp_path, steps=chain.steps)
    changed = _changed(small_design, sensor={"pixel_um": 3.0})
    with pytest.raises(KeyboardInterrupt):
        run(changed, tmp_path, steps=chain.changed("report", work=killed))
    chain.done.clear()
    run(changed, tmp_path, steps=chain.steps)
    assert chain.done == ["report"]


def test_a_changed_input_reaches_all_that_follows(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    chain.done.clear()
    run(_changed(small_design, device={"aperture_um": 100.0}), tmp_path, steps=chain.steps)
    assert chain.done == ["phase", "drc", "capture", "report"]


@pytest.mark.parametrize("damage", ["missing", "edited", "same length"])
def test_a_file_that_is_not_as_it_was_left_is_made_again(
    tmp_path: Path, small_design: Design, chain: Chain, damage: str
) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    chain.done.clear()
    victim = tmp_path / "drc.txt"
    if damage == "missing":
        victim.unlink()
    else:
        victim.write_text(victim.read_text().swapcase() if damage == "same length" else "other")
        os.utime(victim, ns=(1, 1))
    run(small_design, tmp_path, steps=chain.steps)
    assert chain.done == ["drc"]  # the same file again: the page shows nothing new


def test_a_touched_file_with_the_same_bytes_still_stands(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    chain.done.clear()
    os.utime(tmp_path / "capture.txt", ns=(1, 1))
    run(small_design, tmp_path, steps=chain.steps)
    assert chain.done == []


def test_times_of_files_that_are_known_by_content_are_those_of_now(
    tmp_path: Path, small_design: Design, chain: Chain
) -> None:
    """Without its times, a run that skips every step would not know the files on which it rests."""
    first = run(small_design, tmp_path, steps=chain.steps)
    os.utime(tmp_path / "capture.txt", ns=(1, 1))
    (tmp_path / "summary.json").unlink()
    again = run(small_design, tmp_path, steps=chain.steps)
    assert again.modified_ns == first.modified_ns | {"capture.txt": 1}


def test_changed_code_makes_its_steps_stale(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    chain.done.clear()
    # Other rooms have other code, as the same rooms have after a change.
    run(small_design, tmp_path, steps=chain.changed("capture", rooms=("materials",)))
    assert chain.done == ["capture"]


@pytest.mark.parametrize("content", ["", "{", "[]", '{"phase": {"wrong": 1}}'])
def test_a_damaged_record_means_doing_it_again(
    tmp_path: Path, small_design: Design, chain: Chain, content: str
) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    chain.done.clear()
    (tmp_path / "steps.json").write_text(content)
    run(small_design, tmp_path, steps=chain.steps)
    assert chain.done == ["phase", "drc", "capture", "report"]


def test_a_copied_folder_is_judged_by_its_own_files(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    first, copy = tmp_path / "first", tmp_path / "copy"
    run(small_design, first, steps=chain.steps)
    shutil.copytree(first, copy)
    (copy / "capture.txt").unlink()
    chain.done.clear()
    run(small_design, copy, steps=chain.steps)
    assert chain.done == ["capture"]


def test_figures_of_another_version_mean_doing_it_again(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    chain.done.clear()
    records = json.loads((tmp_path / "steps.json").read_text())
    del records["drc"]["summary"]["pillars"]
    (tmp_path / "steps.json").write_text(json.dumps(records))
    run(small_design, tmp_path, steps=chain.steps)
    assert chain.done == ["drc"]


def test_figures_are_read_back_as_they_were_written(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    first = run(small_design, tmp_path, steps=chain.steps)
    second = run(small_design, tmp_path, steps=chain.steps)
    for summary in (second, RunSummary.load(tmp_path / "summary.json")):
        assert (summary.phase, summary.drc, summary.capture) == (first.phase, first.drc, first.capture)
    assert second.drc == DrcFigures(3, {"min_gap": 0}, 100.0, "lattice", ())


def test_a_record_without_files_is_unchanged(tmp_path: Path) -> None:
    assert Record.of("", {}, {}).files_unchanged(tmp_path)


def test_the_design_is_checked_once(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    checked: list[str] = []

    def work(job: Job) -> PreflightFigures:
        checked.append(job.design.name)
        return PreflightFigures(("a large file",))

    check = replace(PREFLIGHT, work=work)
    said: list[str] = []
    for _ in range(2):
        run(small_design, tmp_path, steps=chain.steps, check=check, say=said.extend)
    assert (len(checked), said) == (1, ["a large file"])
    other = _changed(small_design, sensor={"pixel_um": 3.0})
    run(other, tmp_path, steps=chain.steps, check=check, say=said.extend)
    assert len(checked) == 2


def test_a_design_that_cannot_work_leaves_no_folder(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    near = _changed(small_design, verify={"depths_m": (1e-5,)})
    with pytest.raises(InputError, match="focal length"):
        run(near, tmp_path / "run", steps=chain.steps)
    assert not (tmp_path / "run").exists()


def test_the_page_comes_last_and_after_every_step() -> None:
    assert (*RESULT_STEPS, REPORT) == STEPS
    assert REPORT.after == tuple(step.name for step in RESULT_STEPS)
    assert REPORT.reads == ("coupling.json", "exposure.json", "patch.h5", "tolerance.json")
    assert {step.name for step in RESULT_STEPS} <= set(RunSummary.__dataclass_fields__)


def test_one_changed_digit_of_a_record_is_noticed(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    run(small_design, tmp_path, steps=chain.steps)
    chain.done.clear()
    records = tmp_path / "steps.json"
    whole = records.read_text(encoding="utf-8")
    for figure, other in (('"min_gap_nm": 100.0', '"min_gap_nm": 101.0'), ("100.0", "100.00")):
        assert figure in whole
        records.write_text(whole.replace(figure, other), encoding="utf-8")
        run(small_design, tmp_path, steps=chain.steps)
        assert records.read_text(encoding="utf-8") == whole
    assert chain.done == ["drc"]


def test_whole_numbers_where_figures_have_floats_change_nothing(
    tmp_path: Path, small_design: Design, chain: Chain
) -> None:
    """They come back as floats, which the second run writes."""
    steps = (chain.step("phase", (), lambda design: design.device, PhaseFigures(peak_gain=2)),)
    for _ in range(3):
        run(small_design, tmp_path, steps=steps)
    assert chain.done == ["phase"]


def _deep(text: str) -> str:
    return "[" * 100_000


DAMAGES: dict[str, Callable[[str], str]] = {
    "empty": lambda text: "",
    "cut": lambda text: text[: len(text) // 2],
    "nested deeply": _deep,
    "figures nested deeply": lambda text: text.replace("100.0", "[" * 900 + "]" * 900),
    "a list": lambda text: "[1]",
    "a number": lambda text: "3",
    "null": lambda text: "null",
    "records are numbers": lambda text: json.dumps(dict.fromkeys(json.loads(text), 3)),
    "figures are texts": lambda text: re.sub(r": -?[0-9.]+(?=[,\n])", r': "x"', text),
    "figures are lists": lambda text: re.sub(r": -?[0-9.]+(?=[,\n])", ": [1]", text),
    "texts are numbers": lambda text: re.sub(r': "[^"]*"', ": 3", text),
    "huge numbers": lambda text: re.sub(r": -?[0-9.]+(?=[,\n])", ": " + "9" * 400, text),
    "NUL in names": lambda text: text.replace(".txt", r"\u0000.txt"),
    "half a surrogate": lambda text: text.replace("lattice", r"\ud800"),
    "not UTF-8": lambda text: text.replace("lattice", "\udcff"),
}


@pytest.mark.parametrize("name", ["steps.json", "summary.json"])
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_a_damaged_record_is_computed_again(
    tmp_path: Path, small_design: Design, chain: Chain, name: str, damage: Callable[[str], str]
) -> None:
    whole = run(small_design, tmp_path, steps=chain.steps)
    path = tmp_path / name
    path.write_bytes(damage(path.read_text(encoding="utf-8")).encode(errors="surrogateescape"))
    with suppress(ValueError, RecursionError):
        RunSummary.load(tmp_path / "summary.json")
    again = run(small_design, tmp_path, steps=chain.steps)
    assert (again.phase, again.drc, again.capture) == (whole.phase, whole.drc, whole.capture)
    assert RunSummary.load(tmp_path / "summary.json").drc == whole.drc


def test_a_step_that_is_no_longer_needed_removes_nothing_outside_its_folder(
    tmp_path: Path, small_design: Design, chain: Chain
) -> None:
    folder, precious = tmp_path / "run", tmp_path / "precious.txt"
    run(small_design, folder, steps=chain.steps)
    precious.write_text("a user's")
    records = folder / "steps.json"
    records.write_text(records.read_text().replace("capture.txt", "../precious.txt"))
    run(small_design, folder, steps=chain.changed("capture", not_needed=lambda design: "nothing to see"))
    assert precious.read_text() == "a user's"


def test_a_second_run_in_one_folder_is_told_of_the_first(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    def again(job: Job) -> Any:
        with pytest.raises(InputError, match=f"process {os.getpid()} on host"):
            run(small_design, tmp_path, steps=chain.steps)
        return PhaseFigures(peak_gain=1.4)

    run(small_design, tmp_path, steps=chain.changed("phase", work=again, outputs=lambda job: ()))
    assert "phase" not in chain.done
    assert list(tmp_path.glob(".*")) == []


def test_a_run_folder_names_no_folder_of_the_machine(tmp_path: Path, small_design: Design, chain: Chain) -> None:
    """A design and its run, moved together, give the same files; paths are relative to the run folder."""
    texts = []
    for place in ("here", "elsewhere"):
        cell = tmp_path / place / "cells" / small_design.library.name
        cell.parent.mkdir(parents=True)
        shutil.copy(small_design.library, cell)
        folder = tmp_path / place / "runs" / "lens"
        run(replace(small_design, library=cell), folder, steps=chain.steps)
        texts.append((folder / "design.toml").read_text())
        assert load_design(folder / "design.toml").library == cell
        assert fingerprint(replace(small_design, library=cell)) == fingerprint(small_design)
    assert texts[0] == texts[1]
    assert str(tmp_path) not in texts[0]
