"""Bars: long narrow objects before a surface, found by the ridges of light that does not fit the surface's depth.

A bar is narrower than the windows that segments are measured by. It leaves light in the null channel of the surface
behind it along all of its length. Its depth is the maximum of the twins' product summed along the ridge, less the
surface's share: the textures of both are independent, so that their products add. The jackknife over pieces of the bar
gives the error. Place and width follow from the evidence of a strip of even light in the null channel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, map_coordinates, uniform_filter1d
from scipy.ndimage import label as connected_components

from metafab.core.conventions import FloatArray
from metafab.core.numeric.distance import nearest
from metafab.core.numeric.interpolation import spline_weights
from metafab.core.parallel.executor import kept_threads
from metafab.decode.confidence import LARGEST_ERROR
from metafab.decode.matching.cost_volume import CostVolume, correlation
from metafab.decode.matching.depth import spline_peaks
from metafab.decode.segmentation.fit import Misfit, away_from_outlines, is_wide, misfit_at
from metafab.decode.segmentation.layered.layer_light import LayerOptics
from metafab.decode.segmentation.objects.null_channel import BOTH_HALVES, WINDOW, NullChannel
from metafab.decode.segmentation.planes import Plane
from metafab.decode.segmentation.prepared_frame import PreparedFrame
from metafab.decode.segmentation.segments import Regions, SegmentDepth

#: Fewest downsampled pixels of foreign light that begin a ridge, and most such components that are examined.
_FEWEST, _MOST = 12, 60
#: Least length of a bar, frame pixels, and least ratio of the length of a ridge to its width.
_LEAST_LENGTH_PX, _LEAST_RATIO = 60.0, 3.0
#: Half width of the core of a ridge and length over which its misfit is averaged, frame pixels, and least geometric
#: mean of that misfit: that of surfaces is 0.8, and 1.2 in one window of ten.
_CORE_PX, _ALONG_PX, _RIDGE = 6.0, 27.0, 1.6
#: Least misfit, and logarithm of the misfit of pixels that are not judged.
_LEAST_MISFIT, _NONE = 0.2, -1.0
#: Rounds of the fit of a line to a ridge, and half width of the ridge in them, frame pixels.
_ROUNDS, _HALF_RIDGE_PX = 2, 15.0
#: Distance that blur and the misfit's window add to a ridge at each end, frame pixels.
_HALO_PX = 11.0
#: Distance from the middle of a ridge up to which the products are the bar's, and distances between which they are
#: those of the surface behind it, frame pixels. With up to 11 px, 9.4 bars of 11 are within 2 % in place of 9.6.
_OWN_PX, _BESIDE_PX = 8.0, (20.0, 40.0)
#: Length of the pieces of the jackknife, frame pixels, and fewest pieces.
_PIECE_PX, _FEWEST_PIECES = 27.0, 3
#: Fewest candidate depths nearer than the surface, for a spline.
_FEWEST_CANDIDATES = 5
#: Error of depth in standard errors of the jackknife: rms of 54 bars of 5 px in five frames.
_ERROR_RATIO = 1.35
#: Error by what is taken for the surface's share, over the change of 1/depth from all of that share to half of it.
#: Where the surface is near, the bar's own product is not 0 at the surface's depth, and the share is too large: bars
#: come out too near. Where that change exceeds 1 %, bars of 5 and 8 px in four scenes were off by 0.4 to 3 times it.
_SHARE_RATIO = 1.5
#: Length of the strips whose evidence gives the place, downsampled pixels: the even middle of the null channel.
_STRIP = 40.0
#: Places across the ridge, and half widths, of strips, downsampled pixels; the narrowest is a tenth of a pixel's light.
_PLACES, _HALF_WIDTHS = np.linspace(-3.0, 3.0, 61), np.geomspace(0.2, 4.0, 14)
#: Prior rms of a strip's light less the surface's, over the surface's: it tells bright narrow bars from wide dim ones.
_LIGHT = 0.5
#: Bins of the frequencies across a strip: within 3 pixels, phases are off by 0.005 rad at most.
_BINS = 4096


@dataclass(frozen=True)
class Ridge:
    """A straight ridge of light that does not fit a surface, on the downsampled pixels."""

    middle: FloatArray  #: Shape (2,), (row, column).
    along: FloatArray  #: Shape (2,), unit vector along it, (row, column).
    length: float  #: Length, downsampled pixels.
    behind: int  #: Number of the surface's segment.

    @property
    def across(self) -> FloatArray:
        """Unit vector across it, shape (2,)."""
        return np.array([-self.along[1], self.along[0]])

    def places(self, along: FloatArray, across: FloatArray) -> FloatArray:
        """Rows and columns of a grid of places along and across, shapes (n,) and (m,): shape (2, n, m)."""
        return (
            self.middle[:, None, None]
            + self.along[:, None, None] * along[:, None]
            + self.across[:, None, None] * across
        )

    def band(self, shape: tuple[int, int], half_width: float) -> tuple[NDArray[np.bool_], FloatArray]:
        """Pixels within a half width of the ridge, and the place of each pixel along it: shapes (n_y, n_x)."""
        row, column = np.ogrid[: shape[0], : shape[1]]
        y, x = row - self.middle[0], column - self.middle[1]
        along = y * self.along[0] + x * self.along[1]
        inside = (np.abs(along) <= 0.5 * self.length) & (np.abs(y * self.across[0] + x * self.across[1]) <= half_width)
        return inside, along


def with_bars(
    regions: Regions, prepared: PreparedFrame, volume: CostVolume, optics: LayerOptics
) -> tuple[Regions, NDArray[np.bool_]]:
    """Add the segments of bars in place of the narrow segments along them.

    Returns:
        The segments, and the pixels of bars whose depth could not be measured: shape (n_y, n_x).
    """
    shape, step = regions.grown.shape, prepared.downsampling.step
    refused, is_surface = np.zeros(shape, dtype=bool), is_wide(regions, step)
    behind = _surfaces_behind(regions, is_surface)
    if not behind.any():
        return regions, refused
    misfit = misfit_at(prepared, volume, regions.vergence_per_m(behind), regions.interior)
    mixtures = is_surface & _mixtures(regions, misfit)
    if mixtures.any():
        behind = _surfaces_behind(regions, is_surface & ~mixtures)
        misfit = misfit_at(prepared, volume, regions.vergence_per_m(behind), regions.interior)
    found = ridges(behind, misfit, prepared.spoiled, step)
    if not found:
        return regions, refused
    bands = [ridge.band(shape, _HALF_RIDGE_PX / step)[0] for ridge in found]
    clear = ~np.any(bands, axis=0) & ~misfit.is_foreign

    def measured(ridge: Ridge) -> tuple[SegmentDepth, NDArray[np.bool_]] | None:
        plane = regions.depths[ridge.behind - 1].plane
        surface = float(plane.at(*ridge.middle[:, None])[0])
        depth = bar_depth(volume, ridge, clear & (behind == ridge.behind), surface, step)
        mask = None if depth is None else bar_mask(prepared, optics, ridge, depth.vergence_per_m, plane)
        return None if depth is None or mask is None else (replace(depth, pixels=float(mask.sum())), mask)

    with kept_threads() as pool:
        bars = pool.map(measured, found)
    mine = np.zeros(len(regions.depths) + 1, dtype=np.int64)
    sizes = np.bincount(regions.grown.ravel(), minlength=mine.size)
    for bar, band in zip(bars, bands, strict=True):
        if bar is None:
            refused |= band & (misfit.over_noise > _RIDGE)
        else:
            mine += np.bincount(regions.grown[band], minlength=mine.size)
    mine[np.unique(behind)] = 0
    others = regions.without(np.flatnonzero(2 * mine > sizes).tolist())
    pictures, depths = [one.copy() for one in (others.label, others.interior, others.grown)], list(others.depths)
    for depth, mask in (bar for bar in bars if bar is not None):
        depths.append(depth)
        refused &= ~mask
        for picture in pictures:
            picture[mask] = len(depths)
    label, inside, grown = pictures
    return replace(others, depths=tuple(depths), label=label, interior=inside, grown=grown), refused


def _mixtures(regions: Regions, misfit: Misfit) -> NDArray[np.bool_]:
    """Whether the interior of each segment holds light of another depth, by number: shape (n_segments + 1,).

    The windows about a bar, which hold the surface behind it, too, may be a segment at a depth between both.
    """
    pixels = np.bincount(regions.interior.ravel(), minlength=len(regions.depths) + 1)
    foreign = np.bincount(regions.interior[misfit.is_foreign], minlength=pixels.size)
    return np.asarray((2 * foreign > pixels) & (np.arange(pixels.size) > 0))


def _surfaces_behind(regions: Regions, is_surface: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The surface at or nearest to each pixel of a segment: shape (n_y, n_x), 0 for none.

    ``is_surface``: whether each segment is one, by number, shape (n_segments + 1,).
    """
    wide = is_surface[regions.grown]
    if not wide.any():
        return np.zeros_like(regions.grown)
    _, row, column = nearest(wide)
    return np.where(regions.grown > 0, regions.grown[row, column], 0).astype(np.int32)


