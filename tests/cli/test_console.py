"""The rim of every command: what stands where, which exit code an error becomes, and what is left as it was."""

from __future__ import annotations

import errno
import io
import json
import math
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import CancelledError
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer

from metafab.cli import console, entry
from metafab.cli.headlines import headlines
from metafab.core.errors import InputError, MetafabError, MissingToolError, SolverError
from metafab.core.parallel.progress import silent
from metafab.steps import RunSummary
from metafab.steps.exposure import PrintedFigures
from metafab.steps.summary import UNCHANGED, SkippedStep
from tests.closed_form_run import run_summary
from tests.conftest import MainJob
from tests.main_job import SMALL, metafab


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_no_bar_is_drawn_where_nobody_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with console.progress_bars() as progress:
        assert progress is silent


def test_a_terminal_gets_a_bar_for_each_step(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = _Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with console.progress_bars() as progress:
        for done in range(3):
            progress("library", done, 2)
        progress("layout", 1, 1)
    drawn = terminal.getvalue()
    assert "library" in drawn and "layout" in drawn


def test_what_is_left_is_foretold_by_the_first_units_where_their_number_is_known(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = iter(range(1000))
    monkeypatch.setattr(console.time, "monotonic", lambda: 0.5 * next(clock))
    seen: list[float] = []
    progress = console.pace(lambda _step, done, _total: seen.append(done), {"library"})
    for step, total in (("library", 100), ("library over its axes", 100), ("short", 20)):
        for done in range(4, total + 1, 4):
            progress(step, done, total)
    assert len(seen) == 25 + 25 + 5
    # Four cells in half a second; the 24 after the first four take three seconds.
    assert capsys.readouterr().err.splitlines() == [
        "metafab: library: the first 24 took 0.12 s each; the other 72 take about 9 s",
        "metafab: library over its axes: the first 24 took 0.12 s each",
    ]


def test_json_is_one_object_with_arrays_and_paths_as_plain_values(capsys: pytest.CaptureFixture[str]) -> None:
    console.show({"t": np.array([1.0 + 2.0j]), "file": Path("a/b"), "count": np.int64(3), "n": float("nan")}, True)
    said = capsys.readouterr()
    assert said.out.count("\n") == 1
    found = json.loads(said.out, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert found == {"t": [[1.0, 2.0]], "file": "a/b", "count": 3, "n": None}


def test_text_names_every_value_of_nested_tables(capsys: pytest.CaptureFixture[str]) -> None:
    table = {"pillars": 3, "rules": {"min_gap": 0, "empty": {}}, "files": [{"name": "a", "bytes": 1}], "kept": True,
             "none": None, "errors": [0.25, 1e-9]}  # fmt: skip
    console.show(table, False)
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert lines == [
        "pillars 3", "rules", "min_gap 0", "empty none", "files", "name=a bytes=1", "kept yes", "none -",
        "errors [0.25, 1e-09]",
    ]  # fmt: skip


@pytest.mark.parametrize(("count", "code"), [(0, None), (1, 2), (7, 2)])
def test_violations_end_with_2(count: int, code: int | None) -> None:
    if code is None:
        console.exit_on_violations(count)
        return
    with pytest.raises(typer.Exit) as ended:
        console.exit_on_violations(count)
    assert ended.value.exit_code == code


def _raise(error: BaseException) -> Callable[[object], None]:
    def app(arguments: object) -> None:
        raise error

    return app


ERRORS = [
    (InputError.single("lens.toml", "device", "a table", "nothing", "write one"), 2),
    (SolverError("no"), 1),
    (MissingToolError("no"), 1),
    (MetafabError("no"), 1),
    (OSError(28, "No space left on device"), 1),
    (PermissionError(13, "Permission denied"), 1),
    (MemoryError("12 GB"), 1),
    (RecursionError("maximum recursion depth exceeded"), 1),
    (OverflowError("int too large to convert"), 1),
    (ValueError("cannot convert float NaN to integer"), 1),
    (BrokenProcessPool("a child process terminated abruptly"), 1),
    (CancelledError("lost"), 1),
]


@pytest.mark.parametrize(("error", "code"), ERRORS, ids=lambda value: type(value).__name__)
def test_an_error_is_one_message_and_its_code(
    error: BaseException, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(entry, "program", lambda arguments: _raise(error))
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with pytest.raises(SystemExit) as ended:
        entry.main()
    said = capsys.readouterr()
    assert ended.value.code == code
    assert said.out == ""
    assert said.err.startswith("metafab: ") and str(error).splitlines()[-1].strip() in said.err
    assert "Traceback" not in said.err
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


@pytest.mark.parametrize("error", [error for error, _ in ERRORS], ids=lambda value: type(value).__name__)
def test_debug_shows_the_traceback_before_the_message(
    error: BaseException, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(entry, "program", lambda arguments: _raise(error))
    monkeypatch.setenv("METAFAB_DEBUG", "1")
    with pytest.raises(SystemExit):
        entry.main()
    said = capsys.readouterr().err
    assert type(error).__name__ in said.partition("\nmetafab: ")[0]
    assert "\nmetafab: " in said


def _refuse_to_write(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """Exit code of the program with ``arguments``, ``new`` among them, on a disk that refuses the design."""

    def write_new(name: str, kind: str, folder: Path, *further: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder / name))

    monkeypatch.setattr("metafab.spec.write_new", write_new)
    monkeypatch.setattr(sys, "argv", ["metafab", *arguments])
    with pytest.raises(SystemExit) as ended:
        entry.main()
    assert isinstance(ended.value.code, int)
    return ended.value.code


def test_a_failure_names_the_work_the_file_and_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _refuse_to_write(monkeypatch, "new", "lens", "--kind", "metalens", "-o", str(tmp_path)) == 1
    said = capsys.readouterr().err
    assert len(said.strip().splitlines()) == 1
    for part in ("OSError", str(tmp_path / "lens"), "`metafab new`", "free space on the disk"):
        assert part in said


@pytest.mark.parametrize(("options", "begins"), [([], "metafab: OSError"), (["--debug"], "Traceback")])
def test_debug_is_an_option_of_the_program(
    options: list[str], begins: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("METAFAB_DEBUG", "")  # restored after the option has set it
    assert _refuse_to_write(monkeypatch, *options, "new", "lens", "--kind", "metalens", "-o", str(tmp_path)) == 1
    assert capsys.readouterr().err.startswith(begins)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_is_one_message_that_nothing_swallows(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def app(arguments: object) -> None:
        try:
            os.kill(os.getpid(), number)
            signal.sigtimedwait([], 5.0)
        except Exception:
            pytest.fail("an interrupt is no error that a command may swallow")

    monkeypatch.setattr(entry, "program", lambda arguments: app)
    with pytest.raises(SystemExit) as ended:
        entry.main()
    assert ended.value.code == 128 + number
    assert "run it again to go on from here" in capsys.readouterr().err


def test_a_fault_of_ours_is_not_dressed_as_the_users(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entry, "program", lambda arguments: _raise(ZeroDivisionError("a bug")))
    with pytest.raises(ZeroDivisionError):
        entry.main()


@pytest.mark.parametrize(("asked", "threads"), [(None, 1), ("2", 2)])
def test_linear_algebra_has_one_thread_unless_asked_otherwise(asked: str | None, threads: int) -> None:
    """Two threads that wait for each other took fifteen times the processor time of one."""
    code = (
        "from metafab.cli import entry\nentry.program = lambda arguments: lambda arguments: None\nentry.main()\n"
        "import numpy, scipy.linalg, threadpoolctl\n"
        "print([pool['num_threads'] for pool in threadpoolctl.threadpool_info() if pool['user_api'] == 'blas'])"
    )
    variables = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    environment = {name: value for name, value in os.environ.items() if name not in variables}
    if asked is not None:
        environment |= dict.fromkeys(variables, asked)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    found = json.loads(done.stdout)
    assert found, "no library of linear algebra was found"
    # A machine of one core has no second thread to give.
    assert set(found) == {min(threads, len(os.sched_getaffinity(0)))}


def test_help_imports_no_room() -> None:
    """What makes --help quick: a command's room is imported when it works."""
    heavy = {"scipy", "numba", "h5py", "matplotlib", "metafab.optics", "metafab.cell"}
    code = "import sys, json; import metafab.cli.entry; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not heavy & set(json.loads(done.stdout))


def test_a_run_is_told_in_a_dozen_lines_and_names_its_report(tmp_path: Path) -> None:
    summary = replace(run_summary(), decode=None)
    lines = headlines(summary, tmp_path)
    assert lines["pillars"] == "7 213"
    assert lines["rules broken"] == "3"
    assert lines["PSF error"].startswith("0.001 ")
    assert lines["efficiency"].startswith("60.0 %")
    assert lines["time"].startswith("4.4 s")
    assert lines["report"] == str(tmp_path / "report.html")
    assert "depth error" not in lines  # nothing was decoded
    assert len(lines) <= 16 and all("[" not in text and "{" not in text for text in lines.values())
    assert headlines(run_summary(), tmp_path)["depth error"].startswith("0.21 %")
    assert summary.library is not None
    unstated = replace(summary, layout=None, library=replace(summary.library, max_error=math.nan))
    assert "library error" not in headlines(unstated, tmp_path)
    imported = replace(summary, library=replace(summary.library, rounds=0))
    assert headlines(imported, tmp_path)["library error"].endswith("without that of the imported sweep")
    assert "imported" not in lines["library error"]
    unprinted = replace(summary, exposure=PrintedFigures(math.nan, math.nan, 7213, 1e-4))
    assert headlines(unprinted, tmp_path)["printed sizes"] == "no pillar prints with one dose"


def test_a_run_that_skips_steps_says_so_and_counts_only_its_own_time(tmp_path: Path) -> None:
    summary = replace(run_summary(), skipped=())
    assert "skipped" not in headlines(summary, tmp_path)
    step, seconds = next(iter(summary.seconds.items()))
    unneeded = SkippedStep("lights", "the design serves one wavelength")
    lines = headlines(replace(summary, skipped=(SkippedStep(step, UNCHANGED, seconds), unneeded)), tmp_path)
    assert lines["skipped"] == f"unchanged steps: 1, which took {seconds:.3g} s when they last ran"
    assert lines["time"].startswith(f"{sum(summary.seconds.values()) - seconds:.3g} s")
    every = tuple(SkippedStep(step, UNCHANGED, seconds) for step, seconds in summary.seconds.items())
    assert headlines(replace(summary, skipped=every), tmp_path)["time"].startswith("0 s")


def test_only_a_lobe_that_turns_has_a_rotation(main_job: MainJob, tmp_path: Path) -> None:
    summary = RunSummary.load(main_job.folder / "summary.json")
    assert headlines(summary, tmp_path)["rotation"].startswith("59.1 degrees")
    assert "rotation" not in headlines(replace(summary, phase=None), tmp_path)


def test_a_second_run_without_json_names_the_report(main_job: MainJob, tmp_path: Path) -> None:
    folder = shutil.copytree(main_job.folder, tmp_path / "again")
    answer = metafab("run", SMALL, "-o", folder)
    assert answer.code == 0, answer.stderr
    lines = answer.stdout.splitlines()
    assert len(lines) <= 16
    assert lines[-1].split()[-1] == str(folder / "report.html")


def test_a_forked_command_answers_as_one_that_imports_for_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code, both streams, folder and environment: most tests call the command line by a fork of a warm process."""
    (tmp_path / "broken.toml").write_text("name = 3\n", encoding="utf-8")
    for debug in ("0", "1"):
        monkeypatch.setenv("METAFAB_DEBUG", debug)
        warm, fresh = (metafab("layout", "broken.toml", cwd=tmp_path, fresh=fresh) for fresh in (False, True))
        assert warm.code == fresh.code == 2
        assert (warm.stdout, warm.stderr.splitlines()[-1]) == (fresh.stdout, fresh.stderr.splitlines()[-1])
        assert ("Traceback" in warm.stderr) == ("Traceback" in fresh.stderr) == (debug == "1")
