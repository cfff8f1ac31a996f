"""Search for a Python interpreter that has the FDTD program Meep, usually not the one that runs metafab."""

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

#: Environment variable that names the first interpreter to probe.
VARIABLE = "METAFAB_MEEP_PYTHON"
WORKER = Path(__file__).parent.parent / "meep_worker.py"

#: Environment variables that a worker inherits; PYTHONPATH or an active venv would mislead another interpreter.
_INHERITED = ("PATH", "HOME", "LANG", "LC_ALL", "TMPDIR", "LD_LIBRARY_PATH", "SystemRoot")
_PROBE_SECONDS = 60.0

HOW_TO_INSTALL = (
    "Debian and Ubuntu: apt-get install python3-meep python3-matplotlib python3-scipy; "
    "conda: conda create -n meep -c conda-forge pymeep; "
    f"then, unless it is found by itself, set {VARIABLE} to that Python. "
    "The package `meep` on PyPI is another program"
)


@dataclass(frozen=True)
class MeepCandidate:
    """An interpreter that was probed for Meep."""

    interpreter: Path  #: Path of the interpreter.
    found: bool  #: Whether it has the FDTD program Meep, tested by simulating a wave in vacuum.
    version: str  #: Version of Meep, "" without Meep.
    python: str  #: The interpreter's version.
    reason: str  #: Why the interpreter cannot be used, "" if it has Meep.


def find(interpreter: str | Path | None = None) -> list[MeepCandidate]:
    """Probe ``interpreter`` for Meep, or by default every likely one, in the order of preference.

    Likely are ``METAFAB_MEEP_PYTHON``, then the current interpreter, ``/usr/bin/python3`` and the conda environments.
    """
    return [probe(path) for path in ([Path(interpreter)] if interpreter is not None else _likely())]


def best(interpreter: str | Path | None = None) -> MeepCandidate:
    """The first interpreter that has Meep; those after it are not probed.

    MissingToolError if none has it; the message gives the reason for each, and how to install Meep.
    """
    reasons = []
    for path in [Path(interpreter)] if interpreter is not None else _likely():
        candidate = probe(path)
        if candidate.found:
            return candidate
        reasons.append(f"  {candidate.interpreter}: {candidate.reason}")
    raise MissingToolError("\n".join(["no interpreter with the FDTD program Meep:", *reasons, f"  {HOW_TO_INSTALL}"]))


def command(interpreter: Path) -> list[str]:
    """Command of a worker. ``-I`` keeps the worker's folder and its package ``meep`` off the path."""
    return [str(interpreter), "-I", str(WORKER)]


def clean_environment() -> dict[str, str]:
    """Environment of a worker: one thread, and no settings of this interpreter."""
    environment = {name: os.environ[name] for name in _INHERITED if name in os.environ}
    return environment | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}


@cache
def probe(interpreter: Path) -> MeepCandidate:
    """Probe one interpreter; the result is cached for the life of this process."""
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
        return MeepCandidate(interpreter, False, "", "", f"its probe returned no valid JSON ({last})")


def _likely() -> Iterator[Path]:
    # Virtual environments link to one binary but have different packages: compare paths, not link targets.
    yield from (path for path in dict.fromkeys(_places()) if path.exists())


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
