"""What is made and what stands around it: the lens, the design rules of the process, the sensor, other optics."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from metafab.core.conventions import FloatArray
from metafab.spec.fields import Checked, Flag, NonNegative, Positive, Real, spec

#: Largest aperture (um).
LARGEST_APERTURE_UM = 300_000.0


@spec(kw_only=True)
class Device(Checked):
    """The lens: aperture and focal length.

    Helices are optimised for the full circle or square, whatever the outline.
    """

    #: Diameter or side of the aperture.
    aperture_um: Annotated[float, Field(strict=True, gt=0.0, le=LARGEST_APERTURE_UM)]
    focal_length_mm: Positive  #: Focal length for collimated light.
    aperture_shape: Literal["circle", "square", "ring", "polygon"] = "circle"  #: Shape of the aperture.
    inner_um: NonNegative = 0.0  #: Diameter of the circle that a ring excludes.
    #: Vertices (x, y) of a polygon, relative to the axis, within the square of side `aperture_um`.
    outline_um: tuple[tuple[Real, Real], ...] = ()

    def _faults(self) -> Iterator[str]:
        if (self.aperture_shape == "ring") != (self.inner_um > 0.0) or self.inner_um >= self.aperture_um:
            yield "`inner_um` must be between 0 and `aperture_um` for a ring, and not given otherwise"
        if (self.aperture_shape == "polygon") != bool(self.outline_um):
            yield "`outline_um` must be given for a polygon, and not otherwise"
        if not self.outline_um:
            return
        if len(self.outline_um) < 3 or not (polygon := shapely.Polygon(self.outline_um)).is_valid or not polygon.area:
            yield "`outline_um` must be the vertices of one polygon whose edges do not cross or touch"
        if max(abs(u) for vertex in self.outline_um for u in vertex) > 0.5 * self.aperture_um:
            yield "`outline_um` must lie within the square of side `aperture_um` about the axis"

    def encloses(self, x_um: FloatArray, y_um: FloatArray) -> NDArray[np.bool_]:
        """Whether grid points at x, shape (n_x,), and y lie in the aperture, its rim included: shape (n_y, n_x)."""
        return self.contains(x_um[None, :], y_um[:, None])

    def contains(self, x_um: FloatArray, y_um: FloatArray) -> NDArray[np.bool_]:
        """Mask of points (x, y) within the aperture, its rim included; the arguments broadcast."""
        half = 0.5 * self.aperture_um
        if self.aperture_shape == "square":
            return np.asarray((np.abs(y_um) <= half) & (np.abs(x_um) <= half))
        if self.aperture_shape == "polygon":
            return np.asarray(shapely.intersects_xy(shapely.Polygon(self.outline_um), *np.broadcast_arrays(x_um, y_um)))
        square = y_um**2 + x_um**2
        within: NDArray[np.bool_] = square <= half * half
        if self.aperture_shape == "ring":
            within &= square >= (0.5 * self.inner_um) ** 2
        return within


def _no_number(value: object) -> object:
    """Refuse 0 and 1, which are equal to false and true."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        raise ValueError('must be false, true or "table"')
    return value


@spec()
class Rules(Checked):
    """Design rules of the process."""

    min_gap_nm: Positive = 100.0  #: Smallest gap between drawn pillars.
    min_feature_nm: Positive = 100.0  #: Smallest width and length of a drawn pillar.
    max_aspect_ratio: Positive | None = None  #: Largest height over shorter side.
    #: How gaps are kept: "each" limits every width and length to the period minus the gap; with "pairs" a pillar may be
    #: larger where its neighbours leave room.
    gap_rule: Literal["each", "pairs"] = "each"
    #: Standard deviation of a common bias of width and length in fabrication; the mapping then avoids sizes with a
    #: steep phase.
    cd_sigma_nm: NonNegative = 0.0
    #: Whether sizes are chosen for the light of pillars among their own neighbours, by the library's model: true for
    #: each pillar by itself, "table" by one table of sizes over the target phases, made from a sample of the mask.
    neighbours: Annotated[Literal[False, True, "table"], BeforeValidator(_no_number)] = False
    #: Use only sizes that respond equally to both polarisations by symmetry: equal width and length, or crosses, in a
    #: square cell.
    polarisation_independent: Flag = False
    #: Constant part of the phase of y polarisation minus that of x: "kept" as the phase terms say, which wave plates
    #: need, or "free" to suit the library; "auto" keeps it where the terms of x and y differ by a constant other than
    #: 0.
    retardance: Literal["auto", "kept", "free"] = "auto"

    def _faults(self) -> Iterator[str]:
        if self.cd_sigma_nm and self.gap_rule == "pairs":
            yield '`cd_sigma_nm` weighs sizes one by one; it goes with `gap_rule = "each"`'
        if self.neighbours and (self.gap_rule == "pairs" or self.cd_sigma_nm):
            yield '`neighbours` goes with `gap_rule = "each"` and `cd_sigma_nm = 0`'


@spec()
class Sensor:
    """The image sensor: pixel pitch, and the object depth for which it is in focus."""

    pixel_um: Positive  #: Pixel pitch.
    focus_depth_m: Positive  #: Depth of an object that is in focus on the sensor.


@spec()
class Optics(Checked):
    """Optical elements besides the lens; each is optional.

    Efficiencies remain relative to the light on the device's aperture.
    """

    #: Full width at half maximum of a colour filter centred on the wavelength.
    filter_fwhm_nm: Annotated[float | None, Field(strict=True, gt=0.0, le=100.0)] = None
    #: Thickness of the substrate between scene and pillars: a plane-parallel plate.
    substrate_um: Annotated[float, Field(strict=True, ge=0.0, le=20_000.0)] = 0.0
    stop_um: Positive | None = None  #: Diameter of a round stop in the plane of the pillars.
    #: Amplitude transmission (0 to 1) in that plane: a .npy, .csv or .h5 file, shape (n_y, n_x), lowest y first.
    amplitude_file: Path | None = None
    amplitude_pitch_um: Positive | None = None  #: Pitch of that file's square grid, which is centred on the axis.
    amplitude_dataset: str = "amplitude"  #: Name of the map in an .h5 file.
    #: Whether the light of a pillar depends on its neighbours; by default where the library's model of them lowers the
    #: error.
    neighbours: Flag | None = None
    #: Whether the light of a pillar depends on the direction from which it comes, of those of the scene's field; by
    #: default where that changes the field by more than the library's model of neighbours errs. Pillars must be upright
    #: rectangles on a clear isotropic substrate. Printed and measured pillars keep their light along the axis.
    oblique: Flag | None = None

    def _faults(self) -> Iterator[str]:
        if (self.amplitude_file is None) != (self.amplitude_pitch_um is None):
            yield "`amplitude_file` and `amplitude_pitch_um`, its sample pitch, must be given together"
