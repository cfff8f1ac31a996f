"""Which interpreter has the FDTD Meep: usually not the one that runs metafab."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from metafab.core.errors import MissingToolError

#: Names an interpreter that has Meep, before all others.
VARIABLE = "METAFAB_MEEP_PYTHON"
WORKER = Path(__file__).parent.parent / "meep_worker.py"

#: What a worker may see of our environment: PYTHONPATH or an active venv would lead another interpreter astray.
_PASSED_ON = ("PATH", "HOME", "LANG", "LC_ALL", "TMPDIR", "LD_LIBRARY_PATH", "SystemRoot")
_PROBE_SECONDS = 60.0

HOW_TO_INSTALL = (
    "Debian and Ubuntu: apt-get install python3-meep python3-matplotlib python3-scipy; "
    "conda: conda create -n meep -c conda-forge pymeep; "
    f"then, unless it is found by itself, set {VARIABLE} to that Python. "
    "The package `meep` of the Python package index is another program"
)


@dataclass(frozen=True)
class MeepCandidate:
    """An interpreter that was looked at.

    Attributes:
        interpreter: its path.
        found: whether it has the FDTD Meep, proved by a wave in vacuum.
        version: Meep's version, "" where there is none.
        python: the interpreter's own version.
        reason: why it was not taken, "" where it was.
    """

    interpreter: Path
    found: bool
    version: str
    python: str
    reason: str


def find(interpreter: str | Path | None = None) -> list[MeepCandidate]:
    """Look for Meep in every likely interpreter.

    Args:
        interpreter: the only one to look at; by default ``METAFAB_MEEP_PYTHON``, then the current interpreter,
            ``/usr/bin/python3`` and the conda environments.

    Returns:
        One entry an interpreter, in the order of preference.
    """
    return [probe(path) for path in ([Path(interpreter)] if interpreter is not None else _likely())]


def best(interpreter: str | Path | None = None) -> MeepCandidate:
    """The first interpreter that has Meep; those after it are not looked at.

    Raises:
        MissingToolError: none has it; the message says what was found in each, and how to install Meep.
    """
    seen = []
    for path in [Path(interpreter)] if interpreter is not None else _likely():
        candidate = probe(path)
        if candidate.found:
            return candidate
        seen.append(f"  {candidate.interpreter}: {candidate.reason}")
    raise MissingToolError("\n".join(["no interpreter with the FDTD program Meep:", *seen, f"  {HOW_TO_INSTALL}"]))


def command(interpreter: Path) -> list[str]:
    """How a worker is started. ``-I`` keeps the worker's own folder off the path, where our room is called ``meep``."""
    return [str(interpreter), "-I", str(WORKER)]


def clean_environment() -> dict[str, str]:
    """The environment of a worker: one thread, no trace of our own interpreter."""
    environment = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
    return environment | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}


@cache
def probe(interpreter: Path) -> MeepCandidate:
    """Ask one interpreter; it is asked only once in the life of this process."""
    try:
        finished = subprocess.run(
            [*command(interpreter), "--probe"],
            env=clean_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
            check=False,
        )
    except FileNotFoundError:
        return MeepCandidate(interpreter, False, "", "", "no such file")
    except (OSError, subprocess.TimeoutExpired) as error:
        return MeepCandidate(interpreter, False, "", "", f"it cannot be run ({error})")
    try:
        answer: dict[str, Any] = json.loads(finished.stdout)
        return MeepCandidate(interpreter, bool(answer["found"]), answer["version"], answer["python"], answer["reason"])
    except (ValueError, KeyError, TypeError):
        last = (finished.stderr.strip().splitlines() or ["no message"])[-1]
        return MeepCandidate(interpreter, False, "", "", f"its answer made no sense ({last})")


def _likely() -> Iterator[Path]:
    seen: set[Path] = set()
    for path in _places():
        # Virtual environments link to one binary but see different packages: compare paths, not their targets.
        if path not in seen and path.exists():
            seen.add(path)
            yield path


def _places() -> Iterator[Path]:
    if named := os.environ.get(VARIABLE):
        yield Path(named)
    yield Path(sys.executable)
    yield Path("/usr/bin/python3")
    if prefix := os.environ.get("CONDA_PREFIX"):
        yield Path(prefix) / "bin" / "python"
    listed = Path.home() / ".conda" / "environments.txt"
    if listed.is_file():
        yield from (Path(line) / "bin" / "python" for line in listed.read_text().splitlines() if line.strip())
