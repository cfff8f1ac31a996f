"""FDTD jobs, and a worker process that runs them: JSON lines over pipes, arrays as .npz files, with a time limit."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.cell.meep import finding
from metafab.core.conventions import Polarisation
from metafab.core.errors import SolverError
from metafab.core.storage.files import plain

#: Arrays of one run by name, as :func:`metafab.cell.meep_worker.run` documents them.
Reply = dict[str, NDArray[Any]]

#: Lines of the worker's stderr that an error quotes.
_STDERR_LINES = 12
#: Time that a worker gets to end after SIGTERM.
_GRACE_SECONDS = 2.0
#: NumPy parses .npy headers with ``ast``, which is not thread-safe in Python 3.11.
_LOADING = threading.Lock()


@dataclass(frozen=True)
class Block:
    """A box or an upright prism of one material; later ones replace earlier ones where they overlap."""

    low: tuple[float, float, float]  #: (x, y, z) in um from the middle of the cell.
    high: tuple[float, float, float]  #: The opposite corner.
    epsilon: tuple[complex, complex, complex]  #: Permittivity along x, y and z.
    mu: tuple[float, float, float] = (1.0, 1.0, 1.0)  #: Permeability along x, y and z.
    outline: tuple[
        tuple[float, float], ...
    ] = ()  #: (x, y) of the vertices of a prism within the box, um; none for a box.


@dataclass(frozen=True)
class Job:
    """One FDTD run: a plane-wave pulse along +z through a structure that is periodic along x and y."""

    pixel_um: float  #: Grid spacing.
    n_x: int  #: Pixels of the period along x; even.
    n_y: int  #: Pixels of the period along y; even.
    n_z: int  #: Pixels along z, absorbers included; even.
    absorber_nodes: int  #: Thickness of each absorber (PML), in pixels.
    source_node: int  #: Plane of the pulse's source, in pixels from the lower end.
    monitor_nodes: tuple[int, ...]  #: Planes of the recorded fields, in pixels from the lower end.
    wavelength_um: float  #: Vacuum wavelength of the recorded fields.
    polarisation: Polarisation  #: Of the pulse.
    components: tuple[Polarisation, ...]  #: Recorded components of E.
    orders: tuple[tuple[int, int], ...]  #: Recorded diffraction orders (m, n) along x and y.
    #: Weight of the source and of the averaged points; shape (n_y,) for x polarisation, (n_x,) for y.
    weight: tuple[float, ...]
    epsilon_in: tuple[complex, complex, complex]  #: Permittivity along x, y and z outside the blocks, as at the source.
    blocks: tuple[Block, ...]  #: The structure.
    smooth: bool  #: Whether Meep averages pixels that a wall crosses; false for blocks with averages of their own.
    mirrors: tuple[Polarisation, ...]  #: Axes along which the structure equals its mirror image; each halves the work.
    decay: float  #: Change of the extrapolated orders, relative to the incident wave, at which the run ends.
    longest_time: float  #: Latest end of the run, um / c.
    courant: float = 0.5  #: Time step over grid spacing.


class Worker:
    """A process that runs jobs one after the other; not to be shared between threads.

    ``command`` is the program and its arguments; by default the first interpreter that has Meep.
    """

    def __init__(self, command: Sequence[str] | None = None) -> None:
        self.jobs_done = 0
        self._idle = True
        self._folder = tempfile.TemporaryDirectory(prefix="metafab-meep-")
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._log = Path(self._folder.name) / "stderr"
        with self._log.open("wb") as stderr:
            self._process = subprocess.Popen(
                list(command) if command is not None else finding.command(finding.best().interpreter),
                env=finding.clean_environment(),
                cwd=self._folder.name,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
                text=True,
                # Own process group: Ctrl-C does not reach it, and killing the group kills its children.
                start_new_session=True,
            )
        self._reader = threading.Thread(target=self._read_stdout, daemon=True)
        self._reader.start()

    @property
    def alive(self) -> bool:
        """Whether the process still runs."""
        return self._process.poll() is None

    def run(self, job: Job, *, limit_s: float, report: Callable[[float], None] | None = None) -> Reply:
        """Run one job to its end, or to ``limit_s``, when the worker is killed.

        ``report`` is called with the simulated time in um / c. Returns the arrays that
        :func:`metafab.cell.meep_worker.run` documents. SolverError if the worker reported an error, died, broke the
        protocol or took too long; it can be used again only after an error that it reported (see ``alive``).
        """
        name = f"{self.jobs_done}"
        arrays = Path(self._folder.name) / f"{name}.npz"
        try:
            self._send({"id": name, "job": plain(job), "arrays": str(arrays)})
            self._await(name, time.monotonic() + limit_s, limit_s, report)
            reply = load_reply(arrays)
        except (OSError, ValueError) as error:
            failure = self._failure(f"its arrays cannot be read ({error})")
            self.close()
            raise failure from error
        except BaseException:
            # Ctrl-C included: an abandoned run must not go on. After a reported error the worker is idle.
            if not self._idle:
                self.close()
            raise
        finally:
            arrays.unlink(missing_ok=True)
        self.jobs_done += 1
        return reply

    def close(self) -> None:
        """End the process and its children, and remove its files."""
        if self.alive:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGTERM)
            try:
                self._process.wait(_GRACE_SECONDS)
            except subprocess.TimeoutExpired:
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()
        self._reader.join(_GRACE_SECONDS)
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        self._folder.cleanup()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, message: dict[str, Any]) -> None:
        self._idle = False
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(message) + "\n")
            self._process.stdin.flush()
        except OSError as error:
            failure = self._failure("it ended before it received its job")
            self.close()
            raise failure from error

    def _await(self, name: str, deadline: float, limit_s: float, report: Callable[[float], None] | None) -> None:
        while True:
            try:
                line = self._lines.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                raise self._failure(f"it took longer than {limit_s:g} s") from None
            if line is None:
                self._process.wait()
                raise self._failure(f"it died during a job (exit status {self._process.returncode})")
            message = _parse(line)
            if message.get("id") != name:
                raise self._failure(f"unexpected answer {line.strip()[:80]!r}")
            if "error" in message:
                self._idle = True
                raise self._failure(str(message["error"]))
            if "done" in message:
                self._idle = True
                return
            if report is not None and "progress" in message:
                report(float(message["progress"]))

    def _failure(self, reason: str) -> SolverError:
        stderr = ""
        with contextlib.suppress(OSError):
            last = self._log.read_text(errors="replace").splitlines()[-_STDERR_LINES:]
            stderr = "".join(f"\n  | {line}" for line in last)
        return SolverError(f"Meep worker: {reason}{stderr}")

    def _read_stdout(self) -> None:
        assert self._process.stdout is not None
        with contextlib.suppress(ValueError, OSError):
            for line in self._process.stdout:
                self._lines.put(line)
        self._lines.put(None)


def load_reply(path: Path) -> Reply:
    """Read the arrays of an .npz file.

    OSError, ValueError, EOFError, zipfile.BadZipFile if there is no file, or it is damaged.
    """
    with _LOADING, np.load(path, allow_pickle=False) as content:
        return {name: np.array(content[name]) for name in content.files}


def _parse(line: str) -> dict[str, Any]:
    """JSON object of a line; empty if the line holds none."""
    try:
        message = json.loads(line)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}
