"""Focus of a lens: widths, Strehl ratio and encircled energy, beside the ideal flat lens of the same aperture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import RectBivariateSpline

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.figures import FocusFigures
from metafab.core.parallel.work import Work
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import Ray, power_at_aperture
from metafab.optics.measures.metrics import main_lobe_px
from metafab.optics.numerics import PsfNumerics
from metafab.optics.propagation.image import Window
from metafab.optics.propagation.pupil import Pupil
from metafab.optics.sources.source import Source
from metafab.optics.stack import psf

#: Pixels per period of the finest fringe, and pixels of the window: 8 wavelengths / NA wide.
_PER_FRINGE, _WINDOW_PX = 4.0, 64
#: Samples of a cross-section.
_SECTION = 241
#: Samples of a curve of encircled energy.
_RADII = 61
#: Reach of cross-sections and of these curves, wavelengths / NA.
_REACH = 3.0
#: Radius of Airy's first dark ring in wavelengths / NA (first zero of J_1 over 2 pi).
_FIRST_RING = 0.6098
_AXIS = (0.0, 0.0)


@dataclass(frozen=True)
class PerfectLens:
    """Target phases that send the light of one object point on the axis to its image point without aberration."""

    imaging: Imaging  #: Geometry.
    depth_m: float  #: Object depth.

    def transmission(self, x_um: FloatArray, y_um: FloatArray) -> ComplexArray:
        """Return exp(-i k path), shape (2, n_y, n_x), at ``x_um``, shape (n_x,), and ``y_um``, shape (n_y,)."""
        rays = [Ray.towards_image(self.imaging, p, self.depth_m, (0.0, 0.0)) for p in (0, 1)]
        paths = [ray.path_um(x_um[None, :], y_um[:, None]) for ray in rays]
        return np.asarray(np.exp(-1j * self.imaging.wavenumber * np.array(paths)))


@dataclass(frozen=True)
class LensFocus:
    """The focus of a lens, to be measured."""

    perfect: Source  #: Field behind a :class:`PerfectLens` of the same aperture.
    depth_m: float  #: Object depth.
    polarisations: tuple[int, ...] = (0, 1)  #: Polarisations that the lens focuses, 0 for x and 1 for y.

    def spot(self, pupils: Sequence[Pupil], imaging: Imaging, target_error: float) -> tuple[float, float, float]:
        """Widths of the focus along x and y, um, and its maximum per unit of transmitted power, 1/um^2.

        They are those of :func:`focus`. ``pupils`` are the blocks of x and y light; the pixel of ``imaging`` is not
        used.
        """
        fine, chosen, images = _finely(imaging), list(self.polarisations), []
        for energy in (True, False):
            numerics = PsfNumerics(window_px=_WINDOW_PX, target_error=target_error, energy=energy)
            window = Window.for_target(fine, numerics)
            pair = [window.light([pupils[p]], p, _AXIS, [self.depth_m], numerics, judged="none")[0][0] for p in chosen]
            images.append(np.array(pair))
        rays = [Ray.towards_image(fine, p, self.depth_m, _AXIS) for p in chosen]
        passed = [
            pupils[p].transmitted(ray) / power_at_aperture(fine, ray) for p, ray in zip(chosen, rays, strict=True)
        ]
        (width_x_um, width_y_um), flux = _Spot.of(images[0].mean(axis=0), fine.pixel_um).fwhm_um, images[1]
        return width_x_um, width_y_um, _per_power(flux, np.array(passed), fine.pixel_um).peak


def focus(
    source: Source, lens: LensFocus, imaging: Imaging, *, target_error: float = 1e-3, work: Work = Work()
) -> FocusFigures:
    """Return the figures of the focus of a ``lens``, whose light is ``source``.

    The pixel of ``imaging`` is not used; ``target_error`` is the relative L2 error of the images.
    """
    unit_um = imaging.wavelength_um / imaging.numerical_aperture
    fine = _finely(imaging)
    numerics = PsfNumerics(window_px=_WINDOW_PX, target_error=target_error)
    chosen, depth_m = list(lens.polarisations), lens.depth_m
    energy, limit = (
        psf(light, fine, [depth_m], replace(numerics, energy=True), work=work) for light in (source, lens.perfect)
    )
    flux, flux_limit = (psf(light, fine, [depth_m], numerics, work=work) for light in (source, lens.perfect))
    spot, best = (_Spot.of(stack.psf[chosen, 0].mean(axis=0), fine.pixel_um) for stack in (energy, limit))
    polarised, polarised_limit = (
        tuple(_Spot.of(stack.psf[p, 0], fine.pixel_um).fwhm_um for p in (0, 1)) for stack in (energy, limit)
    )
    places = [
        _per_power(stack.psf[chosen, 0], np.array(stack.details.transmitted)[chosen], fine.pixel_um)
        for stack in (flux, flux_limit)
    ]
    radius_um = np.linspace(0.0, _REACH * unit_um, _RADII)
    ring_um = _FIRST_RING * unit_um
    shares = [place.encircled(np.append(radius_um, ring_um)) for place in places]
    offset_um = np.linspace(-_REACH * unit_um, _REACH * unit_um, _SECTION)
    return FocusFigures(
        depth_m=depth_m,
        numerical_aperture=imaging.numerical_aperture,
        fwhm_x_um=spot.fwhm_um[0],
        fwhm_y_um=spot.fwhm_um[1],
        fwhm_limit_um=0.5 * sum(best.fwhm_um),
        fwhm_polarised_um=polarised,
        fwhm_polarised_limit_um=polarised_limit,
        strehl=places[0].peak / places[1].peak,
        encircled_radius_um=ring_um,
        encircled_energy=float(shares[0][-1]),
        encircled_energy_limit=float(shares[1][-1]),
        offset_um=offset_um,
        section_x=spot.section(offset_um, 0),
        section_y=spot.section(offset_um, 1),
        section_limit=best.section(offset_um, 0),
        radius_um=radius_um,
        encircled=shares[0][:-1],
        encircled_limit=shares[1][:-1],
    )


def _finely(imaging: Imaging) -> Imaging:
    """The geometry with pixels that resolve the finest fringe on the axis."""
    return replace(imaging, pixel_um=min(imaging.finest_fringe_um(p, _AXIS) for p in (0, 1)) / _PER_FRINGE)


def _per_power(pair: FloatArray, transmitted: FloatArray, pixel_um: float) -> _Spot:
    """Mean of some polarisations' images, shape (n, n_y, n_x), per unit of transmitted power, shape (n,)."""
    return _Spot.of((pair / np.maximum(transmitted, 1e-300)[:, None, None]).mean(axis=0), pixel_um)


