"""PSF pair from photographs or foreign simulations of a point at known depths: background, centre, twin and scale.

A calibration by photographs lacks part of a computed pair. Assumptions fill in, each named by an entry of
:attr:`StackImport.made`: the twin by point reflection, the efficiency, the distance of the sensor, the split of the
images, the zero of the depths.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from metafab.core.conventions import FloatArray
from metafab.core.errors import Fault, InputError
from metafab.core.numeric.spread import normal_sigma
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.measures.centring import Centre, Centring, find_centre
from metafab.optics.measures.metrics import orientation_deg
from metafab.optics.point_spread import Psf, PsfField
from metafab.spec.fields import LARGEST

FEWEST_DEPTHS = 3
#: Smallest side of a picture, pixels: a border and a lobe.
_SMALLEST_PX = 8
#: Width of the border that measures the background, as a share of the shorter side.
_BORDER = 1.0 / 16.0
#: Standard deviation of rounding to whole levels, in levels.
_ROUNDING = 1.0 / math.sqrt(12.0)
#: Largest count of a camera; larger whole numbers are no counts.
_LARGEST_COUNT = 2.0**53
#: Standard deviations of the border's noise below which a pixel counts as dark.
_SIGMAS = 3.0
#: Standard deviations of noise that no pixel of a dark picture exceeds: of 10^6 pixels, 0.001 do by chance.
_DARK_SIGMAS = 6.0
#: Largest value of a stack, and inverse of its smallest: far from where powers overflow.
_MOST_PEAK = 1e50
#: Pixels of a picture that share exactly its largest value without saturation: four by a centred, symmetric spot.
_MOST_PEAKS = 4
#: Share of a picture's light within the border from which the window is called too small.
_CROWDED = 0.01
#: Distance of the sensor where it is not given, mm; the decoder's depth does not depend on it.
_DISTANCE_MM = 20.0
#: Smallest distance of the sensor, mm: a micrometre.
_LEAST_DISTANCE_MM = 1e-3
#: Directions along each axis of a split lens's field: opposite distortion is quadratic in the tangent.
_FIELD_NODES = 3
#: Distance between the two images where it is not given, pixels; frames simulated with the pair have it.
_SPLIT_PX = 512


@dataclass(frozen=True)
class StackImport:
    """Figures of an imported stack."""

    channels: int  #: Channels of the file; with one, the other is its point reflection.
    window_px: tuple[int, int]  #: Rows and columns.
    depth_m: tuple[float, ...]  #: Object depths of the pair.
    centring: str  #: Rule by which each channel was centred.
    #: (x, y) of each channel's centre from its middle pixel; this place is now the middle pixel.
    centre_px: tuple[tuple[float, float], ...]
    centre_error_px: tuple[float, ...]  #: Standard error of each; NaN unless a lobe turns on a circle.
    background: float  #: Median of the border, mean over the pictures, in the file's units; subtracted.
    noise: float  #: Standard deviation of the border, likewise.
    error: float  #: Largest relative L2 error of a picture by this noise.
    border_light: float  #: Largest share of a picture's light in its border after the subtraction.
    channel_ratio: float  #: Light of the x channel over that of the y channel, over all depths.
    split_um: tuple[float, float]  #: (x, y) from the x image to the y image on the sensor.
    distance_mm: float  #: Distance of the sensor.
    zero_m: float  #: Distance from the lens of the file's depth 0.
    made: tuple[str, ...]  #: Sentences on the assumptions in place of data that the file lacks.
    warnings: tuple[str, ...]  #: Sentences on what may spoil the pair.


def psf_of_stack(
    stack: FloatArray,
    depth_m: FloatArray,
    pixel_um: float,
    *,
    split_um: tuple[float, float] | None = None,
    distance_mm: float | None = None,
    zero_m: float | None = None,
    centring: Centring = "auto",
    integrated: bool = True,
    split_lens: bool = False,
) -> tuple[Psf, StackImport]:
    """Make the PSF pair of a stack of pictures of a point on the axis.

    One shift centres all depths of a channel, since a lobe that turns has to keep its place about the centre. The place
    of the channel's image moves with it: ``split_um`` is the distance between the middle pixels of both channels'
    pictures in the camera's frame, or between the centres of the images for one channel.

    Args:
        stack: shape (channels, n_depth, n_y, n_x), one or two channels, lowest row first; counts of any scale.
        depth_m: shape (n_depth,), increasing, relative to ``zero_m``.
        split_um: (x, y) from the x to the y image; assumed if not given.
        distance_mm: distance of the sensor; assumed if not given.
        zero_m: distance from the lens of depth 0; if not given 0, or assumed where a depth is not positive.
        centring: rule for the centre.
        integrated: whether values are integrals over the pixel, as a camera's are, or samples at its centre. The pair
            is stored as samples: integrals are divided by the pixel's transfer function.
        split_lens: whether the images are those of a lens that splits by a grating along x, whose opposite distortion
            follows from ``split_um`` and ``distance_mm``; otherwise both images have no distortion.

    Raises:
        InputError: other shapes, values or depths, or a split lens without its geometry, all faults at once; a zero
            that leaves depths behind the lens; dark pictures; no circle for the centre.
    """
    depth_m = np.asarray(depth_m, dtype=np.float64)
    faults = [
        *_stack_faults(stack, depth_m),
        *_depth_faults(depth_m),
        *_geometry_faults(pixel_um, split_um, distance_mm, split_lens=split_lens),
    ]
    if faults:
        raise InputError("PSF stack", faults)
    depth, zero, made = _from_lens(depth_m, zero_m)
    lit, background, noise = _without_background(stack, depth)
    channels, _, n_y, n_x = stack.shape
    found = [find_centre(channel, centring) for channel in lit]
    centres = [one.place_px for one in found]
    pair = np.array([_moved(channel, place, integrated) for channel, place in zip(lit, centres, strict=True)])
    if channels == 1:
        made.append("the y image: the point reflection of the x image, of equal light")
        pair = np.concatenate([pair, _reflected(pair)])
    ratio = float(pair[0].sum() / pair[1].sum())
    made.append("efficiency: 1 for the mean of both images at each depth")
    pair = pair / (pair.sum(axis=(-2, -1)).mean(axis=0)[None, :, None, None] * pixel_um**2)
    split_um, distance_mm, assumed = _geometry(pixel_um, split_um, distance_mm)
    made += assumed
    offset_um = pixel_um * np.array(centres if channels == 2 else [(0.0, 0.0)] * 2)
    places = offset_um + 0.5 * np.array([[-1.0], [1.0]]) * np.array(split_um)
    # Noise, at least the rounding of levels, against the signal of each picture; y made of x has the same.
    of_each = np.maximum(noise, _ROUNDING * _level(stack))
    error = (of_each * math.sqrt(n_y * n_x) / np.linalg.norm(lit, axis=(-2, -1))).max(axis=0)
    crowded = float(((lit * _border((n_y, n_x))).sum(axis=(-2, -1)) / lit.sum(axis=(-2, -1))).max())
    psf = Psf(
        depth_m=depth,
        pixel_um=pixel_um,
        psf=pair,
        centre_um=np.repeat(places[:, None], depth.size, axis=1),
        phi_deg=orientation_deg(pair[0]),
        error=error,
        efficiency=pair.sum(axis=(-2, -1)) * pixel_um**2,
        extinction_ratio=np.full(depth.size, np.nan),
        sensor_distance_um=1e3 * distance_mm,
    )
    if split_lens:
        psf = replace(psf, field=_distorted_field(psf, split_um[0], offset_um))
    figures = StackImport(
        channels=channels,
        window_px=(n_y, n_x),
        depth_m=tuple(depth.tolist()),
        centring=" and ".join(dict.fromkeys(one.rule for one in found)),
        centre_px=tuple(centres),
        centre_error_px=tuple(one.error_px for one in found),
        background=float(background.mean()),
        noise=float(noise.mean()),
        error=float(error.max()),
        border_light=crowded,
        channel_ratio=ratio,
        split_um=split_um,
        distance_mm=distance_mm,
        zero_m=zero,
        made=tuple(made),
        warnings=(*_spoiled(found, crowded), *_saturated(stack, depth)),
    )
    return psf, figures


def _geometry(
    pixel_um: float, split_um: tuple[float, float] | None, distance_mm: float | None
) -> tuple[tuple[float, float], float, list[str]]:
    """Split of the images and distance of the sensor, and sentences on those that are assumed."""
    made = []
    if split_um is None:
        split_um = (_SPLIT_PX * pixel_um, 0.0)
        made.append(f"split of the images: {split_um[0]:g} um along x; a real camera's frames need their own")
    if distance_mm is None:
        distance_mm = _DISTANCE_MM
        made.append(f"distance of the sensor: {distance_mm:g} mm; depths do not depend on it")
    return split_um, distance_mm, made


def _spoiled(found: Sequence[Centre], border_light: float) -> list[str]:
    """Sentences on the channels' centres and on the share of light in the border of the windows."""
    # With two channels, the place of each image moves with its centre; the twin made of one is reflected about it.
    sentences = [one.warning for one in found if len(found) == 1 and one.warning is not None]
    if border_light > _CROWDED:
        share = f"{100.0 * border_light:.2g} %"
        sentences.append(f"{share} of a picture's light lies in its border: photograph a larger window")
    return sentences


