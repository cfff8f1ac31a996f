"""The pipeline: which steps are stale, run those, collect the summary.

A step is up to date when the fingerprint of everything that it depends on (its part of the design and the files
named there, the files of the steps before it, the code of the rooms that it uses) is the one under which its own
files were made, and those files are still as it left them. ``steps.json`` in the run folder keeps that record.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from metafab import __version__
from metafab.core.parallel.measure import measured
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.files import clear_parts, file_sha256, fingerprint, plain, whole_file, write_json
from metafab.core.storage.provenance import code_sha256, contents_sha256
from metafab.spec import Design, canonical_toml
from metafab.steps.job import Job, Step

STEPS_FILE = "steps.json"
_LIBRARIES = ("numpy", "scipy", "gdstk", "h5py", "shapely", "matplotlib", "pydantic", "numba", "klayout")


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
    say: Callable[[Sequence[str]], None] = lambda sentences: None,
) -> Outcome:
    """Run every step of the main job that is not up to date.

    Args:
        design: a validated design.
        folder: run folder; files of earlier runs in it are used again where they still hold.
        workers: processes; None for all cores.
        cluster: address of a Dask scheduler.
        progress: callback of long work.
        say: told what is worth knowing before the work begins.

    Returns:
        The summary; it is also written to ``folder/summary.json`` and shown by ``folder/report.html``.
    """
    from metafab.steps import PREFLIGHT, REPORT, STEPS, error_budget, recorded_coupling, recorded_tolerance

    job = Job(design, folder, workers, cluster, progress)
    state = _State(job, _read_records(folder))
    if not state.stands(PREFLIGHT):
        say(PREFLIGHT.work(job)["announcements"])
    folder.mkdir(parents=True, exist_ok=True)
    for place in (folder, folder / "figures"):
        clear_parts(place)
    with whole_file(folder / "design.toml") as part:
        part.write_text(canonical_toml(design), encoding="utf-8")

    state.remember_passed(PREFLIGHT)
    for step in STEPS:
        state.bring_up_to_date(step)
    summary = state.summary()
    if coupling := recorded_coupling(job):
        summary["coupling"] = coupling
    if tolerance := recorded_tolerance(job):
        summary["tolerance"] = tolerance
    summary["error_budget"] = plain(error_budget(summary))
    # The page shows the summary, so it is written before the page is made and again with what the page cost.
    if not state.stands(REPORT):
        write_json(folder / "summary.json", summary)
    state.bring_up_to_date(REPORT)
    summary |= state.costs()
    write_json(folder / "summary.json", summary)
    return Outcome(summary, sum(summary["drc"].get("violations", {}).values()))


@dataclass
class _State:
    """The records of a folder, and what this run has done so far."""

    job: Job
    records: dict[str, Record]
    used: dict[str, Record] = field(default_factory=dict)
    skipped: list[dict[str, str]] = field(default_factory=list)

    def bring_up_to_date(self, step: Step) -> None:
        """Do a step unless it stands or has no point; its record is on disk before the next one begins."""
        if why := step.pointless(self.job.design):
            self.forget(step)
            self.skipped.append({"step": step.name, "why": why})
            return
        if self.stands(step):
            self.skipped.append({"step": step.name, "why": "its inputs and its files are unchanged"})
        else:
            with measured() as cost:
                result = step.work(self.job)
            marks = _marks(step.outputs(self.job), self.job.folder)
            self.records[step.name] = Record(
                self.fingerprint(step), marks, plain(result), cost.seconds, cost.peak_rss_mb
            )
            write_json(self.job.folder / STEPS_FILE, self.records)
        self.used[step.name] = self.records[step.name]

    def remember_passed(self, step: Step) -> None:
        """Note that a step without files has been done, so that it need not be done again for the same inputs."""
        self.records[step.name] = Record(self.fingerprint(step), {}, {}, 0.0, 0.0)

    def forget(self, step: Step) -> None:
        """Remove what an earlier variant of the design left of a step: the page would show it."""
        record = self.records.pop(step.name, None)
        if record is not None:
            for name in record.outputs:
                (self.job.folder / name).unlink(missing_ok=True)
            write_json(self.job.folder / STEPS_FILE, self.records)

    def stands(self, step: Step) -> bool:
        """Whether an earlier run's record of the step still holds."""
        record = self.records.get(step.name)
        return record is not None and record.inputs_sha256 == self.fingerprint(step) and record.stands(self.job.folder)

    def fingerprint(self, step: Step) -> str:
        """Of all that the step depends on; the files of earlier steps count by content."""
        inputs = step.inputs(self.job.design)
        earlier = [self.used[name] for name in step.after if name in self.used]
        before = [[mark["sha256"] for mark in record.outputs.values()] for record in earlier]
        left = [file_sha256(path) for name in step.reads if (path := self.job.folder / name).is_file()]
        return fingerprint(inputs, contents_sha256(inputs), before, left, code_sha256(step.rooms))

    def costs(self) -> dict[str, Any]:
        """What each step cost when it was done, and which this run skipped."""
        return {
            "seconds": {name: record.seconds for name, record in self.used.items()},
            "peak_rss_mb": {name: record.peak_rss_mb for name, record in self.used.items()},
            "skipped": self.skipped,
        }

    def summary(self) -> dict[str, Any]:
        """Every step's part, {} for those without a point."""
        from metafab.steps import STEPS

        parts = {step.name: self.used[step.name].summary if step.name in self.used else {} for step in STEPS}
        return {"name": self.job.design.name, **parts, **self.costs(), "versions": versions()}


def versions() -> dict[str, str]:
    """Versions of metafab, Python and the libraries that results depend on."""
    found = {"metafab": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


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
