"""Solved points of a running build on disk, one line per point as it arrives.

Each line is JSON and its checksum: a header with the fingerprint of the build's inputs, then one record per point.
Numbers read back exactly. Points are solved again from the first line that a kill cut short or that is damaged. The
process that has the file open holds a lock, which ends with the process. A hidden file beside it names the process and
its host: a second build of the same library reports them and waits.
"""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import time
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from metafab.core.errors import InputError
from metafab.core.storage.lock import owner_in, write_owner
from metafab.core.storage.tables import DAMAGED

try:
    import fcntl
except ImportError:  # Windows, where an open file cannot be removed under another process either
    fcntl = None  # type: ignore[assignment]

_LOG = logging.getLogger(__name__)
_KIND = "metafab library checkpoint"
#: Time between two writes to the disk itself (s), which take up to 0.3 s each on a busy disk.
_SYNCHRONISE_S = 5.0


@dataclass(frozen=True)
class SolvedPoint:
    """The solver's answer for one cell or one row."""

    number: int  #: Number of the cell or row.
    #: t_xx, t_yy, r_xx, r_yy of a cell, then their derivatives by width and by length where these are known (1/nm); or
    #: the orders of a row of pillars.
    amplitudes: tuple[complex, ...]
    error: float  #: The solver's certificate, a bound on the absolute error of each amplitude.
    seconds: float  #: Time of the solver.


class Checkpoint:
    """Append-only record of solved points; without a path they are kept in memory only.

    Args:
        path: the file, created when missing and continued when present.
        inputs_sha256: fingerprint of the build.

    Attributes:
        points: points solved so far.
        waited: whether another process held the file when it was opened.

    Raises:
        InputError: the file is not a checkpoint, or one of another unit cell or target error.
    """

    def __init__(self, path: Path | None, inputs_sha256: str) -> None:
        self._path = path
        self._inputs = inputs_sha256
        self._stream: IO[str] | None = None
        self._synchronised_s = time.monotonic()
        self.points: list[SolvedPoint] = []
        self.waited = False

    def __enter__(self) -> Checkpoint:
        if self._path is None:
            return self
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._stream = self._open_alone(self._path)
        try:
            with _owner_file(self._path).open("w", encoding="utf-8") as owner:
                write_owner(owner)
            whole = self._read(self._path)
            self._stream.truncate(whole)
            if whole == 0:
                self._write({"kind": _KIND, "inputs_sha256": self._inputs})
            self._stream.flush()  # a forked worker must not inherit buffered text
        except BaseException:
            _owner_file(self._path).unlink(missing_ok=True)
            self._stream.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._stream is not None and self._path is not None:
            _owner_file(self._path).unlink(missing_ok=True)
            if fcntl is not None:
                with suppress(OSError):  # a file system without locks
                    fcntl.flock(self._stream, fcntl.LOCK_UN)  # forked workers hold the file, too
            self._stream.close()

    def add(self, points: Sequence[SolvedPoint]) -> None:
        """Record points; they survive the end of this process, and after a few seconds that of the machine."""
        self.points += points
        for point in points:
            parts = [part for value in point.amplitudes for part in (value.real, value.imag)]
            self._write([point.number, *parts, point.error, point.seconds])
        if self._stream is not None:
            self._stream.flush()
            if time.monotonic() - self._synchronised_s > _SYNCHRONISE_S:
                os.fsync(self._stream.fileno())
                self._synchronised_s = time.monotonic()

    def remove(self) -> None:
        """Delete the file, once its points are part of a library."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    def _open_alone(self, path: Path) -> IO[str]:
        """Open for appending once no other process has the file."""
        while True:
            stream = path.open("a", encoding="utf-8")
            if fcntl is None:
                return stream
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if getattr(multiprocessing.current_process(), "_inheriting", False):
                    stream.close()
                    raise _unguarded(path) from None
                self.waited = True
                _LOG.warning("metafab: waiting for %s, which builds %s", owner_in(_owner_file(path)), path.name)
                fcntl.flock(stream, fcntl.LOCK_EX)
            except OSError:  # a file system without locks
                return stream
            # The process that held the lock may have removed this file when it was done.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                    return stream
            stream.close()

    def _write(self, record: object) -> None:
        if self._stream is not None:
            text = json.dumps(record)
            self._stream.write(f"{text} {zlib.crc32(text.encode()):08x}\n")

    def _read(self, path: Path) -> int:
        """Take over the points of an earlier start up to the first damaged line; return the bytes of these lines."""
        lines = path.read_bytes().split(b"\n")[:-1]
        if not lines:
            return 0
        try:
            header = _record(lines[0])
            build = (header["kind"], header["inputs_sha256"])
        except DAMAGED as error:
            raise _refused(path, f"a foreign or damaged file ({error})") from error
        if build != (_KIND, self._inputs):
            raise _refused(path, "one of another unit cell, target error or version")
        with suppress(*DAMAGED):
            for line in lines[1:]:
                self.points.append(_point(_record(line)))
        return sum(len(line) + 1 for line in lines[: 1 + len(self.points)])


def _owner_file(path: Path) -> Path:
    """File that names the process which holds the lock."""
    return path.with_name(f".{path.name}.owner")


def _record(line: bytes) -> Any:
    """Record of a line; ValueError if its checksum does not match."""
    text, _, checksum = line.rpartition(b" ")
    if checksum != b"%08x" % zlib.crc32(text):
        raise ValueError("a line with another checksum")
    return json.loads(text)


def _point(record: list[float]) -> SolvedPoint:
    number, *parts, error, seconds = record
    amplitudes = tuple(complex(*parts[k : k + 2]) for k in range(0, len(parts), 2))
    return SolvedPoint(int(number), amplitudes, error, seconds)


def _unguarded(path: Path) -> InputError:
    """Error of a worker that runs its parent's script again and would wait for the parent's lock forever.

    ``multiprocessing`` detects such a worker by the attribute ``_inheriting`` too.
    """
    got, remedy = "a script that its workers run again", 'put its statements under `if __name__ == "__main__":`'
    return InputError.single(str(path), "checkpoint", "one process at a time", got, remedy)


def _refused(path: Path, got: str) -> InputError:
    remedy = "delete it to start the build afresh"
    return InputError.single(str(path), "checkpoint", "the checkpoint of this very build", got, remedy)
