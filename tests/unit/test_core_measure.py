"""Memory of a block: its own, its workers', and not what was before."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from metafab.core.measure import measured

#: Interpreters and NumPy take some tens of megabytes themselves.
WORKER_MB = 700


def test_a_worker_that_ended_in_the_block_counts() -> None:
    with measured() as without:
        pass
    with measured() as cost:
        subprocess.run([sys.executable, "-c", f"x = b'x' * {WORKER_MB * 10**6}"], check=True)
    assert cost.peak_rss_mb > max(WORKER_MB, without.peak_rss_mb)
    with measured() as after:
        pass
    assert after.peak_rss_mb < cost.peak_rss_mb, "one that ended earlier does not"


def test_what_was_freed_before_does_not_count() -> None:
    with measured() as cost:
        np.ones(50_000_000)
    assert cost.peak_rss_mb > 400
    with measured() as after:
        pass
    assert after.peak_rss_mb < cost.peak_rss_mb - 300
