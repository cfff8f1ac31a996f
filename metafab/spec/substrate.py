"""A birefringent substrate between scene and pillars: cut, thickness, orientation, indices."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from metafab.spec.cell import Material, MaterialOrName
from metafab.spec.fields import Checked, spec

#: c / a of sapphire (hexagonal axes), Kronberg, Acta Metall. 5, 507 (1957). It sets the tilt of the r-plane (1-102).
_SAPPHIRE_C_OVER_A = 2.730

#: Angle between optic axis and normal of the usual cuts of sapphire, degrees.
OPTIC_AXIS_DEG = {
    "c-plane": 0.0,
    "r-plane": math.degrees(math.atan(_SAPPHIRE_C_OVER_A / math.sqrt(3.0))),
    "a-plane": 90.0,
    "m-plane": 90.0,
}


@spec()
class Substrate(Checked):
    """Uniaxial plane-parallel plate that light crosses before it meets the pillars."""

    thickness_um: Annotated[float, Field(strict=True, gt=0.0, le=20_000.0)]  #: Thickness of the plate.
    #: Direction of the optic axis' projection on the wafer, counter-clockwise from x.
    azimuth_deg: Annotated[float, Field(strict=True, ge=-360.0, le=360.0)] = 0.0
    #: Plane of sapphire that is the wafer's face.
    cut: Literal["c-plane", "r-plane", "a-plane", "m-plane"] | None = None
    #: Angle between optic axis and normal, in place of `cut`, for other cuts and crystals.
    optic_axis_deg: Annotated[float | None, Field(strict=True, ge=0.0, le=90.0)] = None
    #: Ordinary index: a number `{ n = ... }` or a record.
    ordinary: MaterialOrName = Field(default_factory=lambda: Material(record="Al2O3/Malitson"))
    #: Extraordinary index: a number `{ n = ... }` or a record.
    extraordinary: MaterialOrName = Field(default_factory=lambda: Material(record="Al2O3/Malitson-e"))
    #: Face that light enters by: "bare" reflects as the crystal does, "coated" reflects nothing.
    back_face: Literal["bare", "coated"] = "bare"

    def _faults(self) -> Iterator[str]:
        if (self.cut is None) == (self.optic_axis_deg is None):
            yield "give either `cut`, a plane of sapphire, or `optic_axis_deg`, not both or neither"
        for name in ("ordinary", "extraordinary"):
            material = getattr(self, name)
            if material.k or material.directional:
                yield (f"`{name}` must be one real index: the crystal is transparent, and itself birefringent")

    @property
    def tilt_deg(self) -> float:
        """Angle between optic axis and normal, degrees."""
        return OPTIC_AXIS_DEG[self.cut] if self.cut is not None else float(self.optic_axis_deg or 0.0)
