"""One interface, whoever does the work."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError
from metafab.core.parallel.executor import (
    KeptThreads,
    default_workers,
    kept_threads,
    open_executor,
    spread,
    stream,
)


def _square(value: int) -> int:
    return value * value


def _refuse(value: int) -> int:
    raise InputError.single("item", "value", "an even number", str(value), "use another")


@pytest.mark.parametrize("workers", [1, 2])
def test_results_do_not_depend_on_the_number_of_workers(workers: int) -> None:
    with open_executor(workers) as executor:
        found = dict(stream(executor, _square, range(20), ahead=3))
    assert found == {value: value * value for value in range(20)}


def test_faults_keep_their_details_across_processes() -> None:
    with open_executor(2) as executor, pytest.raises(InputError) as caught:
        list(stream(executor, _refuse, [1]))
    assert caught.value.faults[0].remedy == "use another"


def test_a_stream_pulls_few_items_ahead() -> None:
    pulled: list[int] = []

    def items() -> Iterator[int]:
        for value in range(100):
            pulled.append(value)
            yield value

    with open_executor(1) as executor:
        next(stream(executor, _square, items(), ahead=4))
    assert len(pulled) <= 5


def test_no_workers_is_refused() -> None:
    with pytest.raises(InputError, match="--workers"), open_executor(0):
        pass


def test_kept_threads_are_those_of_the_outermost_block() -> None:
    with kept_threads() as outer:
        with kept_threads() as inner:
            assert inner is outer
        assert list(outer.map(abs, [-1, 2])) == [1, 2]  # the inner block did not end them
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("ThreadPoolExecutor")]
    with kept_threads() as later:
        assert later is not outer


def test_kept_threads_do_not_wait_while_a_job_has_not_begun() -> None:
    """All threads are busy until the last result is there: the thread that asks makes the calls itself."""
    free = threading.Event()
    with kept_threads() as threads:
        busy = [threads.submit(free.wait) for _ in range(default_workers())]
        try:
            begun = threads.submit(threading.get_ident)
            assert begun.result() == threading.get_ident()
            assert threads.map(max, range(9), reversed(range(9))) == [8, 7, 6, 5, 4, 5, 6, 7, 8]
            rows = np.zeros(9)
            spread(_fill, rows.size, rows)
            assert rows.all()
            with pytest.raises(InputError, match="an even number"):
                threads.map(_refuse, range(3))
        finally:
            free.set()
        assert all(job.result() for job in busy[:-1])


@pytest.mark.parametrize("kernel_s", [1e-5, 1e-3])
def test_a_second_thread_is_for_loops_that_take_longer_than_to_start_it(
    kernel_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last call tells; one over no items tells nothing."""
    clock = itertools.count()
    monkeypatch.setattr("metafab.core.parallel.executor.default_workers", lambda: 2)
    monkeypatch.setattr(
        "metafab.core.parallel.executor.time", SimpleNamespace(perf_counter=lambda: kernel_s * next(clock))
    )
    rows, parts = np.zeros(8), list[tuple[int, int]]()

    def kernel(first: int, stop: int, filled: FloatArray) -> None:
        parts.append((first, stop))
        filled[first:stop] = np.arange(first, stop)

    with kept_threads():
        for count in (rows.size, rows.size, 0, rows.size):
            parts.clear()
            spread(kernel, count, rows)
    assert sorted(parts) == ([(0, 4), (4, 8)] if kernel_s > 2e-4 else [(0, 8)])
    np.testing.assert_array_equal(rows, np.arange(8))


def test_all_cores_share_the_items_of_kept_threads() -> None:
    """A single item is computed by this thread, whose own jobs may then use the others."""
    meet = threading.Barrier(2, timeout=60.0)
    with kept_threads() as threads:
        assert threads.map(lambda _: threading.get_ident(), range(1)) == [threading.get_ident()]
        # A job of these threads that asks for threads gets its own: it would wait for itself.
        job = threads.submit(lambda: (meet.wait(), _asked())[1])
        meet.wait()
        assert job.result() is not threads
        assert all(library["num_threads"] == 1 for library in threadpool_info() if library["user_api"] == "blas")


def test_no_calls_begin_after_one_that_failed() -> None:
    begun: list[int] = []

    def call(number: int) -> None:
        begun.append(number)
        if number == 0:
            raise InputError.single("item", "value", "another number", "0")
        time.sleep(0.01)

    with kept_threads() as threads, pytest.raises(InputError, match="another number"):
        threads.map(call, range(100))
    assert len(begun) < 100


def test_blas_has_its_threads_again_after_blocks_that_overlap() -> None:
    """A thread ends its block after the start and before the end of one in another thread."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "2"}
    subprocess.run([sys.executable, "-c", _OVERLAP], env=environment, check=True, timeout=120.0)


_OVERLAP = """
import threading
import numpy
import scipy.linalg
from threadpoolctl import threadpool_info
from metafab.core.parallel.executor import one_blas_thread

first, second = threading.Event(), threading.Event()

def overlap():
    with one_blas_thread():
        first.set()
        second.wait()

def blas_threads():
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

before = blas_threads()
other = threading.Thread(target=overlap)
other.start()
first.wait()
with one_blas_thread():
    assert set(blas_threads()) == {1}
    second.set()
    other.join()
    assert set(blas_threads()) == {1}  # the block that began first has ended
assert blas_threads() == before, blas_threads()
"""


def _fill(first: int, stop: int, rows: FloatArray) -> None:
    rows[first:stop] = 1.0


def _asked() -> KeptThreads:
    with kept_threads() as threads:
        return threads
