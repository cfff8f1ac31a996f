"""Compilation of the kernels of a run by further processes, while the run goes on.

numba compiles one kernel at a time in a process. On a machine whose cache is empty, the first kernel that a run has to
compile starts these processes; they take the files of ``kernels.toml`` in turn, which are listed in the order of need.
Where a run needs a kernel that is not there yet, it compiles it itself.
"""

from __future__ import annotations

import gc
import multiprocessing
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from numba.core.sigutils import normalize_signature

from metafab.core.numeric.compiled import after_first_compilation
from metafab.core.parallel.executor import default_workers
from metafab.core.parallel.interrupts import held_interrupts
from metafab.core.parallel.processes import begin_copy, can_fork

#: Kernels that a run calls from Python, by module, with the types of their arguments; tests/e2e/test_rehearsal.py
#: says which are missing.
KERNELS = Path(__file__).with_name("kernels.toml")
#: Most processes; two more than these find nothing left that is needed early.
_MOST_PROCESSES = 4
_NO_MORE = 1 << 30

#: Kernels of one file, each with the numba types of its arguments.
FileKernels = list[tuple[Any, tuple[Any, ...]]]


def listed_kernels(table: Path = KERNELS) -> list[FileKernels]:
    """Import and return the listed kernels, file by file."""
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
    end of the block they finish the file they are at.
    """
    helpers = _Helpers(min(workers or default_workers(), _MOST_PROCESSES), table)
    try:
        with after_first_compilation(helpers.start):
            yield
    finally:
        helpers.end()


class _Helpers:
    """Processes that compile, and the position of the next file in the list that they share."""

    def __init__(self, count: int, table: Path) -> None:
        self._count, self._table = count, table
        self._processes: list[BaseProcess] = []
        self._position: Any = None

    def start(self) -> None:
        """Fork the processes, which inherit the imported kernels."""
        if self._count == 1 or not can_fork():
            return
        files, forking = listed_kernels(self._table), multiprocessing.get_context("fork")
        self._position = forking.Value("l", 0)
        for _ in range(self._count):
            process = forking.Process(target=_compile_files, args=(files, self._position), daemon=True)
            self._processes.append(process)
            with held_interrupts():
                process.start()

    def end(self) -> None:
        """Give out no further files, and wait for the processes."""
        if self._position is not None:
            self._position.value = _NO_MORE
        for process in self._processes:
            process.join()


def _compile_files(files: list[FileKernels], position: Any) -> None:
    """Compile the kernels of one file after the other; ``position`` is that of the next, shared by all processes."""
    begin_copy()
    gc.disable()
    while True:
        with position.get_lock():
            index = position.value
            position.value += 1
        if index >= len(files):
            return
        for kernel, types in files[index]:
            kernel.compile(types)
