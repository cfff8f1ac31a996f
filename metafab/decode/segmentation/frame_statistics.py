"""A frame at first sight: its twins, how bright and how textured they are, and where."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from metafab.camera.frames.frame import RawFrame
from metafab.core.conventions import FloatArray
from metafab.decode.matching.levels import Levels
from metafab.decode.matching.pooling import window_means
from metafab.decode.registration.reduce import Reduction
from metafab.decode.registration.twins import TwinGrid, Twins, extract
from metafab.decode.segmentation.distance import distance

#: Side of the narrowest window that says a depth, pixels of the frame.
WINDOW_PX = 28
#: Rms of a texture in the frame, as a share of the brightness, that tells a textured surface from a plain one.
_FAINT = 0.01
#: How far from an outline light of the other side is seen.
_BLUR_PX = 12
#: The reason that a dark frame comes back with; it is sound, there is nothing on it.
NO_LIGHT = "there is no light in the frame"


@dataclass(frozen=True)
class Seen:
    """A frame at first sight.

    Attributes:
        twins: both images.
        levels: their noise and texture.
        reduction: which of their pixels are compared.
        spectra: transforms of those pixels.
        small: those pixels, with margin.
    """

    twins: Twins
    levels: Levels
    reduction: Reduction
    spectra: NDArray[np.complex64]
    small: NDArray[np.float32]

    @classmethod
    def of(cls, frame: RawFrame, grid: TwinGrid, reduction: Reduction, levels: Levels | None = None) -> Seen | str:
        """Look at a frame, or say why there is nothing to be seen.

        Args:
            frame: of the grid's shape.
            grid: where its twins stand.
            reduction: every few pixels of the grid.
            levels: of an earlier frame in the same light; measured by default.
        """
        twins = extract(frame, grid)
        if twins.bad.all():
            return "all pixels are saturated or invalid"
        spectra = reduction.spectra(twins.image)
        small = reduction.images(spectra)
        levels = Levels.of(small, frame.read_noise_e) if levels is None else levels
        if levels.signal <= 0.0:
            return NO_LIGHT
        return cls(twins, levels, reduction, spectra, small)

    def within(self, rows: slice, columns: slice) -> Seen:
        """A part of the window (slices of compared pixels); its images have no ``spectra`` of their own."""
        m, part = self.reduction.margin, self.reduction.within(rows, columns)
        small = self.small[:, rows.start : rows.stop + 2 * m, columns.start : columns.stop + 2 * m]
        twins = self.twins.within(*self.reduction.of_part(rows, columns))
        return Seen(twins, self.levels, part, self.spectra[:0], small)

    @property
    def window(self) -> int:
        """Side of the narrowest window, in compared pixels; odd."""
        return round(WINDOW_PX / self.reduction.every) | 1

    @property
    def floor_e(self) -> float:
        """Light of both polarisations below which a pixel is dark, electrons."""
        return max(0.35 * self.levels.signal, 6.0 * self.levels.read_noise_e)

    @property
    def inner(self) -> NDArray[np.float32]:
        """The compared pixels without margin: shape (2, n_y, n_x)."""
        return self.small[:, *self.reduction.inner]

    @cached_property
    def lit(self) -> NDArray[np.bool_]:
        """Where there is light: shape (n_y, n_x)."""
        return np.asarray(self.inner.sum(axis=0) > self.floor_e)

    @cached_property
    def mean(self) -> NDArray[np.float32]:
        """Brightness over a window: shape (2, n_y, n_x)."""
        return window_means(self.inner, self.window)

    @cached_property
    def variance(self) -> FloatArray:
        """Variance of a pixel of the frame about each compared one: shape (2, n_y, n_x), never 0."""
        least = self.levels.read_noise_e**2 + 1e-9 * self.levels.noise_variance
        return np.asarray(np.maximum(self.mean, 0.0) + least)

    @cached_property
    def uneven(self) -> NDArray[np.bool_]:
        """Where the brightness of either image varies over a window by more than its noise."""
        return np.asarray((self._texture > self._least_texture).any(axis=0))

    @cached_property
    def plain(self) -> NDArray[np.bool_]:
        """Surfaces that show no texture, and what lies so near to one that it may be its outline.

        Only where there is light enough for a faint texture to show in one window.
        """
        faint = (_FAINT * self.mean) ** 2
        would_show = (faint > self._least_texture).any(axis=0)
        calm = self.lit & (self._texture < faint).all(axis=0) & would_show
        reach = self.window // 2
        core = distance(~calm) > reach if not calm.all() else calm
        # Windows of calm pixels end before anything else's light.
        outline = 2 * reach + _BLUR_PX / self.reduction.every
        return np.asarray((distance(core) <= outline) & self.lit)

    @cached_property
    def _texture(self) -> NDArray[np.float32]:
        """Variance of the brightness over a window, that of its noise taken off: shape (2, n_y, n_x)."""
        return np.asarray(window_means(self.inner**2, self.window) - self.mean**2 - self._noise)

    @property
    def _noise(self) -> NDArray[np.float32]:
        return np.asarray(self.reduction.variance_left * (np.maximum(self.mean, 0.0) + self.levels.read_noise_e**2))

    @property
    def _least_texture(self) -> NDArray[np.float32]:
        """Variance beyond that of the noise from which a window shows texture, electrons squared."""
        # The mean square of n nearly independent deviations is 1 +- sqrt(2 / n) of their variance.
        return np.asarray(self._noise * np.float32(6.0 * np.sqrt(2.0) / self.window))
