"""A folder is held by one process at a time, and a second one is told by whom."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from metafab.core.errors import InputError
from metafab.core.storage.lock import alone_in, owner_in

_HOLD = """
import sys, time
from pathlib import Path
from metafab.core.storage.lock import alone_in
with alone_in(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen([sys.executable, "-c", _HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_the_second_is_told_by_whom_the_folder_is_held(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    owner = f"process {holder.pid} on host {socket.gethostname()}"
    with pytest.raises(InputError, match=owner), alone_in(tmp_path):
        pass
    assert holder.poll() is None


def test_a_killed_owner_holds_nothing(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    with alone_in(tmp_path):
        assert owner_in(tmp_path / ".run.lock").startswith(f"process {os.getpid()} ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b'{"process": "x", "host": 1}', b"\xff", b"[" * 100_000])
def test_a_damaged_lock_names_nobody(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / ".run.lock"
    assert owner_in(path) == "another process"
    path.write_bytes(content)
    assert owner_in(path) == "another process"
    with alone_in(tmp_path):
        pass
