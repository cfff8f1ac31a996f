"""Surface of a frame: 1/depth of each pixel by semi-global matching, and how well it is known.

A window at an outline holds both sides of it. Of all windows that hold a pixel, the one in which the twins fit best
lies on the pixel's own side (shiftable windows; Bobick and Intille, Int. J. Comput. Vision 33, 181, 1999). The pair
blurs both sides into each other beyond any window: near outlines the twins fit neither depth, and prefer the wrong one.
Once the light is known sharp, pixels count the less the worse they fit, and jumps are cheap at edges of the light.
Windows then fade out at their sides, so that an outline that enters one does not count all at once. Before, they do
not: a smoother surface takes the place of planes more often.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.decode.confidence import RIGHT_WITHIN
from metafab.decode.matching.cost_volume import CostVolume, correlation
from metafab.decode.matching.depth import parabolic_peak
from metafab.decode.matching.levels import light_steps, log_light
from metafab.decode.matching.pooling import smoothed, window_maxima, window_means
from metafab.decode.matching.semi_global import summed_costs
from metafab.decode.segmentation.continuous.local_planes import smoothed_levels
from metafab.decode.segmentation.fit import FAINT, log_misfit, surface_window, texture_energy
from metafab.decode.segmentation.prepared_frame import PreparedFrame

#: Levels of vergence of a surface to a candidate depth.
_LEVELS = 4
#: Prices of a change by one level and of a jump, in logarithms of the misfit. With a change of 0.65, a steep card
#: vanishes in the wall behind it; with 0.25, levels follow noise (Middlebury motorcycle 2.9 % off, not 2.8 %).
_CHANGE, _JUMP = 0.4, 6.5
#: Price of a jump where the light is even, share of it that is left at edges, and change of the light's logarithm from
#: one pixel to the next at which it has fallen to 1/e. Half or 1.5 times as much of any changes errors by 1 to 2 %.
_EVEN_JUMP, _EDGE_SHARE, _EDGE = 10.0, 0.1, 0.2
#: Levels on each side of the least misfit at which its curvature is measured, and least curvature, per squared level.
_APART, _LEAST_CURVATURE = 2, 5e-3
#: Share of the noise above which it outweighs the texture.
_MOSTLY_NOISE = 0.5
#: Side of the window in which a pixel's light is compared with more around it, downsampled pixels, and share of the
#: mean light that is added to it.
_LIGHT_WINDOW, _ADDED_LIGHT = 3, 0.02
#: Side of the window over which gradients of the two sharp images are compared, downsampled pixels.
_GRADIENT_WINDOW = 3
#: Standard deviation of the Gaussian of the planes about each pixel, frame pixels, and their tolerance, levels. With 30
#: in place of 24 px, hills of 60 px are 3 % farther off; with 18, pictures of planes are 15 %.
_SMOOTHED_PX, _TOLERANCE = 24.0, 1.5


@dataclass(frozen=True)
class Surface:
    """1/depth of each pixel, which may change within a window, and measures of its doubt."""

    vergence_per_m: FloatArray  #: Shape (n_y, n_x).
    misfit: NDArray[np.float32]  #: Shape (n_y, n_x), logarithm of the twins' misfit in the window about the pixel.
    best_misfit: NDArray[np.float32]  #: Shape (n_y, n_x), its least in the windows that hold the pixel.
    #: Shape (n_y, n_x), summed cost of the best depth that is not within 5 %, less that of the best one within.
    margin: NDArray[np.float32]
    #: Shape (n_y, n_x), share of the noise in noise and texture: above 1/2, the depth is that of what is around.
    faintness: NDArray[np.float32]
    #: Shape (n_y, n_x), logarithm of the light about the pixel over the most within a window; 0 while light is unknown.
    dimness: NDArray[np.float32]
    #: Shape (n_y, n_x), correlation of the sharp images' gradients about the pixel: 1 for texture, 0 for noise; 1 while
    #: light is unknown.
    coherence: NDArray[np.float32]
    frame_coherence: float  #: Its mean over the lit pixels.

    @property
    def plain(self) -> NDArray[np.bool_]:
        """Shape (n_y, n_x), whether noise outweighs the texture."""
        return np.asarray(self.faintness > _MOSTLY_NOISE)


def matched_surface(
    prepared: PreparedFrame,
    volume: CostVolume,
    before_per_m: FloatArray | None = None,
    light: NDArray[np.float32] | None = None,
) -> Surface:
    """Surface of least cost: misfit of the twins in windows, and changes of depth from pixel to pixel.

    Args:
        prepared: the frame.
        volume: its cost volume, by filters that keep textures in their place.
        before_per_m: shape (n_y, n_x), 1/depth of the surface at which ``light`` was made sharp.
        light: shape (2, n_y, n_x), sharp light of the downsampled pixels; without, all pixels and edges count alike.
    """
    if light is not None:
        volume = replace(volume, products=smoothed(volume.products))
    nodes = volume.vergences_per_m
    levels = np.linspace(nodes[0], nodes[-1], _LEVELS * (nodes.size - 1) + 1)
    misfit, cost = np.empty((2, *volume.shape, levels.size), dtype=np.float32)
    window = surface_window(prepared)
    for number, level_per_m in enumerate(levels):
        of_level = log_misfit(prepared, volume.at(level_per_m[None])[:, 0], volume.noise_gain)
        misfit[..., number], cost[..., number] = of_level, -window_maxima(-of_level, window)
    texture = texture_energy(prepared, volume)
    counts, jump = texture / (texture + np.float32(FAINT)), np.full((2, 1, 1), _JUMP, dtype=np.float32)
    faintness, dimness = np.float32(1.0) - counts, np.zeros(volume.shape, dtype=np.float32)
    coherence, of_frame, light_logarithm = np.ones(volume.shape, dtype=np.float32), 1.0, None
    if before_per_m is not None and light is not None:
        dimness, coherence = dimmer_than_around(light, window), gradient_coherence(light)
        of_frame = float(coherence[prepared.lit].mean()) if prepared.lit.any() else 0.0
        light_logarithm = log_light(light.sum(axis=0))
        before = (before_per_m - levels[0]) / (levels[1] - levels[0])
        counts = counts / (np.float32(1.0) + np.maximum(_at(misfit, before), np.float32(0.0)))
        jump = jump_prices(light)
    total = summed_costs(cost * counts[..., None], _CHANGE, jump)
    level = _valley(total, misfit)
    weight = np.maximum(_curvature(misfit, level), _LEAST_CURVATURE) * counts
    level = smoothed_levels(level, weight, _SMOOTHED_PX / prepared.downsampling.step, _TOLERANCE, light_logarithm)
    level = np.clip(level, 0.0, levels.size - 1.0)
    vergence = levels[0] + (levels[1] - levels[0]) * level
    near = np.abs(levels / vergence[..., None] - 1.0) <= RIGHT_WITHIN
    # The nearest level may be farther than that from the pixel's own.
    np.put_along_axis(near, np.rint(level).astype(np.intp)[..., None], True, axis=-1)
    within, beyond = (total.min(axis=-1, where=which, initial=np.inf) for which in (near, ~near))
    misfits, margin = (_at(misfit, level), _at(cost, level)), beyond - within
    return Surface(vergence, *misfits, margin, faintness, dimness, coherence, of_frame)


def dimmer_than_around(light: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """Logarithm of the light about each pixel over the most within a window, shape (n_y, n_x), at most 0.

    Beside brighter light, the blur of its texture outweighs a dim surface's own, and the twins fit its depth.

    Args:
        light: shape (2, n_y, n_x), sharp light of both images.
        window: side of the window, pixels; odd.
    """
    both = np.maximum(light.mean(axis=0), np.float32(0.0))
    both = window_means(both + np.float32(_ADDED_LIGHT) * both.mean() + np.float32(1e-9), _LIGHT_WINDOW)
    return np.asarray(np.log(both / window_maxima(both, window)))


def gradient_coherence(light: NDArray[np.float32], window: int = _GRADIENT_WINDOW) -> NDArray[np.float32]:
    """Correlation of the gradients of both sharp images in a window about each pixel: shape (n_y, n_x), -1 to 1.

    Both images show a texture, and each has noise of its own. The blur of an outline, in which the twins agree far
    beyond it, is not in the sharp images: where they show noise, the depth is that of what stands nearby.

    Args:
        light: shape (2, n_y, n_x), sharp light of both images.
        window: side of the window, pixels; odd.
    """
    gradients = np.stack([np.gradient(light, axis=axis) for axis in (1, 2)])
    x, y = gradients[:, 0], gradients[:, 1]
    sums = np.stack([(one * other).sum(axis=0) for one, other in ((x, y), (x, x), (y, y))])
    return np.asarray(correlation(window_means(sums.astype(np.float32), window)))


def jump_prices(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Price of a jump of depth from each pixel to the next one along y and x, shape (2, n_y, n_x).

    ``light``, shape (2, n_y, n_x), is that of both images.
    """
    change = np.sqrt(np.square(light_steps(light)).mean(axis=1))
    return np.asarray(_EVEN_JUMP * (_EDGE_SHARE + (1.0 - _EDGE_SHARE) * np.exp(-change / _EDGE)), dtype=np.float32)


