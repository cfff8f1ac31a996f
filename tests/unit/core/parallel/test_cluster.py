"""Faults of a Dask cluster: a scheduler that goes away, and a time without workers."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from metafab.core.errors import ClusterLostError
from metafab.core.parallel import cluster
from metafab.core.parallel.executor import in_order, open_executor

pytest.importorskip("distributed")


class Servers:
    """A scheduler and its workers, each a process of its own that a test may end."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self.processes = [self._start("dask_scheduler", "--port", "0", "--no-dashboard", "--no-jupyter")]

    @property
    def address(self) -> str:
        """Address of the scheduler."""
        import json

        deadline = time.monotonic() + 60.0
        while not self.file.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        return str(json.loads(self.file.read_text())["address"])

    def add_worker(self) -> subprocess.Popen[bytes]:
        """Start a worker of one thread."""
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard")
        self.processes.append(self._start("dask_worker", *options))
        return self.processes[-1]

    def _start(self, module: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--scheduler-file", str(self.file)]
        host = ("--host", "127.0.0.1")
        return subprocess.Popen([*command, *host, *options], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def end(self) -> None:
        """End all of them."""
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture
def servers(tmp_path: Path) -> Iterator[Servers]:
    """A scheduler with one worker."""
    running = Servers(tmp_path)
    try:
        running.add_worker()
        yield running
    finally:
        running.end()


def _process_id(number: int) -> int:
    time.sleep(0.2)
    return os.getpid()


def test_a_scheduler_that_goes_away_ends_the_work_within_ten_seconds(servers: Servers) -> None:
    with pytest.raises(ClusterLostError, match="is gone; finished steps"), open_executor(cluster=servers.address) as ex:
        results = in_order(ex, _process_id, range(1000))
        next(results)
        servers.processes[0].send_signal(signal.SIGKILL)
        killed = time.monotonic()
        list(results)
    assert time.monotonic() - killed < 10.0


def test_work_waits_for_a_worker_and_says_so(
    servers: Servers, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(cluster, "PATIENCE_S", 1.0)
    monkeypatch.setattr(cluster, "_LOOK_EVERY_S", 0.2)
    said, steps = threading.Event(), []

    def progress(step: str, done: float, total: float) -> None:
        steps.append((step, done, total))
        said.set()

    with caplog.at_level(logging.WARNING), open_executor(cluster=servers.address, progress=progress) as executor:
        results = in_order(executor, _process_id, range(20))
        first = next(results)
        os.kill(first, signal.SIGKILL)
        assert said.wait(30.0)
        servers.add_worker()
        rest = list(results)
    assert len(rest) == 19
    assert first not in rest[-10:]
    assert "has had no worker for" in caplog.text
    assert "dask worker tcp://127.0.0.1:" in caplog.text
    assert "has workers again" in caplog.text
    assert steps[-1] == ("waiting for a worker", 1.0, 1.0)


def test_dasks_tracebacks_of_a_lost_connection_are_dropped(servers: Servers, caplog: pytest.LogCaptureFixture) -> None:
    """The command tells the loss in a sentence; other tracebacks are logged, and those after its work."""
    theirs = logging.getLogger("distributed.core")
    with open_executor(cluster=servers.address):
        for fault in (ConnectionResetError("lost"), ValueError("kept")):
            theirs.error("in a handler", exc_info=fault)
    theirs.error("afterwards", exc_info=ConnectionResetError("told"))
    said = [str(record.exc_info[1]) for record in caplog.records if record.name == theirs.name and record.exc_info]
    assert said == ["kept", "told"]
