"""Memory of a block: its own, its workers', and not what was before."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

from metafab.core.parallel.measure import measured

#: Each in an interpreter of its own: a process remembers the largest worker that it ever had.
WORKER = """
import subprocess, sys
from metafab.core.parallel.measure import measured

def work(megabytes):
    with measured() as cost:
        subprocess.run([sys.executable, "-c", f"x = b'x' * {megabytes * 10**6}"], check=True)
    return cost.peak_rss_mb

with measured() as before:
    pass
largest = work(400)
with measured() as after:
    pass
print(before.peak_rss_mb, largest, after.peak_rss_mb)
"""
FREED = """
import numpy as np
from metafab.core.parallel.measure import measured

with measured() as cost:
    np.ones(50_000_000)
with measured() as after:
    pass
print(cost.peak_rss_mb, after.peak_rss_mb)
"""
HELD = """
import numpy as np
from metafab.core.parallel.measure import resident_mb

before = resident_mb()
held = np.ones(5_000_000)
print(before, resident_mb())
"""


def _megabytes(script: str) -> list[float]:
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return [float(word) for word in answer.stdout.split()]


def test_a_worker_that_ended_in_the_block_counts() -> None:
    before, with_worker, after = _megabytes(WORKER)
    assert with_worker > 400.0 > before
    assert after < 400.0, "one that ended earlier does not"


def test_what_was_freed_before_does_not_count() -> None:
    cost, after = _megabytes(FREED)
    assert cost > 400.0
    assert after < cost - 300.0


def test_processor_time_counts_work_and_no_waiting() -> None:
    with measured() as waiting:
        time.sleep(0.2)
    with measured() as working:
        begun = time.process_time()
        while time.process_time() - begun < 0.11:
            pass
    assert working.processor_seconds >= 0.1
    assert waiting.processor_seconds < 0.1 < waiting.seconds


def test_the_resident_set_follows_what_is_held() -> None:
    before, after = _megabytes(HELD)
    assert after - before == pytest.approx(40.0, rel=0.1)
