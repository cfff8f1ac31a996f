"""No interrupt is lost, and none comes in between where something must be whole."""

from __future__ import annotations

import ctypes
import multiprocessing.util
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import resource_tracker
from typing import Any

import numpy as np
import pytest

from metafab.core.numeric.compiled import compiled
from metafab.core.parallel import processes
from metafab.core.parallel.executor import open_executor
from metafab.core.parallel.interrupts import InterruptedRunError, held_interrupts, raised_interrupts
from metafab.library.use import lookup

SIGNALS = [signal.SIGINT, signal.SIGTERM]


def _arrive(number: signal.Signals) -> None:
    signal.raise_signal(number)  # its handler runs before this returns


def _in_finalizer(number: signal.Signals) -> None:
    class Dying:
        def __del__(self) -> None:
            _arrive(number)

    Dying()


def _in_weak_reference(number: signal.Signals) -> None:
    class Referred:
        pass

    referred = Referred()
    reference = weakref.ref(referred, lambda _: _arrive(number))
    del referred
    assert reference() is None


def _in_compiled_code(number: signal.Signals) -> None:
    ctypes.CFUNCTYPE(None)(lambda: _arrive(number))()


def _in_class_body(number: signal.Signals) -> None:
    class Named:
        def __set_name__(self, owner: type, name: str) -> None:
            _arrive(number)

    type("Owner", (), {"named": Named()})  # Python 3.11 raises a RuntimeError in place of the signal's exception


def _in_compiled_import(number: signal.Signals) -> None:
    try:
        _arrive(number)
    except BaseException:
        raise ImportError("numpy.core.multiarray failed to import") from None


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize(
    "where",
    [_arrive, _in_finalizer, _in_weak_reference, _in_compiled_code, _in_class_body, _in_compiled_import],
)
def test_an_interrupt_is_raised_wherever_it_arrives(
    where: Callable[[signal.Signals], None], number: signal.Signals, capfd: pytest.CaptureFixture[str]
) -> None:
    before = [signal.getsignal(each) for each in SIGNALS], sys.unraisablehook
    with pytest.raises(InterruptedRunError) as caught, raised_interrupts():
        where(number)
        time.sleep(20.0)  # a swallowed one wakes it
    assert caught.value.number == number
    assert capfd.readouterr().err == ""
    assert ([signal.getsignal(each) for each in SIGNALS], sys.unraisablehook) == before


def test_what_else_cannot_be_raised_is_told_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda unraisable: told.append(unraisable.exc_type))

    class Faulty:
        def __del__(self) -> None:
            raise ZeroDivisionError

    with raised_interrupts():
        Faulty()
    assert told == [ZeroDivisionError]


@pytest.mark.parametrize("number", SIGNALS)
def test_a_held_interrupt_comes_at_the_end(number: signal.Signals) -> None:
    done = []
    with pytest.raises(InterruptedRunError), raised_interrupts():
        with held_interrupts():
            _arrive(number)
            done.append("inside")
        done.append("after")
    assert done == ["inside"]


def test_a_joined_thread_ends_before_the_interrupt_is_raised() -> None:
    ended = []

    def work() -> None:
        time.sleep(0.05)
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
        time.sleep(0.2)
        ended.append(True)

    thread = threading.Thread(target=work)
    with pytest.raises(InterruptedRunError), raised_interrupts():
        thread.start()
        thread.join()
        time.sleep(20.0)
    assert ended == [True]


def test_nothing_is_held_beside_the_main_thread() -> None:
    handlers = []

    def look() -> None:
        with held_interrupts():
            handlers.extend(signal.getsignal(number) for number in SIGNALS)

    before = [signal.getsignal(number) for number in SIGNALS]
    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert handlers == before


def test_processes_that_start_meanwhile_never_see_ctrl_c() -> None:
    code = "import signal; print(*(int(s) for s in signal.pthread_sigmask(signal.SIG_BLOCK, [])))"
    with held_interrupts():
        within = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    after = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert within.split() == [str(int(signal.SIGINT))]
    assert after.split() == []


def test_workers_of_an_interrupted_run_begin_whole(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A worker that was not told what to begin with said so on the console."""
    start = multiprocessing.util.spawnv_passfds  # type: ignore[attr-defined]

    workers: list[int] = []

    def interrupted(*arguments: object) -> int:
        workers.append(start(*arguments))
        signal.raise_signal(signal.SIGTERM)
        return workers[-1]

    resource_tracker.ensure_running()  # which starts as they do
    monkeypatch.setattr(multiprocessing.util, "spawnv_passfds", interrupted)
    monkeypatch.setattr(processes, "can_fork", lambda: False)
    with pytest.raises(InterruptedRunError), raised_interrupts(), open_executor(2) as executor:
        executor.submit(abs, -1)
    assert workers
    for worker in workers:
        with suppress(ChildProcessError):  # already waited for
            os.waitpid(worker, 0)
    assert capfd.readouterr().err == ""


def test_a_kernel_is_compiled_whole() -> None:
    """An interrupt within the compiler's lock left it taken, and the next thread waited for ever."""
    done = []

    def interrupted(arguments: object) -> None:
        _arrive(signal.SIGTERM)
        done.append(arguments)

    kernel: Any = compiled(_arrive)
    compile_once = kernel.compile.func
    with pytest.raises(InterruptedRunError), raised_interrupts():
        compile_once(kernel, interrupted, __file__, "types")
    assert done == ["types"]


def test_the_threads_of_a_tree_are_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """SciPy's threads read a tree that the interrupt had freed."""
    begun: list[threading.Thread] = []
    start = threading.Thread.start

    def interrupted(thread: threading.Thread) -> None:
        start(thread)
        begun.append(thread)
        _arrive(signal.SIGTERM)

    monkeypatch.setattr(lookup, "default_workers", lambda: 2)
    monkeypatch.setattr(threading.Thread, "start", interrupted)
    with pytest.raises(InterruptedRunError), raised_interrupts():
        lookup.best_overlap(np.exp(1j * np.linspace(0.0, 6.0, 200).reshape(100, 2)), 64)
    assert len(begun) == 2
    assert not any(thread.is_alive() for thread in begun)
