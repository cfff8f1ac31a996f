"""Benchmarks of the repository's ``benchmarks`` folder: rows of error, seconds and memory."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from metafab.core.conventions import FloatArray
from metafab.core.errors import InputError, MissingToolError
from metafab.core.parallel.progress import Progress, silent

ROOMS = (
    "cell",
    "certificates",
    "stability",
    "meep",
    "focus",
    "library",
    "phase",
    "layout",
    "apertures",
    "drc",
    "expose",
    "psf",
    "crystal",
    "made_lens",
    "decode",
    "scenes",
    "films",
    "files",
    "faults",
    "cluster",
    "end_to_end",
    "targets",
    "floor",
)
#: Options of rooms whose cases can be chosen, or drawn with other seeds.
ROOM_OPTIONS = {
    "scenes": ("only", "seeds"),
    "expose": ("only",),
    "certificates": ("seed", "samples", "only"),
    "files": ("seed", "samples", "only"),
    "films": ("samples",),
    "faults": ("seed", "samples", "only"),
    "apertures": ("only",),
    "cluster": ("only",),
}
#: Rooms that report their own progress.
_REPORTING = {"scenes"}
#: Name of a room's row that sums up all others.
ALL_CASES = "all answers"


@dataclass(frozen=True)
class DepthView:
    """Maps of one decoded frame beside its truth."""

    true_intensity: FloatArray  #: Shape (n_y, n_x), electrons, x polarisation.
    intensity: FloatArray  #: Shape (n_y, n_x), decoded.
    true_depth_m: FloatArray  #: Shape (n_y, n_x); NaN where nothing is.
    depth_m: FloatArray  #: Shape (n_y, n_x), decoded; NaN for none.
    confidence: FloatArray  #: Shape (n_y, n_x), 0 to 1.
    bin_confidence: FloatArray  #: Shape (n_bins,), mean confidence of each bin of the reliability diagram.
    bin_right: FloatArray  #: Shape (n_bins,), share of the bin's pixels whose depth is right.


@dataclass(frozen=True)
class BenchmarkRow:
    """One case of a benchmark."""

    name: str  #: Name of the case.
    room: str = ""  #: Room that it measures.
    error: float | None = None  #: Error, None where it is not known; likewise the following figures.
    seconds: float | None = None  #: Time.
    peak_rss_mb: float | None = None  #: Peak memory.
    series: str | None = None  #: Line to which the case belongs in plots.
    bound: float | None = None  #: Smallest possible error.
    photons: float | None = None  #: Mean signal of a pixel, electrons.
    weakness: str | None = None  #: Weakness of the decoder that a case of the scenes measures.
    measured: float | None = None  #: Figure of that weakness, mean over seeds.
    goal: float | None = None  #: Goal of that figure.
    at_least: bool | None = None  #: Whether the figure must be at least the goal, and not at most.
    met: bool | None = None  #: Whether the goal is met.
    view: DepthView | None = None  #: Maps of the case's first frame.
    further: Mapping[str, Any] = field(default_factory=dict)  #: Other columns of the table, by name.

    @classmethod
    def of(cls, table: Mapping[str, Any]) -> BenchmarkRow:
        """Make a row from a table; unknown keys become further columns."""
        names = set(cls.__dataclass_fields__) - {"further"}
        known = {name: value for name, value in table.items() if name in names}
        return cls(**known, further={name: value for name, value in table.items() if name not in names})

    def table(self) -> dict[str, Any]:
        """Columns of the row by name, without its view; those from ``series`` on only where they are known."""
        columns = {name: value for name, value in vars(self).items() if name not in {"view", "further"}}
        always = ("name", "room", "error", "seconds", "peak_rss_mb")
        columns = {name: value for name, value in columns.items() if name in always or value is not None}
        return columns | dict(self.further)


def rows_of(room: str, *, quick: bool = False, progress: Progress = silent, **options: Any) -> list[BenchmarkRow]:
    """Run the benchmark of one room, or of all.

    Args:
        room: one of :data:`ROOMS`, or "all".
        quick: run fewer and smaller cases.
        options: those of the room in :data:`ROOM_OPTIONS`; None, or an empty list, for the default.

    Returns:
        One row for each case. With "all", a room whose tools are not installed gives a row with the reason.

    Raises:
        InputError: ``room`` is unknown, or has no such option.
        MissingToolError: metafab was installed without its repository, or the room's tools are missing.
    """
    if room not in (*ROOMS, "all"):
        raise InputError.single("benchmark", "room", f"one of {', '.join(ROOMS)} or all", repr(room))
    options = {name: value for name, value in options.items() if value is not None and value != []}
    for name in options:
        if name not in ROOM_OPTIONS.get(room, ()):
            having = " or ".join(other for other, names in ROOM_OPTIONS.items() if name in names)
            raise InputError.single("benchmark", "room", f"{having} with --{name}", repr(room))
    chosen = ROOMS if room == "all" else (room,)
    rows: list[BenchmarkRow] = []
    for done, name in enumerate(chosen):
        progress("benchmark", done, len(chosen))
        module = load_room(name)
        told = {"progress": progress} if name in _REPORTING else {}
        try:
            rows += [BenchmarkRow.of({"room": name, **row}) for row in module.rows(quick, **options, **told)]
        except MissingToolError as error:
            if room != "all":
                raise
            rows.append(BenchmarkRow(f"not run: {error}", name))
    progress("benchmark", len(chosen), len(chosen))
    return rows


def load_room(room: str) -> Any:
    """Import the benchmark of a room from the ``benchmarks`` folder beside the package."""
    repository = Path(__file__).parent.parent
    path = next((repository / "benchmarks").glob(f"*/{room}.py"), None)
    if path is None:
        raise MissingToolError(
            "the benchmarks live in metafab's repository: clone it, run .ci/setup there, and call "
            ".venv/bin/metafab benchmark"
        )
    if str(repository) not in sys.path:
        sys.path.insert(0, str(repository))
    return import_module(f"benchmarks.{path.parent.name}.{room}")
