"""Results in a run folder: every file that is present and readable, and a note for each other one."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from metafab.camera.frames.frame import RawFrame
from metafab.comparison import Comparison
from metafab.core.conventions import FloatArray
from metafab.core.errors import MetafabError
from metafab.core.storage.files import file_sha256
from metafab.core.storage.tables import DAMAGED
from metafab.decode.image import Image4D
from metafab.layout.pillars import PillarMap
from metafab.library.library import Library
from metafab.optics.point_spread import Psf
from metafab.phase.studies.study import PhaseStudy
from metafab.spec import Design
from metafab.spec.light import light_label
from metafab.spec.terms import forms_images, has_lobe
from metafab.steps import RunSummary

if TYPE_CHECKING:
    from metafab.exposure.results import ExposureRecord
    from metafab.fullwave import Coupling, Patch

Loaded = TypeVar("Loaded")

#: Mask files, the smaller format first.
_MASK_FILES = ("layout.oas", "layout.gds")
#: Terms that focus or deflect.
_CARRIERS = ("lens", "split_lens", "grating", "axicon")


@dataclass(frozen=True)
class DesignOutline:
    """Main features of ``design.toml``, readable also where files that it names are missing."""

    name: str = ""  #: Name of the design.
    aperture_um: float | None = None  #: Size of the aperture.
    aperture_shape: str = "aperture"  #: Shape of the aperture.
    focal_length_mm: float | None = None  #: Focal length.
    wavelength_nm: float | None = None  #: Vacuum wavelength.
    lights: tuple[str, ...] = ()  #: Wavelength and direction of each light of a design with several.
    terms: tuple[str, ...] = ()  #: Names of the phase terms.
    has_mask: bool = True  #: Whether the design writes a mask; assumed if unknown.
    has_scene: bool = True  #: Whether the design has a scene; assumed if unknown.

    @classmethod
    def load(cls, path: Path) -> DesignOutline:
        """Read the outline of a ``design.toml``."""
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        device, cell = table.get("device", {}), table.get("unit_cell", {})
        return cls(
            name=str(table.get("name", "")),
            aperture_um=device.get("aperture_um"),
            aperture_shape=device.get("aperture_shape", "aperture"),
            focal_length_mm=device.get("focal_length_mm"),
            wavelength_nm=cell.get("illumination", {}).get("wavelength_nm"),
            lights=tuple(
                light_label(light["wavelength_nm"], light.get("angle_x_deg", 0.0), light.get("angle_y_deg", 0.0))
                for light in table.get("light", [])
            ),
            terms=tuple(str(term.get("term", "")) for term in table.get("phase", [])),
            has_mask=bool(table.get("mask", {}).get("formats", ["oas"])),
            has_scene="scene" in table,
        )

    @property
    def has_lobe(self) -> bool:
        """Whether a lobe beside the image point carries the light; assumed if the phase terms are unknown."""
        return not self.terms or has_lobe(self.terms)

    @property
    def own_light(self) -> str:
        """Light of the unit cell in words, for figures of that light alone; empty for a design with one light."""
        several = bool(self.lights) and self.wavelength_nm is not None
        return f"{self.wavelength_nm:.12g} nm along the axis" if several else ""

    def is_parallel(self, depth_m: float) -> bool:
        """Whether a point at this depth lights the aperture like one at infinity, to a hundredth of a wave."""
        if self.aperture_um is None or self.wavelength_nm is None:
            return depth_m == math.inf
        rim_um = self.aperture_um**2 / (8e6 * depth_m)
        return rim_um < 1e-5 * self.wavelength_nm

    @property
    def carriers(self) -> str:
        """Names of the terms that focus or deflect, which the drawn phases leave out."""
        names = [term.replace("_", " ") for term in self.terms if term in _CARRIERS]
        return " and ".join(dict.fromkeys(names))

    @property
    def focuses(self) -> bool:
        """Whether the focal length is that of a lens, not the distance of the sensor alone; assumed if unknown."""
        return not self.terms or not {"lens", "split_lens", "radial"}.isdisjoint(self.terms)

    @property
    def forms_images(self) -> bool:
        """Whether the device is made to image points: not a hologram, not a deflector; assumed if unknown."""
        return not self.terms or forms_images(self.terms)


@dataclass(frozen=True)
class AperturePhases:
    """Target phases of both polarisations, sampled over the aperture."""

    phase_rad: FloatArray  #: Shape (2, n, n), NaN outside the aperture.
    half_side_um: float  #: Half the side of the sampled square.

    @property
    def vary(self) -> bool:
        """Whether the phases differ from whole turns: without lens, split and gratings, many designs are flat."""
        return bool(np.nanmax(np.abs(np.angle(np.exp(1j * self.phase_rad)))) > 1e-6)


@dataclass(frozen=True)
class RunFolder:
    """Results of a run; None for a file that is missing or unreadable."""

    path: Path  #: The folder.
    summary: RunSummary = field(default_factory=RunSummary)  #: ``summary.json``; empty when missing.
    design: Design | None = None  #: The validated ``design.toml``.
    outline: DesignOutline = field(default_factory=DesignOutline)  #: Main features of ``design.toml``.
    library: Library | None = None  #: The library that the summary names.
    phases: AperturePhases | None = None  #: Target phases over the aperture.
    study: PhaseStudy | None = None  #: Study of the phases.
    pillars: PillarMap | None = None  #: Pillars of the written mask.
    mask_file: str = ""  #: Name of the mask file that ``pillars`` were read from.
    psf: Psf | None = None  #: PSF pair of the written mask, or of the target phases for a design without a mask.
    ideal_psf: Psf | None = None  #: PSF pair of the target phases.
    raw: RawFrame | None = None  #: Raw frame.
    decoded: Image4D | None = None  #: 4D image.
    exposure: ExposureRecord | None = None  #: Result of ``metafab expose`` on the written mask.
    coupling: Coupling | None = None  #: Rows by ``metafab coupling``, or of a steep lens by the run.
    patch: Patch | None = None  #: Result of ``metafab patch``.
    comparison: Comparison | None = None  #: Result of ``metafab compare``.
    notes: dict[str, str] = field(default_factory=dict)  #: Reason for each missing result, by its name.

    @property
    def has_lobe(self) -> bool:
        """Whether the maximum of a PSF is a lobe beside the image point, seen as a whole."""
        return self.outline.has_lobe and (self.summary.psf is None or self.summary.psf.is_whole)

    @property
    def forms_images(self) -> bool:
        """Whether the device is made to image points; a mask of the user's own phase that repeats is not."""
        return self.outline.forms_images and (self.summary.orders is None or self.summary.orders.sites is None)

    @property
    def psf_source(self) -> str:
        """Source of the PSFs: the written mask or the target phases."""
        return "written file" if self.outline.has_mask else "target phases"

    @property
    def name(self) -> str:
        """Name of the design, or of the folder."""
        return self.outline.name or self.summary.name or self.path.resolve().name