def ridges(behind: NDArray[np.int32], misfit: Misfit, spoiled: NDArray[np.bool_], step: int) -> list[Ridge]:
    """Straight ridges of misfit, those of the strongest foreign light first.

    Args:
        behind: shape (n_y, n_x), number of the surface at or behind each pixel; 0 for none.
        misfit: of each pixel at the depth of that surface.
        spoiled: shape (n_y, n_x), pixels about saturated or invalid ones.
        step: frame pixels from one downsampled pixel to the next.
    """
    judged = away_from_outlines(behind, step) & ~spoiled
    excess = np.where(judged, np.log(np.maximum(misfit.over_noise, np.float32(_LEAST_MISFIT))), _NONE)
    component, count = connected_components(misfit.is_foreign & judged)
    strength = np.bincount(component.ravel(), excess.ravel(), count + 1)[1:]
    taken, found = np.zeros(behind.shape, dtype=bool), list[Ridge]()
    for number in (1 + np.argsort(-strength)[:_MOST]).tolist():
        row, column = np.nonzero(component == number)
        if row.size < _FEWEST or 2 * taken[row, column].sum() > row.size:
            continue
        ridge = _begun(row, column, excess[row, column], int(behind[row[0], column[0]]))
        for _ in range(_ROUNDS):
            ridge = None if ridge is None else _followed(ridge, excess, behind, step)
        if ridge is not None and ridge.length * step >= _LEAST_LENGTH_PX + 2.0 * _HALO_PX:
            taken |= ridge.band(behind.shape, _HALF_RIDGE_PX / step)[0]
            found.append(replace(ridge, length=ridge.length - 2.0 * _HALO_PX / step))
    return found


