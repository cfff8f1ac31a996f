"""Locks on folders and files that name their owner; a lock ends with its process, however that ends."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from metafab.core.errors import InputError
from metafab.core.storage.tables import DAMAGED

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_RUN_LOCK = ".run.lock"


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold an existing folder for one run; on a file system without locks the block runs unguarded.

    InputError if another process holds it; the message names the process and its host.
    """
    path = folder / _RUN_LOCK
    stream = _locked(path)
    try:
        if stream is not None:
            write_owner(stream)
        yield
    finally:
        if stream is not None:
            path.unlink(missing_ok=True)
            stream.close()


def write_owner(stream: IO[str]) -> None:
    """Replace the content of an open file by this process and its host."""
    stream.truncate(0)
    stream.write(json.dumps({"process": os.getpid(), "host": socket.gethostname()}) + "\n")
    stream.flush()


def owner_in(path: Path) -> str:
    """Return the owner that a file names, such as "process 12 on host lab", or "another process"."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        return f"process {int(table['process'])} on host {table['host']}"
    except (OSError, *DAMAGED):
        return "another process"


def _locked(path: Path) -> IO[str] | None:
    """The open and locked file; None on a system without locks; InputError if another process holds the lock."""
    if fcntl is None:
        return None
    while True:
        stream = path.open("a", encoding="utf-8")
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            stream.close()
            raise InputError.single(
                str(path.parent), "folder", "one run at a time", f"one of {owner_in(path)}",
                "wait for its end, or give another folder with `-o`",
            ) from None  # fmt: skip
        except OSError:  # a file system without locks
            stream.close()
            return None
        # An owner that ended in between has removed this file.
        if path.exists() and os.path.samestat(os.fstat(stream.fileno()), path.stat()):
            return stream
        stream.close()
