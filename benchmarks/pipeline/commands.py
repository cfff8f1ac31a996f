"""The command line in a process of its own, with its processor time and memory."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).parents[2]
#: Runs a command and writes its exit code, processor time and memory to a file. A process begins with the memory of the
#: one that starts it as its largest: this one is small.
_MEASURE = """
import os, sys
_, status, used = os.wait4(os.spawnv(os.P_NOWAIT, sys.argv[2], sys.argv[2:]), 0)
figures = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6
open(sys.argv[1], "w").write(" ".join(map(str, figures)))
"""


@dataclass(frozen=True)
class Finished:
    """A command at its end."""

    code: int  #: Exit code; negative for a signal.
    stdout: str  #: What it printed.
    stderr: str  #: Its messages.
    seconds: float  #: Time by the clock.
    processor_seconds: float  #: Processor time, of its workers too.
    peak_rss_mb: float  #: Largest resident memory of one of its processes.


def command(*arguments: str) -> dict[str, Any]:
    """Arguments of :class:`subprocess.Popen` for ``metafab`` of this repository."""
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    return {"args": [sys.executable, "-m", "metafab.cli", *arguments], "env": environment, "text": True}


def finished(*arguments: str, most_s: int = 3600) -> Finished:
    """Run ``metafab`` to its end, or until one of its processes has taken ``most_s`` of processor time."""
    with tempfile.NamedTemporaryFile("r") as figures:
        told = command(*arguments)
        told["args"] = [sys.executable, "-S", "-c", _MEASURE, figures.name, *told["args"]]
        start = time.perf_counter()
        process = subprocess.Popen(**told, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (most_s, most_s))
        stdout, stderr = process.communicate()
        seconds = time.perf_counter() - start
        code, busy_s, peak_rss_mb = figures.read().split()
    return Finished(int(code), stdout, stderr, seconds, float(busy_s), float(peak_rss_mb))
