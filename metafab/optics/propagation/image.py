"""Irradiance on a window of the sensor over depth, with its error; large windows are computed in panels.

The kernel of a large window has many low-rank terms. The kernel of a panel, whose ray goes to the panel's own centre,
has few, but the blocks must be refocused for each panel. A cost model with measured constants chooses the number of
panels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.numeric.chebyshev import Span, points_needed
from metafab.optics.geometry.imaging import Imaging, Tangent
from metafab.optics.geometry.path import JonesEntry, Ray, power_at_aperture
from metafab.optics.geometry.polarisation import Quantity, irradiance, weights
from metafab.optics.numerics import PsfNumerics, quantity_of
from metafab.optics.propagation.band import band_ends, band_irradiance, padded_px
from metafab.optics.propagation.kernel import KernelSpec, WindowKernel, largest_changes_rad
from metafab.optics.propagation.pupil import Pupil
from metafab.optics.propagation.window import component_fields

#: Depths whose error is estimated: all, the first and the last one, or none.
Judged = Literal["all", "ends", "none"]

#: Relative L2 error of an image by single precision.
_SINGLE_PRECISION_ERROR = 2e-6
#: Smaller singular values of a kernel are lost in rounding.
_FINEST_TOLERANCE = 1e-7
#: Change from blocks of twice the side, over the error of the blocks: a lower bound. Light that fills its blocks gives
#: 10 and more. Light in a few corners of its blocks converges with the square of the side, which gives 3; 2 is safe.
_COARSENING = 2.0
#: Cost model, measured on one core: a real operation of a matrix product, refocusing a block, an entry of the matrix
#: whose singular values split the kernel, and the fixed cost of a panel.
_SECONDS_PER_OPERATION = 3e-11
_SECONDS_PER_BLOCK = 8e-8
_SECONDS_PER_ENTRY = 4e-7
_SECONDS_PER_PANEL = 2e-3
#: Panels along a side of the window that are compared, and the smallest panel.
_PANELS_PER_SIDE = (1, 3, 5, 7, 9, 13, 17, 25, 33, 49, 65)
_SMALLEST_PANEL_PX = 16
#: Number of depths that share a panel's kernel in the cost model; fixed, so that errors do not depend on the stack.
_USUAL_DEPTHS = 8


@dataclass(frozen=True)
class Window:
    """Sampling and tolerance that all windows of a stack share."""

    imaging: Imaging  #: Wavelength, sensor plane, sampling.
    window_px: int  #: Points along a side.
    tolerance: float  #: Relative error of the kernel's low-rank rest.
    quantity: Quantity = "scalar"  #: Irradiance that is computed.
    scalar_error: float = 0.0  #: Error of scalar propagation, where it is used.
    panels: int | None = None  #: Panels along a side; None for the cheapest number.

    @classmethod
    def for_target(cls, imaging: Imaging, numerics: PsfNumerics) -> Window:
        """Return the window whose low-rank error is a sixth of the target error.

        The low-rank error is relative to the light that the lens can send to the window. A window below the size of a
        fringe may lie in the dark core of a vortex, where the field falls with the side to the power of the charge; a
        charge of two is provided for. Kernels of such small windows have few terms at any tolerance.
        """
        fringe_um = imaging.finest_fringe_um(0, (0.0, 0.0))
        share = min(1.0, numerics.window_px * imaging.pixel_um / fringe_um)
        tolerance = max(_FINEST_TOLERANCE, min(numerics.target_error / 12.0, 1e-3) * share**2)
        return cls(imaging, numerics.window_px, tolerance, *quantity_of(imaging, numerics))

    def irradiance(
        self,
        pyramid: Sequence[Pupil],
        polarisation: int,
        tangent: Tangent,
        depths_m: Sequence[float],
        *,
        judged: Judged = "all",
        entry: JonesEntry | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return PSFs about the geometric image point, shape (n_depth, n, n), and the error of each judged depth.

        The error of the blocks falls by three or more when their side is halved, as they are accurate to second order.
        Half of the change from blocks of twice the side is therefore an upper bound. Blocks of one site are exact. The
        error changes slowly with depth; over the field only the first and the last depth are judged.

        Args:
            pyramid: blocks of one polarisation, then blocks of twice the side, and so on.
            polarisation: polarisation of the image point, 0 for x, 1 for y.
            depths_m: shape (n_depth,), object depths.
            judged: depths whose errors are estimated.
            entry: of the Jones matrix of a birefringent substrate; by default ``polarisation`` behind and before it.
        """
        rays = [Ray.towards_image(self.imaging, polarisation, depth, tangent, entry) for depth in depths_m]
        pyramid = [pupil.towards(tangent) for pupil in pyramid[:2]]
        exact = pyramid[0].carrier.block_sites == 1 or len(pyramid) == 1
        indices = {"all": list(range(len(rays))), "ends": sorted({0, len(rays) - 1}), "none": []}[judged]
        ways = [(pyramid[0], rays)]
        if indices and not exact:
            ways.append((pyramid[1], [rays[index] for index in indices]))
        fine, *coarse = self._squared_fields(ways)
        errors = [
            (0.0 if exact else relative_l2(coarse[0][place], fine[index]) / _COARSENING)
            + 2.0 * self.tolerance
            + _SINGLE_PRECISION_ERROR
            + self.scalar_error
            for place, index in enumerate(indices)
        ]
        cell_um2 = pyramid[0].cell_um2
        per_unit_power = np.array([cell_um2**2 / power_at_aperture(self.imaging, ray) for ray in rays])
        return fine * per_unit_power[:, None, None], np.array(errors)

    def over_band(self, tangent: Tangent, filter_fwhm_nm: float | None) -> list[Window]:
        """Return the windows in which blocks are judged: this one, and with a filter its middle and both band ends."""
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
        numerics: PsfNumerics,
        *,
        judged: Judged = "all",
        entry: JonesEntry | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return :meth:`irradiance`, shape (n_depth, n, n), over the band of ``numerics``, and the errors."""
        if numerics.filter_fwhm_nm is None:
            return self.irradiance(pyramid, polarisation, tangent, depths_m, judged=judged, entry=entry)

        def monochromatic(imaging: Imaging, side_px: int, judge: bool) -> tuple[FloatArray, FloatArray]:
            there = replace(self, imaging=imaging, window_px=side_px)
            now: Judged = judged if judge else "none"
            return there.irradiance(pyramid, polarisation, tangent, depths_m, judged=now, entry=entry)

        return band_irradiance(
            monochromatic,
            self.imaging,
            polarisation,
            tangent,
            numerics.filter_fwhm_nm,
            self.window_px,
            numerics.block_error,
        )

    def stray_irradiance(
        self, pupil: Pupil, polarisation: int, tangent: Tangent, depths_m: Sequence[float]
    ) -> FloatArray:
        """Return the irradiance of ``pupil`` in the window of ``polarisation``, shape (n_depth, n, n)."""
        own = pupil.carrier.polarisation
        return self.irradiance([pupil], polarisation, tangent, depths_m, judged="none", entry=(own, own))[0]

    def panels_per_side(self, pupil: Pupil, target_um: tuple[float, float, float]) -> int:
        """Return the cheapest number of panels along a side; it is odd, as the middle of the window is bright."""
        if self.panels is not None:
            return self.panels
        counts = [count for count in _PANELS_PER_SIDE if count == 1 or count * _SMALLEST_PANEL_PX <= self.window_px]
        return min(counts, key=lambda count: self.seconds(pupil, target_um, count))

    def seconds(self, pupil: Pupil, target_um: tuple[float, float, float], panels: int) -> float:
        """Return the expected time on one core for one depth in ``panels`` x ``panels`` panels."""
        side = -(-self.window_px // panels)
        half = 0.5 * side * self.imaging.pixel_um
        changes = largest_changes_rad(self.imaging.wavenumber, target_um, bounding_box([pupil]), (-half, half))
        q_x, q_y, rest = (points_needed(change, self.tolerance) for change in changes)
        n_y, n_x = pupil.power.shape
        terms = 4.0 + rest * rest / 16.0
        gather = q_y * n_x * (12.0 * n_y + 8.0 * q_x)
        images = 8.0 * terms * side * q_y * (q_x + side)
        per_depth = _SECONDS_PER_OPERATION * (gather + images) + _SECONDS_PER_BLOCK * pupil.power.size
        kernel = _SECONDS_PER_PANEL + _SECONDS_PER_ENTRY * rest**4
        return float(panels**2 * (per_depth + kernel / _USUAL_DEPTHS))

    def _squared_fields(self, ways: Sequence[tuple[Pupil, Sequence[Ray]]]) -> list[FloatArray]:
        """Irradiance of each pupil behind its rays, shapes (n_ray, n, n). Each panel's kernel is built once."""
        (pupil, rays), n, pixel_um = ways[0], self.window_px, self.imaging.pixel_um
        k, box = self.imaging.wavenumber, bounding_box([blocks for blocks, _ in ways])
        centre_x, centre_y, distance_um = rays[0].target_um
        side = -(-n // self.panels_per_side(pupil, rays[0].target_um))
        squares = [np.empty((len(its_rays), n, n)) for _, its_rays in ways]
        factors = weights(self.quantity, rays[0].target_um, pupil.carrier.polarisation)
        for row, column in product(range(0, n, side), repeat=2):
            offset = side // 2 - n // 2
            target = (centre_x + (column + offset) * pixel_um, centre_y + (row + offset) * pixel_um, distance_um)
            kernel = WindowKernel.build(KernelSpec(k, target, box, side, pixel_um, self.tolerance))
            # The last panels may reach beyond the window.
            rows, columns = min(side, n - row), min(side, n - column)
            for (blocks, its_rays), square in zip(ways, squares, strict=True):
                for index, fields in enumerate(component_fields(blocks, kernel, its_rays, factors)):
                    part = irradiance(self.quantity, fields)
                    square[index, row : row + rows, column : column + columns] = part[:rows, :columns]
        return squares


def relative_l2(value: FloatArray, reference: FloatArray) -> float:
    """Return |value - reference| / |reference| of two arrays of the same shape; 0 where both are dark."""
    norm = float(np.linalg.norm(reference))
    difference = float(np.linalg.norm(np.asarray(value) - reference))
    return difference / norm if norm > 0.0 else (0.0 if difference == 0.0 else float("inf"))


def bounding_box(pupils: Sequence[Pupil]) -> tuple[Span, Span]:
    """Return the spans of x and y, um, that hold the sites of all blocks of all pupils."""

    def span(axis: int) -> Span:
        ends = []
        for pupil in pupils:
            centres, half = (pupil.x_um, pupil.y_um)[axis], 0.5 * (pupil.block_um[axis] - pupil.pitch_um[axis])
            ends += [float(centres[0]) - half, float(centres[-1]) + half]
        return min(ends), max(ends)

    return span(0), span(1)
