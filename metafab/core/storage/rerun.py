"""The answer of a run, given again while no file that it rests on has changed.

``.rerun.json`` in the run folder holds what the command would print, and marks of the package's source, the input files
and all files of the folder: size, and times of the last change of content and of name or rights. Whatever differs, down
to a file that was added, leaves the answer to the pipeline, which compares contents. This module and its imports need
the standard library alone: validating a design takes longer than the answer.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

from metafab.core.storage.tables import DAMAGED, table_sha256, typed

_RERUN_FILE, _SUMMARY_FILE = ".rerun.json", "summary.json"
#: Top-level name of a design, and size of a file (bytes) up to which it is looked for.
_NAME, _LARGEST = re.compile(r"""^name\s*=\s*["']([^"'\\/]+)["']""", re.MULTILINE), 1 << 16
_PACKAGE = Path(__file__).parents[2]

#: Longest tick of a file system's clock, that of FAT, ns.
_TICK_NS = 2_000_000_000
#: Files of a run folder, at most; more are not the run's own, and looking at them takes longer than the pipeline.
_MOST_FILES = 10_000

#: Size in bytes, and times of the last change of content and of name or rights in ns (mtime and ctime), by path.
Marks: TypeAlias = dict[str, list[int]]


@dataclass(frozen=True)
class Rerun:
    """Printed answer of ``metafab run``, and the state of the files on which it rests."""

    name: str  #: Name of the design.
    design: str  #: Absolute path of the design file.
    folder: str  #: Absolute path of the run folder; its files name others by relative paths.
    code: str  #: :func:`code_mark` when the run began.
    inputs: Marks  #: Files outside the run folder, by absolute path; a link counts by the file it leads to.
    files: Marks  #: Files of the run folder, by relative path.
    summary: Any  #: Content of ``summary.json`` after a run that skips every step.
    headlines: dict[str, str]  #: Text by label; the paths of the run folder are those of then.
    announcements: tuple[str, ...]  #: Sentences for stderr.
    violations: int  #: Places where design rules are violated.

    def keep(self, folder: Path) -> None:
        """Write ``.rerun.json`` into the run folder, with its own hash, so that a changed digit is noticed."""
        table = asdict(self)
        _replace(folder / _RERUN_FILE, {**table, "sha256": table_sha256(table)})


def find_rerun(design: Path, output: Path | None, code: str) -> tuple[Rerun, Path] | None:
    """Answer and run folder of a design file; None where anything differs or cannot be read or written.

    ``output`` is the run folder, None for ``runs/NAME``; ``code`` is :func:`code_mark`. ``summary.json`` is written as
    the pipeline does when it skips every step.
    """
    try:
        if output is None:
            if not design.is_file() or design.stat().st_size > _LARGEST:
                return None
            name = _NAME.search(design.read_text(encoding="utf-8"))
            if name is None:
                return None
            folder = Path("runs") / name[1]
        else:
            folder = output
        table = json.loads((folder / _RERUN_FILE).read_text(encoding="utf-8"))
        if table.pop("sha256") != table_sha256(table):
            return None
        known = typed(Rerun, table)
        stated = (str(design.absolute()), str(folder.resolve()), code)
        is_known = (known.design, known.folder, known.code) == stated
        is_known = is_known and (output is not None or known.name == folder.name)
        if not is_known or marks(known.inputs) != known.inputs or folder_marks(folder) != known.files:
            return None
        _replace(folder / _SUMMARY_FILE, known.summary)
    except (OSError, *DAMAGED):
        return None
    return known, folder


def marks(paths: Iterable[Path | str]) -> Marks:
    """Marks of files by path; OSError if one is missing."""
    found = {}
    for path in paths:
        state = Path(path).stat()
        found[str(path)] = [state.st_size, state.st_mtime_ns, state.st_ctime_ns]
    return found


def folder_marks(folder: Path) -> Marks:
    """Marks of all files under a run folder but those that a rerun writes, by relative path.

    OSError if there are more than any run writes.
    """
    found = marks(islice(_files(str(folder)), _MOST_FILES + 1))
    if len(found) > _MOST_FILES:
        raise OSError(f"more than {_MOST_FILES} files in {folder}")
    return {
        name: mark
        for path, mark in found.items()
        if (name := os.path.relpath(path, folder).replace(os.sep, "/")) not in (_RERUN_FILE, _SUMMARY_FILE)
    }


def all_older(paths: Iterable[Path | str], began_ns: int) -> bool:
    """Whether no file was changed or renamed since a time (ns since the epoch), nor within one tick before it."""
    states = (Path(path).stat() for path in paths)
    return all(max(state.st_mtime_ns, state.st_ctime_ns) < began_ns - _TICK_NS for state in states)


def code_mark(package: Path = _PACKAGE) -> str:
    """Hash of the sizes and times of the package's files, of the interpreter and of the installed packages' folder.

    Empty where a file cannot be read, such as an editor's link to nothing.
    """
    digest = sha256(sys.version.encode())
    try:
        for path, mark in sorted(marks(_files(str(package))).items()):
            digest.update(f"{path} {mark}".encode())
        numpy = importlib.util.find_spec("numpy")
        if numpy is not None and numpy.origin is not None:
            digest.update(str(Path(numpy.origin).parents[1].stat().st_mtime_ns).encode())
    except OSError:
        return ""
    return digest.hexdigest()


def _files(folder: str) -> Iterator[str]:
    """Paths of all files under a folder but compiled ones."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir():
                if entry.name != "__pycache__":
                    yield from _files(entry.path)
            else:
                yield entry.path


def _replace(path: Path, table: Any) -> None:
    """Write JSON beside ``path``, then rename it."""
    part = path.with_name(f".{path.name}.{os.getpid()}-000000.part")
    try:
        part.write_text(json.dumps(table, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
