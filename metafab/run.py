"""The pipeline: which steps are stale, run those, collect the summary.

A step is up to date when the fingerprint of everything that it depends on (its part of the design, the steps
before it, the code of the rooms that it uses) is the one under which its files were made, and those files are
still as it left them. ``steps.json`` in the run folder keeps that record.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from metafab import __version__
from metafab.core.files import file_sha256, fingerprint, plain, whole_file, write_json
from metafab.core.measure import measured
from metafab.core.progress import Progress, silent
from metafab.spec import Design, canonical_toml

STEPS_FILE = "steps.json"
_LIBRARIES = ("numpy", "scipy", "gdstk", "h5py", "shapely", "matplotlib", "pydantic", "numba", "klayout")


@dataclass(frozen=True)
class Job:
    """What a run works on: the design, its folder, and how the work is spread.

    Attributes:
        design: the validated design.
        folder: run folder, created when needed.
        workers: processes; None for all cores.
        cluster: address of a Dask scheduler, or None.
        progress: callback of long work.
    """

    design: Design
    folder: Path
    workers: int | None = None
    cluster: str | None = None
    progress: Progress = silent


@dataclass(frozen=True)
class Step:
    """One step of the pipeline.

    Attributes:
        name: key in the summary.
        rooms: packages whose code decides the result.
        after: steps whose results it uses.
        inputs: the parts of the design that it depends on.
        outputs: the files that it writes.
        work: does it, and returns the step's part of the summary.
    """

    name: str
    rooms: tuple[str, ...]
    after: tuple[str, ...]
    inputs: Callable[[Design], Any]
    outputs: Callable[[Job], tuple[Path, ...]]
    work: Callable[[Job], dict[str, Any]]


@dataclass
class Record:
    """What ``steps.json`` remembers of a step; file names are relative to the run folder where they lie in it."""

    inputs_sha256: str
    outputs: dict[str, dict[str, Any]]
    summary: dict[str, Any]
    seconds: float
    peak_rss_mb: float

    def stands(self, folder: Path) -> bool:
        """Whether every file is as the step left it: same size and time, or else the same bytes."""
        for name, mark in self.outputs.items():
            path = folder / name
            if not path.is_file() or path.stat().st_size != mark["bytes"]:
                return False
            if path.stat().st_mtime_ns != mark["mtime_ns"] and file_sha256(path) != mark["sha256"]:
                return False
        return True


@dataclass
class Outcome:
    """What a run did.

    Attributes:
        summary: content of ``summary.json``.
        violations: design rules broken, over all rules.
    """

    summary: dict[str, Any] = field(default_factory=dict)
    violations: int = 0


def run(
    design: Design,
    folder: Path,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress = silent,
) -> Outcome:
    """Run every step of the main job that is not up to date.

    Args:
        design: a validated design.
        folder: run folder; files of earlier runs in it are used again where they still hold.
        workers: processes; None for all cores.
        cluster: address of a Dask scheduler.
        progress: callback of long work.

    Returns:
        The summary; it is also written to ``folder/summary.json`` and shown by ``folder/report.html``.
    """
    from metafab.steps import STEPS, error_budget, write_report

    job = Job(design, folder, workers, cluster, progress)
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(folder / "design.toml") as part:
        part.write_text(canonical_toml(design), encoding="utf-8")

    records = _read_records(folder)
    prints: dict[str, str] = {}
    skipped: list[dict[str, str]] = []
    for step in STEPS:
        print_ = fingerprint(step.inputs(design), [prints[name] for name in step.after], code_sha256(step.rooms))
        prints[step.name] = print_
        record = records.get(step.name)
        if record and record.inputs_sha256 == print_ and record.stands(folder):
            skipped.append({"step": step.name, "why": "its inputs and its files are unchanged"})
            continue
        with measured() as cost:
            result = step.work(job)
        peak_mb = max(cost.peak_rss_mb, float(result.pop("worker_peak_rss_mb", 0.0)))
        records[step.name] = Record(print_, _marks(step.outputs(job), folder), plain(result), cost.seconds, peak_mb)
        _write_records(folder, records)

    summary = _summary(design, {step.name: records[step.name] for step in STEPS}, skipped)
    summary["error_budget"] = plain(error_budget({name: record.summary for name, record in records.items()}))
    stale = not (folder / "report.html").is_file() or len(skipped) < len(STEPS)
    with measured() as cost:
        if stale:
            write_json(folder / "summary.json", summary)
            write_report(job)
    if stale:
        summary["seconds"]["report"] = cost.seconds
        summary["peak_rss_mb"]["report"] = cost.peak_rss_mb
    else:
        skipped.append({"step": "report", "why": "nothing that it shows has changed"})
    write_json(folder / "summary.json", summary)
    return Outcome(summary, sum(summary["drc"]["violations"].values()))


def _summary(design: Design, records: Mapping[str, Record], skipped: list[dict[str, str]]) -> dict[str, Any]:
    summary: dict[str, Any] = {"name": design.name}
    summary |= {name: record.summary for name, record in records.items()}
    summary["seconds"] = {name: record.seconds for name, record in records.items()}
    summary["peak_rss_mb"] = {name: record.peak_rss_mb for name, record in records.items()}
    summary["skipped"] = skipped
    summary["versions"] = versions()
    return summary


def versions() -> dict[str, str]:
    """Versions of metafab, Python and the libraries that results depend on."""
    found = {"metafab": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


@cache
def code_sha256(rooms: tuple[str, ...]) -> str:
    """Hash of the source of some rooms and of what all rooms stand on: changed code makes its steps stale."""
    package = Path(__file__).parent
    digest = sha256(__version__.encode())
    for room in ("core", *rooms):
        for path in sorted((package / room).rglob("*.py")):
            digest.update(path.relative_to(package).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _marks(paths: tuple[Path, ...], folder: Path) -> dict[str, dict[str, Any]]:
    return {
        str(path.relative_to(folder) if path.is_relative_to(folder) else path.resolve()): {
            "bytes": path.stat().st_size,
            "mtime_ns": path.stat().st_mtime_ns,
            "sha256": file_sha256(path),
        }
        for path in paths
    }


def _read_records(folder: Path) -> dict[str, Record]:
    """The record of earlier runs; none where it is missing or not ours."""
    try:
        table = json.loads((folder / STEPS_FILE).read_text(encoding="utf-8"))
        return {name: Record(**entry) for name, entry in table.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}


def _write_records(folder: Path, records: Mapping[str, Record]) -> None:
    write_json(folder / STEPS_FILE, dict(records))
