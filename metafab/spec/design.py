"""The design file: device, phase terms, rules, mask, sensor, and what is to be verified."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import shapely
from pydantic import Field, field_validator, model_validator
from pydantic.dataclasses import dataclass

from metafab.core.conventions import Polarisation
from metafab.spec.cell import UnitCell
from metafab.spec.fields import CONFIG, DepthOrInfinity, Name, NonNegative, Positive, Real, TargetError
from metafab.spec.mask import Mask
from metafab.spec.scene import Scene

FieldPoints = Annotated[int, Field(strict=True, ge=1, le=65)]

#: Smallest rule over the wavelength: no process is finer, and micrometres taken for nanometres are found.
_LEAST_RULE = 1e-3

#: Largest PSF window a side; beyond it the work grows without telling more.
MAX_WINDOW_PX = 2048


@dataclass(frozen=True, config=CONFIG)
class Device:
    """The lens: outline, size (diameter or side, at most a 300 mm wafer) and focal length.

    A "ring" is a circle without the inner circle of diameter ``inner_um``. A "polygon" is what ``outline_um``, at
    least three (x, y) from the axis, encloses within the square of side ``aperture_um`` about the axis. Helices are
    optimised for the full circle (or square), whatever is cut out of it.
    """

    aperture_um: Annotated[float, Field(strict=True, gt=0.0, le=300_000.0)]
    focal_length_mm: Positive
    aperture_shape: Literal["circle", "square", "ring", "polygon"] = "circle"
    inner_um: NonNegative = 0.0
    outline_um: tuple[tuple[Real, Real], ...] = ()

    @model_validator(mode="after")
    def _outline(self) -> Device:
        if (self.aperture_shape == "ring") != (self.inner_um > 0.0) or self.inner_um >= self.aperture_um:
            raise ValueError("`inner_um` must be between 0 and `aperture_um` for a ring, and not given otherwise")
        if (self.aperture_shape == "polygon") != bool(self.outline_um):
            raise ValueError("`outline_um` must be given for a polygon, and not otherwise")
        if not self.outline_um:
            return self
        if len(self.outline_um) < 3 or not (polygon := shapely.Polygon(self.outline_um)).is_valid or not polygon.area:
            raise ValueError("`outline_um` must be the vertices of one polygon whose edges do not cross or touch")
        if max(abs(u) for vertex in self.outline_um for u in vertex) > 0.5 * self.aperture_um:
            raise ValueError("`outline_um` must lie within the square of side `aperture_um` about the axis")
        return self


@dataclass(frozen=True, config=CONFIG)
class _Term:
    """What all phase terms share: the polarisations that they act on (both unless named)."""

    polarisation: Polarisation | None = None


@dataclass(frozen=True, config=CONFIG)
class SpiralZones(_Term):
    """Fresnel zones with topological charge rising from 1 to ``zones`` outwards: Eq. 2 of Shen 2023.

    The y polarisation gets the point mirror image, so that the PSF pair is conjugate.
    """

    term: Literal["spiral_zones"] = "spiral_zones"
    zones: Annotated[int, Field(strict=True, ge=1, le=64)] = 4
    exponent: Annotated[float, Field(strict=True, gt=0.0, le=16.0)] = 0.5
    optimise: Literal["none", "peak", "worst_peak", "blind_information"] = "none"
    side_lobe_limit: Annotated[
        float | None, Field(strict=True, gt=0.0, lt=1.0, description="largest side lobe over the main lobe")
    ] = None
    side_lobe_over: Annotated[Literal["worst", "mean"], Field(description="over the depths of a turn")] = "worst"

    @model_validator(mode="after")
    def _turns(self) -> SpiralZones:
        if self.zones == 1 and self.optimise != "none":
            raise ValueError("`zones` must be at least 2 to be optimised: a single zone does not turn with depth")
        if self.side_lobe_limit is not None and self.optimise != "peak":
            raise ValueError("`side_lobe_limit` goes with `optimise` = 'peak': the mean peak is maximised below it")
        return self


@dataclass(frozen=True, config=CONFIG)
class SplitLens(_Term):
    """Off-axis lenses that focus x polarisation at -theta and y polarisation at +theta: Eqs. 3 and 4.

    Eqs. 3 and 4 focus parallel light; ``object_depth_m`` makes them exact for an object at a finite depth.
    """

    term: Literal["split_lens"] = "split_lens"
    angle_deg: Annotated[float, Field(strict=True, ge=0.0, lt=90.0)] = 8.0
    object_depth_m: Positive | None = None


@dataclass(frozen=True, config=CONFIG)
class Lens(_Term):
    """A hyperbolic lens on the axis: parallel light, or an object at ``object_depth_m``, to a point."""

    term: Literal["lens"] = "lens"
    object_depth_m: Positive | None = None


@dataclass(frozen=True, config=CONFIG)
class Vortex(_Term):
    """A spiral phase of integer charge."""

    term: Literal["vortex"] = "vortex"
    charge: Annotated[int, Field(strict=True)] = 1


@dataclass(frozen=True, config=CONFIG)
class Grating(_Term):
    """A linear phase that deflects normal incidence by ``angle_deg`` towards ``azimuth_deg``."""

    term: Literal["grating"] = "grating"
    angle_deg: Annotated[float, Field(strict=True, gt=-90.0, lt=90.0)] = 0.0
    azimuth_deg: Real = 0.0


@dataclass(frozen=True, config=CONFIG)
class Axicon(_Term):
    """A cone that sends light towards the axis at ``angle_deg`` (away from it where negative)."""

    term: Literal["axicon"] = "axicon"
    angle_deg: Annotated[float, Field(strict=True, gt=-90.0, lt=90.0)] = 0.0


@dataclass(frozen=True, config=CONFIG)
class DoubleHelix(_Term):
    """A double helix of Gauss-Laguerre modes, for comparison; ``waist`` in units of the aperture's radius."""

    term: Literal["double_helix"] = "double_helix"
    waist: Positive = 0.35
    modes: Annotated[int, Field(strict=True, ge=2, le=8)] = 5


