"""Server that has imported metafab and forks a process for each command: a command without a second of imports.

The child has its own arguments, folder, environment, streams and memory, and ends as any Python process does. The
server never runs a command itself and has one thread, so a fork inherits no lock and no state.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import threading
from functools import cache
from pathlib import Path
from select import select

ROOT = Path(__file__).parents[1]
#: Modules that commands import when they run.
MODULES = ("run", "report", "report.draw", "steps.images", "steps.optics", "exposure", "comparison", "tolerance")
#: Environment in which the server imports: that before any test has changed it, and one thread of linear algebra, which
#: a command sets before it imports NumPy.
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", **os.environ, "PYTHONPATH": str(ROOT)}


class WarmCommands:
    """A server process; each call runs ``metafab ARGUMENTS`` in a fork of it."""

    def __init__(self) -> None:
        command, pipe = [sys.executable, str(Path(__file__))], subprocess.PIPE
        self._server = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, cwd=ROOT, env=ENVIRONMENT, start_new_session=True
        )
        atexit.register(self.close)

    def __call__(self, arguments: list[str], cwd: Path | None, timeout_s: float) -> tuple[int, str, str]:
        """Exit code (negative: signal), standard output and standard error.

        Any error ends the server, TimeoutExpired and KeyboardInterrupt among them: its answer would be taken for that
        to the next call. RuntimeError if the server has ended by itself.
        """
        assert self._server.stdin is not None and self._server.stdout is not None
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
            streams = [f"/proc/{os.getpid()}/fd/{stream.fileno()}" for stream in (out, err)]
            request = [arguments, str(cwd or Path.cwd()), dict(os.environ), streams]
            try:
                self._server.stdin.write(json.dumps(request).encode() + b"\n")
                self._server.stdin.flush()
                if not select([self._server.stdout], [], [], timeout_s)[0]:
                    raise subprocess.TimeoutExpired(arguments, timeout_s)
                if not (line := self._server.stdout.readline()):
                    raise RuntimeError("the server of warm commands ended; its standard error says why")
            except BaseException:
                self.close()
                warm_commands.cache_clear()
                raise
            out.seek(0)
            err.seek(0)
            return int(line), out.read().decode(), err.read().decode()

    def close(self) -> None:
        """End the server and what it runs."""
        if self._server.poll() is None:
            os.killpg(self._server.pid, signal.SIGKILL)
            self._server.wait()


@cache
def warm_commands() -> WarmCommands:
    """The server of this process."""
    return WarmCommands()


def _serve() -> None:
    """Fork a process for each request of standard input; answer its exit code."""
    for module in MODULES:
        importlib.import_module(f"metafab.{module}")
    assert threading.active_count() == 1, "a fork would inherit the locks of another thread"
    gc.freeze()  # Collections in forked processes leave what they inherit alone; they would copy every page.
    while line := sys.stdin.buffer.readline():
        pid = os.fork()
        if pid == 0:
            _run(*json.loads(line))
            return
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        os.write(1, f"{code}\n".encode())


def _run(arguments: list[str], folder: str, environment: dict[str, str], streams: list[str]) -> None:
    """Run the command in this forked process, which is then like a fresh one."""
    files = [os.open(path, flags) for path, flags in zip([os.devnull, *streams], (0, 1, 1), strict=True)]
    for target, file in enumerate(files):
        os.dup2(file, target)
        os.close(file)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment, PYTHONPATH=str(ROOT))
    sys.argv, sys.path[0] = ["metafab", *arguments], folder
    runpy.run_module("metafab.cli", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    _serve()
