"""Psf, the result of :mod:`metafab.optics`: point-spread functions of both polarisations over depth and field."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import POLARISATIONS, FloatArray
from metafab.core.display import Displayed, dataset

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class PsfField:
    """The pair of PSFs over the field of view."""

    tangent_x: FloatArray  #: Shape (n_field_x,), object directions x/z, ascending.
    tangent_y: FloatArray  #: Shape (n_field_y,), object directions y/z, ascending.
    psf: NDArray[np.float32]  #: Shape (2, n_depth, n_field_y, n_field_x, n_y, n_x), as :attr:`Psf.psf`.
    centre_um: FloatArray  #: Shape (2, n_depth, n_field_y, n_field_x, 2), as :attr:`Psf.centre_um`.


@dataclass(frozen=True)
class NeighbourMap:
    """Light of pillars among their own neighbours against that among equal ones, in square blocks of sites.

    With a the amplitudes among their own neighbours, b those among equal ones, and means over a block; NaN without
    pillars.
    """

    x_um: FloatArray  #: Shape (n_x,), centres of the blocks.
    y_um: FloatArray  #: Shape (n_y,), likewise.
    change: FloatArray  #: Shape (2, n_y, n_x), sqrt(<|a - b|^2> / <|b|^2>) of x and y polarisation.
    kept: FloatArray  #: Shape (2, n_y, n_x), |<a b*>|^2 / <|b|^2>^2: light in the wave b, over all light of that wave.


@dataclass(frozen=True)
class PsfDetails:
    """Record of how a stack was computed, and its power budget."""

    block_sites: int = 0  #: Sites along a side of a pupil block.
    blocks: int = 0  #: Number of pupil blocks.
    #: Shape (2,), share of the power at the aperture that the pillars transmit, at the middle depth.
    transmitted: tuple[float, ...] = ()
    stray: tuple[float, ...] = ()  #: Shape (2,), share that is transmitted but misses the window.
    field_error: float = math.nan  #: Largest relative L2 error over the field points; NaN without a field.
    #: Relative L2 error of interpolation between field points, where it was measured; else NaN.
    field_interpolation_error: float = math.nan
    #: Rms error of the amplitudes of pillars as exposure and etch make them, over their rms; NaN for those of a file.
    #: Efficiencies may be off by about as much; ``error`` does not contain it.
    made_error: float = math.nan
    filter_fwhm_nm: float | None = None  #: Full width of the filter; None for one wavelength.
    seconds: float = 0.0  #: Wall-clock time of the computation.
    #: Parameters of the camera that the stack was fitted to; empty for a computed stack.
    camera_fit: Mapping[str, float] = field(default_factory=dict)

    @property
    def lost(self) -> tuple[float, ...]:
        """Share of the power at the aperture that is not transmitted, shape (2,)."""
        return tuple(1.0 - share for share in self.transmitted)

    def figures(self) -> dict[str, float]:
        """Return all computed entries, flat, by their names in summaries and files."""
        computed: dict[str, float] = {
            "block_sites": float(self.block_sites),
            "blocks": float(self.blocks),
            "field_error": self.field_error,
        }
        for index, name in enumerate(POLARISATIONS[: len(self.transmitted)]):
            computed[f"transmitted_{name}"] = self.transmitted[index]
            computed[f"stray_{name}"] = self.stray[index]
            computed[f"lost_{name}"] = self.lost[index]
        computed["seconds"] = self.seconds
        if self.filter_fwhm_nm is not None:
            computed["filter_fwhm_nm"] = self.filter_fwhm_nm
        if not math.isnan(self.field_interpolation_error):
            computed["field_interpolation_error"] = self.field_interpolation_error
        if not math.isnan(self.made_error):
            computed["made_error"] = self.made_error
        return {**(computed if self.blocks else {}), **self.camera_fit}

    @classmethod
    def of_figures(cls, figures: Mapping[str, float]) -> PsfDetails:
        """Inverse of :meth:`figures`; unknown names are parameters of a camera fit."""
        rest = dict(figures)
        known = [name for name in POLARISATIONS if f"transmitted_{name}" in rest]
        transmitted = tuple(rest.pop(f"transmitted_{name}") for name in known)
        stray = tuple(rest.pop(f"stray_{name}") for name in known)
        for name in known:
            del rest[f"lost_{name}"]
        return cls(
            block_sites=int(rest.pop("block_sites", 0)),
            blocks=int(rest.pop("blocks", 0)),
            transmitted=transmitted,
            stray=stray,
            field_error=rest.pop("field_error", math.nan),
            field_interpolation_error=rest.pop("field_interpolation_error", math.nan),
            made_error=rest.pop("made_error", math.nan),
            filter_fwhm_nm=rest.pop("filter_fwhm_nm", None),
            seconds=rest.pop("seconds", 0.0),
            camera_fit=rest,
        )


@dataclass(frozen=True, repr=False)
class Psf(Displayed):
    """Point-spread functions of both polarisations over depth, for objects on the axis or in one direction.

    Attributes:
        depth_m: shape (n_depth,), ascending.
        pixel_um: sampling step on the sensor plane.
        psf: shape (2, n_depth, n_y, n_x), irradiance at pixel centres, 1/um^2 per unit power of that polarisation at
            the aperture.
        centre_um: shape (2, n_depth, 2), (x, y) on the sensor of the centre pixel ``[n_y // 2, n_x // 2]``: the exact
            geometric image point.
        phi_deg: shape (n_depth,), orientation of the main lobe of PSF_x (:mod:`metafab.core.conventions`).
        error: shape (n_depth,), relative L2 error of the irradiance by the propagation alone.
        efficiency: shape (2, n_depth), share of the power at the aperture that falls into the window.
        extinction_ratio: shape (n_depth,), power of x over that of y polarised light in the window of x; NaN where both
            windows coincide.
        sensor_distance_um: distance of the sensor plane from the metasurface.
        field: the pair over the field of view; None for one direction.
        details: record of the computation.
        ghost: light that a birefringent substrate brings into the wrong image: irradiance in the window of each
            polarisation per unit power of the *other* polarisation at the aperture; None without such a substrate.
        aperture_um: shape (n, 2), (x, y) of points of the aperture that carry equal shares of its power
            (:mod:`metafab.optics.geometry.aperture`); None where the aperture is not known.
        neighbours: change of the pillars' light by their neighbours, over the aperture; None without a model of them.
    """

    depth_m: FloatArray
    pixel_um: float
    psf: FloatArray
    centre_um: FloatArray
    phi_deg: FloatArray
    error: FloatArray
    efficiency: FloatArray
    extinction_ratio: FloatArray
    sensor_distance_um: float
    field: PsfField | None = None
    details: PsfDetails = PsfDetails()
    ghost: Psf | None = None
    aperture_um: FloatArray | None = None
    neighbours: NeighbourMap | None = None

    def key_figures(self) -> dict[str, str]:
        """Depths, window, orientation, efficiency and error."""
        phi, efficiency = self.phi_deg, 100.0 * self.efficiency.mean(axis=1)
        return {
            "depths": f"{self.depth_m.size}, {self.depth_m[0]:g} to {self.depth_m[-1]:g} m",
            "window": f"{self.psf.shape[-1]} pixels of {self.pixel_um:g} um",
            "orientation": f"{phi[0]:.1f} to {phi[-1]:.1f} degrees",
            "efficiency x, y": ", ".join(f"{share:.1f} %" for share in efficiency),
            "relative error": f"{self.error.max():.1e}",
        }

    def to_xarray(self) -> xarray.Dataset:
        """PSFs over (polarisation, depth_m, y_um, x_um); places are relative to the geometric image point.

        MissingToolError if xarray is not installed.
        """
        n_y, n_x = self.psf.shape[-2:]
        image = ("polarisation", "depth_m", "y_um", "x_um")
        variables = {
            "psf": (image, self.psf, "1/um^2"),
            "efficiency": (image[:2], self.efficiency, ""),
            "phi_deg": (("depth_m",), self.phi_deg, "degree"),
            "error": (("depth_m",), self.error, ""),
            "extinction_ratio": (("depth_m",), self.extinction_ratio, ""),
        }
        coordinates = {
            "polarisation": list(POLARISATIONS),
            "depth_m": self.depth_m,
            "y_um": (np.arange(n_y) - n_y // 2) * self.pixel_um,
            "x_um": (np.arange(n_x) - n_x // 2) * self.pixel_um,
        }
        return dataset(variables, coordinates)