@dataclass(frozen=True, config=CONFIG)
class Zernike(_Term):
    """One Zernike polynomial of ``degree`` n and ``order`` m, 1 at the rim, times ``amplitude_rad``.

    Positive orders go with cos(m phi), negative ones with sin(|m| phi).
    """

    amplitude_rad: Real = 0.0
    term: Literal["zernike"] = "zernike"
    degree: Annotated[int, Field(strict=True, ge=0, le=40)] = 0
    order: Annotated[int, Field(strict=True, ge=-40, le=40)] = 0

    @model_validator(mode="after")
    def _exists(self) -> Zernike:
        if abs(self.order) > self.degree or (self.degree - abs(self.order)) % 2:
            raise ValueError(
                f"`order` must be one of -{self.degree}, -{self.degree} + 2, ..., {self.degree} for this `degree`, "
                f"got {self.order}"
            )
        return self


@dataclass(frozen=True, config=CONFIG)
class UserArray(_Term):
    """A phase of the user's own on a square grid centred on the axis: a .npy, .csv or .h5 file, radians.

    Shape (n_y, n_x), lowest y first, or (2, n_y, n_x) for x and y polarisation; ``dataset`` names it in an .h5.
    """

    file: Path = Field(kw_only=True)
    pitch_um: Positive = Field(kw_only=True)
    term: Literal["array"] = "array"
    dataset: str = "phase_rad"


@dataclass(frozen=True, config=CONFIG)
class Picture(_Term):
    """A hologram: the phase that, with a lens, paints a picture (.png, .tif, .npy) on the sensor.

    ``width_um`` is the picture's width there; what is bright in the file becomes bright, its first row at the top.
    """

    file: Path = Field(kw_only=True)
    width_um: Positive = Field(kw_only=True)
    term: Literal["hologram"] = "hologram"


PhaseTerm = Annotated[
    SpiralZones | SplitLens | Lens | Vortex | Grating | Axicon | DoubleHelix | Zernike | UserArray | Picture,
    Field(discriminator="term"),
]


@dataclass(frozen=True, config=CONFIG)
class Rules:
    """What the process can make.

    With ``gap_rule`` "each", no pillar is wider or longer than the period less ``min_gap_nm``, whatever stands beside
    it; with "pairs", a pillar may be larger where its neighbours leave the gap. ``max_aspect_ratio`` limits the
    height over the shorter side. ``cd_sigma_nm`` is the standard deviation of a bias that fabrication adds to width
    and length alike: sizes are chosen for the field expected under it, so that those whose phase turns fast give way
    to calm ones. With ``polarisation_independent`` only sizes are used that answer both polarisations alike by
    symmetry: pillars as wide as long, and crosses, in a square cell.
    """

    min_gap_nm: Positive = 100.0
    min_feature_nm: Positive = 100.0
    max_aspect_ratio: Positive | None = None
    gap_rule: Literal["each", "pairs"] = "each"
    cd_sigma_nm: NonNegative = 0.0
    polarisation_independent: bool = False

    @model_validator(mode="after")
    def _one_weight(self) -> Rules:
        if self.cd_sigma_nm and self.gap_rule == "pairs":
            raise ValueError('`cd_sigma_nm` weighs sizes one by one; it goes with `gap_rule = "each"`')
        return self


