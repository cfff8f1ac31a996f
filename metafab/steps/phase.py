"""Target phases, and what they are worth."""

from __future__ import annotations

from typing import Any

from metafab.core.storage.files import fingerprint
from metafab.spec import Design
from metafab.steps.job import Job, Step
from metafab.steps.outputs import in_folder


def _phase(job: Job) -> dict[str, Any]:
    from metafab import phase

    phase.save(job.profile, job.design, job.folder / "phase.h5")
    return dict(job.profile.figures.applicable())


def _study_inputs(design: Design) -> tuple[Any, ...]:
    illumination = design.unit_cell.illumination
    return (design.phase, design.device, design.sensor, illumination, design.depths_m, design.scene, design.optics)


def _study(job: Job) -> dict[str, Any]:
    from metafab.phase.studies.bandwidth import bandwidth_figures
    from metafab.phase.studies.study import study
    from metafab.phase.studies.study_store import save_study

    found = study(job.design, job.profile)
    inputs = fingerprint(*_study_inputs(job.design), job.design.numerics)
    save_study(found, job.folder / "phase_study.h5", inputs_sha256=inputs)
    return {} if found.bandwidth is None else {"bandwidth": bandwidth_figures(found.bandwidth)}


PHASE = Step(
    "phase", ("spec", "information", "phase"), (),
    lambda d: (d.phase, d.device, d.sensor, d.unit_cell.illumination, d.verify, d.numerics),
    in_folder("phase.h5"), _phase,
)  # fmt: skip

STUDY = Step(
    "study", ("spec", "information", "phase"), ("phase",),
    lambda d: (*_study_inputs(d), d.numerics), in_folder("phase_study.h5"), _study,
)  # fmt: skip
