"""Scene and PSF pair -> raw frame with its truth (Eq. 1 of Shen 2023)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from metafab.camera.frames.frame import RawFrame, Truth
from metafab.camera.geometry import ImageMap
from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.blur import FieldBlur
from metafab.camera.rendering.motion import Shutter, moved
from metafab.camera.rendering.render import Piece, Renderer, extent
from metafab.camera.rendering.windows import Window, sensor_windows
from metafab.camera.sensor import FixedPattern, expose
from metafab.core.conventions import FloatArray
from metafab.core.parallel.progress import Progress, silent
from metafab.optics.point_spread import Psf
from metafab.spec.scene import Scene


def capture(scene: Scene, psf: Psf, *, seed: int | None = None, progress: Progress = silent) -> RawFrame:
    """One exposure of a scene through the lens, the first frame of a film.

    Each depth is blurred by its own pair, which varies over the field where ``psf.field`` is present. Layers
    are composed from far to near; the blurred coverage of a nearer one hides what lies behind it, so light is
    never counted twice. This is exact for each layer alone; at an occluding edge it takes the share of the
    aperture that the nearer layer blocks as independent of where in the aperture the light passes.

    Args:
        scene: objects, photons, noise. A field stop passes ``scene.field_px`` pixels about the axis.
        psf: the pair over depth; depths of the scene must lie inside its range.
        seed: of textures and noise; ``scene.seed`` if not given.
        progress: called after each layer.

    Returns:
        A frame over both images and the margin that their blur needs, rows and columns on whole multiples of
        ``psf.pixel_um`` from the axis.

    Raises:
        InputError: a depth is outside the calibrated range, or the two images overlap.
    """
    return next(film(replace(scene, frames=1), psf, seed=seed, progress=progress))


def film(scene: Scene, psf: Psf, *, seed: int | None = None, progress: Progress = silent) -> Iterator[RawFrame]:
    """The frames of a scene whose objects move: as :func:`capture`, ``scene.frames`` times.

    An exposure in which something moves is the mean of as many instants as it moves pixels; with a rolling shutter
    each row has its own. The truth is that of the middle of each row's exposure. Noise differs from frame to frame;
    textures keep to their objects, and hot pixels to their places.
    """
    seed = scene.seed if seed is None else seed
    lens = _Lens(PairKernels(psf), sensor_windows(scene, psf, ImageMap.from_psf(psf)))
    pixel_tangent = psf.pixel_um / psf.sensor_distance_um
    still = Renderer.of(scene, pixel_tangent, seed)
    pattern = FixedPattern.of(scene, lens.shape, seed)
    for number in range(scene.frames):
        shutter = Shutter.of(scene, number * scene.frame_interval_s, lens.shape[0], pixel_tangent)
        mean_e = np.zeros(lens.shape)
        lens.forget()
        for index, time_s in enumerate(shutter.instants_s.tolist()):
            renderer = Renderer(moved(scene, time_s), still.textures)
            part = _share(progress, index, shutter.instants_s.size)
            mean_e += shutter.weights[:, index, None] * lens.light(renderer, part)
        rng = np.random.default_rng(np.random.SeedSequence((seed, 0x0C0FFEE, *((number,) if number else ()))))
        first, pixel = lens.windows[0], psf.pixel_um
        yield RawFrame(
            expose(mean_e, scene, pattern, rng),
            pixel,
            (lens.left * pixel, lens.bottom * pixel),
            scene.read_noise_e,
            _shutter_truth(still, first, shutter, shutter.middle_s[first.row - lens.bottom :][: scene.field_px[0]]),
            (first.column * pixel, first.row * pixel),
            (first.row - lens.bottom, first.column - lens.left, *scene.field_px),
            scene.full_well_e,
        )


#: A blur of the paper's lens takes a megabyte.
_MOST_BLURS = 256


@dataclass(frozen=True)
class Layer:
    """What one object adds to an image, and what it hides of those behind it.

    Attributes:
        rows: of the image with its margin; likewise ``columns``.
        columns: see ``rows``.
        light: shape (n_rows, n_columns), electrons.
        hidden: the same shape, 0 to 1.
    """

    rows: slice
    columns: slice
    light: FloatArray
    hidden: FloatArray

    @classmethod
    def nowhere(cls) -> Layer:
        """Of an object out of sight."""
        return cls(slice(0, 0), slice(0, 0), *np.zeros((2, 0, 0)))


@dataclass(frozen=True)
class _Lens:
    """What turns a scene at rest into light on the sensor.

    Attributes:
        kernels: the PSF pair.
        windows: of the x and the y image.
        blurs: those of the depths that were met.
        still: layers of the objects that do not move, by polarisation and number: each is blurred once in a film.
    """

    kernels: PairKernels
    windows: tuple[Window, Window]
    blurs: dict[float, tuple[FieldBlur, FieldBlur]] = field(default_factory=dict)
    still: dict[tuple[int, int], Layer] = field(default_factory=dict)

    @property
    def left(self) -> int:
        """The frame's first column: that of the leftmost window, less the margin of its blur."""
        return min(window.column for window in self.windows) - self.kernels.shape[1] // 2

    @property
    def bottom(self) -> int:
        """The frame's first row."""
        return min(window.row for window in self.windows) - self.kernels.shape[0] // 2

    @cached_property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the frame."""
        margin_y, margin_x = self.kernels.shape
        right = max(window.column + window.seen.shape[1] for window in self.windows) + margin_x // 2
        top = max(window.row + window.seen.shape[0] for window in self.windows) + margin_y // 2
        return top - self.bottom, right - self.left

    def forget(self) -> None:
        """Let go of the blurs of past depths, where they are many: what stands still asks for the same again."""
        if len(self.blurs) > _MOST_BLURS:
            self.blurs.clear()

    def light(self, renderer: Renderer, progress: Progress) -> FloatArray:
        """Mean electrons of a scene at rest, shape :attr:`shape`."""
        mean_e = np.zeros(self.shape)
        margin_y, margin_x = self.kernels.shape
        for polarisation, window in enumerate(self.windows):
            part = _share(progress, polarisation, len(self.windows))
            light = _light(renderer, self.kernels, window, polarisation, self.blurs, self.still, part)
            row, column = window.row - self.bottom - margin_y // 2, window.column - self.left - margin_x // 2
            place = mean_e[row : row + light.shape[0], column : column + light.shape[1]]
            place += light[: place.shape[0], : place.shape[1]]
        return mean_e


def _share(progress: Progress, done: int, parts: int) -> Progress:
    """Progress of one of several equal parts."""
    return lambda step, current, total: progress(step, done * total + current, parts * total)


def _light(
    renderer: Renderer,
    kernels: PairKernels,
    window: Window,
    polarisation: int,
    blurs: dict[float, tuple[FieldBlur, FieldBlur]],
    still: dict[tuple[int, int], Layer],
    progress: Progress,
) -> FloatArray:
    """Mean electrons of one image with its blur's margin all around: window shape plus kernel shape."""
    scene = renderer.scene
    k_y, k_x = kernels.shape
    n_y, n_x = window.seen.shape
    light = np.zeros((n_y + k_y, n_x + k_x))
    if scene.background > 0.0:
        # Without structure, depth does not matter: the mean of all depths' throughputs is 1.
        inner = (slice(k_y // 2, k_y // 2 + n_y), slice(k_x // 2, k_x // 2 + n_x))
        light[inner] = scene.background * window.gain * window.seen
    for done, (index, spec) in enumerate(renderer.farthest_first(), start=1):
        place = (polarisation, index)
        layer = still.get(place)
        if layer is None:
            piece = renderer.piece(index, window.tangent_x, window.tangent_y)
            layer = Layer.nowhere() if piece is None else _blurred(piece, kernels, window, polarisation, blurs)
            if not spec.moves:
                still[place] = layer
        part = light[layer.rows, layer.columns]
        part *= 1.0 - layer.hidden
        part += layer.light
        progress("capture", done, len(scene.objects))
    return light


def _blurred(
    piece: Piece,
    kernels: PairKernels,
    window: Window,
    polarisation: int,
    blurs: dict[float, tuple[FieldBlur, FieldBlur]],
) -> Layer:
    """A piece as one image shows it.

    Its steps lie beside each other: their light adds up, and so does what they hide.
    """
    margins = [kernel - 1 for kernel in kernels.shape]
    shape = tuple(n + margin for n, margin in zip(piece.coverage.shape[1:], margins, strict=True))
    spread, hidden = np.zeros((2, *shape))
    for depth_m, coverage, brightness in zip(piece.depth_m, piece.coverage, piece.brightness, strict=True):
        if not coverage.any():
            continue
        rows, columns = extent(coverage.any(axis=1)), extent(coverage.any(axis=0))
        crop = (_beyond(piece.rows, rows), _beyond(piece.columns, columns))
        flux = piece.share[polarisation] * window.gain[crop] * brightness[rows, columns]
        if depth_m not in blurs:
            blurs[depth_m] = FieldBlur.at_depth(kernels, float(depth_m))
        lit, covered = blurs[depth_m][polarisation](
            flux * window.seen[crop],
            coverage[rows, columns] * window.seen[crop],
            window.tangent_x[crop],
            window.tangent_y[crop],
        )
        part = tuple(slice(at.start, at.start + n) for at, n in zip((rows, columns), lit.shape, strict=True))
        spread[part] += lit
        hidden[part] += covered
    rows, columns = (slice(at.start, at.start + n) for at, n in zip((piece.rows, piece.columns), shape, strict=True))
    return Layer(rows, columns, spread, np.clip(hidden, 0.0, 1.0))


def _beyond(outer: slice, inner: slice) -> slice:
    """A part of a part, in the coordinates of the whole."""
    return slice(outer.start + inner.start, outer.start + inner.stop)


def _shutter_truth(still: Renderer, window: Window, shutter: Shutter, middle_s: FloatArray) -> Truth:
    """The truth of each row of the window at the middle of its exposure (of a rolling shutter, the next instant)."""

    def at(time_s: float) -> Truth:
        return _truth(Renderer(moved(still.scene, time_s), still.textures), window)

    if middle_s[0] == middle_s[-1] or shutter.instants_s.size == 1:
        return at(float(middle_s[middle_s.size // 2]))
    nearest = np.abs(middle_s[:, None] - shutter.instants_s).argmin(axis=1)
    truths = {index: at(float(shutter.instants_s[index])) for index in np.unique(nearest).tolist()}
    columns = ([getattr(truths[index], item.name)[row] for row, index in enumerate(nearest)] for item in fields(Truth))
    return Truth(*(np.stack(rows) for rows in columns))


def _truth(renderer: Renderer, window: Window) -> Truth:
    """Depths, labels and sharp intensities of the nearest piece at each pixel; a pixel is whose half it is."""
    scene = renderer.scene
    shape = window.seen.shape
    depth_m, label = np.full(shape, np.nan), np.zeros(shape, dtype=np.int32)
    intensity = np.stack([scene.background * window.gain] * 2)
    for piece in renderer.pieces(window.tangent_x, window.tangent_y):
        crop = (piece.rows, piece.columns)
        coverage = piece.coverage.sum(axis=0)
        for channel in (0, 1):
            lit = piece.brightness.sum(axis=0) * piece.share[channel] * window.gain[crop]
            intensity[channel][crop] = intensity[channel][crop] * (1.0 - coverage) + lit
        owned = coverage >= 0.5
        mean_m = np.tensordot(piece.depth_m, piece.coverage, axes=(0, 0)) / np.maximum(coverage, 1e-12)
        depth_m[crop] = np.where(owned, mean_m, depth_m[crop])
        label[crop] = np.where(owned, piece.label, label[crop])
    return Truth(depth_m, intensity[0], intensity[1], label)