def _saturated(stack: FloatArray, depth_m: FloatArray) -> list[str]:
    """A sentence on a picture of which many pixels share the largest value."""
    shared = (stack == stack.max(axis=(-2, -1), keepdims=True)).sum(axis=(-2, -1))
    if (most := int(shared.max())) <= _MOST_PEAKS:
        return []
    _, at = np.unravel_index(shared.argmax(), shared.shape)
    pixels = f"{most} pixels of the picture at {depth_m[at]:g} m"
    return [f"{pixels} share exactly its largest value: is it saturated?"]


def _from_lens(depth_m: FloatArray, zero_m: float | None) -> tuple[FloatArray, float, list[str]]:
    """Depths from the lens, shape (n_depth,), the distance of their zero, and the assumption on it.

    InputError for a zero that leaves depths behind the lens, or none apart.
    """
    made = []
    zero = 0.0 if zero_m is None else zero_m
    if zero_m is None and depth_m[0] <= 0.0:
        # The nearest depth is one range from the lens: 1/depth then changes by a factor of two over the stack.
        zero = float(np.ptp(depth_m) - depth_m[0])
        made.append(f"depth 0 of the file: {zero:g} m from the lens; subtract it from decoded depths")
    depth = depth_m + zero
    if not (abs(zero) <= LARGEST and depth[0] > 0.0 and (np.diff(depth) > 0.0).all()):
        expected = f"a distance up to {LARGEST:g} m that keeps all depths before the lens, and apart"
        got = f"{zero:g} m, nearest depth {depth[0]:g} m"
        raise InputError.single("PSF stack", "zero_m", expected, got)
    return depth, zero, made