@dataclass(frozen=True, config=CONFIG)
class Sensor:
    """The image sensor: pixel pitch and where it stands (the depth whose image is sharp)."""

    pixel_um: Positive
    focus_depth_m: Positive


@dataclass(frozen=True, config=CONFIG)
class Optics:
    """What stands in the light besides the lens; nothing where a key is left out.

    ``filter_fwhm_nm`` is a colour filter's full width about the wavelength. ``substrate_um`` is the thickness of the
    substrate between scene and pillars, which refracts as a plane-parallel plate of the unit cell's index. A round stop
    of diameter ``stop_um`` and an amplitude of the user's own stand in the plane of the pillars; the amplitude (0 to 1)
    is a .npy, .csv or .h5 file on a square grid about the axis, (n_y, n_x), lowest y first. Efficiencies remain shares
    of the light at the device's aperture.
    """

    filter_fwhm_nm: Annotated[float | None, Field(strict=True, gt=0.0, le=100.0)] = None
    substrate_um: Annotated[float, Field(strict=True, ge=0.0, le=20_000.0)] = 0.0
    stop_um: Positive | None = None
    amplitude_file: Path | None = None
    amplitude_pitch_um: Positive | None = None
    amplitude_dataset: str = "amplitude"

    @model_validator(mode="after")
    def _samples_have_a_pitch(self) -> Optics:
        if (self.amplitude_file is None) != (self.amplitude_pitch_um is None):
            raise ValueError("`amplitude_file` and `amplitude_pitch_um`, the distance of its samples, go together")
        return self


@dataclass(frozen=True, config=CONFIG)
class Verify:
    """At which depths the written file is simulated, on which window, at how many field points.

    The last of ``depths_m`` may be ``inf``. ``field_points`` is [x, y], or one number for both; the pair changes
    fastest along the split.
    """

    depths_m: tuple[DepthOrInfinity, ...]
    window_px: Annotated[int, Field(strict=True, ge=4, le=MAX_WINDOW_PX)] = 64
    field_points: tuple[FieldPoints, FieldPoints] = (5, 5)
    target_error: TargetError = 1e-3

    @field_validator("field_points", mode="before")
    @classmethod
    def _both_axes(cls, value: object) -> object:
        return (value, value) if isinstance(value, int) else value

    @model_validator(mode="after")
    def _increasing(self) -> Verify:
        if not self.depths_m or any(b <= a for a, b in zip(self.depths_m, self.depths_m[1:], strict=False)):
            raise ValueError("`depths_m` must hold at least one depth, in increasing order")
        return self


@dataclass(frozen=True, config=CONFIG)
class Tolerances:
    """How far fabrication may go; a run with this table says what each corner does to the PSFs. Zeros leave one out.

    ``cd_bias_nm``, ``height_nm``, ``sidewall_deg`` and ``pillar_n`` (half the spread of published indices of silicon)
    are taken both ways, one at a time; ``misplacement_nm`` (of each pillar) and ``stitching_nm`` (of each write field)
    are rms along x and y, ``missing_share`` is of the pillars, each over ``draws`` random masks.
    """

    cd_bias_nm: NonNegative = 10.0
    height_nm: NonNegative = 10.0
    sidewall_deg: Annotated[float, Field(strict=True, ge=0.0, le=10.0)] = 2.0
    pillar_n: NonNegative = 0.0135
    misplacement_nm: NonNegative = 10.0
    stitching_nm: NonNegative = 30.0
    missing_share: Annotated[float, Field(strict=True, ge=0.0, le=0.5)] = 1e-3
    draws: Annotated[int, Field(strict=True, ge=2, le=1000)] = 8


@dataclass(frozen=True, config=CONFIG)
class Measured:
    """What was measured on the made device, to stand beside what is simulated; all optional.

    Efficiencies are through a pinhole of ``pinhole_um``, of the power at the aperture; ``source`` says whose they are.
    """

    efficiency_x: Annotated[float | None, Field(strict=True, gt=0.0, le=1.0)] = None
    efficiency_y: Annotated[float | None, Field(strict=True, gt=0.0, le=1.0)] = None
    extinction_ratio: Positive | None = None
    pinhole_um: Positive = 100.0
    source: str = ""


