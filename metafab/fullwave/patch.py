"""A square patch of the written mask by Meep, compared with the field stitched from the library.

The patch is simulated with a frame of its real neighbours, so that the effect of the periodic images decays before it
reaches the patch. Three fields are compared: of Meep, of the library, and of each pillar alone on Meep's grid. The last
one separates coupling from the error of the grid. A library that holds a model of neighbours adds a fourth, which is
compared with the coupling by Meep added to the library's field. Each field consists of all propagating orders of the
period (no evanescent ones), traced back to the plane where the pillars end and sampled at the sites.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metafab.cell.meep import Pool, SupercellSettings, estimate, solve_supercell
from metafab.cell.meep.supercell import Cost
from metafab.cell.supercell import Supercell
from metafab.core.conventions import POLARISATIONS, ComplexArray, FloatArray, Polarisation
from metafab.core.errors import InputError
from metafab.core.parallel.progress import Progress, silent
from metafab.core.storage.hdf5 import create, open_kind, put
from metafab.fullwave.written import library_responses, supercell_at
from metafab.layout import PillarMap
from metafab.library import Library
from metafab.library.neighbours import solve_supercell as solve_by_model

KIND = "metafab patch"
FORMAT = 1
#: Sites of neighbours on each side of the patch.
PADDING_SITES = 3
#: Decay at which a simulation ends, relative to the extrapolated orders; the error of the grid is far larger.
PATCH_DECAY = 1e-2
#: Settings with which a patch of 3 um takes minutes on one core.
QUICK = SupercellSettings(pixels_per_period=12, decay=PATCH_DECAY)


@dataclass(frozen=True)
class PatchPlan:
    """A patch to simulate, and its expected cost."""

    supercell: Supercell  #: The patch and its frame.
    x_um: FloatArray  #: Shape (n_x,), x of the sites of the supercell.
    y_um: FloatArray  #: Shape (n_y,), y of the sites of the supercell.
    padding_sites: int  #: Width of the frame.
    settings: SupercellSettings  #: Grid and decay.
    cost: Cost  #: Expected cost on one core, for one polarisation.


@dataclass(frozen=True)
class FieldDifference:
    """Difference of two fields."""

    amplitude_rms: float  #: Rms difference of the amplitudes, over the rms of the reference.
    phase_rms_rad: float  #: Rms phase difference about its mean, weighted by both amplitudes.
    phase_offset_rad: float  #: Mean phase difference.
    relative_l2: float  #: Rms of the complex difference, over the rms of the reference.


@dataclass(frozen=True)
class Patch:
    """Fields at the sites of a patch, in the plane where the pillars end, over the incident field."""

    x_um: FloatArray  #: Shape (n_x,), x of the sites.
    y_um: FloatArray  #: Shape (n_y,), y of the sites.
    polarisation: Polarisation  #: Polarisation of the incident light and of the fields.
    full_wave: ComplexArray  #: Shape (n_y, n_x), field by Meep.
    library: ComplexArray  #: Shape (n_y, n_x), field stitched from the library, without evanescent waves.
    alone: ComplexArray  #: Shape (n_y, n_x), field stitched from each pillar alone on Meep's grid.
    decay: float  #: Remaining share of the decaying field, relative to the incident wave.
    seconds: float  #: Time of the simulation.
    pixels_per_period: int  #: Resolution of the grid.
    padding_sites: int  #: Neighbours simulated on each side of the patch.
    #: Shape (n_y, n_x), field by the library's model of neighbours; None where the library holds none.
    neighbours: ComplexArray | None = None

    @property
    def against_library(self) -> FieldDifference:
        """Full-wave field against the library's: coupling and grid together."""
        return field_difference(self.full_wave, self.library)

    @property
    def coupling(self) -> FieldDifference:
        """Full-wave field against the pillars alone on the same grid."""
        return field_difference(self.full_wave, self.alone)

    @property
    def grid(self) -> FieldDifference:
        """Pillars alone on Meep's grid against the library."""
        return field_difference(self.alone, self.library)

    @property
    def among(self) -> ComplexArray:
        """The library's field with the coupling by Meep, which leaves the error of the grid out: shape (n_y, n_x)."""
        return self.library + self.full_wave - self.alone

    @property
    def model(self) -> FieldDifference | None:
        """Field by the model of neighbours against :attr:`among`; None where the library holds no model."""
        return None if self.neighbours is None else field_difference(self.neighbours, self.among)


def field_difference(field: ComplexArray, reference: ComplexArray) -> FieldDifference:
    """Compare a field with a reference; both have any one shape."""
    scale = float(np.sqrt(np.mean(np.abs(reference) ** 2)))
    product = field * reference.conj()
    weight = np.abs(product)
    offset = float(np.angle(product.sum()))
    around = np.angle(product * np.exp(-1j * offset))
    return FieldDifference(
        amplitude_rms=float(np.sqrt(np.mean((np.abs(field) - np.abs(reference)) ** 2))) / scale,
        phase_rms_rad=float(np.sqrt(np.sum(weight * around**2) / weight.sum())),
        phase_offset_rad=offset,
        relative_l2=float(np.sqrt(np.mean(np.abs(field - reference) ** 2))) / scale,
    )


