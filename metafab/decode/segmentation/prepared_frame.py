"""A frame prepared for decoding: registered twins, their spectra, and masks of light and texture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes
from scipy.ndimage import label as connected_components

from metafab.camera.frames.frame import RawFrame
from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import distance, nearest
from metafab.core.numeric.spread import normal_sigma
from metafab.decode.matching.levels import Levels
from metafab.decode.matching.pooling import window_maxima, window_means
from metafab.decode.registration.downsampling import Downsampling, blocks_with, enlarged
from metafab.decode.registration.pedestal import pedestal_e, without_pedestal
from metafab.decode.registration.twins import TwinGrid, Twins, extract

#: Side of the narrowest window from which a depth is measured, frame pixels.
WINDOW_PX = 28
#: Rms of a texture in the frame, as a share of the brightness, below which a surface is plain.
_FAINT = 0.01
#: Distance from an outline up to which light of the other side is mixed in, frame pixels.
BLUR_PX = 12
#: Least share of a plain object's pixels away from its outline that are plain.
_PLAIN_SHARE = 0.99
#: Largest ratio of distances of a plain object's outline from its core (quantiles 0.95 and 0.05): rectangles have up to
#: 1.6, pixels of a textured surface behind that happen to be as bright 2.
_OUTLINE_RATIO = 1.7
#: Least median change of the light across a plain object's outline, over its standard deviation along it: a smaller
#: change may be texture beyond it.
_ONE_STEP = 3.0
#: Most smooth cores that are examined, the largest.
_MOST_PLAIN = 16
#: Sum of both images, in standard deviations of the read noise, up to which a pixel is dark.
_DARK_DEVIATIONS = 6.0
#: Share of a surface's light at which its outline stands, next to the dark.
_OUTLINE_SHARE = 0.175
#: Share of the blur of a bright surface that is left beside its sharp image.
_SHARP_SHARE = 0.4
#: Reach of the blur of a highlight, frame pixels.
SPOILED_PX = 24
#: The images fade around bright pixels, from where their blur is this multiple of a dim surface's light, over this
#: distance (frame pixels). Around pixels of five times the light that is from 8 to 24 px; 4 to 20 px does as well.
_FADED_BLUR, _FADE_PX = 2.0, 16.0
#: Side of the window whose mean light scales a texture, frame pixels.
_LIGHT_PX = 21
#: Error of the calibration as a share of the light, and least variance of a pixel, over that of a typical one.
_MODEL_ERROR, _LEAST_VARIANCE = 0.01, 0.05
#: Distance over which light from beyond the window is mixed in, frame pixels.
_BEYOND_PX = 12
#: Distance from a lit pixel up to which images are deconvolved, downsampled pixels.
_LIT_MARGIN_PX = 2
#: Reason for an empty image of a dark frame.
NO_LIGHT = "there is no light in the frame, or none that differs from an even level"


def saturated_share(frame: RawFrame) -> float:
    """Share of saturated pixels among those of a frame that are saturated or no number; 0 without any."""
    if frame.saturation_e is None:
        return 0.0
    saturated = int(np.count_nonzero(frame.frame >= frame.saturation_e))
    return saturated / max(saturated + int(np.count_nonzero(np.isnan(frame.frame))), 1)


@dataclass(frozen=True)
class PreparedFrame:
    """Registered twins of a frame and their downsampled images."""

    twins: Twins  #: Both images at all pixels.
    levels: Levels  #: Their noise and texture.
    downsampling: Downsampling  #: The pixels that are compared.
    spectra: NDArray[np.complex64]  #: Shape (2, n_ky, n_kx), transforms of the downsampled images.
    images: NDArray[np.float32]  #: Shape (2, n_y + 2 margin, n_x + 2 margin), the downsampled images, electrons.
    #: Distances from an outline, frame pixels, and the share of a surface's light beyond them.
    spill: tuple[tuple[int, float], ...] = ()
    #: Share of saturated pixels among the frame's broken ones, the others of which are no number.
    saturated_share: float = 0.0

    @classmethod
    def of(
        cls,
        frame: RawFrame,
        grid: TwinGrid,
        downsampling: Downsampling,
        spill: tuple[tuple[int, float], ...],
    ) -> PreparedFrame | str:
        """Register and downsample a frame of the grid's shape, or return the reason why it cannot be decoded.

        ``spill`` is that of the calibration.
        """
        level_e = pedestal_e(frame)
        frame = without_pedestal(frame, level_e)
        twins = extract(frame, grid)
        if twins.bad.all():
            return "all pixels are saturated or invalid"
        spectra = downsampling.spectra(twins.image)
        images = downsampling.images(spectra)
        levels = replace(Levels.of(images, frame.read_noise_e), pedestal_e=level_e)
        if levels.signal <= 0.0:
            return NO_LIGHT
        return cls(twins, levels, downsampling, spectra, images, spill, saturated_share(frame))

    def within(self, rows: slice, columns: slice) -> PreparedFrame:
        """A part of the window (slices of downsampled pixels), without ``spectra``."""
        m, part = self.downsampling.margin, self.downsampling.within(rows, columns)
        images = self.images[:, rows.start : rows.stop + 2 * m, columns.start : columns.stop + 2 * m]
        twins = self.twins.within(*self.downsampling.frame_slices(rows, columns))
        return PreparedFrame(twins, self.levels, part, self.spectra[:0], images, self.spill, self.saturated_share)

    def about(self, middle: tuple[int, int], side: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Both images in a square about a downsampled pixel (row, column), and whether a pixel lies in the images.

        Shapes (2, side, side), electrons, 0 outside of the images, and (side, side).
        """
        square, inside = np.zeros((2, side, side), dtype=np.float32), np.zeros((side, side), dtype=bool)
        corner = [place + self.downsampling.margin - side // 2 for place in middle]
        part = tuple(slice(max(0, c), min(c + side, m)) for c, m in zip(corner, self.images.shape[1:], strict=True))
        to = tuple(slice(p.start - c, p.stop - c) for p, c in zip(part, corner, strict=True))
        square[:, *to], inside[to] = self.images[:, *part], True
        return square, inside

    def without_light(
        self, bright: NDArray[np.bool_], level_e: FloatArray, ratio: float
    ) -> tuple[NDArray[np.complex64], NDArray[np.bool_]]:
        """Transforms of the downsampled images in which the light about bright pixels fades into an even level.

        The matched filters reach farther than the blur: near a bright outline, its response exceeds that of the dim
        surface's texture.

        Args:
            bright: shape (n_y, n_x), downsampled pixels.
            level_e: shape (2,), mean light of the dim surface in both images, electrons.
            ratio: light of the bright pixels over that of the dim surface.

        Returns:
            The transforms, shape (2, n_ky, n_kx), and the pixels whose light is whole, (n_y, n_x).
        """
        step, away_px = self.downsampling.step, distance(bright) * np.float32(self.downsampling.step)
        reach_px = max((px for px, _ in self.spill), default=0)
        near_px = next((px for px, share in self.spill if ratio * share < _FADED_BLUR), reach_px)
        rise = np.clip((away_px - near_px) / _FADE_PX, 0.0, 1.0)
        kept = enlarged((rise * rise * (3.0 - 2.0 * rise)).astype(np.float32), step, self.twins.grid.shape)
        level = level_e.astype(np.float32)[:, None, None]
        faded = level + (self.twins.image - level) * np.pad(kept, self.twins.grid.margin, mode="edge")
        return self.downsampling.spectra(faded), rise == 1.0

    @property
    def window(self) -> int:
        """Side of the narrowest window, downsampled pixels; odd."""
        return round(WINDOW_PX / self.downsampling.step) | 1

    @property
    def outline_reach(self) -> float:
        """Distance from an outline up to which windows contain its blur, downsampled pixels."""
        return self.window // 2 + BLUR_PX / self.downsampling.step

    @property
    def dark_e(self) -> float:
        """Sum of both images below which a pixel shows no light beyond noise, electrons."""
        return _DARK_DEVIATIONS * self.levels.read_noise_e

    @cached_property
    def floor_e(self) -> NDArray[np.float32]:
        """Sum of both images below which a pixel is dark, electrons: noise, or blur of what is bright around it.

        Shape (n_y, n_x), downsampled pixels.
        """
        light, half = self.mean.sum(axis=0), self.window // 2
        floor = np.full(light.shape, self.dark_e, dtype=np.float32)
        shares = [_OUTLINE_SHARE, *(share for _, share in self.spill)]
        brightest = np.float32(light.max(initial=0.0))
        for (reach_px, _), share in zip(self.spill, shares, strict=False):
            if np.float32(share) * brightest <= floor.min():  # in even light, the first reach is enough
                continue
            # At an outline, half of the averaging window is dark: the surface's full light is half a window farther in.
            side = 2 * (half + reach_px // self.downsampling.step) + 1
            np.maximum(floor, np.float32(share) * window_maxima(light, side), out=floor)
        return floor

    @property
    def sharp_floor_e(self) -> NDArray[np.float32]:
        """Sum of both sharp images below which a pixel is dark, electrons: shape (n_y, n_x), downsampled pixels.

        Deconvolution leaves little of the blur, but all of it about a saturated or invalid pixel, which is not known.
        """
        share = np.where(self.spoiled, np.float32(1.0), np.float32(_SHARP_SHARE))
        return np.asarray(np.maximum(share * self.floor_e, np.float32(self.dark_e)))

    @property
    def inner(self) -> NDArray[np.float32]:
        """The downsampled images without margin: shape (2, n_y, n_x)."""
        return self.images[:, *self.downsampling.inner]

    @cached_property
    def lit(self) -> NDArray[np.bool_]:
        """Downsampled pixels with light: shape (n_y, n_x)."""
        return np.asarray(self.inner.sum(axis=0) > self.floor_e)

    @cached_property
    def enclosed(self) -> NDArray[np.bool_]:
        """Lit pixels, and dark ones that these enclose: shape (n_y, n_x).

        The latter send some light, without which no model of outlines nearby fits.
        """
        return np.asarray(binary_fill_holes(self.lit))

    @cached_property
    def _mean_around(self) -> NDArray[np.float32]:
        """Mean about each pixel: shape (2, n_y, n_x) with margins, electrons."""
        return window_means(self.images, max(3, _LIGHT_PX // self.downsampling.step | 1))

    @cached_property
    def light_around(self) -> NDArray[np.float32]:
        """Mean light of both images about each pixel, which scales its texture: shape (n_y, n_x), electrons, positive.

        With margins, as ``weight``.
        """
        return np.asarray(np.maximum(self._mean_around.mean(axis=0), np.float32(1e-3)))

    @cached_property
    def weight(self) -> NDArray[np.float32]:
        """Inverse standard deviation of each pixel, 0 where no model holds: shape (2, n_y, n_x) with margins."""
        step, mean = self.downsampling.step, self._mean_around
        # Dark pixels are not known better than a frame's usual noise allows, whatever read noise it states.
        floor_e2 = self.levels.read_noise_e**2 + _LEAST_VARIANCE * self.levels.noise_variance
        variance = np.maximum(mean, np.float32(0.0)) + np.float32(floor_e2)
        sigma = np.sqrt(variance / step**2 + (_MODEL_ERROR * mean) ** 2 + np.float32(1e-9))
        weight = (1.0 / sigma).astype(np.float32)
        # Light from beyond the window is not modelled.
        beyond = self.images.sum(axis=0) > np.pad(self.floor_e, self.downsampling.margin, mode="edge")
        beyond[self.downsampling.inner] = False
        weight[:, distance(beyond) * step <= _BEYOND_PX] = 0.0
        weight[:, *self.downsampling.inner][:, self.spoiled] = 0.0
        return weight

    @cached_property
    def near_light(self) -> NDArray[np.bool_]:
        """Downsampled pixels near a lit one, at which images are deconvolved: shape (n_y, n_x)."""
        return near_light(self.lit)

    @cached_property
    def spoiled(self) -> NDArray[np.bool_]:
        """Downsampled pixels that the blur of a saturated or invalid pixel reaches: shape (n_y, n_x)."""
        if not self.twins.bad.any():
            return np.zeros(self.downsampling.shape, dtype=bool)
        step, (n_y, n_x) = self.downsampling.step, self.downsampling.shape
        bad = blocks_with(self.twins.bad, (step, step), (n_y, n_x))
        return np.asarray(distance(bad) * step <= SPOILED_PX)

    @cached_property
    def mean(self) -> NDArray[np.float32]:
        """Mean over a window: shape (2, n_y, n_x), electrons."""
        return window_means(self.inner, self.window)

    @cached_property
    def variance(self) -> FloatArray:
        """Variance of the frame's pixels in a window about each pixel: shape (2, n_y, n_x), positive."""
        least = self.levels.read_noise_e**2 + 1e-9 * self.levels.noise_variance
        return np.asarray(np.maximum(self.mean, 0.0) + least)

    @cached_property
    def textured(self) -> NDArray[np.bool_]:
        """Whether either image varies over a window by more than its noise: shape (n_y, n_x)."""
        return np.asarray((self._texture > self._least_texture).any(axis=0))

    @cached_property
    def plain(self) -> NDArray[np.bool_]:
        """Surfaces without texture and their outlines, where even a faint texture would show: shape (n_y, n_x)."""
        # Windows that hold an outline or its blur are not smooth, and smooth cores keep half a window away from these.
        outline = 2 * (self.window // 2) + BLUR_PX / self.downsampling.step
        return np.asarray((distance(self._smooth_cores) <= outline) & self.lit)

    @cached_property
    def plain_objects(self) -> NDArray[np.int32]:
        """Number from 1 of each plain surface that lies whole in the picture or in the dark: shape (n_y, n_x), else 0.

        Its pixels are connected, lie about one smooth core, and are plain but for those along the outline. Their light
        is nearer to that of the core than to that beyond the outline.
        """
        objects, count = np.zeros(self.lit.shape, dtype=np.int32), 0
        cores, _ = connected_components(self._smooth_cores)
        largest = 1 + np.argsort(-np.bincount(cores.ravel())[1:])[:_MOST_PLAIN]
        for number in largest.tolist():
            mask = self._about(cores == number)
            if mask.any():
                count += 1
                objects[mask] = count
        return objects

    def _about(self, core: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Pixels of the plain object about a smooth core, none if there is no such object: shapes (n_y, n_x)."""
        away, none, reach = distance(core), np.zeros_like(core), self.outline_reach
        outside = (away > 3.0 * reach) | (self._smooth_cores & ~core)
        if not outside.any():
            return none
        _, row, column = nearest(outside)
        level, beyond = self.inner[:, core].mean(axis=1)[:, None, None], self.mean[:, row, column]
        like = ((self.inner - level) ** 2).sum(axis=0) < ((self.inner - beyond) ** 2).sum(axis=0)
        component, _ = connected_components(core | (like & self.lit & (away <= 3.0 * reach)))
        mask = binary_fill_holes(component == component[core][0])
        within = distance(~mask)
        inner, outline = self.plain[mask & (within > reach)], mask & (within <= 1.0)
        if mask.all():  # Light that fills the frame has no outline.
            return none
        if not inner.size or inner.mean() < _PLAIN_SHARE or (mask & self._smooth_cores & ~core).any():
            return none
        nearest_to_core, farthest = np.quantile(away[outline], [0.05, 0.95])
        change = (level - beyond).sum(axis=0)[outline]
        middle = np.median(change)
        if farthest > _OUTLINE_RATIO * nearest_to_core or abs(middle) < _ONE_STEP * normal_sigma(change - middle):
            return none
        border = mask[[0, -1]].any() or mask[:, [0, -1]].any()
        touches_light = bool((self.lit & ~mask & (distance(mask) <= 2.0)).any())
        return none if border and touches_light else mask

    @cached_property
    def _smooth_cores(self) -> NDArray[np.bool_]:
        """Pixels farther than half a window from all windows with texture: shape (n_y, n_x)."""
        faint = (_FAINT * self.mean) ** 2
        would_show = (faint > self._least_texture).any(axis=0)
        smooth = self.lit & (self._texture < faint).all(axis=0) & would_show
        return distance(~smooth) > self.window // 2 if not smooth.all() else smooth

    @cached_property
    def _texture(self) -> NDArray[np.float32]:
        """Variance of each image over a window minus that of its noise: shape (2, n_y, n_x)."""
        return np.asarray(window_means(self.inner**2, self.window) - self.mean**2 - self._noise)

    @property
    def _noise(self) -> NDArray[np.float32]:
        noise = np.maximum(self.mean, 0.0) + self.levels.read_noise_e**2
        return np.asarray(self.downsampling.variance_gain * noise)

    @property
    def _least_texture(self) -> NDArray[np.float32]:
        """Variance beyond that of the noise from which a window shows texture, electrons squared."""
        # The mean square of n nearly independent deviations is 1 +- sqrt(2 / n) of their variance.
        return np.asarray(self._noise * np.float32(6.0 * np.sqrt(2.0) / self.window))


def near_light(lit: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels within two pixels of a lit one, shape (n_y, n_x): the same shape."""
    return np.asarray(distance(lit) <= _LIT_MARGIN_PX)