@dataclass(frozen=True)
class _Spot:
    """One image as a quintic spline, and its maximum."""

    spline: RectBivariateSpline  #: Irradiance over (y, x), um from the centre pixel.
    x_um: float  #: Place of the maximum; likewise ``y_um``.
    y_um: float
    peak: float  #: Irradiance there.
    half_um: float  #: Half the side of the window.

    @classmethod
    def of(cls, image: FloatArray, pixel_um: float) -> _Spot:
        axis = (np.arange(image.shape[0]) - image.shape[0] // 2) * pixel_um
        x, y, peak = main_lobe_px(image) if image.any() else (0.0, 0.0, 0.0)
        spline = RectBivariateSpline(axis, axis, image, kx=5, ky=5)
        return cls(spline, x * pixel_um, y * pixel_um, peak, float(axis[-1]))

    def section(self, offset_um: FloatArray, axis: int) -> FloatArray:
        """Irradiance over that of the maximum along x (0) or y (1); NaN outside the window."""
        x, y = (self.x_um + offset_um * (axis == 0), self.y_um + offset_um * (axis == 1))
        inside = np.maximum(np.abs(x), np.abs(y)) <= self.half_um
        return np.where(inside & (self.peak > 0.0), self.spline(y, x, grid=False) / max(self.peak, 1e-300), np.nan)

    @property
    def fwhm_um(self) -> tuple[float, float]:
        """Full width at half maximum along x and y; NaN if the window is too narrow."""
        return self._width(0), self._width(1)

    def _width(self, axis: int) -> float:
        total = 0.0
        offset_um = np.linspace(0.0, 2.0 * self.half_um, 40 * _WINDOW_PX)
        for side in (1.0, -1.0):
            curve = self.section(side * offset_um, axis)
            below = np.flatnonzero(curve < 0.5)
            if not below.size:
                return float("nan")
            i = int(below[0])
            total += float(np.interp(0.5, curve[[i, i - 1]], offset_um[[i, i - 1]]))
        return total

    def encircled(self, radius_um: FloatArray) -> FloatArray:
        """Integral of the irradiance over circles about the maximum; outside the window it counts as dark."""
        azimuth = 2.0 * np.pi * np.arange(72) / 72
        node, weight = np.polynomial.legendre.leggauss(48)
        shares = []
        for edge_um in radius_um.tolist():
            r = 0.5 * edge_um * (node + 1.0)[:, None]
            x, y = self.x_um + r * np.cos(azimuth), self.y_um + r * np.sin(azimuth)
            inside = np.maximum(np.abs(x), np.abs(y)) <= self.half_um
            ring = np.where(inside, self.spline(y, x, grid=False), 0.0).mean(axis=1)
            shares.append(float(np.pi * edge_um * np.sum(weight * r[:, 0] * ring)))
        return np.array(shares)
