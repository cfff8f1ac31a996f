"""PSFs of a full-Stokes lens over depth: at each of six places, one PSF for each Stokes parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.parallel.work import Work
from metafab.core.polarisation import JONES, ORTHOGONAL, stokes_of, stokes_response
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import Ray, power_at_aperture
from metafab.optics.propagation.image import bounding_box
from metafab.optics.propagation.kernel import KernelSpec, WindowKernel
from metafab.optics.propagation.pupil import Carrier, reduce_field
from metafab.optics.propagation.window import window_fields
from metafab.optics.sources.source import Source
from metafab.phase.jones_target import JonesTarget

#: Relative error of the propagation kernel's low-rank part.
_KERNEL_TOLERANCE = 1e-4
#: Sites along a side of a block. For Shen's lens and its tenth, blocks of 2 sites agree with single sites to 1e-3.
_BLOCK_SITES = 2


@dataclass(frozen=True)
class StokesPsf:
    """PSFs of six places over depth."""

    depth_m: FloatArray  #: Shape (n_depth,), ascending.
    pixel_um: float  #: Sampling step.
    #: Shape (6, 4, n_depth, n, n), irradiance about each place per unit power at the aperture, 1/um^2, for each Stokes
    #: parameter: light with the Stokes vector S has the irradiance sum_j psf[:, j] S_j.
    psf: FloatArray
    centre_um: FloatArray  #: Shape (6, 2), (x, y) of the six places on the sensor.
    sensor_distance_um: float  #: Distance of the sensor plane.
    #: Shape (n, 2), points of equal power of the aperture; None where it is not known.
    aperture_um: FloatArray | None = None

    @property
    def instrument(self) -> FloatArray:
        """Instrument matrix at the middle depth, shape (6, 4): power in each window per unit Stokes parameter."""
        return np.asarray(self.psf[:, :, self.depth_m.size // 2].sum(axis=(-2, -1)) * self.pixel_um**2)

    @property
    def efficiency(self) -> FloatArray:
        """Share of each state's power in its own window at the middle depth, shape (6,)."""
        return np.asarray(np.sum(self.instrument * stokes_of(JONES), axis=1))

    @property
    def extinction_ratio(self) -> FloatArray:
        """Efficiency of each state over that of the orthogonal state in the same window, shape (6,)."""
        unwanted = np.sum(self.instrument * stokes_of(JONES[list(ORTHOGONAL)]), axis=1)
        return np.asarray(self.efficiency / unwanted)


def stokes_psf(
    source: Source,
    target: JonesTarget,
    imaging: Imaging,
    depths_m: Sequence[float] | FloatArray,
    *,
    window_px: int = 64,
    work: Work = Work(),
) -> StokesPsf:
    """Compute the PSFs of a full-Stokes lens for points on the axis.

    Args:
        source: tiles whose three amplitudes are the Jones entries xx, xy = yx and yy: turned pillars or their target.
        target: places of the six images.
        imaging: wavelength, pixel, sensor, aperture.
        depths_m: shape (n_depth,), object depths, ascending.
        window_px: points along a side of each window.
        work: threads, and progress over tiles and places.
    """
    depth_m, focus_per_um = np.asarray(depths_m, dtype=np.float64), 1e-6 / target.focus_depth_m
    targets_um = [(x, y, imaging.sensor_distance_um) for x, y in target.places_um.tolist()]
    focused = [Ray(focus_per_um, (0.0, 0.0), target_um) for target_um in targets_um]
    carriers = [Carrier(entry, ray, _BLOCK_SITES) for ray in focused for entry in range(3)]
    pupils = reduce_field(source, carriers, imaging.wavenumber, work)
    k, lens_um = imaging.wavenumber, bounding_box(pupils)
    psf = np.empty((len(targets_um), 4, depth_m.size, window_px, window_px))
    for place, target_um in enumerate(targets_um):
        spec = KernelSpec(k, target_um, lens_um, window_px, imaging.pixel_um, _KERNEL_TOLERANCE)
        kernel = WindowKernel.build(spec)
        rays = [Ray(1e-6 / depth, (0.0, 0.0), target_um) for depth in depth_m.tolist()]
        entries = [window_fields(pupil, kernel, rays) for pupil in pupils[3 * place : 3 * place + 3]]
        for index, (ray, xx, xy, yy) in enumerate(zip(rays, *entries, strict=True)):
            per_unit_power = pupils[0].cell_um2 ** 2 / power_at_aperture(imaging, ray)
            psf[place, :, index] = stokes_response(xx, xy, xy, yy) * per_unit_power
        work.progress("psf", place + 1, len(targets_um))
    places_um, distance_um = target.places_um, imaging.sensor_distance_um
    return StokesPsf(depth_m, imaging.pixel_um, psf, places_um, distance_um, pupils[0].sub_apertures_um)
