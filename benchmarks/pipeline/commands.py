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
    with tempfile.TemporaryFile("w+") as stdout, tempfile.TemporaryFile("w+") as stderr:
        start = time.perf_counter()
        process = subprocess.Popen(**command(*arguments), stdout=stdout, stderr=stderr)
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (most_s, most_s))
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        seconds = time.perf_counter() - start
        texts = []
        for stream in (stdout, stderr):
            stream.seek(0)
            texts.append(stream.read())
    busy = used.ru_utime + used.ru_stime
    return Finished(process.returncode, texts[0], texts[1], seconds, busy, used.ru_maxrss * 1024 / 1e6)
