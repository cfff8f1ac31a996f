"""What the steps of a run left, as its folder keeps it: state of their files, figures, times.

``steps.json`` holds a :class:`Record` of each step. Times stand in ``summary.json`` alone, so that one design gives the
same bytes in every folder.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from metafab.core.storage.files import file_sha256, plain
from metafab.core.storage.tables import DAMAGED, table_sha256, typed
from metafab.steps.job import Step
from metafab.steps.summary import SUMMARY_FILE

STEPS_FILE = "steps.json"


@dataclass(frozen=True)
class FileMark:
    """State of a file when its step had written it."""

    bytes: int  #: Size.
    sha256: str  #: Hash of the content.

    @classmethod
    def of(cls, path: Path) -> FileMark:
        """State of a file now."""
        return cls(path.stat().st_size, file_sha256(path))

    def holds(self, path: Path, modified_ns: int | None = None) -> bool:
        """Whether the file is unchanged: equal size, and equal content or the known time of its last change."""
        if not path.is_file() or path.stat().st_size != self.bytes:
            return False
        return path.stat().st_mtime_ns == modified_ns or file_sha256(path) == self.sha256


@dataclass(frozen=True)
class Record:
    """One step's entry in ``steps.json``."""

    inputs_sha256: str  #: Fingerprint of all that the step depends on.
    outputs: dict[str, FileMark]  #: State of each file, by its path relative to the run folder.
    summary: Any  #: Figures of the step; None where they are damaged, or an older version wrote them in another form.
    #: Hash of the figures, so that a changed digit is noticed; empty in records of older versions.
    summary_sha256: str = ""

    @classmethod
    def of(cls, inputs_sha256: str, outputs: dict[str, FileMark], figures: Any) -> Record:
        """Entry of a step with these figures."""
        return cls(inputs_sha256, outputs, figures, table_sha256(plain(figures)))

    def files_unchanged(self, folder: Path, modified_ns: Mapping[str, int] = MappingProxyType({})) -> bool:
        """Whether every file is as the step left it; ``modified_ns`` are times of its last change, by name."""
        return all(mark.holds(folder / name, modified_ns.get(name)) for name, mark in self.outputs.items())


@dataclass(frozen=True)
class Log:
    """Times and memory of steps and files, by name, which no other file than ``summary.json`` holds."""

    seconds: dict[str, float] = field(default_factory=dict)
    peak_rss_mb: dict[str, float] = field(default_factory=dict)
    modified_ns: dict[str, int] = field(default_factory=dict)


def read_records(folder: Path, steps: Sequence[Step]) -> dict[str, Record]:
    """Read the records of earlier runs; a record that is missing or damaged is left out."""
    try:
        tables = json.loads((folder / STEPS_FILE).read_text(encoding="utf-8"))
    except (OSError, *DAMAGED):
        return {}
    records = {}
    for step in steps:
        try:
            record = typed(Record, tables[step.name])
            is_whole = table_sha256(record.summary) == record.summary_sha256
        except DAMAGED:
            continue
        figures = _figures(step, record.summary) if is_whole else None
        # Hashed anew: by their types, 5 may have been read as 5.0.
        records[step.name] = Record.of(record.inputs_sha256, record.outputs, figures)
    return records


def read_log(folder: Path) -> Log:
    """Times of earlier runs; none where the summary is missing or damaged."""
    try:
        return typed(Log, json.loads((folder / SUMMARY_FILE).read_text(encoding="utf-8")))
    except (OSError, *DAMAGED):
        return Log()


def _figures(step: Step, table: Any) -> Any:
    """Figures of a step, None if the table has another form."""
    try:
        return typed(step.figures, table)
    except DAMAGED:
        return None
