"""The two types of the pipeline: the job of a run, and one step of it."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metafab.core.errors import InputError, SpecError
from metafab.core.parallel.progress import silent
from metafab.core.parallel.work import Work
from metafab.spec import Design, Light

if TYPE_CHECKING:
    from metafab.phase import PhaseProfile


@dataclass(frozen=True)
class Job:
    """Design and folder of a run, with the resources for its work."""

    design: Design  #: The validated design.
    folder: Path  #: Run folder, created when needed.
    work: Work = Work()  #: Workers, cluster and progress.
    #: Whether steps leave out work that the target errors allow to leave out (:mod:`metafab.steps.summary`).
    skips: bool = True
    #: Design for the unit cell's own light, where ``design`` is that design at another (:meth:`at_light`).
    nominal: Design | None = None
    light: Light | None = None  #: Light of ``design``, where ``nominal`` has several.

    @cached_property
    def profile(self) -> PhaseProfile:
        """Target phases of the design, optimised once for all steps that need them."""
        from metafab.phase import profile_of

        return profile_of(self.design, progress=self.work.progress)

    def silenced(self) -> Job:
        """Return this job without its progress, for a copy of the process; the target phases are shared."""
        job = replace(self, work=replace(self.work, progress=silent))
        vars(job).update(vars(self) | vars(job))
        return job

    def at_light(self, light: Light) -> Job:
        """Return the job of one light alone.

        Raises:
            InputError: the unit cell's lengths do not suit the wavelength.
        """
        try:
            design = self.design.at_light(light)
        except SpecError as error:
            raise InputError(f"{self.design.name} at {light.label}", error.faults) from error
        own = light.wavelength_nm == self.design.unit_cell.illumination.wavelength_nm and not light.angles_deg
        return replace(self, design=design, nominal=None if own else self.design, light=None if own else light)


def light_tangent(design: Design, light: Light) -> tuple[float, float]:
    """Direction (x/z, y/z), in air, of the distant object that a light comes from.

    InputError if no light of the air has that angle in the medium of incidence.
    """
    from metafab.cell import pillar_cell

    n = complex(pillar_cell(design.unit_cell, 0.0, 0.0, wavelength_nm=light.wavelength_nm).n_of_angle).real
    tangents = []
    for axis, angle_deg in (("angle_x_deg", light.angle_x_deg), ("angle_y_deg", light.angle_y_deg)):
        sine = n * math.sin(math.radians(angle_deg))
        if abs(sine) >= 1.0:
            largest = f"below {math.degrees(math.asin(1.0 / n)):.4g} deg in a medium of index {n:.4g}"
            raise InputError.single(
                design.name, f"light.{axis}", largest, f"{angle_deg:g}", "no light of the air has it"
            )
        # The object stands on the other side of the axis than the light travels to.
        tangents.append(-sine / math.sqrt(1.0 - sine**2) + 0.0)
    return tangents[0], tangents[1]


def with_targets(design: Design) -> Design:
    """Return the design with the numerics that its ``verify.target_depth_error`` needs; InputError if none suffice."""
    if design.verify.target_depth_error is None:
        return design
    from metafab.optics.depth_target import with_depth_target

    return with_depth_target(design)


def relative_to(folder: Path, path: Path) -> str:
    """``path`` from ``folder``, ".." included, so that a project gives the same text wherever it stands."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


@dataclass(frozen=True)
class Step:
    """One step of the pipeline."""

    name: str  #: Name of the step, and of its figures in :class:`metafab.steps.summary.RunSummary`.
    rooms: tuple[str, ...]  #: Packages whose code determines the result.
    after: tuple[str, ...]  #: Names of the earlier steps whose files it uses.
    inputs: Callable[[Design], Any]  #: Returns the parts of the design that it depends on.
    outputs: Callable[[Job], tuple[Path, ...]]  #: Returns the files that it writes.
    work: Callable[[Job], Any]  #: Runs the step and returns its figures.
    figures: type  #: Dataclass of these figures.
    #: Returns why a design does not need the step, or None if it does.
    not_needed: Callable[[Design], str | None] = lambda design: None
    reads: tuple[str, ...] = ()  #: Files of the run folder that other commands may have written and that the step uses.
    #: Whether other steps may go on in this process while a copy of it runs this one: one that takes a single core, and
    #: leaves nothing but files and figures.
    is_beside: bool = False
    shows_summary: bool = False  #: Whether the step reads ``summary.json``, which is then written before it.


def in_folder(*names: str) -> Callable[[Job], tuple[Path, ...]]:
    """Return a function that gives the paths of these files in the run folder of a job."""
    return lambda job: tuple(job.folder / name for name in names)


def no_images(design: Design) -> str | None:
    """Return why a design gives no images to decode; None if it does."""
    if design.scene is None:
        return "the design has no scene to photograph"
    if design.split_angle_deg == 0.0:
        return "the design does not split polarisations, so there is no pair of images to decode"
    return None


def no_mask(design: Design) -> str | None:
    """Return why a design has no pillars; None if it has."""
    return None if design.has_mask else "the design writes no mask (`mask.formats` is empty): target phases alone"
