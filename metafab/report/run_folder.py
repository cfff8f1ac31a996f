"""A run folder, opened: whatever of its files is there and readable, and a note for each that is not."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from metafab.camera.frames.frame import RawFrame
from metafab.comparison import Comparison
from metafab.core.conventions import FloatArray
from metafab.core.errors import MetafabError
from metafab.decode.image import Image4D
from metafab.fullwave.coupling import Coupling
from metafab.fullwave.patch import Patch
from metafab.layout.pillars import PillarMap
from metafab.library.library import Library
from metafab.optics.point_spread import Psf
from metafab.phase.studies.study import PhaseStudy
from metafab.spec import Design

Loaded = TypeVar("Loaded")

#: Smallest first: a mask is read from the format that takes the least reading.
_MASK_FILES = ("layout.oas", "layout.gds")


@dataclass(frozen=True)
class AperturePhases:
    """Target phases of both polarisations, sampled over the aperture.

    Attributes:
        phase_rad: shape (2, n, n), NaN outside the aperture.
        half_side_um: half the side of the square that the samples span.
    """

    phase_rad: FloatArray
    half_side_um: float

    @property
    def vary(self) -> bool:
        """Whether there is anything beside lens, split and gratings."""
        return bool(np.nanmax(np.abs(np.angle(np.exp(1j * self.phase_rad)))) > 1e-6)


@dataclass(frozen=True)
class RunFolder:
    """The results of a run, as its files hold them; None for what is missing.

    Attributes:
        path: the folder.
        summary: content of ``summary.json``, {} when missing.
        design: the validated ``design.toml``, None when it or what it names has gone.
        design_table: the same file as plain TOML.
        library: the library that the summary names.
        phases: target phases sampled over the aperture.
        study: what the phases are worth.
        pillars: the pillars, read back from the written mask.
        mask_file: name of the mask that ``pillars`` comes from.
        psf: PSF pair of the written mask.
        ideal_psf: PSF pair of the target phases.
        raw: raw frame.
        decoded: 4D image.
        coupling: rows of one local period by full-wave solvers, where ``metafab coupling`` left them.
        patch: fields of a patch of the mask by Meep, where ``metafab patch`` left them.
        comparison: depth and sharpness beside other cameras, where ``metafab compare`` left them.
        notes: section -> why it has nothing to show.
    """

    path: Path
    summary: dict[str, Any] = field(default_factory=dict)
    design: Design | None = None
    design_table: dict[str, Any] = field(default_factory=dict)
    library: Library | None = None
    phases: AperturePhases | None = None
    study: PhaseStudy | None = None
    pillars: PillarMap | None = None
    mask_file: str = ""
    psf: Psf | None = None
    ideal_psf: Psf | None = None
    raw: RawFrame | None = None
    decoded: Image4D | None = None
    coupling: Coupling | None = None
    patch: Patch | None = None
    comparison: Comparison | None = None
    notes: dict[str, str] = field(default_factory=dict)

    def part(self, step: str) -> dict[str, Any]:
        """A step's part of the summary, {} when missing."""
        part = self.summary.get(step)
        return part if isinstance(part, dict) else {}

    @property
    def has_mask(self) -> bool:
        """Whether the design asks for a mask; one that is not known does."""
        return bool(self.design_table.get("mask", {}).get("formats", ["oas"]))

    @property
    def psf_source(self) -> str:
        """What the PSFs are of."""
        return "written file" if self.has_mask else "target phases"

    @property
    def name(self) -> str:
        """The design's name, or the folder's."""
        return str(self.design_table.get("name") or self.summary.get("name") or self.path.resolve().name)


def open_run(path: Path) -> RunFolder:
    """Open the files of a run folder; one that is missing or damaged leaves a note in place of a result."""
    from metafab import camera, comparison, decode, fullwave, library, mask, optics
    from metafab.phase.studies.study_store import load_study
    from metafab.spec import load_design

    notes: dict[str, str] = {}
    summary = _attempt(notes, "summary", path / "summary.json", _read_object) or {}
    design = _attempt(notes, "design", path / "design.toml", load_design)
    built = summary.get("library")
    library_file = built.get("file") if isinstance(built, dict) else None
    if library_file is None:
        notes["library"] = "summary.json does not name a library"
    patch_file = path / "patch.h5"
    masks = [path / name for name in _MASK_FILES if (path / name).is_file()] or [path / _MASK_FILES[0]]
    pillars = None
    if design is not None:
        pillars = _attempt(notes, "mask", masks[0], lambda file: mask.read(file, design).pillars)
    else:
        notes["mask"] = "reading a mask needs design.toml"
    return RunFolder(
        path=path,
        summary=summary,
        design=design,
        design_table=_attempt(notes, "design_table", path / "design.toml", _read_toml) or {},
        library=_attempt(notes, "library", path / library_file, library.load) if library_file else None,
        phases=_attempt(notes, "phases", path / "phase.h5", _read_phases),
        study=_attempt(notes, "study", path / "phase_study.h5", load_study),
        pillars=pillars,
        mask_file=masks[0].name,
        psf=_attempt(notes, "psf", path / "psf.h5", optics.load),
        ideal_psf=_attempt(notes, "ideal_psf", path / "ideal_psf.h5", optics.load),
        raw=_attempt(notes, "raw", path / "raw.h5", camera.load),
        decoded=_attempt(notes, "decoded", path / "decoded.h5", decode.load),
        # No step's: their absence is nothing to tell.
        coupling=fullwave.load_coupling(path / "coupling.json"),
        patch=_attempt(notes, "patch", patch_file, fullwave.load_patch) if patch_file.is_file() else None,
        comparison=comparison.load_comparison(path / "comparison.json"),
        notes=notes,
    )


def _attempt(notes: dict[str, str], section: str, file: Path, load: Callable[[Path], Loaded]) -> Loaded | None:
    """What ``load`` makes of a file, or None and a note."""
    if not file.is_file():
        notes[section] = f"{file.name} is not in the run folder"
        return None
    try:
        return load(file)
    except (MetafabError, OSError, ValueError, KeyError) as error:
        notes[section] = f"{file.name} could not be used: {error}"
        return None


def _read_phases(path: Path) -> AperturePhases:
    from metafab.phase import load

    x_um, phase_rad = load(path)
    return AperturePhases(phase_rad, float(0.5 * (x_um[-1] - x_um[0])))


def _read_object(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict):
        raise ValueError("expected one JSON object")
    return content


def _read_toml(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))