def _begun(row: NDArray[np.intp], column: NDArray[np.intp], weight: FloatArray, behind: int) -> Ridge | None:
    """Ridge along the principal axis of some pixels, shape (n,) each; None unless they are long and narrow."""
    place = np.stack([row, column]).astype(np.float64)
    spread, axes = np.linalg.eigh(np.cov(place, aweights=weight))
    if spread[1] < _LEAST_RATIO**2 * spread[0]:
        return None
    return Ridge(np.average(place, axis=1, weights=weight), axes[:, 1], math.sqrt(12.0 * spread[1]), behind)


def _followed(ridge: Ridge, excess: FloatArray, behind: NDArray[np.int32], step: int) -> Ridge | None:
    """Follow a ridge to both ends, and fit the line to it anew; None where its misfit is too small.

    Args:
        ridge: to begin with.
        excess: shape (n_y, n_x), logarithm of the misfit.
        behind: shape (n_y, n_x), number of the surface behind each pixel.
        step: frame pixels from one downsampled pixel to the next.
    """
    reach, core, gap = math.hypot(*behind.shape), round(_CORE_PX / step), round(_ALONG_PX / step) | 1
    along = np.arange(-math.ceil(reach), math.ceil(reach) + 1.0)
    places = ridge.places(along, np.arange(-core, core + 1.0))
    mean = map_coordinates(excess, places, order=1, cval=_NONE).mean(axis=1)
    on_surface = map_coordinates((behind == ridge.behind).astype(np.float32), places, order=0, cval=0.0).all(axis=1)
    run = (uniform_filter1d(mean, gap) > math.log(_RIDGE)) & on_surface
    run = binary_closing(np.pad(run, gap), np.ones(gap, dtype=bool))[gap:-gap]
    number, _ = connected_components(run)
    begun = number[np.abs(along) <= 0.5 * ridge.length]
    if not begun.any():
        return None
    run = number == np.bincount(begun[begun > 0]).argmax()
    if run.sum() < 2:  # No line.
        return None
    half = round(_HALF_RIDGE_PX / step)
    across = np.arange(-half, half + 1.0)
    weight = np.maximum(map_coordinates(excess, ridge.places(along[run], across), order=1, cval=0.0), 0.0)
    total = np.maximum(weight.sum(axis=1), _LEAST_MISFIT)
    slope, offset = np.polyfit(along[run], weight @ across / total, 1, w=np.sqrt(total))
    place = 0.5 * (along[run][0] + along[run][-1])
    middle = ridge.middle + place * ridge.along + (offset + slope * place) * ridge.across
    turned = ridge.along + slope * ridge.across
    return Ridge(middle, turned / np.linalg.norm(turned), float(run.sum()), ridge.behind)


