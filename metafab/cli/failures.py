"""Failures from outside as one message: the error, the work in progress, and the remedy."""

from __future__ import annotations

import errno
import os
from concurrent.futures import BrokenExecutor, CancelledError

#: Set by ``--debug``: failures show their traceback.
DEBUG_VARIABLE = "METAFAB_DEBUG"

#: Errors that a disk, a damaged file, a lack of memory or a lost worker can cause in any command.
FAILURES = (OSError, MemoryError, RecursionError, OverflowError, ValueError, BrokenExecutor, CancelledError)

_FULL = "free space on the disk and run it again to go on from here"
_FORBIDDEN = "name a folder that can be written, with `-o`"
_MISPLACED = "a file stands where a folder is needed, or a folder where a file is; name another path with `-o`"
_DISK_REMEDIES = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), _FULL),
    **dict.fromkeys((errno.EROFS, errno.EACCES, errno.EPERM), _FORBIDDEN),
    **dict.fromkeys((errno.ENOTDIR, errno.EISDIR, errno.EEXIST), _MISPLACED),
    errno.ENOENT: "check the path",
    errno.EAGAIN: "raise the limit of processes (`ulimit -u`) or use fewer `--workers`",
    errno.EMFILE: "raise the limit of open files (`ulimit -n`) or use fewer `--workers`",
}
_REMEDIES: tuple[tuple[type[Exception], str], ...] = (
    (OSError, "check the path and the disk, and run it again to go on from here"),
    (MemoryError, "use fewer `--workers`, or a smaller aperture, window or picture"),
    (RecursionError, "a file is nested too deeply; simplify it"),
    (BrokenExecutor, "a worker process was ended, often for lack of memory; run it again with fewer `--workers`"),
    (CancelledError, "the cluster gave up the work; start its workers again and run it again to go on from here"),
)
_UNEXPECTED = "check the numbers and files of the design; `metafab --debug` shows the place in the program"


def is_debugging() -> bool:
    """Return whether failures show their traceback."""
    return os.environ.get(DEBUG_VARIABLE, "") not in {"", "0"}


def message_of(error: Exception) -> str:
    """Return one line: the error, its notes (what was being done, and with which file), and the remedy."""
    text = f"{type(error).__name__}: {error}".rstrip(": ").replace("\n", " ")
    notes = list(dict.fromkeys(getattr(error, "__notes__", ())))
    if notes:
        text += f" ({', '.join(notes)})"
    return f"{text}; {_remedy(error)}"


def _remedy(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno in _DISK_REMEDIES:
        return _DISK_REMEDIES[error.errno]
    return next((remedy for kind, remedy in _REMEDIES if isinstance(error, kind)), _UNEXPECTED)
