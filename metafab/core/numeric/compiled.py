"""Compilation of numerical kernels by numba, cached on disk, once among the processes that share a cache."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numba.extending
from numba.core.compiler_lock import global_compiler_lock

from metafab.core.numeric.ahead import start_helpers
from metafab.core.parallel.interrupts import held_interrupts

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

Function = TypeVar("Function", bound=Callable[..., Any])
_log = logging.getLogger(__name__)

#: Seconds that a process waits for another one to compile the kernels of a file (the longest take 3 s).
_LONGEST_WAIT_S = 20.0
_POLL_S = 0.005
#: Files whose kernels this process is compiling.
_held: set[str] = set()


def inlined(function: Function) -> Function:
    """Let kernels inline ``function``; called from Python, it is not compiled and takes NumPy arrays."""
    numba.extending.register_jitable(function)
    return function


def compiled(function: Function) -> Function:
    """Compile ``function`` on its first call.

    Division follows NumPy (x / 0 is infinite, nothing is raised), which lets loops with quotients be vectorised. The
    interpreter lock is released, so that :func:`metafab.core.parallel.executor.spread` can run parts of a loop in
    threads: numba's own parallel loops take three times as long to compile. A process that needs a kernel while another
    one compiles it waits and reads it from the cache. Where no folder for the cache can be written, each process
    compiles its kernels itself, and a warning says so once.
    """
    options: Any = {"nogil": True, "fastmath": False, "error_model": "numpy", "no_cfunc_wrapper": True}
    try:
        kernel: Any = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # numba finds no folder for the cache
        warn_uncached()
        return cast("Function", numba.njit(**options)(function))
    if hasattr(kernel, "compile"):  # numba is not disabled
        kernel.compile = partial(_compile_once, kernel, kernel.compile, function.__code__.co_filename)
    return cast("Function", kernel)


@cache
def warn_uncached() -> None:
    """Log once that no cache for kernels can be written."""
    _log.warning("no cache for compiled kernels can be written, so each process compiles them: set NUMBA_CACHE_DIR")


def _compile_once(kernel: Any, compile_or_load: Callable[[Any], Any], source: str, arguments: Any) -> Any:
    """Compile ``kernel`` of the file ``source`` for the types of ``arguments``, or load it from the cache."""
    # An interrupt between a lock and its block would leave the lock taken, for which other threads wait for ever.
    # Compiler lock first: a thread that held a file's lock while it waited for the compiler would stop the one that has
    # the compiler.
    with held_interrupts(), global_compiler_lock, alone_with(source):
        misses = sum(kernel.stats.cache_misses.values())
        entry_point = compile_or_load(arguments)
        was_compiled = sum(kernel.stats.cache_misses.values()) > misses
    # Without the locks, which a forked process would inherit.
    if was_compiled and not _held:
        start_helpers()
    return entry_point


@contextmanager
def alone_with(source: str) -> Iterator[None]:
    """Lock the file ``source`` against other processes; unguarded without locks, and after the longest wait."""
    if fcntl is None or source in _held:
        yield
        return
    _held.add(source)
    try:
        with Path(source).open("rb") as stream:
            end_s = time.monotonic() + _LONGEST_WAIT_S
            while time.monotonic() < end_s:
                try:
                    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    time.sleep(_POLL_S)
                except OSError:  # a file system without locks
                    break
                else:
                    break
            try:
                yield
            finally:
                with suppress(OSError):  # closing alone would leave the lock to processes that were forked meanwhile
                    fcntl.flock(stream, fcntl.LOCK_UN)
    finally:
        _held.discard(source)