def bar_depth(
    volume: CostVolume, ridge: Ridge, surface: NDArray[np.bool_], surface_per_m: float, step: int
) -> SegmentDepth | None:
    """Depth of a bar along a ridge; None if it has none before its surface, or only one with a large error.

    Args:
        volume: cost volume.
        ridge: of the bar.
        surface: shape (n_y, n_x), pixels of the surface behind it that hold no other light.
        surface_per_m: 1/depth of that surface.
        step: frame pixels from one downsampled pixel to the next.
    """
    near, far = (ridge.band(volume.shape, px / step)[0] for px in _BESIDE_PX)
    beside = far & ~near & surface
    own, along = ridge.band(volume.shape, _OWN_PX / step)
    count = round(ridge.length * step / _PIECE_PX)
    if count < _FEWEST_PIECES or beside.sum() < own.sum():
        return None
    piece = np.clip(np.floor((along / ridge.length + 0.5) * count), 0, count - 1)
    pieces = volume.label_sums(np.where(own, 1 + piece, 0).astype(np.int32), count)
    of_surface = volume.label_sums(beside.astype(np.int32), 1)[0]
    # Leave-one-out sums, and the sum of all.
    sums = np.concatenate([pieces.sum(axis=0) - pieces, pieces.sum(axis=0)[None]])
    nodes = volume.vergences_per_m
    at_surface, first = spline_weights(nodes, np.array([surface_per_m]))[0], int(np.searchsorted(nodes, surface_per_m))
    if nodes.size - first < _FEWEST_CANDIDATES:
        return None
    share = np.maximum(sums[:, 0] @ at_surface / (of_surface[0] @ at_surface), 0.0)
    # Last, less half of the surface's share.
    shares = np.append(share, 0.5 * share[-1])[:, None] * of_surface[0]
    rest = (np.concatenate([sums[:, 0], sums[-1:, 0]]) - shares)[:, first:]
    # The product is negative where the bar is brighter than what it hides in one image, and darker in the other.
    peak = spline_peaks(rest * np.sign(rest[-2, np.abs(rest[-2]).argmax()]))
    *without_one, one, half = (nodes[first] + volume.step_per_m * peak.place).tolist()
    scatter = _ERROR_RATIO * math.sqrt((count - 1) * float(np.var(without_one)))
    error = math.hypot(scatter, _SHARE_RATIO * (one - half)) / one
    if not (peak.inside[:-1].all() and error < LARGEST_ERROR):
        return None
    nearest_candidate = int(np.abs(nodes - one).argmin())
    products = pieces.sum(axis=0)[:, nearest_candidate]
    power = float(np.sqrt(products[1] * products[2])) / float(own.sum())
    return SegmentDepth(one, error, float(correlation(products)), power, Plane(one), of_outline=True)


