"""The pipeline: runs the steps that are not up to date, and collects their figures.

A step is up to date when the fingerprint of all that it depends on is unchanged and its files are as it left them. The
fingerprint covers its part of the design, the files named there, the files of earlier steps, and the code of the rooms
that it uses.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from metafab import __version__
from metafab.core.errors import noted
from metafab.core.numeric.ahead import compiling_ahead
from metafab.core.parallel.beside import Beside, begin_beside
from metafab.core.parallel.executor import one_blas_thread
from metafab.core.parallel.measure import Cost, measured
from metafab.core.parallel.memory import give_back_freed_memory
from metafab.core.parallel.work import Work
from metafab.core.storage.files import clear_parts, file_sha256, fingerprint, whole_file, write_json
from metafab.core.storage.lock import alone_in
from metafab.core.storage.provenance import code_sha256, contents_sha256
from metafab.spec import Design, canonical_toml
from metafab.steps import RESULT_STEPS
from metafab.steps.job import Job, Step, relative_to, with_targets
from metafab.steps.orders import recorded_coupling
from metafab.steps.preflight import PREFLIGHT
from metafab.steps.records import STEPS_FILE, FileMark, Log, Record, read_log, read_records
from metafab.steps.summary import SUMMARY_FILE, UNCHANGED, RunSummary, SkippedStep, error_budget, savings
from metafab.steps.tolerance import recorded_tolerance

#: Size of a step's files, in bytes, from which a copy of this process hashes them: a fork takes as long as 30 MB do.
_HASHED_BESIDE = 1 << 26
_LIBRARIES = ("numpy", "scipy", "gdstk", "h5py", "shapely", "matplotlib", "pydantic", "numba", "klayout")


@dataclass(frozen=True)
class ReportFigures:
    """Outcome of the report step."""

    file: str  #: Name of the page.


def _report(job: Job) -> ReportFigures:
    from metafab import report  # Imports matplotlib, so only when a page is drawn.

    return ReportFigures(report.write(job.folder, progress=job.work.progress, workers=job.work.workers).name)


REPORT = Step(
    name="report",
    rooms=("report",),
    after=tuple(step.name for step in RESULT_STEPS),
    inputs=lambda design: design.name,
    outputs=lambda job: (job.folder / "report.html", *sorted((job.folder / "figures").glob("*.png"))),
    work=_report,
    figures=ReportFigures,
    reads=("coupling.json", "exposure.json", "patch.h5", "tolerance.json"),
    shows_summary=True,
)

#: All steps of a run, in their order.
STEPS = (*RESULT_STEPS, REPORT)


def run(
    design: Design,
    folder: Path,
    *,
    steps: Sequence[Step] = STEPS,
    check: Step = PREFLIGHT,
    work: Work = Work(),
    skips: bool = True,
    say: Callable[[Sequence[str]], None] = lambda sentences: None,
) -> RunSummary:
    """Run every step that is not up to date; return the summary, as in ``folder/summary.json``.

    Files of earlier runs in the run folder are used again as long as they are up to date. ``check`` is the step that
    checks the design before the folder is made. With ``skips`` false, every step runs, and computes what it otherwise
    interpolates. ``say`` is called with announcements before the work begins. InputError if another process runs in
    this folder.
    """
    with compiling_ahead(work.workers):
        return _run(Job(with_targets(design), folder, work, skips), steps, check, say)


def _run(job: Job, steps: Sequence[Step], check: Step, say: Callable[[Sequence[str]], None]) -> RunSummary:
    design, folder = job.design, job.folder
    names = tuple(step.name for step in (check, *steps))
    state = _State(job, names, read_records(folder, (check, *steps)), read_log(folder))
    if not state.is_current(check):
        figures, _ = _cost_of(check, job)
        say(figures.announcements)
        state.records[check.name] = Record.of(state.fingerprint(check), {}, figures)
    folder.mkdir(parents=True, exist_ok=True)
    with alone_in(folder):
        for place in (folder, folder / "figures"):
            clear_parts(place)
        with whole_file(folder / "design.toml") as part:
            part.write_text(canonical_toml(design, folder), encoding="utf-8")

        try:
            for step in steps:
                state.collect(step.after)
                # The page shows the summary, which is written before the page and again with the cost of the page.
                if step.shows_summary and not state.is_current(step):
                    state.summary().save(folder / SUMMARY_FILE)
                state.bring_up_to_date(step)
            state.collect(names)
        finally:
            state.end_copies()
        state.save_records()
        summary = state.summary()
        summary.save(folder / SUMMARY_FILE)
        return summary


@dataclass
class _State:
    """Records and times of earlier runs, and the progress of this one."""

    job: Job
    names: tuple[str, ...]  #: All steps, in their order.
    records: dict[str, Record]
    log: Log
    used: dict[str, Record] = field(default_factory=dict)
    skipped: list[SkippedStep] = field(default_factory=list)
    #: Steps that copies of this process run, in their order.
    copies: dict[str, tuple[Step, Beside[tuple[Any, Cost]]]] = field(default_factory=dict)
    #: Steps whose large files copies of this process hash: fingerprint, states of the files, and figures.
    hashed: dict[str, tuple[str, Beside[dict[str, FileMark]], Any]] = field(default_factory=dict)

    def bring_up_to_date(self, step: Step) -> None:
        """Run a step unless it is up to date or not needed, or begin one that may run beside others.

        The steps that it comes after are collected. Its record is saved before the next step begins, when it is
        collected, or, with large files, when their hashes are there.
        """
        if why := step.not_needed(self.job.design):
            self.forget(step)
            self.skipped.append(SkippedStep(step.name, why))
            return
        if self.job.skips and self.is_current(step):
            self.skipped.append(SkippedStep(step.name, UNCHANGED, self.log.seconds.get(step.name)))
            self.use(step.name, self.records[step.name])
        elif step.is_beside and (copy := begin_beside(partial(_cost_of, step, self.job.silenced()), self.workers)):
            self.copies[step.name] = step, copy
        else:
            self.keep(step, partial(_cost_of, step, self.job))

    @property
    def workers(self) -> int | None:
        """Processes of this machine for the run; None for all cores."""
        return 1 if self.job.work.cluster is not None else self.job.work.workers

    def keep(self, step: Step, work: Callable[[], tuple[Any, Cost]]) -> None:
        """Save the record of a step with the outcome of its work, figures and cost."""
        with noted(f"step `{step.name}`"):
            figures, cost = work()
        paths = {relative_to(self.job.folder, path): path for path in step.outputs(self.job)}
        self.log.seconds[step.name], self.log.peak_rss_mb[step.name] = cost.seconds, cost.peak_rss_mb
        self.log.modified_ns.update({name: path.stat().st_mtime_ns for name, path in paths.items()})
        inputs_sha256, marks = self.fingerprint(step), partial(_marks, paths)
        is_large = sum(path.stat().st_size for path in paths.values()) >= _HASHED_BESIDE
        if is_large and (copy := begin_beside(marks, self.workers)):
            self.hashed[step.name] = inputs_sha256, copy, figures
        else:
            self.use(step.name, Record.of(inputs_sha256, marks(), figures))
            self.save_records()

    def use(self, name: str, record: Record) -> None:
        """Note the record of a step whose files this run uses; records stay in the order of the steps."""
        self.records[name] = record
        kept = self.used | {name: record}
        self.used = {each: kept[each] for each in self.names if each in kept}
        self.records = {each: self.records[each] for each in self.names if each in self.records}

    def collect_hashes(self) -> None:
        """Wait for the hashes of large files, and save the records of their steps."""
        while self.hashed:
            name, (inputs_sha256, copy, figures) = self.hashed.popitem()
            self.use(name, Record.of(inputs_sha256, copy.result(), figures))
            self.save_records()

    def collect(self, names: Collection[str]) -> None:
        """Wait for those of the named steps that copies of this process run."""
        for name in [each for each in self.copies if each in names]:
            step, copy = self.copies[name]
            self.keep(step, copy.result)
            del self.copies[name]

    def end_copies(self) -> None:
        """End the copies that still run steps, and remove what they and killed ones had half written."""
        for _, copy in self.copies.values():
            copy.kill()
        self.collect_hashes()
        clear_parts(self.job.folder)

    def forget(self, step: Step) -> None:
        """Remove the files and the record of a step that the design no longer needs."""
        record = self.records.pop(step.name, None)
        if record is not None:
            for name in record.outputs:
                self.log.modified_ns.pop(name, None)
                path = self.job.folder / name
                # A file elsewhere, such as a library, may serve other runs.
                if path.is_file() and path.resolve().is_relative_to(self.job.folder.resolve()):
                    path.unlink()
            self.save_records()

    def save_records(self) -> None:
        """Write ``steps.json``."""
        write_json(self.job.folder / STEPS_FILE, self.records)

    def is_current(self, step: Step) -> bool:
        """Whether the record of a step is up to date; if so, the times of its files are those of now."""
        record = self.records.get(step.name)
        if record is None or record.summary is None or record.inputs_sha256 != self.fingerprint(step):
            return False
        found = {name: path.stat().st_mtime_ns for name in record.outputs if (path := self.job.folder / name).is_file()}
        if not record.files_unchanged(self.job.folder, self.log.modified_ns):
            return False
        self.log.modified_ns.update(found)
        return True

    def fingerprint(self, step: Step) -> str:
        """Hash of all that a step depends on; the files of earlier steps count by content."""
        self.collect_hashes()
        inputs = step.inputs(self.job.design)
        earlier = [self.used[name] for name in step.after if name in self.used]
        before = [[mark.sha256 for mark in record.outputs.values()] for record in earlier]
        left = [file_sha256(path) for name in step.reads if (path := self.job.folder / name).is_file()]
        whole = () if self.job.skips else ("nothing left out",)
        return fingerprint(inputs, contents_sha256(inputs), before, left, code_sha256(step.rooms), *whole)

    def summary(self) -> RunSummary:
        """Summary of the steps so far."""
        self.collect_hashes()
        names, log = {item.name for item in fields(RunSummary)}, self.log
        written = {name for record in self.used.values() for name in record.outputs}
        summary = RunSummary(
            name=self.job.design.name,
            **{name: record.summary for name, record in self.used.items() if name in names},
            seconds={name: log.seconds[name] for name in self.used if name in log.seconds},
            peak_rss_mb={name: log.peak_rss_mb[name] for name in self.used if name in log.peak_rss_mb},
            skipped=tuple(self.skipped),
            versions=versions(),
            coupling=recorded_coupling(self.job),
            modified_ns={name: time_ns for name, time_ns in sorted(log.modified_ns.items()) if name in written},
        )
        tolerance = recorded_tolerance(self.job) or summary.tolerance
        saved = savings(self.job.design, summary)
        return replace(summary, tolerance=tolerance, error_budget=error_budget(summary), saved=saved)


def _marks(paths: Mapping[str, Path]) -> dict[str, FileMark]:
    """States of files, by name."""
    return {name: FileMark.of(path) for name, path in paths.items()}


def _cost_of(step: Step, job: Job) -> tuple[Any, Cost]:
    """Run a step; return its figures and its cost. The memory that it leaves behind is not held during the next one."""
    # The matrices are small: further threads of BLAS would wait in busy loops on the cores of the workers.
    with measured() as cost, one_blas_thread():
        figures = step.work(job)
    give_back_freed_memory()
    return figures, cost


def skipping_all(summary: RunSummary) -> RunSummary:
    """Summary of the next run if nothing changes."""
    unneeded = {entry.step: entry for entry in summary.skipped if entry.why != UNCHANGED}
    unchanged = (SkippedStep(step.name, UNCHANGED, summary.seconds.get(step.name)) for step in STEPS)
    return replace(summary, skipped=tuple(unneeded.get(entry.step, entry) for entry in unchanged))


def versions() -> dict[str, str]:
    """Versions of metafab, Python and the libraries that affect results."""
    installed = {"metafab": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            installed[name] = version(name)
        except PackageNotFoundError:
            continue
    return installed
