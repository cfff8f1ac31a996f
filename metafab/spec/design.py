"""Design: device, phase terms, rules, mask, sensor, and verification."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator
from pydantic.dataclasses import dataclass

from metafab.core.conventions import FloatArray
from metafab.spec.cell import UnitCell
from metafab.spec.fields import CONFIG, DepthOrInfinity, Name, NonNegative, Positive, Real, TargetError
from metafab.spec.mask import Mask, Process
from metafab.spec.scene import Scene
from metafab.spec.terms import PhaseTerm, SpiralZones, SplitLens

FieldPoints = Annotated[int, Field(strict=True, ge=1, le=65)]

#: Smallest design rule over the wavelength; a smaller one is probably in micrometres.
_LEAST_RULE = 1e-3

#: Longest side of a PSF window (pixels).
MAX_WINDOW_PX = 2048


@dataclass(frozen=True, config=CONFIG)
class Device:
    """The lens: aperture and focal length.

    ``aperture_um``: diameter or side, at most that of a 300 mm wafer. A "ring" excludes the inner circle of diameter
    ``inner_um``. A "polygon" has the vertices ``outline_um``, at least three (x, y) relative to the axis, within the
    square of side ``aperture_um``. Helices are optimised for the full circle or square in every case.
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

    def encloses(self, x_um: FloatArray, y_um: FloatArray) -> NDArray[np.bool_]:
        """Mask of the grid points within the aperture, its rim included.

        Args:
            x_um: shape (n_x,), from the axis.
            y_um: shape (n_y,), from the axis.

        Returns:
            Shape (n_y, n_x).
        """
        half = 0.5 * self.aperture_um
        if self.aperture_shape == "square":
            return np.asarray((np.abs(y_um) <= half)[:, None] & (np.abs(x_um) <= half))
        if self.aperture_shape == "polygon":
            x, y = np.meshgrid(x_um, y_um)
            return np.asarray(shapely.intersects_xy(shapely.Polygon(self.outline_um), x, y))
        square = y_um[:, None] ** 2 + x_um**2
        within: NDArray[np.bool_] = square <= half * half
        if self.aperture_shape == "ring":
            within &= square >= (0.5 * self.inner_um) ** 2
        return within


@dataclass(frozen=True, config=CONFIG)
class Rules:
    """Design rules of the process.

    ``gap_rule`` "each" limits every width and length to the period minus ``min_gap_nm``; with "pairs", a pillar may be
    larger if the gaps to its neighbours still hold. ``max_aspect_ratio`` limits height over the shorter side.
    ``cd_sigma_nm`` is the standard deviation of a common bias of width and length in fabrication: the mapping maximises
    the field expected under it, which avoids sizes with a steep phase. ``polarisation_independent`` restricts the
    mapping to sizes that respond equally to both polarisations by symmetry: equal width and length, or crosses, in a
    square cell.
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
    """The image sensor: pixel pitch, and the object depth for which it is in focus."""

    pixel_um: Positive
    focus_depth_m: Positive


@dataclass(frozen=True, config=CONFIG)
class Optics:
    """Optical elements besides the lens; each is optional.

    ``filter_fwhm_nm``: full width at half maximum of a colour filter centred on the wavelength. ``substrate_um``:
    thickness of the substrate between scene and pillars, a plane-parallel plate with the unit cell's index.
    ``stop_um``: diameter of a round stop in the plane of the pillars. ``amplitude_file``: amplitude transmission (0 to
    1) in that plane, a .npy, .csv or .h5 file on a square grid about the axis with pitch ``amplitude_pitch_um``, shape
    (n_y, n_x), lowest y first. Efficiencies remain relative to the light on the device's aperture.
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
            raise ValueError("`amplitude_file` and `amplitude_pitch_um`, its sample pitch, must be given together")
        return self


@dataclass(frozen=True, config=CONFIG)
class Verify:
    """Depths, window and number of field points at which the written mask is simulated.

    The last of ``depths_m`` may be ``inf``. ``field_points`` is [x, y], or one number for both axes; the PSF pair
    changes fastest along x, the axis of the split.
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
    """Fabrication tolerances; a run with this table simulates the PSFs at each of its corners.

    ``cd_bias_nm``, ``height_nm``, ``sidewall_deg`` and ``pillar_n`` (default: half the spread of published indices of
    silicon) are applied with both signs, one at a time. ``misplacement_nm`` (each pillar) and ``stitching_nm`` (each
    write field) are rms displacements along x and y, ``missing_share`` is the share of missing pillars; each is
    averaged over ``draws`` random masks. Zero omits a tolerance.
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
    """Measured figures of the fabricated device, shown with the simulated ones; all optional.

    Efficiencies are the power through a pinhole of diameter ``pinhole_um`` over the power on the aperture; ``source``
    is their reference.
    """

    efficiency_x: Annotated[float | None, Field(strict=True, gt=0.0, le=1.0)] = None
    efficiency_y: Annotated[float | None, Field(strict=True, gt=0.0, le=1.0)] = None
    extinction_ratio: Positive | None = None
    pinhole_um: Positive = 100.0
    source: str = ""


@dataclass(frozen=True, config=CONFIG)
class Numerics:
    """Numerical settings."""

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
    optics: Annotated[Optics | None, Field(description="omitted: one wavelength, no elements besides the lens")] = None
    tolerance: Annotated[Tolerances | None, Field(description="omitted: no table of tolerances")] = None
    process: Annotated[Process | None, Field(description="omitted: no exposure is simulated")] = None
    measured: Annotated[Measured | None, Field(description="omitted: no measured figures")] = None

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
                "`optics.substrate_um` needs `illumination.side` = 'substrate': light from the ambient misses it"
            )
        nearest_m = min(self.sensor.focus_depth_m, *self.depths_m)
        if substrate_um >= 1e6 * nearest_m:
            raise ValueError(f"`optics.substrate_um` must end before the nearest object, {1e6 * nearest_m:g} um away")
        if stop_um is not None and stop_um > self.device.aperture_um:
            raise ValueError(f"`optics.stop_um` must be at most `device.aperture_um`, {self.device.aperture_um:g} um")
        return self

    @property
    def depths_m(self) -> tuple[float, ...]:
        """Verified depths and the extreme depths of the scene's objects, ascending."""
        return tuple(sorted({*self.verify.depths_m, *(() if self.scene is None else self.scene.depths_m)}))

    @property
    def min_side_nm(self) -> float:
        """Smallest width and length of a pillar, nm, by the rules for the drawn feature and the aspect ratio."""
        ratio = self.rules.max_aspect_ratio
        upright_nm = 0.0 if ratio is None else self.unit_cell.cell.height_nm / ratio
        return max(self.rules.min_feature_nm - self.mask.bias_nm, upright_nm)

    @property
    def min_spacing_nm(self) -> float:
        """Smallest gap between pillars without bias, nm; drawn with ``mask.bias_nm`` they keep ``rules.min_gap_nm``."""
        return self.rules.min_gap_nm + self.mask.bias_nm

    @property
    def has_mask(self) -> bool:
        """Whether a mask is written; without one, the target phases are simulated."""
        return bool(self.mask.formats)

    @property
    def wavelength_um(self) -> float:
        """Vacuum wavelength, um."""
        return self.unit_cell.illumination.wavelength_nm * 1e-3

    @property
    def split_angle_deg(self) -> float:
        """Off-axis angle theta of the split lens, 0 for a design without one."""
        return next((term.angle_deg for term in self.phase if isinstance(term, SplitLens)), 0.0)
