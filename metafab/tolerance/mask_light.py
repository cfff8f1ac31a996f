"""Light behind a mask in blocks of fixed size: what the corners and the random faults of a mask are compared by."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.core.parallel.work import Work
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.measures.focus import LensFocus
from metafab.optics.numerics import PsfNumerics, require_valid
from metafab.optics.propagation.blocks import reduce_to_target
from metafab.optics.propagation.image import Window
from metafab.optics.propagation.pupil import Carrier, Pupil, reduce_field
from metafab.optics.sources.source import Source, Transmission, WrittenField, apodised

_AXIS = (0.0, 0.0)


@dataclass(frozen=True)
class Light:
    """Irradiance behind one mask."""

    pair: FloatArray  #: Shape (2, n_depth, n, n), 1/um^2 per unit power at the aperture.
    #: Shape (n_depth,), power of y polarised light in the window of x; NaN where one window holds both polarisations.
    unwanted: FloatArray
    pixel_um: float  #: Sampling step.
    #: Widths of a lens' focus along x and y, um, and its maximum per unit of transmitted power, 1/um^2.
    spot: tuple[float, float, float] = (math.nan, math.nan, math.nan)

    @property
    def efficiency(self) -> FloatArray:
        """Share of the power in the window, shape (2, n_depth)."""
        return np.asarray(self.pair.sum(axis=(2, 3)) * self.pixel_um**2)

    @property
    def extinction(self) -> FloatArray:
        """Wanted over unwanted power in the window of x, shape (n_depth,)."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.efficiency[0] / self.unwanted)


@dataclass(frozen=True)
class PsfConditions:
    """Conditions of every PSF of a comparison, on the axis."""

    imaging: Imaging  #: Geometry.
    depths_m: tuple[float, ...]  #: Object depths, ascending.
    #: Window, target error and filter. Unwanted light is that of the design wavelength.
    numerics: PsfNumerics = PsfNumerics()
    transmission: Transmission | None = None  #: Stop or amplitude in the plane of the pillars; None for none.
    lens: LensFocus | None = None  #: Focus that is measured; None for devices without one.


@dataclass(frozen=True)
class MaskOptics:
    """Propagation of masks of one lattice in blocks of fixed size."""

    conditions: PsfConditions  #: Conditions of the PSFs.
    window: Window  #: Sampling of the windows.
    carriers: tuple[Carrier, Carrier, Carrier]  #: Carriers of x, of y, and of y polarised light in the window of x.

    @classmethod
    def of(
        cls, written: WrittenField, conditions: PsfConditions, work: Work = Work()
    ) -> tuple[MaskOptics, list[Pupil], float]:
        """Return the optics with the coarsest blocks that keep the target error, the blocks of the mask, and the error.

        InputError for inputs for which no PSF stack exists.
        """
        imaging, depths_m, numerics = conditions.imaging, conditions.depths_m, conditions.numerics
        require_valid(imaging, depths_m, _AXIS, None, numerics)
        window = Window.for_target(imaging, numerics)
        windows = window.over_band(_AXIS, numerics.filter_fwhm_nm)
        source = apodised(written, conditions.transmission)
        here = Work(progress=work.progress)
        with here.threads() as threads:
            pyramids, stray = reduce_to_target(
                source, windows, depths_m, _AXIS, None, numerics.block_error, threads, here
            )
        error = max(float(window.light(pyramids[p], p, _AXIS, depths_m, numerics)[1].max()) for p in (0, 1))
        pupils = [pyramids[0][0], pyramids[1][0], stray]
        carriers = (pupils[0].carrier, pupils[1].carrier, pupils[2].carrier)
        return cls(conditions, window, carriers), pupils, error

    def with_blocks(self, block_sites: int) -> MaskOptics:
        """Return the same optics with blocks of another size."""
        x, y, stray = (replace(carrier, block_sites=block_sites) for carrier in self.carriers)
        return replace(self, carriers=(x, y, stray))

    def sums(self, source: Source) -> list[Pupil]:
        """Return the blocks of x, of y, and of y behind the carrier of x."""
        wavenumber = self.conditions.imaging.wavenumber
        return reduce_field(apodised(source, self.conditions.transmission), self.carriers, wavenumber)

    def light(self, pupils: Sequence[Pupil]) -> Light:
        """Return the pair and the unwanted light of some blocks."""
        depths_m, numerics, lens = self.conditions.depths_m, self.conditions.numerics, self.conditions.lens
        pair = [self.window.light([pupils[p]], p, _AXIS, depths_m, numerics)[0] for p in (0, 1)]
        stray = self.window.stray_irradiance(pupils[2], 0, _AXIS, depths_m)
        if self.window.imaging.crystal is not None:
            stray = stray + self.window.light([pupils[0]], 0, _AXIS, depths_m, numerics, entry=(0, 1))[0]
        pixel_um = self.window.imaging.pixel_um
        unwanted = stray.sum(axis=(1, 2)) * pixel_um**2 if self.is_pair else np.full(len(depths_m), math.nan)
        light = Light(np.array(pair), unwanted, pixel_um)
        return light if lens is None else replace(light, spot=self._spot(lens, pupils))

    @property
    def ideal_peak(self) -> float:
        """Maximum of the ideal lens' focus per unit of transmitted power, 1/um^2; NaN for devices without a focus."""
        lens = self.conditions.lens
        return math.nan if lens is None else self._spot(lens, self.sums(lens.perfect))[2]

    def _spot(self, lens: LensFocus, pupils: Sequence[Pupil]) -> tuple[float, float, float]:
        return lens.spot(pupils, self.window.imaging, self.conditions.numerics.target_error)

    @property
    def is_pair(self) -> bool:
        """Whether the images of both polarisations lie apart; one window has no extinction and no twins to decode."""
        points = [self.window.imaging.image_point_um(p, _AXIS) for p in (0, 1)]
        return abs(points[0][0] - points[1][0]) >= self.window.imaging.pixel_um
