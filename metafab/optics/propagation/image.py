"""Irradiance on a window of the sensor over depth, with its error: panel after panel, where the window is large.

One kernel of a large window has many terms. Cut into panels, each with a ray to its own centre, the same light takes
few terms again, but the blocks are refocused for each panel. How many panels are cheapest a cost model says, whose
constants were measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import Ray, power_at_aperture
from metafab.optics.propagation.band import band_ends, band_irradiance, padded_px
from metafab.optics.propagation.chebyshev import Span, points_needed
from metafab.optics.propagation.kernel import WindowKernel, largest_changes_rad
from metafab.optics.propagation.pupil import Pupil
from metafab.optics.propagation.refocus import refocus
from metafab.optics.propagation.window import WindowTransform

Tangent = tuple[float, float]
#: Whether the error of all depths is judged, of the first and the last one, or of none.
Judged = Literal["all", "ends", "none"]

_SINGLE_PRECISION_ERROR = 2e-6
#: Below, singular values of kernels are lost in rounding.
_FINEST_TOLERANCE = 1e-7
#: How much more blocks of twice the side err than they change at least. Light that fills its blocks gives 10 and more;
#: light in a few corners of them converges with the square of the side, which makes it 3, and 2 is safe.
_HALVING = 2.0
#: Measured on one core: a real operation of a matrix product, a block refocused on a ray, an entry of the matrix
#: whose singular values split the kernel's rest, and what a panel takes however small it is.
_SECONDS_PER_OPERATION = 3e-11
_SECONDS_PER_BLOCK = 8e-8
_SECONDS_PER_ENTRY = 4e-7
_SECONDS_PER_PANEL = 2e-3
_PANELS_A_SIDE = (1, 3, 5, 7, 9, 13, 17, 25, 33, 49, 65)
_SMALLEST_PANEL_PX = 16
#: Depths over which the cost model spreads a panel's kernel: the same for any stack, so that errors are the same.
_USUAL_DEPTHS = 8


@dataclass(frozen=True)
class Panel:
    """A square part of a window: its first row and column, and its side, which may reach beyond the window."""

    row: int
    column: int
    side_px: int

    def target_um(
        self, centre_um: tuple[float, float, float], window_px: int, pixel_um: float
    ) -> tuple[float, float, float]:
        """The panel's centre point; ``centre_um`` is the window's."""
        x, y = (
            centre + (start + self.side_px // 2 - window_px // 2) * pixel_um
            for centre, start in zip(centre_um, (self.column, self.row), strict=False)
        )
        return x, y, centre_um[2]

    def inside(self, window_px: int) -> tuple[slice, slice]:
        """Rows and columns of the window that the panel covers."""
        rows, columns = (slice(first, min(first + self.side_px, window_px)) for first in (self.row, self.column))
        return rows, columns


@dataclass(frozen=True)
class Window:
    """What all windows of a stack share.

    Attributes:
        imaging: wavelength, sensor plane, sampling.
        window_px: points a side.
        tolerance: relative error of the kernel's low-rank part.
    """

    imaging: Imaging
    window_px: int
    tolerance: float

    @classmethod
    def for_target(cls, imaging: Imaging, window_px: int, target_error: float) -> Window:
        """The window whose low rank takes a fifth of the target.

        What low rank errs by is of the light that the lens can send there. A window smaller than a fringe may hold
        nothing but a dark core, whose field falls as its side or faster, to the power of the vortex' charge: two is
        provided for. Kernels of such windows have few terms at any tolerance.
        """
        fringe_um = imaging.finest_fringe_um(0, (0.0, 0.0))
        share = min(1.0, window_px * imaging.pixel_um / fringe_um)
        return cls(imaging, window_px, max(_FINEST_TOLERANCE, min(0.1 * target_error, 1e-3) * share**2))

    def irradiance(
        self,
        pyramid: Sequence[Pupil],
        polarisation: int,
        tangent: Tangent,
        depths_m: Sequence[float],
        *,
        judged: Judged = "all",
    ) -> tuple[FloatArray, FloatArray]:
        """PSFs about the geometric image point, shape (n_depth, n, n), and the error of each that is judged.

        Blocks are followed to second order in their size, so that twice the size has three times the error or
        more: half of the change from twice the size is a bound. Blocks of one site are exact. The error
        changes slowly with depth; over the field only the first and the last depth are judged.

        Args:
            pyramid: the blocks to use, then those of twice the side, and so on.
            polarisation: of the image point, 0 for x, 1 for y.
            tangent: object direction.
            depths_m: object depths.
            judged: which depths' errors are judged.
        """
        rays = [Ray.towards_image(self.imaging, polarisation, depth, tangent) for depth in depths_m]
        exact = pyramid[0].carrier.block_sites == 1 or len(pyramid) == 1
        last = len(rays) - 1
        places = {"all": range(len(rays)), "ends": sorted({0, last}), "none": ()}[judged]
        ways = [(pyramid[0], rays)]
        if places and not exact:
            ways.append((pyramid[1], [rays[index] for index in places]))
        fine, *coarse = self._powers(ways)
        errors = [
            (0.0 if exact else relative_l2(coarse[0][place], fine[index]) / _HALVING)
            + 2.0 * self.tolerance
            + _SINGLE_PRECISION_ERROR
            for place, index in enumerate(places)
        ]
        return fine * self._per_unit_power(pyramid[0], rays), np.array(errors)

    def over_band(self, tangent: Tangent, filter_fwhm_nm: float | None) -> list[Window]:
        """This window, and where there is a filter those of its middle and ends: the ones whose blocks are judged."""
        if filter_fwhm_nm is None:
            return [self]
        side_px = padded_px(self.imaging, tangent, filter_fwhm_nm, self.window_px)
        lights = (self.imaging, *band_ends(self.imaging, filter_fwhm_nm))
        return [self, *(replace(self, imaging=light, window_px=side_px) for light in lights)]

    def light(
        self,
        pyramid: Sequence[Pupil],
        polarisation: int,
        tangent: Tangent,
        depths_m: Sequence[float],
        filter_fwhm_nm: float | None,
        target_error: float,
        *,
        judged: Judged = "all",
    ) -> tuple[FloatArray, FloatArray]:
        """As :meth:`irradiance`, in the light of a filter or, where it is None, of one wavelength."""
        if filter_fwhm_nm is None:
            return self.irradiance(pyramid, polarisation, tangent, depths_m, judged=judged)

        def monochromatic(imaging: Imaging, side_px: int, judge: bool) -> tuple[FloatArray, FloatArray]:
            there = replace(self, imaging=imaging, window_px=side_px)
            return there.irradiance(pyramid, polarisation, tangent, depths_m, judged=judged if judge else "none")

        return band_irradiance(
            monochromatic, self.imaging, polarisation, tangent, filter_fwhm_nm, self.window_px, target_error
        )

    def stray_irradiance(
        self, pupil: Pupil, polarisation: int, tangent: Tangent, depths_m: Sequence[float]
    ) -> FloatArray:
        """Irradiance of ``pupil``'s light in the window of ``polarisation``, shape (n_depth, n, n)."""
        return self.irradiance([pupil], polarisation, tangent, depths_m, judged="none")[0]

    def panels_a_side(self, pupil: Pupil, target_um: tuple[float, float, float]) -> int:
        """The cheapest number of panels along a side of the window, by the cost model; odd, as the middle is bright."""
        counts = [count for count in _PANELS_A_SIDE if count == 1 or count * _SMALLEST_PANEL_PX <= self.window_px]
        return min(counts, key=lambda count: self.seconds(pupil, target_um, count))

    def seconds(self, pupil: Pupil, target_um: tuple[float, float, float], panels: int) -> float:
        """What the cost model expects of one core for a depth in ``panels`` x ``panels`` panels."""
        side = -(-self.window_px // panels)
        half = 0.5 * side * self.imaging.pixel_um
        changes = largest_changes_rad(self.imaging.wavenumber, target_um, _box([pupil]), (-half, half))
        q_x, q_y, rest = (points_needed(change, self.tolerance) for change in changes)
        n_y, n_x = pupil.power.shape
        terms = 4.0 + rest * rest / 16.0
        gather = 12.0 * q_y * n_x * (n_y + q_x)
        images = 16.0 * terms * side * q_y * (q_x + side)
        per_depth = _SECONDS_PER_OPERATION * (gather + images) + _SECONDS_PER_BLOCK * pupil.power.size
        kernel = _SECONDS_PER_PANEL + _SECONDS_PER_ENTRY * rest**4
        return float(panels**2 * (per_depth + kernel / _USUAL_DEPTHS))

    def _powers(self, ways: Sequence[tuple[Pupil, Sequence[Ray]]]) -> list[FloatArray]:
        """Squared fields of each pupil behind its rays, (n_ray, n, n) each; panels' kernels are built once."""
        (pupil, rays), n, pixel_um = ways[0], self.window_px, self.imaging.pixel_um
        k, box = self.imaging.wavenumber, _box([blocks for blocks, _ in ways])
        powers = [np.empty((len(wanted), n, n)) for _, wanted in ways]
        for panel in _panels(n, self.panels_a_side(pupil, rays[0].target_um)):
            target = panel.target_um(rays[0].target_um, n, pixel_um)
            kernel = WindowKernel.build(k, target, box, panel.side_px, pixel_um, self.tolerance)
            rows, columns = panel.inside(n)
            for (blocks, wanted), power in zip(ways, powers, strict=True):
                transform = WindowTransform.build(blocks, kernel)
                for index, ray in enumerate(wanted):
                    field = transform.field(refocus(blocks, replace(ray, target_um=target), k)).astype(np.complex128)
                    square = field.real**2 + field.imag**2
                    power[index, rows, columns] = square[: rows.stop - rows.start, : columns.stop - columns.start]
        return powers

    def _per_unit_power(self, pupil: Pupil, rays: Sequence[Ray]) -> FloatArray:
        return np.array([pupil.cell_um2**2 / power_at_aperture(self.imaging, ray) for ray in rays])[:, None, None]


def relative_l2(value: FloatArray, reference: FloatArray) -> float:
    """|value - reference| / |reference|; 0 where both are dark."""
    norm = float(np.linalg.norm(reference))
    difference = float(np.linalg.norm(np.asarray(value) - reference))
    return difference / norm if norm > 0.0 else (0.0 if difference == 0.0 else float("inf"))


def _box(pupils: Sequence[Pupil]) -> tuple[Span, Span]:
    x, y = (
        (min(float(axis[0]) for axis in axes), max(float(axis[-1]) for axis in axes))
        for axes in ([p.x_um for p in pupils], [p.y_um for p in pupils])
    )
    return x, y


def _panels(window_px: int, count: int) -> list[Panel]:
    side = -(-window_px // count)
    starts = range(0, window_px, side)
    return [Panel(row, column, side) for row in starts for column in starts]
