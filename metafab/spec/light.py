"""Lights that one mask serves together: the table ``[[light]]`` of a design."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from metafab.spec.fields import Positive, spec
from metafab.spec.terms import PhaseTerm

Angle = Annotated[float, Field(strict=True, gt=-90.0, lt=90.0)]


@spec()
class Light:
    """One wavelength or direction that the mask serves, its weight, and its target phases."""

    wavelength_nm: Positive  #: Vacuum wavelength; one light has the unit cell's.
    weight: Positive = 1.0  #: Weight of its field overlap in the choice of each size.
    #: Angle of incidence in the x-z plane, in the medium of incidence, of light that travels towards +x; it needs
    #: `sweep.axes.angle_x_deg`.
    angle_x_deg: Angle = 0.0
    angle_y_deg: Angle = 0.0  #: Likewise in the y-z plane; a light has at most one of the two.
    #: Phase terms of this light; without the key those of the design, at this wavelength.
    phase: Annotated[tuple[PhaseTerm, ...] | None, Field(min_length=1)] = None

    @property
    def key(self) -> tuple[float, float, float]:
        """Wavelength and angles, which differ between the lights of a design."""
        return self.wavelength_nm, self.angle_x_deg, self.angle_y_deg

    @property
    def angles_deg(self) -> dict[str, float]:
        """Angles of incidence other than 0, by the name of the library's axis."""
        angles = {"angle_x_deg": self.angle_x_deg, "angle_y_deg": self.angle_y_deg}
        return {axis: angle for axis, angle in angles.items() if angle}

    @property
    def label(self) -> str:
        """Wavelength and direction in words."""
        return light_label(*self.key)


def light_label(wavelength_nm: float, angle_x_deg: float, angle_y_deg: float) -> str:
    """Return a light's wavelength and direction in words: "540 nm, 10 deg in x-z"."""
    angles = {"x": angle_x_deg, "y": angle_y_deg}
    return ", ".join([f"{wavelength_nm:.12g} nm", *(f"{at:g} deg in {axis}-z" for axis, at in angles.items() if at)])
