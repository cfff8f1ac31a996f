"""Mask files of the design: written from phases and library, then read back and checked against the design rules."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from metafab.core.errors import InputError
from metafab.core.figures import LightMapping, MappingFigures, WriteTime
from metafab.core.storage.tables import optional, typed
from metafab.spec.light import light_label
from metafab.steps.job import Job, Step, in_folder, no_mask
from metafab.steps.library import libraries, neighbour_warning, open_library

if TYPE_CHECKING:
    from metafab.layout.mapping import LightTarget

#: What asks for the choice of sizes by a model of neighbours that does not pay.
_CHOSEN_BY = "`rules.neighbours`, which chooses the sizes by it"


@dataclass(frozen=True)
class FileFigures:
    """Name and size of a written file."""

    name: str  #: File name.
    bytes: int  #: Size.


@dataclass(frozen=True)
class LayoutFigures(MappingFigures):
    """Figures of the mapping and of the written mask files."""

    offsets_rad: tuple[float, ...]  #: Constants added to the target phases of x and y polarisation.
    files: tuple[FileFigures, ...]  #: The mask files.
    #: Figures of the mapping if every pillar kept the gap rule within its own cell; None unless the design asks for
    #: ``gap_rule = "pairs"``.
    gap_rule_each: MappingFigures | None = optional()
    #: The mapping at each wavelength; None for a design with one light.
    lights: tuple[LightMapping, ...] | None = optional()
    write_time: WriteTime | None = optional()  #: Time on the e-beam writer; None without ``mask.exposure``.
    #: Sentence about a model of neighbours that chose the sizes and is not known to lower the error; None for others.
    neighbour_warning: str | None = optional()

    def warnings(self) -> list[str]:
        """Return the sentences of :class:`MappingFigures`, for each wavelength, and that about the neighbours."""
        if self.lights is None:
            return [*super().warnings(), *([] if self.neighbour_warning is None else [self.neighbour_warning])]
        return [
            f"at {light_label(light.wavelength_nm, light.angle_x_deg, light.angle_y_deg)}, {text}"
            for light in self.lights
            for text in light.figures.warnings()
        ]


@dataclass(frozen=True)
class DrcFigures:
    """Outcome of the design-rule check of all written files."""

    pillars: int  #: Pillars that were found.
    #: Number of violations of each rule in the worst file; ``formats_differ`` counts the files whose pillars differ
    #: from those of the first.
    violations: dict[str, int]
    #: Smallest gap between drawn neighbours, with ``mask.bias_nm``; None where the engine does not measure it.
    min_gap_nm: float | None
    engine: str  #: Engine that checked.
    files: tuple[str, ...]  #: Names of the checked files.


def mask_paths(job: Job) -> tuple[Path, ...]:
    """Paths of the mask files that the design asks for."""
    return tuple(job.folder / f"layout.{suffix}" for suffix in job.design.mask.formats)


def _layout_files(job: Job) -> tuple[Path, ...]:
    """Paths of the mask files and of all files next to them."""
    from metafab import mask

    names = "layout.lyp", "layout.json", *mask.table_names(job.design)
    return *mask_paths(job), *in_folder(*names)(job)


def write_layout(job: Job) -> LayoutFigures:
    """Map the target phases to pillars and write the mask files.

    InputError if the design asks for no file, or a biased lens of ``mask.copies`` violates the design rules.
    """
    from metafab import layout, mask
    from metafab.layout.assign import KEPT_SITES

    if not job.design.has_mask:
        remedy = 'set it to ["oas"]; `metafab run` does without a mask'
        raise InputError.single(job.design.name, "mask.formats", "'gds', 'oas' or both", "none", remedy)
    progress = job.work.progress
    lights = light_targets(job)
    library = open_library(job)
    with job.work.threads() as executor:
        assignment = layout.assign(
            job.profile,
            library,
            job.design,
            lights=lights,
            executor=executor,
            progress=progress,
            # Workers of a cluster map each tile again rather than have it sent twice.
            kept_sites=KEPT_SITES if job.work.cluster is None else 0,
        )
        written = mask.write(
            assignment.pillars,
            job.folder,
            job.design,
            executor=executor,
            progress=progress,
            mapping=assignment,
        )
    _require_rules_of_copies(job)
    time = None
    if job.design.mask.exposure is not None:
        time = typed(WriteTime, json.loads((job.folder / "layout.json").read_text(encoding="utf-8"))["exposure"])
    return LayoutFigures(
        **vars(assignment.figures),
        offsets_rad=assignment.offsets_rad,
        files=tuple(FileFigures(file.path.name, file.bytes) for file in written),
        gap_rule_each=assignment.gap_rule_each,
        lights=assignment.lights or None,
        write_time=time,
        neighbour_warning=neighbour_warning(library, _CHOSEN_BY) if job.design.rules.neighbours else None,
    )


def light_targets(job: Job) -> list[LightTarget]:
    """Target phases and library of each light of the design; none for a design with one light."""
    from metafab.layout.mapping import LightTarget

    return [
        LightTarget(job.at_light(light).profile, library, light.weight)
        for light, library in zip(job.design.light, libraries(job), strict=True)
    ]


def _require_rules_of_copies(job: Job) -> None:
    """Check the design rules of each bias of ``mask.copies``, for which the mapping leaves no room."""
    from metafab import drc

    path, checked = mask_paths(job)[-1], {0.0}
    for number, copy in enumerate(job.design.mask.copies, start=1):
        if copy.bias_nm in checked:
            continue
        checked.add(copy.bias_nm)
        report = drc.check(path, job.design, work=job.work, copy=number)
        broken = ", ".join(f"{rule}: {count}" for rule, count in report.violations.items() if count)
        if broken:
            gap = "" if report.min_gap_nm is None else f"; smallest gap {report.min_gap_nm:g} nm"
            remedy = (
                f"lower the bias or widen `rules.min_gap_nm`; `metafab drc {path.name} --copy {number}` lists places"
            )
            expected = "a bias that keeps the design rules"
            key = f"mask.copies[{number - 1}].bias_nm"
            raise InputError.single(job.design.name, key, expected, f"{copy.bias_nm:g} nm ({broken}{gap})", remedy)


def _check_rules(job: Job) -> DrcFigures:
    from metafab import drc, mask

    work = job.work
    reports = [drc.check(path, job.design, work=work, reader=mask.read_shared) for path in mask_paths(job)]
    drc.save(reports, job.folder, mask.top_name(job.design.name))
    first = reports[0]
    worst = {rule: max(report.violations[rule] for report in reports) for rule in first.violations}
    # Both files may keep all rules and still hold different pillars.
    worst["formats_differ"] = len({report.pillars_sha256 for report in reports}) - 1
    names = tuple(report.file for report in reports)
    return DrcFigures(first.pillars, worst, first.min_gap_nm, first.engine, names)


LAYOUT = Step(
    name="layout",
    rooms=("layout", "mask", "drc"),
    after=("library", "phase"),
    inputs=lambda d: (d.name, d.rules, d.mask, d.device, d.numerics, d.light),
    outputs=_layout_files,
    work=write_layout,
    figures=LayoutFigures,
    not_needed=no_mask,
)

DRC = Step(
    name="drc",
    rooms=("mask", "drc"),
    after=("layout",),
    inputs=lambda d: (d.rules, d.mask, d.device),
    outputs=in_folder("drc.json", "drc.lyrdb"),
    work=_check_rules,
    figures=DrcFigures,
    not_needed=no_mask,
)
