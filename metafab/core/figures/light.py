"""Figures of the light behind a mask: overlap and losses, aberrations, focus, diffraction orders, tolerances."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from metafab.core.conventions import FloatArray
from metafab.core.storage.tables import optional


@dataclass(frozen=True)
class Wavefront:
    """Overlap of the field behind a mask with the target wave, for x and y polarisation."""

    overlap: tuple[float, float]  #: |<a u*>|^2 / <|a|^2> over sites with a pillar.
    error: tuple[float, float]  #: Statistical error of ``overlap``, as rows are sampled.
    best_overlap: tuple[float, float]  #: Overlap with continuous sizes, chosen as in the mapping.
    filled: float  #: Share of the sites in the aperture that carry a pillar.
    sites: int  #: Number of sampled sites with a pillar.


@dataclass(frozen=True)
class Loss:
    """One factor of the loss chain."""

    stage: str  #: Cause of the loss.
    factor: tuple[float, float] | None  #: Remaining share of x and of y polarised light; None if it was not measured.


@dataclass(frozen=True)
class SpaceVariance:
    """Image points and aberrations of both polarisations over a grid of object directions."""

    tangent_x: FloatArray  #: Shape (n_x,), x/z of the object.
    tangent_y: FloatArray  #: Shape (n_y,), y/z of the object.
    defocus_dioptre: FloatArray  #: Shape (2, n_y, n_x), change of vergence, positive as for a nearer object.
    astigmatism_dioptre: FloatArray  #: Shape (2, n_y, n_x), half the vergence along x minus that along y.
    distortion_um: FloatArray  #: Shape (2, n_y, n_x, 2), deviation from the image by a pinhole at the lens centre.


@dataclass(frozen=True)
class AberrationFigures:
    """Wavefront behind a lens against the sphere about its image point, in waves, positive where light arrives late.

    The image point of a design with phases of its own lies where their mean slope sends the light, which for coma is
    not the peak: the coefficients then have a tilt. Rms, Strehl ratio and map leave out piston and tilt, by the plane
    of least squares, since a tilt moves the image and does not blur it.

    Coefficients are those of least squares, weighted by power, over the circle of ``radius_um``. Fringe coefficients
    are amplitudes at the rim, Noll coefficients rms values.
    """

    polarisation: Literal["x", "y"]  #: Polarisation of the light.
    depth_m: float  #: Object depth.
    radius_um: float  #: Radius of the unit circle of the polynomials, half the aperture.
    rms_waves: float  #: Rms about the plane, weighted by power, over places within the circle.
    residual_waves: float  #: Rms of what the Noll polynomials leave.
    strehl_of_phase: float  #: Strehl ratio that these phases leave: |mean field|^2 over that without phase errors.
    noll_waves: FloatArray  #: Shape (36,), Noll coefficients from number 1, the piston.
    fringe_waves: FloatArray  #: Shape (36,), fringe coefficients from number 1, the piston.
    x_um: FloatArray  #: Shape (n_x,), middles of some blocks of pillars.
    y_um: FloatArray  #: Shape (n_y,).
    opd_waves: FloatArray  #: Shape (n_y, n_x), wavefront error about the plane; NaN where a block is dark.


@dataclass(frozen=True)
class FocusFigures:
    """Focus of a lens on the sensor, beside that of the ideal flat lens of its aperture, sharp at the focus depth.

    Widths are those of the density of electric energy in unpolarised light, the mean of both polarisations about their
    image points. Shares and the Strehl ratio are those of the flux.
    """

    depth_m: float  #: Object depth, the focus depth.
    numerical_aperture: float  #: Sine of half the angle of the aperture at the image point.
    #: Full width at half maximum along x through the maximum; likewise along y; NaN where the window is too narrow.
    fwhm_x_um: float
    fwhm_y_um: float
    fwhm_limit_um: float  #: That of the ideal lens, mean of both axes.
    #: Shape (2, 2), widths of x and of y polarised light along x and y.
    fwhm_polarised_um: tuple[tuple[float, ...], ...]
    fwhm_polarised_limit_um: tuple[tuple[float, ...], ...]  #: Shape (2, 2), those of the ideal lens.
    strehl: float  #: Maximum per transmitted power over that of the ideal lens.
    encircled_radius_um: float  #: 0.61 wavelength / NA, the radius of Airy's first dark ring.
    encircled_energy: float  #: Share of the transmitted light within that radius about the maximum.
    encircled_energy_limit: float  #: That of the ideal lens.
    offset_um: FloatArray  #: Shape (n,), distance from the maximum.
    section_x: FloatArray  #: Shape (n,), cross-section along x over the maximum; likewise along y.
    section_y: FloatArray
    section_limit: FloatArray  #: Shape (n,), cross-section of the ideal lens along x.
    radius_um: FloatArray  #: Shape (m,), radii of ``encircled`` and ``encircled_limit``.
    encircled: FloatArray  #: Shape (m,), share of the transmitted light within the radius.
    encircled_limit: FloatArray  #: Shape (m,), that of the ideal lens.


@dataclass(frozen=True, kw_only=True)
class OrderFigures:
    """One transmitted order of a mask whose pattern repeats, for one incident polarisation."""

    polarisation: Literal["x", "y"]  #: Polarisation of the incident light.
    order: tuple[int, ...]  #: Orders (m, n) of the repeat along x and y.
    angle_x_deg: float  #: Angle behind the mask whose sine is the direction's component along x; likewise y.
    angle_y_deg: float
    efficiency: float  #: Power over the incident power, by full wave.
    library_efficiency: float  #: The same by the library, each pillar among equal ones.
    error: float  #: Bound on the error of ``efficiency``: of the solver, and of the windows that were not solved.
    wanted: bool  #: Whether the library's light is at least half as bright as in its brightest order.


@dataclass(frozen=True, kw_only=True)
class OrdersFigures:
    """Orders of a mask whose pattern repeats, far from its rim, by full wave."""

    reason: str | None = optional()  #: Why they were not solved.
    sites: tuple[int, ...] | None = optional()  #: Pillars of a repeat along x and y.
    windows: int | None = optional()  #: Unlike repeats that were solved.
    coupling_error: float | None = optional()  #: Relative L2 error of the library's field.
    #: Of a steep lens: light in the wanted order of its rows by full wave, over that by the library.
    efficiency_ratio: float | None = optional()
    #: Wanted orders, and all others of 3 % of the light or more, brightest first, x then y polarisation.
    orders: tuple[OrderFigures, ...] = ()

    def wanted(self, polarisation: str) -> tuple[float, float, float]:
        """Efficiency, error and the library's efficiency, summed over the wanted orders of a polarisation."""
        rows = [row for row in self.orders if row.wanted and row.polarisation == polarisation]
        return (
            sum(row.efficiency for row in rows),
            sum(row.error for row in rows),
            sum(row.library_efficiency for row in rows),
        )

    @property
    def label(self) -> str:
        """Label of the sentence; rows of a lens measure the effect of neighbours, not orders."""
        return "wanted orders" if self.efficiency_ratio is None else "neighbours"

    @property
    def sentence(self) -> str:
        """Light in the wanted orders in words, or why it comes from the library alone."""
        if self.efficiency_ratio is not None:
            return (
                f"{self.windows} rows of the lens by full wave bring {self.efficiency_ratio:.2g} times the library's "
                "light into the focusing order: efficiency and peak are off by about that factor"
            )
        if self.sites is None:
            return f"by the library alone: {self.reason}"
        shares = [self.wanted(p) for p in ("x", "y")]
        text = ", ".join(
            f"{100 * e:.1f} ± {float(f'{100 * d:.1g}'):g} % of {p}" for p, (e, d, _) in zip("xy", shares, strict=True)
        )
        library = ", ".join(f"{100 * of_library:.1f}" for _, _, of_library in shares)
        return (
            f"{text} polarised light, by full wave of {self.sites[0]} x {self.sites[1]} pillars (library {library} %)"
        )


