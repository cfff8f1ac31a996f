"""Kernels compiled by further processes: the list is right, and none is compiled twice."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from pathlib import Path

from metafab.core.numeric.ahead import listed_kernels

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
