"""Design: device, phase terms, rules, mask, sensor, and verification, and how they must fit each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from pydantic import Field

from metafab.spec.cell import UnitCell
from metafab.spec.device import Device, Optics, Rules, Sensor
from metafab.spec.fields import (
    BOTH,
    Checked,
    DepthOrInfinity,
    Flag,
    Name,
    NonNegative,
    Positive,
    Real,
    TargetError,
    spec,
)
from metafab.spec.light import Light
from metafab.spec.mask import Mask, Process
from metafab.spec.scene import Scene
from metafab.spec.substrate import Substrate
from metafab.spec.terms import Lens, PhaseTerm, Radial, SpiralZones, SplitLens

#: Most directions along an axis of the field at which PSFs are computed.
MOST_FIELD_POINTS = 65
FieldPoints = Annotated[int, Field(strict=True, ge=1, le=MOST_FIELD_POINTS)]

#: Smallest design rule over the wavelength; a smaller one is probably in micrometres.
_LEAST_RULE = 1e-3

#: Longest side of a PSF window (pixels).
MAX_WINDOW_PX = 2048


@spec()
class Verify(Checked):
    """Depths, window and number of field points at which the written mask is simulated.

    The PSF pair changes fastest along x, the axis of the split.
    """

    depths_m: tuple[DepthOrInfinity, ...]  #: Depths in increasing order; the last may be inf.
    window_px: Annotated[int, Field(strict=True, ge=4, le=MAX_WINDOW_PX)] = 64  #: Side of the PSF windows.
    #: Number of field points along x and y; one number for both.
    field_points: Annotated[tuple[FieldPoints, FieldPoints], BOTH] = (5, 5)
    target_error: TargetError = 1e-3  #: Target error of the PSFs (relative L2).
    #: Wanted relative error of depth; sets `target_error` and `field_points` so that the numerics take a third of it.
    target_depth_error: Annotated[TargetError | None, Field(description="omitted: these two as given")] = None
    #: Whether propagation is vectorial: the electric field stays perpendicular to each ray.
    vectorial: Annotated[Flag | None, Field(description="omitted: where its effect counts, from an NA near 0.3")] = None
    #: (x, y) of the centre of the PSF windows on the sensor, from the axis.
    centre_um: Annotated[tuple[Real, Real] | None, Field(description="omitted: where the target sends light")] = None

    def _faults(self) -> Iterator[str]:
        if not self.depths_m or any(b <= a for a, b in zip(self.depths_m, self.depths_m[1:], strict=False)):
            yield "`depths_m` must hold at least one depth, in increasing order"


@spec()
class Tolerances:
    """Fabrication tolerances; a run with this table simulates the PSFs at each of its corners. 0 omits a tolerance."""

    cd_bias_nm: NonNegative = 10.0  #: Bias of width and length, applied with both signs.
    height_nm: NonNegative = 10.0  #: Error of the height, applied with both signs.
    #: Error of the sidewall angle, applied with both signs.
    sidewall_deg: Annotated[float, Field(strict=True, ge=0.0, le=10.0)] = 2.0
    #: Error of the pillar's index, applied with both signs; by default half the spread of published indices of silicon.
    pillar_n: NonNegative = 0.0135
    misplacement_nm: NonNegative = 10.0  #: Displacement of each pillar along x and y, rms.
    stitching_nm: NonNegative = 30.0  #: Displacement of each write field along x and y, rms.
    missing_share: Annotated[float, Field(strict=True, ge=0.0, le=0.5)] = 1e-3  #: Share of missing pillars.
    #: Number of random masks over which random errors are averaged.
    draws: Annotated[int, Field(strict=True, ge=2, le=1000)] = 8


@spec()
class Measured:
    """Measured figures of the made device, shown with the simulated ones; all optional."""

    #: Measured efficiency of x polarisation: power through the pinhole over power on the aperture.
    efficiency_x: Annotated[float | None, Field(strict=True, gt=0.0, le=1.0)] = None
    #: Measured efficiency of y polarisation.
    efficiency_y: Annotated[float | None, Field(strict=True, gt=0.0, le=1.0)] = None
    extinction_ratio: Positive | None = None  #: Measured extinction ratio.
    pinhole_um: Positive = 100.0  #: Diameter of the pinhole.
    source: str = ""  #: Reference of the measured figures.


@spec()
class Numerics:
    """Numerical settings."""

    tile_sites: Annotated[int, Field(strict=True, ge=16, le=4096)] = 476  #: Sites along a tile's side.
    seed: Annotated[int, Field(strict=True, ge=0)] = 1  #: Seed of random starts.
    iterations: NonNegative = 200  #: Most iterations of an optimisation.


@spec()
class Limits:
    """Limits on what reading a file may take; a small file can state more than any machine holds.

    Each replaces the limits that the readers choose by the size of the file and of the lens. They hold for masks, and
    in a run for every file that it reads.
    """

    memory_mb: Positive | None = None  #: Memory of what one file expands to.
    #: Shapes of a mask file on the pillar layer, or of a cell of `mask.include` on all layers, all placements and
    #: repetitions expanded.
    shapes: Annotated[int | None, Field(strict=True, ge=1)] = None
    #: Nesting of the cells of a mask file, or of a cell of `mask.include`; omitted: 100.
    depth: Annotated[int | None, Field(strict=True, ge=1, le=250)] = None
    #: Processor time of reading a mask file, estimated from its records, so that it is the same on every machine.
    seconds: Positive | None = None


@spec()
class Design(Checked):
    """A design file (``layouts/NAME.toml``) with its unit cell and scene resolved.

    Without a scene, nothing is photographed or decoded, and the mask is verified on the axis alone.
    """

    name: Name  #: Name of the design, of its mask files and of its run folder.
    library: Path  #: Unit-cell file or built library, relative to the design.
    unit_cell: UnitCell  #: Unit cell of `library`; not a key of a design file.
    device: Device  #: The lens.
    phase: Annotated[tuple[PhaseTerm, ...], Field(min_length=1)]  #: Phase terms, whose sum is the target phase.
    rules: Rules  #: Design rules of the process.
    mask: Mask  #: Mask files.
    sensor: Sensor  #: Image sensor.
    verify: Verify  #: Depths, window and field points of the simulation of the written mask.
    #: Scene to photograph and decode: a table, or the path of a scene file; without it the mask is verified on the axis
    #: alone.
    scene: Scene | None = None
    numerics: Numerics = Field(default_factory=Numerics)  #: Numerical settings.
    optics: Optics | None = None  #: Optical elements besides the lens; none without the table, and one wavelength.
    #: Birefringent substrate between scene and pillars; without the table the substrate keeps the polarisation.
    substrate: Substrate | None = None
    tolerance: Tolerances | None = None  #: Fabrication tolerances; no corners are simulated without the table.
    #: Fabrication process, a table or the path of a process file; no exposure is simulated without it.
    process: Process | None = None
    measured: Measured | None = None  #: Measured figures of the made device, shown beside the simulated ones.
    #: Wavelengths and directions that the mask serves together, the unit cell's wavelength along the axis among them;
    #: that alone without the table.
    light: tuple[Light, ...] = ()
    limits: Limits | None = None  #: Limits on what reading a file may take.

    def _faults(self) -> Iterator[str]:
        least_nm = _LEAST_RULE * self.unit_cell.illumination.wavelength_nm
        for name in ("min_gap_nm", "min_feature_nm"):
            if getattr(self.rules, name) < least_nm:
                yield (
                    f"`rules.{name}` must be at least {least_nm:g} nm, a thousandth of the wavelength, got "
                    f"{getattr(self.rules, name):g}; is it in nanometres?"
                )
        yield from self._faults_of_rings()
        if self.verify.centre_um is not None and self.windows_follow_images:
            yield (
                "`verify.centre_um` moves the window of a device without scene and `split_lens`, whose windows follow "
                "the images of objects"
            )
        if self.optics is not None and self.optics.oblique and self.scene is None:
            yield "`optics.oblique` needs a `scene`, whose field sets the directions of the light"
        if self.verify.target_depth_error is not None and self.scene is None:
            yield "`verify.target_depth_error` needs a `scene`, whose depths it is about"
        informed = any(isinstance(term, SpiralZones) and term.optimise == "blind_information" for term in self.phase)
        if informed and self.scene is None:
            yield "`optimise` = 'blind_information' needs a `scene`: its photons and noise decide"
        yield from self._faults_of_lights()
        yield from self._faults_of_plates()
        stop_um = None if self.optics is None else self.optics.stop_um
        if stop_um is not None and stop_um > self.device.aperture_um:
            yield f"`optics.stop_um` must be at most `device.aperture_um`, {self.device.aperture_um:g} um"
        least_um = 2e-3 * max(self.unit_cell.cell.period_nm)
        if stop_um is not None and stop_um < (1.0 - 1e-9) * least_um:
            least = f"at least {least_um:g} um, two periods"
            yield f"`optics.stop_um` must be {least}, got {stop_um:g}; is it in micrometres?"

    def _faults_of_plates(self) -> Iterator[str]:
        """Faults of the plate between the object and the lens."""
        isotropic_um = 0.0 if self.optics is None else self.optics.substrate_um
        if isotropic_um > 0.0 and self.substrate is not None:
            yield "give `optics.substrate_um` or a `[substrate]`, not both: they are the same plate"
        crystal_um = 0.0 if self.substrate is None else self.substrate.thickness_um
        nearest_m = min(self.sensor.focus_depth_m, *self.depths_m)
        for name, substrate_um in (("optics.substrate_um", isotropic_um), ("substrate.thickness_um", crystal_um)):
            if substrate_um > 0.0 and self.unit_cell.illumination.side != "substrate":
                yield f"`{name}` needs `illumination.side` = 'substrate': light from the ambient misses it"
            if substrate_um >= 1e6 * nearest_m:
                yield f"`{name}` must end before the nearest object, {1e6 * nearest_m:g} um away"

    def _faults_of_rings(self) -> Iterator[str]:
        """Faults of rings: a wall or hole that cannot be drawn, or that breaks the rules at every outer diameter."""
        cell, (wall_nm, hole_nm), unit_nm = self.unit_cell.cell, self.drawn_ring_nm, self.mask.database_unit_nm
        if cell.shape != "ring":
            return
        for name, length_nm, step_nm, rule in (
            ("wall_nm", wall_nm, unit_nm, "min_feature_nm"),
            ("inner_diameter_nm", hole_nm, 2.0 * unit_nm, "min_gap_nm"),
        ):
            if getattr(cell, name) is None:
                continue
            if abs(length_nm / step_nm - round(length_nm / step_nm)) > 1e-6:
                yield f"`{name}` of the unit cell, drawn as {length_nm:g} nm, must be a multiple of {step_nm:g} nm"
            if length_nm <= 0.0:
                yield f"`{name}` of the unit cell with `mask.bias_nm` must be above 0, got {length_nm:g} nm"
            elif length_nm < getattr(self.rules, rule) - 1e-6:
                got = f"{getattr(self.rules, rule):g} nm"
                yield f"`rules.{rule}` must be at most {length_nm:g} nm, the drawn `{name}` of the unit cell, got {got}"
        ratio = self.rules.max_aspect_ratio
        if ratio is not None and cell.wall_nm and cell.height_nm > ratio * cell.wall_nm + 1e-6:
            least = f"{cell.height_nm / cell.wall_nm:.4g}, the height over `wall_nm` of the unit cell"
            yield f"`rules.max_aspect_ratio` must be at least {least}, got {ratio:g}"
        if any(copy.bias_nm for copy in self.mask.copies):
            yield "`mask.copies` with a `bias_nm` are not available for rings; use `mask.bias_nm`"
        if self.rules.cd_sigma_nm > 0.0:
            yield "`rules.cd_sigma_nm` is not available for rings; `[tolerance] cd_bias_nm` solves them"

    def _faults_of_lights(self) -> Iterator[str]:
        """Faults of the lights: their list, phases and axes, and keys that are not available with several."""
        if not self.light:
            return
        own_nm = self.unit_cell.illumination.wavelength_nm
        lights, own = [light.key for light in self.light], (own_nm, 0.0, 0.0)
        if len(set(lights)) < max(len(lights), 2) or own not in lights:
            listed = "; ".join(light.label for light in self.light)
            yield (
                f"`light` must list two or more different wavelengths or directions, the {own_nm:g} nm of the unit "
                f"cell along the axis among them, got {listed}"
            )
        elif self.light[lights.index(own)].phase is not None:
            yield f"the `light` of {own_nm:g} nm, the unit cell's, has the design's `phase`; leave out `light.phase`"
        spans = {} if self.unit_cell.sweep.axes is None else self.unit_cell.sweep.axes.spans
        for light in self.light:
            needed = {axis: abs(angle) for axis, angle in light.angles_deg.items()}
            if needed and light.wavelength_nm != own_nm:
                needed["wavelength_nm"] = light.wavelength_nm
            for axis, value in needed.items():
                low, high = spans.get(axis, (0.0, 0.0))
                if not low <= value <= high:
                    got = f"[{low:g}, {high:g}]" if axis in spans else "none"
                    yield f"the `light` of {light.label} needs a `sweep.axes.{axis}` that holds {value:g}, got {got}"
        rules = self.rules
        hindrances = {
            'rules.gap_rule = "pairs"': rules.gap_rule == "pairs",
            "rules.cd_sigma_nm": rules.cd_sigma_nm > 0.0,
            "rules.neighbours": rules.neighbours,
            # Libraries at other wavelengths have no model of neighbours.
            "optics.neighbours": self.optics is not None and self.optics.neighbours is True,
            "optics.oblique": self.optics is not None and self.optics.oblique is True,
        }
        if given := [name for name, stands in hindrances.items() if stands]:
            yield f"`light` is not available with `{'`, `'.join(given)}`; leave one out"

    @property
    def stated_limits(self) -> dict[str, float | None]:
        """Limits of reading a file by name; None where the readers choose."""
        return {} if self.limits is None else dict(vars(self.limits))

    @property
    def depths_m(self) -> tuple[float, ...]:
        """Verified depths and the extreme depths of the scene's objects, ascending."""
        return tuple(sorted({*self.verify.depths_m, *(() if self.scene is None else self.scene.depths_m)}))

    @property
    def min_side_nm(self) -> float:
        """Smallest width and length of a pillar, nm, by the rules for the drawn feature and the aspect ratio."""
        ratio = self.rules.max_aspect_ratio
        upright_nm = 0.0 if ratio is None else self.unit_cell.cell.height_nm / ratio
        side_nm = max(self.rules.min_feature_nm - self.mask.bias_nm, upright_nm)
        if self.unit_cell.cell.shape != "ring":
            return side_nm
        # A ring's drawn wall keeps the rule of features, its drawn hole that of gaps.
        wall_nm, hole_nm = self.unit_cell.cell.wall_nm, self.unit_cell.cell.inner_diameter_nm
        return self.min_spacing_nm + 2.0 * wall_nm if wall_nm else 2.0 * side_nm + (hole_nm or 0.0)

    @property
    def drawn_ring_nm(self) -> tuple[float, float]:
        """Drawn wall and drawn hole of a ring, nm, with ``mask.bias_nm``; 0 for the one that the size decides."""
        cell, bias_nm = self.unit_cell.cell, self.mask.bias_nm
        wall_nm, hole_nm = cell.wall_nm, cell.inner_diameter_nm
        return (0.0 if wall_nm is None else wall_nm + bias_nm), (0.0 if hole_nm is None else hole_nm - bias_nm)

    @property
    def min_spacing_nm(self) -> float:
        """Smallest gap between pillars without bias, nm; drawn with ``mask.bias_nm`` they keep ``rules.min_gap_nm``."""
        return self.rules.min_gap_nm + self.mask.bias_nm

    @property
    def has_mask(self) -> bool:
        """Whether a mask is written; without one, the target phases are simulated."""
        return bool(self.mask.formats)

    @property
    def is_lens(self) -> bool:
        """Whether the phase is that of a lens with one focus, aberrations included."""
        focusing = any(isinstance(term, Lens | Radial | SplitLens) for term in self.phase)
        return focusing and not any(term.blurs for term in self.phase)

    @property
    def windows_follow_images(self) -> bool:
        """Whether the PSF windows follow the images of objects; otherwise ``verify.centre_um`` may place them."""
        return bool(self.split_angle_deg) or self.scene is not None

    def at_light(self, light: Light) -> Design:
        """Return the design for one light alone: with its wavelength, and with its phase terms if it has its own.

        Raises:
            SpecError: the unit cell's lengths do not suit the wavelength.
        """
        unit_cell, illumination = self.unit_cell, self.unit_cell.illumination
        if light.wavelength_nm != illumination.wavelength_nm:
            illumination = replace(illumination, wavelength_nm=light.wavelength_nm)
            sweep = replace(unit_cell.sweep, axes=None)
            unit_cell = replace(unit_cell, illumination=illumination, sweep=sweep, neighbours=None)
        return replace(self, unit_cell=unit_cell, phase=light.phase or self.phase, light=())

    @property
    def wavelength_um(self) -> float:
        """Vacuum wavelength, um."""
        return self.unit_cell.illumination.wavelength_nm * 1e-3

    @property
    def split_angle_deg(self) -> float:
        """Off-axis angle theta of the split lens, 0 for a design without one."""
        return next((term.angle_deg for term in self.phase if isinstance(term, SplitLens)), 0.0)