def _stack_faults(stack: FloatArray, depth_m: FloatArray) -> Iterator[Fault]:
    """Faults of shape and values."""
    if stack.ndim != 4 or stack.shape[0] not in {1, 2} or min(stack.shape[2:]) < _SMALLEST_PX:
        expected = f"(1 or 2 channels, depths, rows, columns), {_SMALLEST_PX} pixels a side or more"
        yield Fault("stack", expected, f"shape {stack.shape}")
    elif depth_m.shape != stack.shape[1:2]:
        yield Fault("depths", f"one for each of {stack.shape[1]} pictures", f"shape {depth_m.shape}")
    if not np.isfinite(stack).all():
        got = f"{int((~np.isfinite(stack)).sum())} values NaN or infinite"
        yield Fault("stack", "finite values", got, "repair dead pixels before the import")
    elif (peak := float(np.abs(stack).max(initial=0.0))) and not 1.0 / _MOST_PEAK <= peak <= _MOST_PEAK:
        expected = f"values whose largest lies between {1.0 / _MOST_PEAK:g} and {_MOST_PEAK:g}"
        yield Fault("stack", expected, f"{peak:g}", "scale them")


def _depth_faults(depth_m: FloatArray) -> Iterator[Fault]:
    """Faults of depths relative to their zero."""
    if depth_m.size < FEWEST_DEPTHS:
        yield Fault("depths", f"{FEWEST_DEPTHS} or more, as decoding needs", f"{depth_m.size}")
    elif not (np.isfinite(depth_m).all() and (np.diff(depth_m) > 0.0).all()):
        remedy = "sort the pictures by depth, nearest first"
        yield Fault("depths", "finite, increasing depths in metres", _listed(depth_m), remedy)
    elif depth_m[-1] > LARGEST:
        yield Fault("depths", f"depths in metres, at most {LARGEST:g}", _listed(depth_m))


def _geometry_faults(
    pixel_um: float, split_um: tuple[float, float] | None, distance_mm: float | None, *, split_lens: bool
) -> Iterator[Fault]:
    """Faults of pixel, split and distance, and of a lens that splits by a grating."""
    if not 0.0 < pixel_um <= LARGEST:
        yield Fault("pixel_um", f"a number above zero, at most {LARGEST:g}", f"{pixel_um:g}")
    elif split_um is not None and not pixel_um <= math.hypot(*split_um) <= LARGEST:
        expected = f"images at least a pixel ({pixel_um:g} um) apart"
        yield Fault("split_um", expected, f"{split_um[0]:g} {split_um[1]:g}", "measure it on a frame")
    if distance_mm is not None and not _LEAST_DISTANCE_MM <= distance_mm <= LARGEST:
        yield Fault("distance_mm", f"a number from {_LEAST_DISTANCE_MM:g} to {LARGEST:g}", f"{distance_mm:g}")
    if split_lens and (split_um is None or distance_mm is None or split_um[1] != 0.0 or split_um[0] == 0.0):
        expected = "the distance of the sensor and a split along x alone, from which the distortion follows"
        distance = "no distance" if distance_mm is None else f"{distance_mm:g} mm"
        split = "no split" if split_um is None else f"{split_um[0]:g} {split_um[1]:g} um"
        yield Fault("split_lens", expected, f"{distance} and {split}")


