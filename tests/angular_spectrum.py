"""Angular spectrum of a small lens: a second reference, in direction space, and its power budget.

    E(u, v) = integral over f of A(f) exp(i k_z(f) z) exp(2 pi i f . (u, v)),
    A(f) = sum over sites of a exp(-2 pi i f . r) times the cell's area,

equals the direct sum by the Weyl expansion of its kernel, without any distance. Frequencies whose light cannot reach
the window are faded out, so that a grid of frequencies represents the integral without wrapped light. By Parseval's
theorem the spectrum holds the power of all directions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.optics.direct_sum import incident_wave
from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.errors import InputError
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.sources.source import Source

#: Largest number of sites along a side: the spectrum takes a matrix of sites times frequencies.
_MOST_SITES = 2000
#: Width of the fade, and its distance from the farthest wanted direction, in direction sine.
_FADE_SINE = 0.25
_CLEAR_SINE = 0.1


@dataclass(frozen=True)
class AngularSpectrum:
    """Light of one object point and one polarisation just behind a small lens."""

    imaging: Imaging  #: Wavelength and sensor.
    #: Shape (n_y, n_x), field at the sites; its square is the power per area from an object of 1 W per steradian, z /
    #: R^3 times the transmission of the pillar. Powers are over 1 W, not over the power at the aperture.
    lit: ComplexArray
    x_um: FloatArray  #: Shape (n_x,), sites.
    y_um: FloatArray  #: Shape (n_y,).
    cell_um2: float  #: Area of one unit cell.

    @classmethod
    def of(
        cls, source: Source, imaging: Imaging, depth_m: float, tangent: tuple[float, float], polarisation: int
    ) -> AngularSpectrum:
        """The light of an object at a finite depth.

        Raises:
            InputError: a lens of so many sites that the spectrum would not fit into memory.
        """
        lattice = source.lattice
        if max(lattice.shape) > _MOST_SITES:
            expected = f"at most {_MOST_SITES} sites a side for the angular spectrum"
            raise InputError.single("optics", "aperture_um", expected, f"{max(lattice.shape)}", "take a smaller lens")
        amplitude = np.zeros(lattice.shape, dtype=np.complex128)
        for tile in source.tiles():
            part = tile.amplitude(polarisation)
            amplitude[tile.row : tile.row + part.shape[0], tile.column : tile.column + part.shape[1]] = part
        x, y = lattice.x_um(), lattice.y_um()
        depth_um = 1e6 * depth_m
        plate = imaging.plates[polarisation] if imaging.plates else None
        # Flux z / R^3 of an object of unit power per solid angle.
        wave = incident_wave(tangent[0] * depth_um, tangent[1] * depth_um, depth_um, x, y, imaging.wavenumber, plate)
        return cls(imaging, np.asarray(amplitude * wave), x, y, lattice.cell_um2)

    @property
    def power(self) -> float:
        """Power that the pillars transmit, in units of the squared field times um^2."""
        return float(np.sum(np.abs(self.lit) ** 2) * self.cell_um2)

    def irradiance(self, x_um: FloatArray, y_um: FloatArray) -> FloatArray:
        """Squared field at the points (x, y) of the sensor plane: shapes (n_x,) and (n_y,) give (n_y, n_x)."""
        z, wavelength = self.imaging.sensor_distance_um, self.imaging.wavelength_um
        sines = [self._reach(sites, at) for sites, at in ((self.x_um, x_um), (self.y_um, y_um))]
        centre = [0.5 * (low + high) for low, high in sines]
        clear = [0.5 * (high - low) + _CLEAR_SINE for low, high in sines]
        steepest = max(abs(c) + w + _FADE_SINE for c, w in zip(centre, clear, strict=True))
        steepest = min(steepest, 0.98)
        travel = 2.0 * z * steepest / math.sqrt(1.0 - steepest**2)
        extent = travel + sum(float(np.ptp(axis)) for axis in (self.x_um, x_um)) + float(np.abs(x_um).max())
        step = wavelength / extent
        grids, fades = [], []
        for c, w in zip(centre, clear, strict=True):
            sine = np.arange(max(c - w - _FADE_SINE, -0.99), min(c + w + _FADE_SINE, 0.99), step)
            grids.append(sine)
            fades.append(_fade(np.abs(sine - c) - w))
        s_x, s_y = grids
        transverse = s_x[None, :] ** 2 + s_y[:, None] ** 2
        k = self.imaging.wavenumber
        forward = np.where(transverse < 1.0, np.exp(1j * k * z * np.sqrt(np.maximum(1.0 - transverse, 0.0))), 0.0)
        spectrum = self._spectrum(s_x, s_y) * forward * (fades[1][:, None] * fades[0][None, :])
        to_y, to_x = np.exp(1j * k * np.outer(y_um, s_y)), np.exp(1j * k * np.outer(s_x, x_um))
        field = to_y @ spectrum @ to_x * (step / wavelength) ** 2
        return np.asarray(np.abs(field) ** 2, dtype=np.float64)

    def propagating_power(self) -> float:
        """Power of all propagating directions; the rest of :attr:`power` is evanescent.

        The discrete spectrum over one period of frequencies, sampled at twice the lens' size.
        """
        n_y, n_x = (2 * count for count in self.lit.shape)
        pitch_x, pitch_y = self.x_um[1] - self.x_um[0], self.y_um[1] - self.y_um[0]
        sine_x = self.imaging.wavelength_um * np.fft.fftfreq(n_x, pitch_x)
        sine_y = self.imaging.wavelength_um * np.fft.fftfreq(n_y, pitch_y)
        squares = np.abs(np.fft.fft2(self.lit, (n_y, n_x))) ** 2
        leaves = sine_x[None, :] ** 2 + sine_y[:, None] ** 2 < 1.0
        return float(np.sum(squares[leaves]) * self.cell_um2**2 / (n_x * n_y * pitch_x * pitch_y))

    def _spectrum(self, s_x: FloatArray, s_y: FloatArray) -> ComplexArray:
        k = self.imaging.wavenumber
        from_y, from_x = np.exp(-1j * k * np.outer(s_y, self.y_um)), np.exp(-1j * k * np.outer(self.x_um, s_x))
        return np.asarray(from_y @ self.lit @ from_x * self.cell_um2)

    def _reach(self, sites_um: FloatArray, at_um: FloatArray) -> tuple[float, float]:
        """Lowest and highest direction sine from any site to any point, along one axis."""
        z = self.imaging.sensor_distance_um
        low, high = float(at_um.min() - sites_um.max()), float(at_um.max() - sites_um.min())
        return low / math.hypot(low, z), high / math.hypot(high, z)


def _fade(beyond: FloatArray) -> FloatArray:
    """1 up to 0, then smoothly (all derivatives) down to 0 at the fade's width."""
    place = np.clip(beyond / _FADE_SINE, 1e-9, 1.0 - 1e-9)
    down = np.exp(-1.0 / (1.0 - place))
    up = np.exp(-1.0 / place)
    return np.asarray(down / (down + up))
