"""The page that shows the files of all other steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from metafab.steps.job import Job, Step


def _report(job: Job) -> dict[str, Any]:
    from metafab import report  # With all of matplotlib: only when a page is drawn.

    return {"file": report.write(job.folder, progress=job.progress, workers=job.workers).name}


def _report_files(job: Job) -> tuple[Path, ...]:
    return (job.folder / "report.html", *sorted((job.folder / "figures").glob("*.png")))


def report_step(after: tuple[str, ...]) -> Step:
    """The last step, which shows the files of the steps ``after`` which it comes."""
    return Step(
        "report",
        ("report",),
        after,
        lambda d: d.name,
        _report_files,
        _report,
        reads=("coupling.json", "patch.h5", "tolerance.json"),
    )
