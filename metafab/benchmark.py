"""Finds and runs the benchmarks of the repository's ``benchmarks`` folder: rows of error, seconds and memory."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from metafab.core.errors import InputError, MissingToolError
from metafab.core.parallel.progress import Progress, silent

ROOMS = ("cell", "meep", "library", "phase", "layout", "drc", "psf", "decode", "end_to_end")


def rows_of(room: str, *, quick: bool = False, progress: Progress = silent) -> list[dict[str, Any]]:
    """Rows of one room's benchmark, or of all.

    Args:
        room: one of :data:`ROOMS`, or "all".
        quick: fewer and smaller cases.
        progress: called once a room.

    Returns:
        One dict a case with at least ``room``, ``name``, ``error``, ``seconds``, ``peak_rss_mb``. Of all rooms, one
        whose tools are not installed gives a row that says so.

    Raises:
        InputError: ``room`` is unknown.
        MissingToolError: metafab was installed without its repository, or the room's tools are missing.
    """
    if room not in (*ROOMS, "all"):
        raise InputError.single("benchmark", "room", f"one of {', '.join(ROOMS)} or all", repr(room))
    chosen = ROOMS if room == "all" else (room,)
    rows: list[dict[str, Any]] = []
    for done, name in enumerate(chosen):
        progress("benchmark", done, len(chosen))
        module = _load(name)
        try:
            found = module.rows(quick)
        except MissingToolError as error:
            if room != "all":
                raise
            found = [{"name": f"not run: {error}", "error": None, "seconds": None, "peak_rss_mb": None}]
        rows += [{"room": name, **row} for row in found]
    progress("benchmark", len(chosen), len(chosen))
    return rows


def _load(room: str) -> Any:
    """The module of a room in the ``benchmarks`` folder beside the package."""
    repository = Path(__file__).parent.parent
    if not (repository / "benchmarks" / f"{room}.py").is_file():
        raise MissingToolError(
            "the benchmarks live in metafab's repository: clone it, run .ci/setup there, and call "
            ".venv/bin/metafab benchmark"
        )
    if str(repository) not in sys.path:
        sys.path.insert(0, str(repository))
    return import_module(f"benchmarks.{room}")
