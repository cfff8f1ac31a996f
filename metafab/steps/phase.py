"""Target phases of the design, and the study of their lobe, depth bounds and bandwidth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from metafab.core.figures import PhaseFigures, Remedy
from metafab.core.storage.files import fingerprint
from metafab.core.storage.tables import optional
from metafab.spec import Design
from metafab.steps.job import Job, Step, in_folder


@dataclass(frozen=True)
class FilterFigures:
    """Key figures of a :class:`metafab.phase.studies.bandwidth.BandwidthBudget`."""

    filter_fwhm_nm: float  #: Full width of the filter.
    dispersion_um_per_nm: float  #: Shift of an image along the split per nanometre.
    smear_um: float  #: Spread of a point along the split.
    information_kept: float  #: Information over that at one wavelength with equal electrons.
    depth_error_factor: float  #: Cramer-Rao bound of depth over that at one wavelength.
    remedies: tuple[Remedy, ...]  #: Effective changes, the most effective first.


@dataclass(frozen=True)
class StudyFigures:
    """Figures of the phase study."""

    bandwidth: FilterFigures | None = optional()  #: Cost of the colour filter; None without a filter.


def _phase(job: Job) -> PhaseFigures:
    from metafab import phase

    phase.save(job.profile, job.design, job.folder / "phase.h5")
    return job.profile.figures


def _study_inputs(design: Design) -> tuple[Any, ...]:
    illumination = design.unit_cell.illumination
    return (design.phase, design.device, design.sensor, illumination, design.depths_m, design.scene, design.optics)


def _study(job: Job) -> StudyFigures:
    from metafab.phase.studies.study import study
    from metafab.phase.studies.study_store import save_study

    results = study(job.design, job.profile)
    inputs_sha256 = fingerprint(*_study_inputs(job.design), job.design.numerics)
    save_study(results, job.folder / "phase_study.h5", inputs_sha256=inputs_sha256)
    if (budget := results.bandwidth) is None:
        return StudyFigures()
    return StudyFigures(
        FilterFigures(
            filter_fwhm_nm=budget.fwhm_nm,
            dispersion_um_per_nm=budget.dispersion_um_per_nm,
            smear_um=budget.smear_um,
            information_kept=budget.kept,
            depth_error_factor=budget.depth_error_factor,
            remedies=budget.remedies,
        )
    )


PHASE = Step(
    name="phase",
    rooms=("spec", "information", "phase"),
    after=(),
    inputs=lambda d: (d.phase, d.device, d.sensor, d.unit_cell.illumination, d.verify, d.numerics),
    outputs=in_folder("phase.h5"),
    work=_phase,
    figures=PhaseFigures,
)

STUDY = Step(
    name="study",
    rooms=("spec", "information", "phase"),
    after=("phase",),
    inputs=lambda d: (*_study_inputs(d), d.numerics),
    outputs=in_folder("phase_study.h5"),
    work=_study,
    figures=StudyFigures,
    is_beside=True,
)