@dataclass(frozen=True, config=CONFIG)
class Numerics:
    """Settings of the computing, not of the device; all have good defaults."""

    tile_sites: Annotated[int, Field(strict=True, ge=16, le=4096)] = 476
    seed: Annotated[int, Field(strict=True, ge=0)] = 1
    iterations: NonNegative = 200


@dataclass(frozen=True, config=CONFIG)
class Design:
    """A design file (``layouts/NAME.toml``) with its unit cell and scene resolved.

    Without a scene, nothing is photographed or decoded, and the mask is verified on the axis alone.
    """

    name: Name
    library: Path
    unit_cell: UnitCell
    device: Device
    phase: Annotated[tuple[PhaseTerm, ...], Field(min_length=1)]
    rules: Rules
    mask: Mask
    sensor: Sensor
    verify: Verify
    scene: Scene | None = None
    numerics: Numerics = Field(default_factory=Numerics)
    optics: Annotated[
        Optics | None, Field(description="omitted: one wavelength, no budget of bandwidth, and nothing before the lens")
    ] = None
    tolerance: Annotated[Tolerances | None, Field(description="omitted: no table of corners")] = None
    measured: Annotated[Measured | None, Field(description="omitted: nothing to compare with")] = None

    @model_validator(mode="after")
    def _rules_in_nanometres(self) -> Design:
        least_nm = _LEAST_RULE * self.unit_cell.illumination.wavelength_nm
        for name in ("min_gap_nm", "min_feature_nm"):
            if getattr(self.rules, name) < least_nm:
                raise ValueError(
                    f"`rules.{name}` must be at least {least_nm:g} nm, a thousandth of the wavelength, got "
                    f"{getattr(self.rules, name):g}; is it in nanometres?"
                )
        return self

    @model_validator(mode="after")
    def _photons(self) -> Design:
        informed = any(isinstance(term, SpiralZones) and term.optimise == "blind_information" for term in self.phase)
        if informed and self.scene is None:
            raise ValueError("`optimise` = 'blind_information' needs a `scene`: its photons and noise decide")
        return self

    @model_validator(mode="after")
    def _light_reaches_the_lens(self) -> Design:
        if self.optics is None:
            return self
        substrate_um, stop_um = self.optics.substrate_um, self.optics.stop_um
        if substrate_um > 0.0 and self.unit_cell.illumination.side != "substrate":
            raise ValueError(
                "`optics.substrate_um` is for light from the substrate's side; here it comes from the other"
            )
        nearest_m = min(self.sensor.focus_depth_m, *self.depths_m)
        if substrate_um >= 1e6 * nearest_m:
            raise ValueError(f"`optics.substrate_um` must end before the nearest object, {1e6 * nearest_m:g} um away")
        if stop_um is not None and stop_um > self.device.aperture_um:
            raise ValueError(
                f"`optics.stop_um` must be at most `device.aperture_um`, {self.device.aperture_um:g} um: a wider stop "
                "stops nothing"
            )
        return self

    @property
    def depths_m(self) -> tuple[float, ...]:
        """Every depth that matters, ascending: those to verify, and the ends of the scene's."""
        return tuple(sorted({*self.verify.depths_m, *(() if self.scene is None else self.scene.depths_m)}))

    @property
    def min_side_nm(self) -> float:
        """Smallest width and length that a pillar may have: it is drawn with ``mask.bias_nm`` and must stand, nm."""
        ratio = self.rules.max_aspect_ratio
        upright_nm = 0.0 if ratio is None else self.unit_cell.cell.height_nm / ratio
        return max(self.rules.min_feature_nm - self.mask.bias_nm, upright_nm)

    @property
    def min_spacing_nm(self) -> float:
        """Smallest gap between pillars, so that those drawn with ``mask.bias_nm`` keep ``rules.min_gap_nm``, nm."""
        return self.rules.min_gap_nm + self.mask.bias_nm

    @property
    def has_mask(self) -> bool:
        """Whether a mask is written; without one, the design is judged by its target phases."""
        return bool(self.mask.formats)

    @property
    def wavelength_um(self) -> float:
        """Vacuum wavelength, um."""
        return self.unit_cell.illumination.wavelength_nm * 1e-3

    @property
    def split_angle_deg(self) -> float:
        """Off-axis angle theta of the split lens, 0 for a design without one."""
        return next((term.angle_deg for term in self.phase if isinstance(term, SplitLens)), 0.0)
