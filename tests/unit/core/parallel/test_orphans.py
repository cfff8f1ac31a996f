"""No worker outlives a parent that was killed by more than two seconds."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.pipeline.faults import processes_of
from tests.main_job import ROOT

_POOL = """
import threading
import time
from metafab.core.parallel.executor import open_executor
if __name__ == "__main__":
    if {spawned}:
        threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
    with open_executor(2) as executor:
        waits = [executor.submit(time.sleep, 0.01) for _ in range(8)]
        print([wait.result() for wait in waits], flush=True)
        {then}
"""
_FORKED = """
import time
from metafab.core.parallel.forked import shared
def work(item):
    print(item, flush=True)
    time.sleep(60)
if __name__ == "__main__":
    list(shared(work, [1, 2], 2))
"""
_WORK = "[wait.result() for wait in [executor.submit(time.sleep, 60)] * 2]"
PROGRAMS = {
    "spawned, idle": _POOL.format(spawned=True, then="time.sleep(60)"),
    "spawned, at work": _POOL.format(spawned=True, then=_WORK),
    "pool of copies, at work": _POOL.format(spawned=False, then=_WORK),
    "forked": _FORKED,
}


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS.keys())
def test_no_process_outlives_its_killed_parent(program: str, tmp_path: Path) -> None:
    script = tmp_path / "program.py"
    script.write_text(program)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, env=environment, start_new_session=True
    )
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(0.3)
    try:
        assert len(processes_of(process.pid)) > 2
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        end = time.monotonic() + 2.0
        while (left := processes_of(process.pid)) and time.monotonic() < end:
            time.sleep(0.05)
        assert left == []
    finally:
        for pid in processes_of(process.pid):
            os.kill(pid, signal.SIGKILL)
        process.stdout.close()
