"""Seconds and peak memory of a step."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

_PEAK_RESET = Path("/proc/self/clear_refs")
_STATUS = Path("/proc/self/status")


@dataclass
class Cost:
    """What a block cost; filled in when it ends.

    Attributes:
        seconds: wall clock.
        processor_seconds: of this process, all threads together; what others do on the machine changes it little.
        peak_rss_mb: largest resident set of any one process inside the block: of this one (on Linux; elsewhere since
            its start), or of a worker that ended in the block, if it was larger than all that ended before.
    """

    seconds: float = 0.0
    peak_rss_mb: float = 0.0
    processor_seconds: float = 0.0


@contextmanager
def measured() -> Iterator[Cost]:
    """Measure a block; the yielded :class:`Cost` is filled in when the block ends."""
    cost = Cost()
    _reset_peak()
    workers_mb = _workers_peak_mb()
    start, busy = time.perf_counter(), time.process_time()
    try:
        yield cost
    finally:
        cost.seconds = time.perf_counter() - start
        cost.processor_seconds = time.process_time() - busy
        cost.peak_rss_mb = peak_rss_mb()
        if _workers_peak_mb() > workers_mb:
            cost.peak_rss_mb = max(cost.peak_rss_mb, _workers_peak_mb())


def peak_rss_mb() -> float:
    """Largest resident set of this process since the last reset, in megabytes."""
    with suppress(OSError):
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    return _megabytes(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def _workers_peak_mb() -> float:
    """Largest resident set of all processes that this one has waited for."""
    return _megabytes(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)


def _reset_peak() -> None:
    """Linux forgets the old peak on this write; where it cannot, the peak counts from the process' start."""
    with suppress(OSError):
        _PEAK_RESET.write_text("5")


def _megabytes(maxrss: int) -> float:
    """``ru_maxrss`` is in kibibytes on Linux and in bytes on macOS."""
    return maxrss / 1e6 if sys.platform == "darwin" else maxrss * 1024 / 1e6
