"""Wall-clock time, processor time and peak memory of a block."""

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
    """Cost of a block; filled in when the block ends."""

    seconds: float = 0.0  #: Wall-clock time.
    #: Largest resident set of one process: this one (on Linux within the block, elsewhere since its start), or a worker
    #: that ended within the block, if larger than all workers before it.
    peak_rss_mb: float = 0.0
    processor_seconds: float = 0.0  #: Processor time of all threads of this process.


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
    peak = _status_mb("VmHWM")
    return _megabytes(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) if peak is None else peak


def resident_mb() -> float:
    """Resident set of this process, in megabytes; its peak on systems other than Linux."""
    now = _status_mb("VmRSS")
    return peak_rss_mb() if now is None else now


def _status_mb(name: str) -> float | None:
    """A line of this process's status file, in megabytes; None without one."""
    with suppress(OSError):
        for line in _STATUS.read_text().splitlines():
            if line.startswith(f"{name}:"):
                return int(line.split()[1]) * 1024 / 1e6
    return None


def _workers_peak_mb() -> float:
    """Largest resident set of all child processes that have ended, in megabytes."""
    return _megabytes(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)


def _reset_peak() -> None:
    """Reset the peak (Linux only); elsewhere it counts from the start of the process."""
    with suppress(OSError):
        _PEAK_RESET.write_text("5")


def _megabytes(maxrss: int) -> float:
    """Convert ``ru_maxrss``, which is in kibibytes on Linux and in bytes on macOS."""
    return maxrss / 1e6 if sys.platform == "darwin" else maxrss * 1024 / 1e6
