"""Compilation of the kernels of a run by further processes, while the run goes on.

numba compiles one kernel at a time in a process. On a machine whose cache is empty, the first kernel that a run has to
compile starts these processes; they take the files of ``kernels.toml`` in turn, which are listed in the order of need.
Where a run needs a kernel that is not there yet, it compiles it itself. numba is imported with the list alone: a run
with nothing to do needs none.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.interrupts import held_interrupts
from metafab.core.parallel.processes import begin_copy, can_fork

#: Kernels that a run calls from Python, by module, with the types of their arguments; tests/e2e/test_rehearsal.py
#: says which are missing.
KERNELS = Path(__file__).with_name("kernels.toml")
#: Most processes; two more than these find nothing left that is needed early.
_MOST_PROCESSES = 4
#: Most files of a list; the number of each is one byte.
_MOST_FILES = 256

#: Kernels of one file, each with the numba types of its arguments.
FileKernels = list[tuple[Any, tuple[Any, ...]]]


def listed_kernels(table: Path = KERNELS) -> list[FileKernels]:
    """Import and return the listed kernels, file by file."""
    from numba.core.sigutils import normalize_signature

    return [
        [
            (getattr(import_module(module), name), normalize_signature(types)[0])  # type: ignore[no-untyped-call]
            for name, signatures in kernels.items()
            for types in signatures
        ]
        for module, kernels in tomllib.loads(table.read_text(encoding="utf-8")).items()
    ]


@contextmanager
def compiling_ahead(workers: int | None = None, table: Path = KERNELS) -> Iterator[None]:
    """Start up to ``workers`` processes that compile the listed kernels once this block has had to compile one.

    By default there is one a core. None are started for a single worker, or where this process cannot be forked. At the
    end of the block they finish the file they are at; an error in the block ends them.
    """
    helpers = Helpers(min(workers or default_workers(), _MOST_PROCESSES), table)
    _waiting.append(helpers)
    try:
        yield
    except BaseException:
        helpers.kill()
        raise
    finally:
        with suppress(ValueError):
            _waiting.remove(helpers)
        helpers.end()


def start_helpers() -> None:
    """Start the processes that wait for this process' first compilation; called after each one, without locks.

    Beside other threads none can be forked, and they wait for the next compilation.
    """
    if can_fork():
        with suppress(IndexError):
            _waiting.pop().start()


class Helpers:
    """Processes that compile, and a pipe with one byte for each file that none has taken: its number in the list.

    A process that is killed leaves nothing locked.
    """

    def __init__(self, count: int, table: Path) -> None:
        self._count, self._table = count, table
        self._processes: list[BaseProcess] = []
        self._numbers: int | None = None

    def start(self) -> None:
        """Fork the processes, which inherit the imported kernels; fewer or none where the system has no room."""
        if self._count == 1 or multiprocessing.current_process().daemon:
            return
        files = listed_kernels(self._table)
        self._numbers, end = os.pipe()
        os.write(end, bytes(range(len(files))))
        os.close(end)
        for _ in range(self._count):
            process = multiprocessing.get_context("fork").Process(
                target=_compile_files, args=(files, self._numbers), daemon=True
            )
            try:
                with held_interrupts():
                    process.start()
                    self._processes.append(process)
            except OSError:  # no memory, or no process left to this user
                return

    def kill(self) -> None:
        """End the processes now; what they are compiling is lost."""
        for process in self._processes:
            process.kill()

    def end(self) -> None:
        """Give out no further files, and wait for the processes."""
        if self._numbers is not None:
            os.read(self._numbers, _MOST_FILES)
        for process in self._processes:
            process.join()
        if self._numbers is not None:
            os.close(self._numbers)


#: Processes that no compilation has started yet, of the block that began last at the end.
_waiting: list[Helpers] = []


def _compile_files(files: list[FileKernels], numbers: int) -> None:
    """Compile the kernels of one file after the other, as the pipe ``numbers`` gives them out."""
    begin_copy()
    gc.disable()
    while number := os.read(numbers, 1):
        for kernel, types in files[number[0]]:
            kernel.compile(types)
