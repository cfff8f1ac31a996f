"""One interface, whoever does the work."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Executor

import pytest

from metafab.core.errors import InputError
from metafab.core.parallel.executor import kept_threads, open_executor, stream


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
        # A job of these threads that asks for threads gets its own: it would wait for itself.
        assert outer.submit(lambda: _asked() is not outer).result()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("ThreadPoolExecutor")]
    with kept_threads() as later:
        assert later is not outer


def _asked() -> Executor:
    with kept_threads() as threads:
        return threads
