"""Layouts and a library by the workers of a Dask cluster on this machine: the same bytes as alone, and the speed-up.

Each job runs alone in one process, then by one worker and by two, each of one thread. A row has the time by the clock,
and the processor time of the command, the scheduler and each worker: that of the command is what workers do not share.
``error`` is 0 for the same bytes as alone, and 1 otherwise. ``--only`` names jobs: an aperture in um (the paper's lens,
``apertures.py``), or a unit cell of ``unitcell_lib``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.mask.apertures import lens_of
from benchmarks.pipeline.commands import REPOSITORY, dask_scheduler, dask_worker, finished
from metafab.core.errors import InputError, MissingToolError
from metafab.core.storage.files import file_sha256

JOBS = ("2000", "8000", "tio2_hexagonal_660nm")
#: Numbers of workers; 0 is one process without a cluster.
WORKERS = (0, 1, 2)


def rows(quick: bool, only: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
    """A row of each job and number of workers."""
    cells = sorted(path.stem for path in (REPOSITORY / "unitcell_lib").glob("*.toml"))
    for job in only:
        if not re.fullmatch(r"[1-9]\d*", job) and job not in cells:
            expected = f"an aperture in whole um, or a unit cell: {', '.join(cells)}"
            raise InputError.single("benchmark", "--only", expected, repr(job))
    for job in only or (JOBS[:1] if quick else JOBS):
        with TemporaryDirectory() as name:
            folder = Path(name)
            if job.isdigit():
                lens = str(lens_of(float(job), folder))
                yield from _by_workers(f"layout, {int(job) / 1e3:g} mm", ("layout", lens), "layout.oas", folder)
            else:
                cell = str(REPOSITORY / "unitcell_lib" / f"{job}.toml")
                yield from _by_workers(f"library {job}", ("library", "build", cell), "library.h5", folder)


def _by_workers(title: str, job: Sequence[str], file: str, folder: Path) -> Iterator[dict[str, Any]]:
    """Rows of a command that writes ``file``."""
    alone, one_s = "", 0.0
    for count in WORKERS:
        out = folder / str(count)
        out.mkdir()
        with ExitStack() as stack:
            by, cluster = ["--workers", "1"], []
            if count:
                at = folder / f"{count}.json"
                scheduler, address = stack.enter_context(dask_scheduler(at))
                cluster = [scheduler, *(stack.enter_context(dask_worker(at)) for _ in range(count))]
                by = ["--cluster", address]
                _wait_for(count, address)
            done = finished(*job, "-o", str(out if job[0] == "layout" else out / file), *by)
        if done.code:
            raise RuntimeError(f"exit {done.code} of {title} by {count} workers: {done.stderr}")
        written = file_sha256(out / file)
        (out / file).unlink()
        alone, one_s = alone or written, done.seconds if count == 1 else one_s
        yield {
            "name": f"{title}, {count or 'no'} Dask workers",
            "series": title,
            "error": float(written != alone),
            "seconds": done.seconds,
            "peak_rss_mb": max(done.peak_rss_mb, *(process.peak_rss_mb for process in cluster), 0.0),
            "speed_up": one_s / done.seconds if count else None,
            "command_s": done.processor_seconds,
            "scheduler_s": cluster[0].processor_seconds if cluster else None,
            "worker_s": [process.processor_seconds for process in cluster[1:]],
        }


def _wait_for(workers: int, address: str) -> None:
    """Wait until the workers have come to the scheduler, so that their start is not timed."""
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingToolError("the benchmark `cluster` needs Dask: pip install 'metafab[cluster]'") from error
    with Client(address) as client:
        client.wait_for_workers(workers)
