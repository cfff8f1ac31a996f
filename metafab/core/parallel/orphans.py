"""Worker processes that end when their parent is gone, however it ended."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from multiprocessing import connection

#: Exit code of a worker without its parent.
_ORPHANED = 3
_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """End this worker process as soon as its parent is gone.

    A daemon thread waits on the pipe that the parent holds open. A process that multiprocessing did not start is left
    as it is.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_wait_for_end, args=(parent.sentinel,), daemon=True).start()


def end_with_forking_thread() -> None:
    """Let Linux kill this forked worker when the thread that forked it ends; needs no thread of its own."""
    parent = multiprocessing.parent_process()
    if parent is None or sys.platform != "linux":
        return
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent.pid:  # It ended before the call.
        os._exit(_ORPHANED)


def _wait_for_end(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(_ORPHANED)
