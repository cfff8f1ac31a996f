"""Design rules of the written files."""

from __future__ import annotations

from typing import Any

from metafab.steps.job import Job, Step
from metafab.steps.layout import mask_paths
from metafab.steps.outputs import in_folder, no_mask


def _drc(job: Job) -> dict[str, Any]:
    from metafab import drc, mask

    reports = [
        drc.check(path, job.design, workers=job.workers, cluster=job.cluster, progress=job.progress)
        for path in mask_paths(job)
    ]
    drc.save(reports, job.folder, mask.top_name(job.design.name))
    first = reports[0]
    worst = {rule: max(report.violations[rule] for report in reports) for rule in first.violations}
    # Legal but unlike pillars in two formats would pass every other rule.
    worst["formats_differ"] = len({report.pillars_sha256 for report in reports}) - 1
    return {
        "pillars": first.pillars,
        "violations": worst,
        "min_gap_nm": first.min_gap_nm,
        "engine": first.engine,
        "files": [report.file for report in reports],
    }


DRC = Step(
    "drc", ("mask", "drc"), ("layout",),
    lambda d: (d.rules, d.mask, d.device), in_folder("drc.json", "drc.lyrdb"), _drc, no_mask,
)  # fmt: skip
