"""The command line, and a Dask scheduler and its workers, as processes with their processor time and memory."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
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
    """Arguments of :class:`subprocess.Popen` for ``metafab`` of this repository.

    Its modules are compiled once, as an installation's are, also where the environment keeps Python from storing them.
    """
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "PYTHONDONTWRITEBYTECODE": ""}
    return {"args": [sys.executable, "-m", "metafab.cli", *arguments], "env": environment, "text": True}


def finished(*arguments: str, most_s: int = 3600, **variables: str) -> Finished:
    """Run ``metafab`` to its end, or until one of its processes has taken ``most_s`` of processor time.

    ``variables`` are added to its environment.
    """
    told = command(*arguments)
    return measure(told["args"], most_s, {**told["env"], **variables})


def measure(arguments: list[str], most_s: int = 3600, environment: dict[str, str] | None = None) -> Finished:
    """Run a program likewise, by default in the environment of this process."""
    with tempfile.NamedTemporaryFile("r") as figures:
        told = [sys.executable, "-S", "-c", _MEASURE, figures.name, *arguments]
        start = time.perf_counter()
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        process = subprocess.Popen(told, env=environment, text=True, **pipes)
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (most_s, most_s))
        stdout, stderr = process.communicate()
        seconds = time.perf_counter() - start
        code, busy_s, peak_rss_mb = figures.read().split()
    return Finished(int(code), stdout, stderr, seconds, float(busy_s), float(peak_rss_mb))


@dataclass
class DaskProcess:
    """The scheduler or a worker of a Dask cluster on this machine; its figures are known once it is ended."""

    process: subprocess.Popen[bytes]  #: The process.
    processor_seconds: float = field(default=0.0, init=False)  #: Processor time; 0 if it ended by itself.
    peak_rss_mb: float = field(default=0.0, init=False)  #: Largest resident memory; likewise.

    def end(self) -> None:
        """Kill the process and note what it took."""
        self.process.kill()
        with suppress(ChildProcessError):  # it has ended, and been seen to
            _, status, used = os.wait4(self.process.pid, 0)
            self.process.returncode = os.waitstatus_to_exitcode(status)
            self.processor_seconds = used.ru_utime + used.ru_stime
            self.peak_rss_mb = used.ru_maxrss * 1024 / 1e6


@contextmanager
def dask_scheduler(file: Path) -> Iterator[tuple[DaskProcess, str]]:
    """Start a Dask scheduler on the loopback interface, yield it and its address, and end it in the end.

    Workers find it by ``file``, which it writes.
    """
    with _dask("scheduler", file, "--host", "127.0.0.1", "--port", "0") as scheduler:
        yield scheduler, _address(file, scheduler.process)


def _address(file: Path, scheduler: subprocess.Popen[bytes]) -> str:
    """Address that a scheduler writes into its file; RuntimeError if it ends before."""
    while scheduler.poll() is None:
        with suppress(OSError, ValueError):  # not there, or half written
            return str(json.loads(file.read_text(encoding="utf-8"))["address"])
        time.sleep(0.1)
    raise RuntimeError(f"the Dask scheduler ended with {scheduler.returncode}")


@contextmanager
def dask_worker(file: Path) -> Iterator[DaskProcess]:
    """Start a worker of one thread for the scheduler of ``file``, and end it in the end."""
    with _dask("worker", file, "--nthreads", "1", "--no-nanny") as worker:
        yield worker


@contextmanager
def _dask(what: str, file: Path, *options: str) -> Iterator[DaskProcess]:
    arguments = ["--scheduler-file", str(file), "--no-dashboard", *options]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    args = [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments]
    started = DaskProcess(subprocess.Popen(args, env=environment, **quiet))
    try:
        yield started
    finally:
        started.end()