def open_run(path: Path) -> RunFolder:
    """Open the files of a run folder; a missing or damaged file leaves a note."""
    from metafab import camera, comparison, decode, library, mask, optics
    from metafab.phase.studies.study_store import load_study
    from metafab.spec import load_design

    notes: dict[str, str] = {}
    summary = _attempt(notes, "summary", path / "summary.json", RunSummary.load) or RunSummary()
    design = _attempt(notes, "design", path / "design.toml", load_design)
    library_file = None if summary.library is None else path / summary.library.file
    if library_file is None:
        notes["library"] = "summary.json does not name a library"
    masks = [path / name for name in _MASK_FILES if (path / name).is_file()] or [path / _MASK_FILES[0]]
    pillars = None
    if design is not None:
        pillars = _attempt(notes, "mask", masks[0], lambda file: mask.read_shared(file, design).pillars)
    else:
        notes["mask"] = "reading a mask needs design.toml"
    return RunFolder(
        path=path,
        summary=summary,
        design=design,
        outline=_attempt(notes, "outline", path / "design.toml", DesignOutline.load) or DesignOutline(),
        library=None if library_file is None else _attempt(notes, "library", library_file, library.load),
        phases=_attempt(notes, "phases", path / "phase.h5", _read_phases),
        study=_attempt(notes, "study", path / "phase_study.h5", load_study),
        pillars=pillars,
        mask_file=masks[0].name,
        psf=_attempt(notes, "psf", path / "psf.h5", optics.load),
        ideal_psf=_attempt(notes, "ideal_psf", path / "ideal_psf.h5", optics.load),
        raw=_attempt(notes, "raw", path / "raw.h5", camera.load),
        decoded=_attempt(notes, "decoded", path / "decoded.h5", decode.load),
        # Files of other commands: no note where they are missing.
        exposure=_exposure(notes, path / "exposure.json", masks),
        coupling=_coupling(path, masks),
        patch=_patch(notes, path / "patch.h5"),
        comparison=comparison.load_comparison(path / "comparison.json"),
        notes=notes,
    )


def _attempt(notes: dict[str, str], name: str, file: Path, load: Callable[[Path], Loaded]) -> Loaded | None:
    """Load a file; return None and leave a note if that is not possible."""
    if not file.is_file():
        notes[name] = f"{file.name} is not in the run folder"
        return None
    try:
        return load(file)
    except (MetafabError, OSError, *DAMAGED) as error:
        notes[name] = f"{file.name} could not be used: {error}"
        return None


# Most runs have none of the following files, and do without the import of their rooms.


def _coupling(folder: Path, masks: list[Path]) -> Coupling | None:
    """Rows of a mask of the run; None without any."""
    if not any((folder / name).is_file() for name in ("coupling.json", "orders.json")):
        return None
    from metafab.fullwave.coupling import find_coupling

    return find_coupling(folder, masks)


def _patch(notes: dict[str, str], file: Path) -> Patch | None:
    """Load ``patch.h5``; None without it."""
    if not file.is_file():
        return None
    from metafab.fullwave import load_patch

    return _attempt(notes, "patch", file, load_patch)


def _exposure(notes: dict[str, str], file: Path, masks: list[Path]) -> ExposureRecord | None:
    """Load ``exposure.json``; None if it is missing, and with a note if it is damaged or of another mask."""
    if not file.is_file():
        return None
    from metafab.exposure.results import load_record

    record = load_record(file)
    if record is not None and record.mask_sha256 in {file_sha256(mask) for mask in masks if mask.is_file()}:
        return record
    reason = "could not be read" if record is None else "is of another mask"
    notes["exposure"] = f"{file.name} {reason}: make it with `metafab expose`"
    return None


def _read_phases(path: Path) -> AperturePhases:
    from metafab.phase import load

    x_um, phase_rad = load(path)
    return AperturePhases(phase_rad, float(0.5 * (x_um[-1] - x_um[0])))
