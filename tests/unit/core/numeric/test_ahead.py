"""Kernels compiled by further processes: the list is right, and none is compiled twice."""

from __future__ import annotations

import fcntl
import inspect
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from numba.core.caching import CompileResultCacheImpl

from metafab.core.numeric import ahead, compiled
from metafab.core.numeric.ahead import compiling_ahead, listed_kernels

#: Compiles one kernel, waits until a process that this starts compiles the other one, calls that, and prints how often
#: it was compiled here and read from the cache.
_SCRIPT = """
import fcntl, sys, time
from pathlib import Path
from metafab.core.numeric.ahead import compiling_ahead
from metafab.layout.outlines import _rectangle_distance
from metafab.mask.oasis.elements import _along

with compiling_ahead(2, Path(sys.argv[1])):
    _rectangle_distance(1.0, 2.0)
    is_compiled = False
    with open(_along.py_func.__code__.co_filename) as source:
        while not is_compiled:
            try:
                fcntl.flock(source, fcntl.LOCK_EX | fcntl.LOCK_NB)
                fcntl.flock(source, fcntl.LOCK_UN)
                time.sleep(0.02)
            except BlockingIOError:
                is_compiled = True
    _along(1, 2)
print(sum(_along.stats.cache_misses.values()), sum(_along.stats.cache_hits.values()))
"""


def test_every_listed_kernel_takes_as_many_arguments() -> None:
    for kernels in listed_kernels():
        for kernel, types in kernels:
            assert len(types) == len(inspect.signature(kernel.py_func).parameters), kernel


def test_a_kernel_that_another_process_compiles_is_waited_for(tmp_path: Path) -> None:
    table, cache = tmp_path / "kernels.toml", tmp_path / "cache"
    table.write_text('["metafab.mask.oasis.elements"]\n_along = ["(int64, int64)"]\n', encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT, str(table)],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert done.stdout.split() == ["0", "1"], done.stderr


def _compile_ahead(table: Path) -> None:
    """Take the place of a run whose first kernel had to be compiled."""
    with compiling_ahead(2, table):
        ahead.start_helpers()


@pytest.fixture
def empty_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A list without kernels, and leave to fork beside the threads of other tests."""
    monkeypatch.setattr(ahead, "can_fork", lambda: True)
    table = tmp_path / "kernels.toml"
    table.write_text("", encoding="utf-8")
    return table


def test_a_run_goes_on_without_help_where_no_process_can_be_started(
    empty_table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused() -> int:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(os, "fork", refused)
    _compile_ahead(empty_table)


def test_a_worker_of_another_pool_runs_without_help(empty_table: Path) -> None:
    worker = multiprocessing.get_context("fork").Process(target=_compile_ahead, args=(empty_table,), daemon=True)
    worker.start()
    worker.join()
    assert worker.exitcode == 0


def test_a_first_compilation_beside_other_threads_leaves_the_help_to_the_next(
    empty_table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[ahead.Helpers] = []

    def start(helpers: ahead.Helpers) -> None:
        started.append(helpers)

    monkeypatch.setattr(ahead.Helpers, "start", start)
    with compiling_ahead(2, empty_table):
        monkeypatch.setattr(ahead, "can_fork", lambda: False)
        ahead.start_helpers()
        assert not started
        monkeypatch.setattr(ahead, "can_fork", lambda: True)
        ahead.start_helpers()
    assert len(started) == 1


def test_an_error_ends_the_processes_at_once(empty_table: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "_compile_files", lambda files, numbers: time.sleep(60.0))
    began_s = time.monotonic()
    with pytest.raises(KeyError), compiling_ahead(2, empty_table):
        ahead.start_helpers()
        raise KeyError
    assert time.monotonic() - began_s < 30.0


def test_a_process_forked_during_a_compilation_does_not_keep_the_lock(tmp_path: Path) -> None:
    source = tmp_path / "kernels.py"
    source.touch()
    with compiled.alone_with(str(source)):
        forked = multiprocessing.get_context("fork").Process(target=threading.Event().wait, daemon=True)
        forked.start()
    with source.open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    forked.kill()
    forked.join()


def test_kernels_run_where_no_cache_can_be_written(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(CompileResultCacheImpl, "_locator_classes", [])
    compiled.warn_uncached.cache_clear()
    kernels = [compiled.compiled(function) for function in (_double, _negative)]
    assert [kernel(2) for kernel in kernels] == [4, -2]
    assert [record.getMessage().partition(":")[2] for record in caplog.records] == [" set NUMBA_CACHE_DIR"]


def _double(number: int) -> int:
    return 2 * number


def _negative(number: int) -> int:
    return -number
