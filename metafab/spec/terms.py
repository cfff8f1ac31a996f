"""Phase terms of a design; a target phase is their sum."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from metafab.core.conventions import Polarisation
from metafab.spec.fields import CONFIG, Positive, Real


@dataclass(frozen=True, config=CONFIG)
class _Term:
    """Base of all phase terms; ``polarisation`` limits a term to one polarisation."""

    polarisation: Polarisation | None = None


@dataclass(frozen=True, config=CONFIG)
class SpiralZones(_Term):
    """Fresnel zones with topological charges 1 to ``zones`` from the centre outwards: Eq. 2 of Shen 2023.

    The y polarisation gets the point reflection, which makes the PSF pair conjugate.
    """

    term: Literal["spiral_zones"] = "spiral_zones"
    zones: Annotated[int, Field(strict=True, ge=1, le=64)] = 4
    exponent: Annotated[float, Field(strict=True, gt=0.0, le=16.0)] = 0.5
    optimise: Literal["none", "peak", "worst_peak", "blind_information"] = "none"
    side_lobe_limit: Annotated[
        float | None, Field(strict=True, gt=0.0, lt=1.0, description="upper limit of side lobe over main lobe")
    ] = None
    side_lobe_over: Annotated[Literal["worst", "mean"], Field(description="over the depths of a turn")] = "worst"

    @model_validator(mode="after")
    def _turns(self) -> SpiralZones:
        if self.zones == 1 and self.optimise != "none":
            raise ValueError("`zones` must be at least 2 to be optimised: a single zone does not turn with depth")
        if self.side_lobe_limit is not None and self.optimise != "peak":
            raise ValueError("`side_lobe_limit` needs `optimise` = 'peak'")
        return self


@dataclass(frozen=True, config=CONFIG)
class SplitLens(_Term):
    """Off-axis lenses that focus x polarisation at -theta and y polarisation at +theta: Eqs. 3 and 4.

    Eqs. 3 and 4 focus collimated light; ``object_depth_m`` makes them exact for an object at a finite depth.
    """

    term: Literal["split_lens"] = "split_lens"
    angle_deg: Annotated[float, Field(strict=True, ge=0.0, lt=90.0)] = 8.0
    object_depth_m: Positive | None = None


@dataclass(frozen=True, config=CONFIG)
class Lens(_Term):
    """A hyperbolic lens on the axis that focuses collimated light, or an object at ``object_depth_m``."""

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
    """A conical phase that deflects light towards the axis by ``angle_deg`` (away from it if negative)."""

    term: Literal["axicon"] = "axicon"
    angle_deg: Annotated[float, Field(strict=True, gt=-90.0, lt=90.0)] = 0.0


@dataclass(frozen=True, config=CONFIG)
class DoubleHelix(_Term):
    """A double helix of Gauss-Laguerre modes; ``waist`` in units of the aperture's radius."""

    term: Literal["double_helix"] = "double_helix"
    waist: Positive = 0.35
    modes: Annotated[int, Field(strict=True, ge=2, le=8)] = 5


@dataclass(frozen=True, config=CONFIG)
class Zernike(_Term):
    """A Zernike polynomial of ``degree`` n and ``order`` m, normalised to 1 at the rim, times ``amplitude_rad``.

    Positive orders use cos(m phi), negative orders sin(|m| phi).
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
    """A phase map in radians from a .npy, .csv or .h5 file, on a square grid centred on the axis.

    Shape (n_y, n_x), lowest y first, or (2, n_y, n_x) for x and y polarisation; ``dataset`` is its name in an .h5 file.
    """

    file: Path = Field(kw_only=True)
    pitch_um: Positive = Field(kw_only=True)
    term: Literal["array"] = "array"
    dataset: str = "phase_rad"


@dataclass(frozen=True, config=CONFIG)
class Picture(_Term):
    """A hologram: with a lens, the phase that projects a picture (.png, .tif, .npy) onto the sensor.

    ``width_um`` is the width of the projected picture; its first row is at the top.
    """

    file: Path = Field(kw_only=True)
    width_um: Positive = Field(kw_only=True)
    term: Literal["hologram"] = "hologram"


PhaseTerm = Annotated[
    SpiralZones | SplitLens | Lens | Vortex | Grating | Axicon | DoubleHelix | Zernike | UserArray | Picture,
    Field(discriminator="term"),
]
