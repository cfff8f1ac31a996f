"""The pipeline's two types: the job of a run, and one step of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metafab.core.parallel.progress import Progress, silent
from metafab.spec import Design

if TYPE_CHECKING:
    from metafab.phase import PhaseProfile


@dataclass(frozen=True)
class Job:
    """What a run works on: the design, its folder, and how the work is spread.

    Attributes:
        design: the validated design.
        folder: run folder, created when needed.
        workers: processes; None for all cores.
        cluster: address of a Dask scheduler, or None.
        progress: callback of long work.
    """

    design: Design
    folder: Path
    workers: int | None = None
    cluster: str | None = None
    progress: Progress = silent

    @cached_property
    def profile(self) -> PhaseProfile:
        """The design's target phases, optimised once for all steps that need them."""
        from metafab.phase import profile_of

        return profile_of(self.design, progress=self.progress)


@dataclass(frozen=True)
class Step:
    """One step of the pipeline.

    Attributes:
        name: key in the summary.
        rooms: packages whose code decides the result.
        after: steps whose results it uses.
        inputs: the parts of the design that it depends on.
        outputs: the files that it writes, or has written.
        work: does it, and returns the step's part of the summary.
        pointless: why a design has no use for the step; None if it has.
        reads: files that other commands may have left in the run folder, and that it uses.
    """

    name: str
    rooms: tuple[str, ...]
    after: tuple[str, ...]
    inputs: Callable[[Design], Any]
    outputs: Callable[[Job], tuple[Path, ...]]
    work: Callable[[Job], dict[str, Any]]
    pointless: Callable[[Design], str | None] = lambda design: None
    reads: tuple[str, ...] = ()