@dataclass(frozen=True)
class ToleranceRow:
    """One corner compared with the nominal mask; each figure is the worst of both polarisations and all depths.

    For random faults, ``change``, ``turn_deg`` and ``depth_error_m`` are the rms over the draws, the others their mean.
    """

    corner: str  #: Name of the corner or fault.
    change: float  #: Relative L2 change of the irradiance.
    peak_ratio: float  #: Smallest peak over the nominal peak.
    efficiency: float  #: Smallest share of the power in the window.
    efficiency_change: float  #: Signed change of ``efficiency`` where its modulus is largest.
    #: Smallest ratio of wanted over unwanted light in the window of x; NaN where one window holds both polarisations.
    extinction_ratio: float
    #: Signed turn of the main lobe of PSF_x where its modulus is largest; NaN where the lobe lies on the image point.
    turn_deg: float
    #: Signed error of the decoded depth where its modulus is largest, over finite depths; NaN where the pair does not
    #: turn, no trial depth agrees, or one window holds both images.
    depth_error_m: float
    #: Relative error of these changes, from the error of the corner's amplitudes or the number of draws.
    relative_error: float
    draws: int = 0  #: Number of random masks; 0 for a corner of the cell.
    solved: int = 0  #: Number of cells solved for the row.
    #: Whether the change of the PSFs is within their error, so that the row is an upper bound.
    below_error: bool = False
    #: Full width at half maximum of a lens' focus along x, and along y, at the focus depth, as in
    #: :class:`FocusFigures`; NaN for other devices and where the window is too narrow.
    fwhm_x_um: float = math.nan
    fwhm_y_um: float = math.nan
    strehl: float = math.nan  #: Strehl ratio there, likewise.


@dataclass(frozen=True)
class ToleranceTable:
    """All fabrication corners of a mask."""

    depth_m: FloatArray  #: Shape (n_depth,), object depths.
    error: float  #: Relative L2 error of any PSF; smaller changes are not significant.
    block_sites: int  #: Lattice sites along the side of a pupil block.
    nominal: ToleranceRow  #: The mask without faults.
    rows: tuple[ToleranceRow, ...]  #: Corners and random faults.