def _valley(total: NDArray[np.float32], misfit: NDArray[np.float32]) -> FloatArray:
    """Level of each pixel's least misfit next to its level of least summed cost: shape (n_y, n_x).

    Both have the shape (n_y, n_x, n_levels). The parabola is that of the misfit: summed costs draw levels to those of
    the neighbours, and make stairs of slopes.
    """
    best = np.clip(total.argmin(axis=-1), 1, total.shape[-1] - 2)
    below, at, above = (_at(misfit, best + step).astype(np.float64) for step in (-1, 0, 1))
    place = np.clip(parabolic_peak(-below, -at, -above).place, -1.0, 1.0)
    return np.asarray(best + np.where(below + above > 2.0 * at, place, 0.0))


def _curvature(misfit: NDArray[np.float32], level: FloatArray) -> NDArray[np.float32]:
    """Curvature of each pixel's misfit (n_y, n_x, n_levels) at its level, per squared level: shape (n_y, n_x)."""
    middle = np.clip(level, _APART, misfit.shape[-1] - 1 - _APART)
    below, at, above = (_at(misfit, middle + step) for step in (-_APART, 0, _APART))
    return np.asarray((below + above - 2.0 * at) / _APART**2)


def _at(values: NDArray[np.float32], level: FloatArray | NDArray[np.intp]) -> NDArray[np.float32]:
    """Values (n_y, n_x, n_levels) at the level next to each pixel's: shape (n_y, n_x)."""
    return np.take_along_axis(values, np.rint(level).astype(np.intp)[..., None], axis=-1)[..., 0]
