"""Finds and runs the benchmarks of the repository's ``benchmarks`` folder: rows of error, seconds and memory."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from metafab.core.errors import InputError, MissingToolError
from metafab.core.progress import Progress, silent

ROOMS = ("cell", "library", "layout", "drc", "psf", "decode")


def rows_of(room: str, *, quick: bool = False, progress: Progress = silent) -> list[dict[str, Any]]:
    """Rows of one room's benchmark, or of all.

    Args:
        room: one of :data:`ROOMS`, or "all".
        quick: fewer and smaller cases.
        progress: called once a room.

    Returns:
        One dict a case with at least ``room``, ``name``, ``error``, ``seconds``, ``peak_rss_mb``.

    Raises:
        InputError: ``room`` is unknown.
        MissingToolError: metafab was installed without its repository.
    """
    if room not in (*ROOMS, "all"):
        raise InputError.single("benchmark", "room", f"one of {', '.join(ROOMS)} or all", repr(room))
    chosen = ROOMS if room == "all" else (room,)
    rows: list[dict[str, Any]] = []
    for done, name in enumerate(chosen):
        progress("benchmark", done, len(chosen))
        rows += [{"room": name, **row} for row in _load(name).rows(quick)]
    progress("benchmark", len(chosen), len(chosen))
    return rows


def _load(room: str) -> Any:
    path = Path(__file__).parent.parent / "benchmarks" / f"{room}.py"
    if not path.is_file():
        raise MissingToolError(
            "the benchmarks live in metafab's repository: clone it, run .ci/setup there, and call "
            ".venv/bin/metafab benchmark"
        )
    spec = spec_from_file_location(f"metafab_benchmark_{room}", path)
    assert spec is not None and spec.loader is not None  # a .py file always has a loader
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