def bar_mask(
    prepared: PreparedFrame, optics: LayerOptics, ridge: Ridge, vergence_per_m: float, surface: Plane
) -> NDArray[np.bool_] | None:
    """Pixels of a bar: those of the strip of even light of most evidence in the null channel of the surface behind it.

    Args:
        prepared: the frame.
        optics: the pair on its downsampled pixels.
        ridge: of the bar.
        vergence_per_m: 1/depth of the bar.
        surface: 1/depth of the surface behind it.

    Returns:
        Shape (n_y, n_x); None without light in both images.
    """
    count = max(1, round(ridge.length / _STRIP))
    length = ridge.length / count
    evidence = np.zeros((_HALF_WIDTHS.size, _PLACES.size))
    for middle in ridge.places(length * (np.arange(float(count)) - 0.5 * (count - 1)), np.zeros(1))[..., 0].T:
        at = round(float(middle[0])), round(float(middle[1]))
        channel = NullChannel.of(prepared, optics, at, float(surface.at(*middle[:, None])[0]))
        if channel is None:
            return None
        evidence += _strip_evidence(channel, vergence_per_m, middle - at + WINDOW // 2, ridge, length)
    width, place = np.unravel_index(int(evidence.argmax()), evidence.shape)
    moved = replace(ridge, middle=ridge.middle + _PLACES[place] * ridge.across)
    return moved.band(prepared.downsampling.shape, max(float(_HALF_WIDTHS[width]), 0.5))[0]


def _strip_evidence(
    channel: NullChannel, vergence_per_m: float, middle: FloatArray, ridge: Ridge, length: float
) -> FloatArray:
    """Logarithm of the evidence of strips of even light, of unknown light in both images: shape (n_widths, n_places).

    ``middle`` of the ridge's strips, shape (2,), and their ``length`` are in pixels of the channel's window.
    """
    y, x = scipy.fft.fftfreq(WINDOW)[:, None], scipy.fft.rfftfreq(WINDOW)
    along, across = (unit[0] * y + unit[1] * x for unit in (ridge.along, ridge.across))
    wave = np.exp(2j * np.pi * (middle[0] * y + middle[1] * x))
    profile = length * channel.light * np.sinc(length * along) * np.sinc(y) * np.sinc(x)
    response, weight = channel.response(vergence_per_m), channel.precision * BOTH_HALVES
    # All strips differ in the frequency across alone: its bins are summed once.
    bins = np.rint((across + 1.0) * (0.5 * _BINS)).astype(np.intp).ravel()
    frequency = np.arange(_BINS + 1) / (0.5 * _BINS) - 1.0

    def binned(values: FloatArray) -> FloatArray:
        return np.bincount(bins, values.ravel(), _BINS + 1).astype(np.float64)

    light = 2.0 * _HALF_WIDTHS[:, None] * np.sinc(2.0 * _HALF_WIDTHS[:, None] * frequency)
    waves = np.exp(2j * np.pi * frequency[:, None] * _PLACES)
    matched = [(one.conj() * channel.spectrum * wave * (profile * weight)) for one in response]
    data = np.stack([((binned(one.real) + 1j * binned(one.imag)) * light @ waves).real for one in matched], axis=-1)
    pairs = [binned((one * other.conj()).real * weight * profile**2) for one, other in _pairs(response)]
    information = np.stack([light**2 @ one for one in pairs], axis=-1)[:, [0, 1, 1, 2]].reshape(-1, 1, 2, 2)
    # The light's prior: the surface's in both images, independent.
    prior = np.eye(2) / _LIGHT**2
    both, mean = information + prior, data + 1.0 / _LIGHT**2
    found = np.linalg.solve(both, mean[..., None])[..., 0]
    return np.asarray(0.5 * (mean * found).sum(axis=-1) - 0.5 * np.linalg.slogdet(both)[1])


def _pairs(response: NDArray[np.complex128]) -> tuple[tuple[NDArray[np.complex128], NDArray[np.complex128]], ...]:
    """Pairs of both images' responses: x x, x y, y y."""
    x, y = response
    return (x, x), (x, y), (y, y)
