"""The unit cell that is solved: one pillar, the layers around it, and the plane wave that lights it."""

from __future__ import annotations

import math
from collections.abc import Container
from dataclasses import dataclass, replace
from typing import Literal

from metafab.core.conventions import Side
from metafab.core.errors import Fault

#: Height at which a sloped pillar has the stated width and length.
SizesAt = Literal["bottom", "middle", "top"]
#: Cross-section within width and length; a cross is a rectangle united with itself turned by 90 degrees, a ring a
#: circle with a round hole.
Shape = Literal["rectangle", "ellipse", "cross", "ring"]


@dataclass(frozen=True)
class Slice:
    """A layer with one outline: a cap, a coating, a film, or one step of a sloped pillar."""

    height_nm: float  #: Thickness.
    n_inside: complex  #: Complex index within the outline.
    n_around: complex  #: Complex index around the outline; equal to ``n_inside`` for a closed film.
    #: Size of the outline along x, 0 to the period; by default the pillar's size where the two touch.
    width_nm: float | None = None
    length_nm: float | None = None  #: Size along y, likewise.


@dataclass(frozen=True, kw_only=True)
class PillarCell:
    """One unit cell under a plane wave."""

    period_nm: tuple[float, float]  #: (x, y) period.
    width_nm: float  #: Pillar size along x (at ``sizes_at``); 0 is an empty cell, the period a closed film.
    length_nm: float  #: Pillar size along y.
    height_nm: float  #: Pillar height.
    n_pillar: complex  #: Complex index of the pillar.
    n_substrate: tuple[complex, complex]  #: Complex index of the half space under the pillar, for x and y polarisation.
    n_ambient: complex  #: Complex index around and above the pillar.
    wavelength_nm: float  #: Vacuum wavelength.
    side: Side = "substrate"  #: Half space that the light comes from.
    #: Polar angle of incidence inside the incident half space, 0 to < 90; in a birefringent one, of the ordinary wave.
    angle_deg: float = 0.0
    azimuth_deg: float = 0.0  #: Azimuth of the plane of incidence, counter-clockwise from +x.
    #: Layers between substrate and pillar, from the substrate upwards. The reference planes of t and r are then the two
    #: ends of the whole stack.
    under: tuple[Slice, ...] = ()
    over: tuple[Slice, ...] = ()  #: Layers on the pillar, from the pillar upwards.
    #: Index of a birefringent substrate along z, for principal axes x, y and z; its waves are then solved as those of a
    #: tensor. Without it each polarisation has its own index, with light along z only.
    n_substrate_z: complex | None = None
    #: Angle between wall and substrate, inside the pillar: below 90 the pillar narrows upwards, above 90 downwards.
    sidewall_angle_deg: float = 90.0
    sizes_at: SizesAt = "middle"  #: Height at which the pillar has the stated width and length.
    #: Whether every other row of pillars is shifted by half a period (a hexagonal lattice); the period along y is then
    #: the distance of rows. rcwa only, with upright pillars, no layers, and light along z.
    is_staggered: bool = False
    #: Cross-section within width and length: a rectangle, an ellipse (a circle if both are equal), a cross or a ring.
    shape: Shape = "rectangle"
    corner_radius_nm: float = 0.0  #: Radius of the rectangle's four vertical edges, at most half a side.
    #: Diameter of the hole of a ring, between 0 and its width; the hole is filled with the ambient.
    hole_nm: float = 0.0

    @property
    def layer(self) -> Slice:
        """The layer of an upright pillar."""
        return Slice(self.height_nm, self.n_pillar, self.n_ambient)

    @property
    def is_shaped(self) -> bool:
        """Whether the cross-section is more than one rectangle."""
        return self.shape != "rectangle" or self.corner_radius_nm > 0.0

    @property
    def is_sloped(self) -> bool:
        """Whether the pillar's sizes change with height."""
        return self.sidewall_angle_deg != 90.0

    @property
    def is_birefringent(self) -> bool:
        """Whether the substrate is a tensor."""
        return self.n_substrate_z is not None and len({*self.n_substrate, self.n_substrate_z}) > 1

    @property
    def k0_per_nm(self) -> float:
        """Vacuum wave number, rad/nm."""
        return 2.0 * math.pi / self.wavelength_nm

    @property
    def far_side(self) -> Side:
        """Half space that the light goes to."""
        return "ambient" if self.side == "substrate" else "substrate"

    @property
    def n_in(self) -> tuple[complex, complex]:
        """Index of the half space that the light comes from, for x and y polarisation."""
        return self.n_substrate if self.side == "substrate" else (self.n_ambient, self.n_ambient)

    @property
    def n_out(self) -> tuple[complex, complex]:
        """Index of the half space that the light goes to, for x and y polarisation."""
        return (self.n_ambient, self.n_ambient) if self.side == "substrate" else self.n_substrate

    @property
    def n_of_angle(self) -> complex:
        """The index in which ``angle_deg`` is stated; the ordinary one of a birefringent half space."""
        n_x, n_y = self.n_in
        return n_x if n_x == n_y or self.side == "ambient" or self.n_substrate_z != n_y else n_y

    @property
    def in_plane(self) -> tuple[float, float]:
        """Wave vector (k_x, k_y) of the incident light in the plane of the cell, over k0."""
        k_in = complex(self.n_of_angle).real * math.sin(math.radians(self.angle_deg))
        cosine, sine = _direction(self.azimuth_deg)
        return k_in * cosine, k_in * sine

    def tensor(self, side: Side) -> tuple[complex, complex, complex] | None:
        """Principal indices of the half space on ``side``; None where it is not birefringent."""
        if side == "ambient" or not self.is_birefringent or self.n_substrate_z is None:
            return None
        return (*self.n_substrate, self.n_substrate_z)

    def sizes_nm(self, height_share: float) -> tuple[float, float]:
        """(width, length) of the pillar at a share of its height, 0 at the substrate and 1 at its top.

        An axis without walls (a size of the period) has no slope; nor has an empty cell.
        """
        if not self.is_sloped or 0.0 in (self.width_nm, self.length_nm):
            return self.width_nm, self.length_nm
        stated = {"bottom": 0.0, "middle": 0.5, "top": 1.0}[self.sizes_at]
        grown = 2.0 * (stated - height_share) * self.height_nm / math.tan(math.radians(self.sidewall_angle_deg))
        width = self.width_nm if self.width_nm == self.period_nm[0] else self.width_nm + grown
        return width, self.length_nm if self.length_nm == self.period_nm[1] else self.length_nm + grown

    def exchanged(self) -> PillarCell | None:
        """The cell with x and y exchanged, and the two polarisations with them.

        None for a hexagonal lattice, whose rows run along x, and for light at an angle, which has an azimuth.
        """
        if self.is_staggered or self.angle_deg != 0.0:
            return None
        under, over = (
            tuple(replace(each, width_nm=each.length_nm, length_nm=each.width_nm) for each in layers)
            for layers in (self.under, self.over)
        )
        return replace(
            self,
            period_nm=self.period_nm[::-1],
            width_nm=self.length_nm,
            length_nm=self.width_nm,
            n_substrate=self.n_substrate[::-1],
            under=under,
            over=over,
        )

    def untreated(self, purpose: str, treated: Container[str] = (), remedy: str = "") -> list[Fault]:
        """Faults of a cell that is more than an upright rectangle under light along the axis.

        Args:
            purpose: end of the sentence "expected ... for ``purpose``".
            treated: fields that may differ from the plain cell's.
            remedy: advice that each fault ends with.

        Returns:
            One fault for each field that differs and is not in ``treated``.
        """
        outlines = {"ellipse": "circles or ellipses", "cross": "crosses", "ring": "rings"}
        outline = outlines.get(self.shape, "rounded corners")
        special = {
            "angle_deg": (self.angle_deg != 0.0, "0", f"{self.angle_deg:g}"),
            "under, over": (bool(self.under or self.over), "no layers", "layers"),
            "sidewall_angle_deg": (self.is_sloped, "90", f"{self.sidewall_angle_deg:g}"),
            "n_substrate_z": (self.is_birefringent, "no index along z", f"{self.n_substrate_z}"),
            "is_staggered": (self.is_staggered, "a rectangular lattice", "a hexagonal one"),
            "shape, corner_radius_nm": (self.is_shaped, "a plain rectangle", f"{outline}: not available for these"),
        }
        return [
            Fault(name, f"{expected} for {purpose}", got, remedy)
            for name, (differs, expected, got) in special.items()
            if differs and name not in treated
        ]


def _direction(azimuth_deg: float) -> tuple[float, float]:
    """Cosine and sine, exact at multiples of 90 degrees, so that mirror planes are recognised."""
    quarter, rest = divmod(azimuth_deg, 90.0)
    c, s = (1.0, 0.0) if rest == 0.0 else (math.cos(math.radians(rest)), math.sin(math.radians(rest)))
    return ((c, s), (-s, c), (-c, -s), (s, -c))[int(quarter) % 4]
