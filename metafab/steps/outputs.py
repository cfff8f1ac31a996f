"""What several steps say of their files and of their point."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from metafab.spec import Design
from metafab.steps.job import Job


def in_folder(*names: str) -> Callable[[Job], tuple[Path, ...]]:
    """The files of these names in the run folder."""
    return lambda job: tuple(job.folder / name for name in names)


def nothing_to_decode(design: Design) -> str | None:
    """A decoder needs two images of a scene side by side."""
    if design.scene is None:
        return "the design has no scene to photograph"
    if design.split_angle_deg == 0.0:
        return "the design does not split polarisations, so there is no pair of images to decode"
    return None


def no_mask(design: Design) -> str | None:
    """What is asked of pillars has no answer where there are only target phases."""
    return None if design.has_mask else "the design writes no mask (`mask.formats` is empty): target phases alone"
