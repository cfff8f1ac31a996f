"""What each of the six places makes of a point of any polarisation, over depth: four PSFs a place, one a parameter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.parallel.progress import Progress, silent
from metafab.layout import Lattice
from metafab.optics import Imaging
from metafab.optics.geometry.path import Ray, power_at_aperture
from metafab.optics.propagation.kernel import WindowKernel
from metafab.optics.propagation.pupil import Carrier, reduce_field
from metafab.optics.propagation.refocus import refocus
from metafab.optics.propagation.window import WindowTransform
from metafab.optics.sources.source import FieldTile
from metafab.spec import Device
from metafab.spec.outline import encloses
from metafab.stokes.bases import response_of
from metafab.stokes.target import StokesProfile, nearest_unitary

_TOLERANCE = 1e-4
_TILE_SITES = 256


class JonesSource(Protocol):
    """Tiles whose three "polarisations" are the entries xx, xy = yx and yy of Jones matrices."""

    @property
    def lattice(self) -> Lattice:
        """Where the sites are."""

    def tiles(self) -> Iterator[FieldTile]:
        """Tiles that cover the lattice once."""


@dataclass(frozen=True)
class UnitaryField:
    """The nearest lossless matrices to the target: what perfect pillars would give."""

    profile: StokesProfile
    lattice: Lattice
    device: Device

    def tiles(self) -> Iterator[FieldTile]:
        """Bands of rows."""
        x_um, y_um = self.lattice.x_um(), self.lattice.y_um()
        for row in range(0, y_um.size, _TILE_SITES):
            band = y_um[row : row + _TILE_SITES]
            yield FieldTile(
                row, 0, amplitudes=nearest_unitary(self.profile(x_um, band)) * encloses(self.device, x_um, band)
            )


@dataclass(frozen=True)
class StokesPsf:
    """PSFs of six places over depth.

    Attributes:
        depth_m: shape (n_depth,), ascending.
        pixel_um: sampling step.
        psf: shape (6, 4, n_depth, n, n), irradiance about each place, 1/um^2, that one unit of S0, S1, S2, S3 per power
            at the aperture adds: the irradiance of light with the Stokes vector S is the sum of psf[:, j] S_j.
        centre_um: shape (6, 2), the places.
        sensor_distance_um: distance of the sensor plane.
    """

    depth_m: FloatArray
    pixel_um: float
    psf: FloatArray
    centre_um: FloatArray
    sensor_distance_um: float

    @property
    def instrument(self) -> FloatArray:
        """Share of the light of each Stokes parameter in each place's window, shape (6, 4), at the middle depth."""
        return np.asarray(self.psf[:, :, self.depth_m.size // 2].sum(axis=(-2, -1)) * self.pixel_um**2)


def stokes_psf(
    source: JonesSource,
    profile: StokesProfile,
    imaging: Imaging,
    depths_m: Sequence[float] | FloatArray,
    *,
    window_px: int = 64,
    block_sites: int = 2,
    progress: Progress = silent,
) -> StokesPsf:
    """PSFs of a full-Stokes lens for points on the axis.

    Args:
        source: Jones matrices behind the sites.
        profile: where the places are.
        imaging: wavelength, pixel, sensor.
        depths_m: object depths, ascending.
        window_px: points a side of each window.
        block_sites: sites a side that are summed before they travel; for the paper's lens and its tenth blocks of 240 a
            side keep to 1e-3.
        progress: called as windows are done.
    """
    depth_m = np.asarray(depths_m, dtype=np.float64)
    carriers = [Carrier(entry, ray, block_sites) for ray in profile.rays for entry in range(3)]
    pupils = reduce_field(source, carriers, imaging.wavenumber, progress=progress)
    psf = np.empty((len(profile.rays), 4, depth_m.size, window_px, window_px))
    for place, ray in enumerate(profile.rays):
        entries = pupils[3 * place : 3 * place + 3]
        spans = tuple((float(axis[0]), float(axis[-1])) for axis in (entries[0].x_um, entries[0].y_um))
        kernel = WindowKernel.build(
            imaging.wavenumber, ray.target_um, (spans[0], spans[1]), window_px, imaging.pixel_um, _TOLERANCE
        )
        transforms = [WindowTransform.build(pupil, kernel) for pupil in entries]
        cell_um2 = entries[0].pitch_um[0] * entries[0].pitch_um[1]
        for index, depth in enumerate(depth_m.tolist()):
            there = Ray(1e-6 / depth, (0.0, 0.0), ray.target_um)
            xx, xy, yy = (
                transform.field(refocus(pupil, there, imaging.wavenumber)).astype(np.complex128)
                for transform, pupil in zip(transforms, entries, strict=True)
            )
            psf[place, :, index] = response_of(xx, xy, xy, yy) * (cell_um2**2 / power_at_aperture(imaging, there))
        progress("psf", place + 1, len(profile.rays))
    places = np.array([ray.target_um[:2] for ray in profile.rays])
    return StokesPsf(depth_m, imaging.pixel_um, psf, places, imaging.sensor_distance_um)
