"""Phase terms of a design; a target phase is their sum."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from metafab.core.conventions import Polarisation
from metafab.spec.fields import Checked, Positive, Real, spec

#: Largest numbers of Zernike polynomials and of radial coefficients, those of Zemax' Binary 2 surface.
_MOST_ZERNIKES, _MOST_RADIAL = 231, 240


@spec()
class _Term(Checked):
    """Base of all phase terms."""

    deflects: ClassVar[bool] = False  #: Whether it sends all light in directions that its keys state, as a lens does.
    is_own: ClassVar[bool] = False  #: Whether its phase is the user's own, whose mean slope may deflect light.
    blurs: ClassVar[bool] = False  #: Whether a lens with this term images a point as something other than a spot.
    is_smooth: ClassVar[bool] = True  #: Whether the phase has no jumps, so that its slope is where its light goes.

    polarisation: Polarisation | None = None  #: Polarisation that the term acts on; both without the key.


@spec()
class SpiralZones(_Term):
    """Fresnel zones with topological charges 1 to ``zones`` from the centre outwards: Eq. 2 of Shen 2023.

    The y polarisation gets the point reflection, which makes the PSF pair conjugate.
    """

    blurs, is_smooth = True, False
    term: Literal["spiral_zones"] = "spiral_zones"
    #: Number of zones; zone number n has topological charge n.
    zones: Annotated[int, Field(strict=True, ge=1, le=64)] = 4
    exponent: Annotated[float, Field(strict=True, gt=0.0, le=16.0)] = 0.5  #: Exponent of the zones' radii.
    #: Optimisation of the rotating lobe, starting from the zones: of its mean peak over depth, its lowest peak, or
    #: the information about depth under unknown texture.
    optimise: Literal["none", "peak", "worst_peak", "blind_information"] = "none"
    #: Upper limit of side lobe over main lobe.
    side_lobe_limit: Annotated[float | None, Field(strict=True, gt=0.0, lt=1.0)] = None
    #: Whether the limit holds at the worst depth of a turn of the lobe, or for the mean over its depths.
    side_lobe_over: Literal["worst", "mean"] = "worst"

    def _faults(self) -> Iterator[str]:
        if self.zones == 1 and self.optimise != "none":
            yield "`zones` must be at least 2 to be optimised: a single zone does not turn with depth"
        if self.side_lobe_limit is not None and self.optimise != "peak":
            yield "`side_lobe_limit` needs `optimise` = 'peak'"


@spec()
class SplitLens(_Term):
    """Off-axis lenses, one for each polarisation: Eqs. 3 and 4 of Shen 2023."""

    deflects = True
    term: Literal["split_lens"] = "split_lens"
    #: Off-axis angle: x polarisation is focused at minus, y polarisation at plus this angle.
    angle_deg: Annotated[float, Field(strict=True, ge=0.0, lt=90.0)] = 8.0
    object_depth_m: Positive | None = None  #: Depth of the object in focus; collimated light without the key.


@spec()
class Lens(_Term):
    """A hyperbolic lens on the axis."""

    deflects = True
    term: Literal["lens"] = "lens"
    object_depth_m: Positive | None = None  #: Depth of the object in focus; collimated light without the key.


@spec()
class Vortex(_Term):
    """A spiral phase of integer charge."""

    blurs = True
    term: Literal["vortex"] = "vortex"
    charge: Annotated[int, Field(strict=True)] = 1  #: Topological charge.


@spec()
class Grating(_Term):
    """A linear phase."""

    deflects = True
    term: Literal["grating"] = "grating"
    angle_deg: Annotated[float, Field(strict=True, gt=-90.0, lt=90.0)] = 0.0  #: Deflection of normal incidence.
    azimuth_deg: Real = 0.0  #: Direction of the deflection, from x towards y.


@spec()
class Axicon(_Term):
    """A conical phase."""

    deflects = blurs = True
    term: Literal["axicon"] = "axicon"
    #: Deflection towards the axis; away from it if negative.
    angle_deg: Annotated[float, Field(strict=True, gt=-90.0, lt=90.0)] = 0.0


@spec()
class DoubleHelix(_Term):
    """A double helix of Gauss-Laguerre modes."""

    blurs, is_smooth = True, False
    term: Literal["double_helix"] = "double_helix"
    waist: Positive = 0.35  #: Waist of the modes in units of the aperture's radius.
    modes: Annotated[int, Field(strict=True, ge=2, le=8)] = 5  #: Number of Gauss-Laguerre modes.


@spec()
class Zernike(_Term):
    """A Zernike polynomial, normalised to 1 at the rim, times an amplitude."""

    is_own = True
    amplitude_rad: Real = 0.0  #: Phase at the rim.
    term: Literal["zernike"] = "zernike"
    degree: Annotated[int, Field(strict=True, ge=0, le=40)] = 0  #: Degree n.
    #: Order m, one of -n, -n + 2, ..., n; cos(m phi) if positive, sin(|m| phi) if negative.
    order: Annotated[int, Field(strict=True, ge=-40, le=40)] = 0

    def _faults(self) -> Iterator[str]:
        if abs(self.order) > self.degree or (self.degree - abs(self.order)) % 2:
            yield (
                f"`order` must be one of -{self.degree}, -{self.degree} + 2, ..., {self.degree} for this `degree`, "
                f"got {self.order}"
            )


@spec()
class Zernikes(_Term):
    """A sum of Zernike polynomials by their numbers in a named convention, from number 1 on."""

    is_own = True
    term: Literal["zernikes"] = "zernikes"
    coefficients_rad: tuple[Real, ...] = ()  #: Coefficients of numbers 1, 2, 3, ...; piston is the first.
    #: Numbers and norm: rms 1 over the circle for "noll", 1 at the rim for "fringe".
    convention: Literal["noll", "fringe"] = "noll"

    def _faults(self) -> Iterator[str]:
        if not 1 <= len(self.coefficients_rad) <= _MOST_ZERNIKES:
            yield (f"`coefficients_rad` must hold 1 to {_MOST_ZERNIKES} numbers, got {len(self.coefficients_rad)}")


@spec()
class Radial(_Term):
    """An even polynomial of the radius, as lens-design programs have it; a negative first coefficient focuses."""

    term: Literal["radial"] = "radial"
    coefficients: tuple[Real, ...] = ()  #: Coefficients of r^2, r^4, r^6, ...
    #: Zemax Binary 2 in order 1: radians, of r over ``norm_radius_um``. CODE V: optical path in mm, of r in mm.
    convention: Literal["binary2", "path_mm"] = "binary2"
    norm_radius_um: Positive | None = None  #: Norm radius of "binary2"; omitted: the radius of the aperture.

    def _faults(self) -> Iterator[str]:
        if not 1 <= len(self.coefficients) <= _MOST_RADIAL:
            yield f"`coefficients` must hold 1 to {_MOST_RADIAL} numbers, got {len(self.coefficients)}"
        if self.convention == "path_mm" and self.norm_radius_um is not None:
            yield "`norm_radius_um` belongs to `convention` = 'binary2'; with 'path_mm', r is in mm"


@spec()
class UserArray(_Term):
    """A phase map from a file."""

    is_own = True
    #: A .npy, .csv or .h5 file of phases in radians: shape (n_y, n_x), lowest y first, or (2, n_y, n_x) for x and y
    #: polarisation.
    file: Path = Field(kw_only=True)
    pitch_um: Positive = Field(kw_only=True)  #: Pitch of the square grid, which is centred on the axis.
    term: Literal["array"] = "array"
    dataset: str = "phase_rad"  #: Name of the map in an .h5 file.


@spec()
class Picture(_Term):
    """A hologram: with a lens, the phase that projects a picture onto the sensor."""

    blurs, is_smooth = True, False
    file: Path = Field(kw_only=True)  #: Picture to project: .png, .tif or .npy, its first row at the top.
    width_um: Positive = Field(kw_only=True)  #: Width of the projected picture.
    term: Literal["hologram"] = "hologram"


PhaseTerm = Annotated[
    SpiralZones
    | SplitLens
    | Lens
    | Radial
    | Vortex
    | Grating
    | Axicon
    | DoubleHelix
    | Zernike
    | Zernikes
    | UserArray
    | Picture,
    Field(discriminator="term"),
]


def forms_images(terms: Collection[str]) -> bool:
    """Whether a device of terms of these names images points: one with a lens or a user's array, and no hologram."""
    return not {"lens", "split_lens", "radial", "array"}.isdisjoint(terms) and "hologram" not in terms


def has_lobe(terms: Collection[str]) -> bool:
    """Whether a device of terms of these names may send its light to a lobe beside the image point."""
    own = not {"array", "zernike", "zernikes"}.isdisjoint(terms) and not {"lens", "split_lens"}.isdisjoint(terms)
    return own or not {"spiral_zones", "double_helix"}.isdisjoint(terms)