def _listed(depth_m: FloatArray) -> str:
    text = ", ".join(f"{value:g}" for value in depth_m[:8])
    return f"{text}, ..." if depth_m.size > 8 else text


def _border(shape: tuple[int, int]) -> FloatArray:
    """1 in the border of a picture, 0 inside, shape (n_y, n_x)."""
    width = max(1, round(_BORDER * min(shape)))
    border = np.ones(shape)
    border[width:-width, width:-width] = 0.0
    return border


def _level(stack: FloatArray) -> float:
    """Step between the levels of whole counts, such as 16 for 12 bits stored in the upper bits of 16; 0 for others."""
    if not np.array_equal(stack, np.rint(stack)) or np.abs(stack).max() > _LARGEST_COUNT:
        return 0.0
    return float(np.gcd.reduce(stack.astype(np.int64), axis=None))


def _without_background(stack: FloatArray, depth_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pictures less the median of their border, 0 below three standard deviations of its noise.

    Also background and standard deviation of each, shape (channels, n_depth). InputError if no pixel of a picture is
    brighter than noise alone.
    """
    ring = stack[..., _border(stack.shape[2:]) > 0.0]
    background = np.median(ring, axis=-1)
    noise = normal_sigma(ring - background[..., None], axis=-1)
    lit = stack - background[..., None, None]
    lit = np.where(lit > _SIGMAS * noise[..., None, None], lit, 0.0)
    dark = np.argwhere(lit.max(axis=(-2, -1)) <= _DARK_SIGMAS * noise)
    if dark.size:
        where = ", ".join(f"channel {c + 1} at {depth_m[d]:g} m" for c, d in dark[:4])
        expected = "light above the background in each picture"
        raise InputError.single("PSF stack", "stack", expected, f"none in {where}", "expose longer, or leave it out")
    return lit, background, noise


def _moved(channel: FloatArray, centre_px: tuple[float, float], integrated: bool) -> FloatArray:
    """Pictures with ``centre_px`` at the middle pixel, as samples, by Fourier transform."""
    if centre_px == (0.0, 0.0) and not integrated:
        return channel
    shape = (channel.shape[1], channel.shape[2])
    ky, kx = scipy.fft.fftfreq(shape[0])[:, None], scipy.fft.rfftfreq(shape[1])[None, :]
    transfer = np.exp(2j * np.pi * (kx * centre_px[0] + ky * centre_px[1]))
    if integrated:
        # At least (2/pi)^2 = 0.41; the decoder's kernels are multiplied by it again.
        transfer = transfer / (np.sinc(ky) * np.sinc(kx))
    return np.asarray(scipy.fft.irfft2(scipy.fft.rfft2(channel) * transfer, shape))


def _reflected(pictures: FloatArray) -> FloatArray:
    """Point reflection about the middle pixel ``[n_y // 2, n_x // 2]``, shape (..., n_y, n_x)."""
    turned = pictures[..., ::-1, ::-1]
    n_y, n_x = pictures.shape[-2:]
    return np.roll(turned, (1 - n_y % 2, 1 - n_x % 2), axis=(-2, -1))


def _distorted_field(psf: Psf, split_um: float, offset_um: FloatArray) -> PsfField:
    """The pair of the axis in all directions, at the places of a split lens's images.

    The field reaches to where the two images meet, and as far along y.
    """
    distance_um = psf.sensor_distance_um
    angle_deg = math.degrees(math.atan(0.5 * split_um / distance_um))
    lens = Imaging(
        wavelength_um=1.0,
        focal_length_mm=1.0,
        split_angle_deg=angle_deg,
        sensor_distance_um=distance_um,
        pixel_um=psf.pixel_um,
        aperture_um=1.0,
    )
    tangents = np.linspace(-0.5, 0.5, _FIELD_NODES) * abs(split_um) / distance_um
    places = [[[lens.image_point_um(p, (x, y)) for x in tangents] for y in tangents] for p in (0, 1)]
    centre_um = np.array(places) + offset_um[:, None, None]
    n_depth, n_y, n_x = psf.psf.shape[1:]
    shape = (2, n_depth, _FIELD_NODES, _FIELD_NODES)
    return PsfField(
        tangents,
        tangents,
        np.broadcast_to(psf.psf[:, :, None, None].astype(np.float32), (*shape, n_y, n_x)),
        np.broadcast_to(centre_um[:, None], (*shape, 2)),
    )