def plan_patch(
    pillars: PillarMap,
    library: Library,
    at_um: tuple[float, float],
    size_um: float,
    *,
    padding_sites: int = PADDING_SITES,
    settings: SupercellSettings = QUICK,
) -> PatchPlan:
    """Cut a square patch, its side rounded to whole sites, from a mask and estimate the cost of its simulation.

    ``padding_sites`` neighbours on each side are simulated but not compared. InputError if the place is off the lens,
    no pillar stands there, or the grid does not fit.
    """
    period_um = [p * 1e-3 for p in library.unit_cell.cell.period_nm]
    n_x, n_y = (round(size_um / p) for p in period_um)
    if min(n_x, n_y) < 1:
        raise InputError.single("patch", "size_um", f"at least one site, {max(period_um):g} um", f"{size_um:g} um")
    supercell, x, y = supercell_at(pillars, library, *at_um, (n_y + 2 * padding_sites, n_x + 2 * padding_sites))
    inner = _inside(supercell.size_nm, padding_sites)
    if not np.any(inner > 0.0):
        raise InputError.single("patch", "at_um", "a place with pillars", f"none about {at_um[0]:g}, {at_um[1]:g} um")
    return PatchPlan(supercell, x, y, padding_sites, settings, estimate(supercell, settings))


def solve_patch(
    plan: PatchPlan,
    library: Library,
    polarisation: Polarisation = "x",
    pool: Pool | None = None,
    progress: Progress = silent,
) -> Patch:
    """Simulate a planned patch, by default with workers of Meep that live as long as this process.

    MissingToolError if no interpreter has Meep, SolverError if the simulation failed.
    """
    supercell, padding = plan.supercell, plan.padding_sites
    answer = solve_supercell(supercell, polarisation, plan.settings, pool, progress)
    stored = library_responses(supercell, library)[POLARISATIONS.index(polarisation)]

    def field(amplitude: ComplexArray) -> ComplexArray:
        return _inside(supercell.at_sites(answer.order, amplitude), padding)

    neighbours = None
    if library.neighbours is not None and np.all(supercell.size_nm > 0.0):
        model = solve_by_model(library, supercell)
        axis = POLARISATIONS.index(polarisation)
        neighbours = _inside(supercell.at_sites(model.order, model.t[:, axis, axis]), padding)
    return Patch(
        x_um=plan.x_um[padding : plan.x_um.size - padding],
        y_um=plan.y_um[padding : plan.y_um.size - padding],
        polarisation=polarisation,
        full_wave=field(answer.co_polarised),
        library=field(supercell.local_period(answer.order, stored)),
        alone=field(answer.local_period),
        decay=answer.error,
        seconds=answer.seconds,
        pixels_per_period=plan.settings.pixels_per_period,
        padding_sites=padding,
        neighbours=neighbours,
    )


def save_patch(patch: Patch, path: Path, *, inputs_sha256: str) -> None:
    """Write ``patch.h5``."""
    with create(path, kind=KIND, format_version=FORMAT, inputs_sha256=inputs_sha256) as file:
        file.attrs["polarisation"] = patch.polarisation
        for name in ("decay", "seconds", "pixels_per_period", "padding_sites"):
            file.attrs[name] = getattr(patch, name)
        put(file, "x_um", patch.x_um, units="um", description="sites of the patch", dims=("x_um",))
        put(file, "y_um", patch.y_um, units="um", description="sites of the patch", dims=("y_um",))
        for name, text in (
            ("full_wave", "field behind the pillars over incident field, by Meep"),
            ("library", "field over incident field, stitched from the library"),
            ("alone", "field over incident field, stitched from each pillar alone on the grid of Meep"),
            ("neighbours", "field over incident field, by the library's model of neighbours"),
        ):
            if (field := getattr(patch, name)) is not None:
                put(file, name, field, units="1", description=text, dims=("y_um", "x_um"))


def load_patch(path: Path) -> Patch:
    """Read ``patch.h5``; InputError if the file is missing, damaged, or of another kind."""
    with open_kind(path, kind=KIND, format_version=FORMAT, remedy="make it with `metafab patch`") as file:
        return Patch(
            polarisation="y" if file.attrs["polarisation"] == "y" else "x",
            decay=float(file.attrs["decay"]),
            seconds=float(file.attrs["seconds"]),
            pixels_per_period=int(file.attrs["pixels_per_period"]),
            padding_sites=int(file.attrs["padding_sites"]),
            **{name: file[name][()] for name in ("x_um", "y_um", "full_wave", "library", "alone")},
            neighbours=file["neighbours"][()] if "neighbours" in file else None,
        )


def _inside(values: np.ndarray, padding: int) -> np.ndarray:
    n_y, n_x = values.shape[:2]
    return values[padding : n_y - padding, padding : n_x - padding]
