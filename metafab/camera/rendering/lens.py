"""Both images of a scene at rest: layers of its objects, blurred and composed from far to near."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.blur import FieldBlur
from metafab.camera.rendering.render import Piece, Renderer, extent
from metafab.camera.rendering.windows import Window
from metafab.core.conventions import FloatArray
from metafab.core.parallel.progress import Progress

#: Blurs that are kept from frame to frame; one of the paper's lens takes a megabyte.
_MOST_BLURS = 256


@dataclass(frozen=True)
class Layer:
    """The light of one object in an image, and the share of the light behind it that it hides.

    Attributes:
        rows: rows of the image, margin included.
        columns: columns of the image.
        light: shape (n_rows, n_columns), electrons.
        hidden: shape (n_rows, n_columns), 0 to 1.
    """

    rows: slice
    columns: slice
    light: FloatArray
    hidden: FloatArray

    @classmethod
    def empty(cls) -> Layer:
        """The layer of an object out of sight."""
        return cls(slice(0, 0), slice(0, 0), *np.zeros((2, 0, 0)))


@dataclass(frozen=True)
class Lens:
    """A lens that blurs scenes, and the blurred layers that later frames of a film share.

    Attributes:
        kernels: the PSF pair.
        windows: of the x and the y image.
        blurs: blurs of both polarisations by depth.
        still: layers of the objects that do not move, by (polarisation, number): each is blurred once in a film.
        crossed: whether the kernels are of each image for light of the other polarisation, the ghosts of a substrate.
    """

    kernels: PairKernels
    windows: tuple[Window, Window]
    blurs: dict[float, tuple[FieldBlur, FieldBlur]] = field(default_factory=dict)
    still: dict[tuple[int, int], Layer] = field(default_factory=dict)
    crossed: bool = False

    @property
    def left(self) -> int:
        """First column of the frame: that of the leftmost window, less the margin of its blur."""
        return min(window.column for window in self.windows) - self.kernels.shape[1] // 2

    @property
    def bottom(self) -> int:
        """First row of the frame."""
        return min(window.row for window in self.windows) - self.kernels.shape[0] // 2

    @cached_property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the frame."""
        margin_y, margin_x = self.kernels.shape
        right = max(window.column + window.stop.shape[1] for window in self.windows) + margin_x // 2
        top = max(window.row + window.stop.shape[0] for window in self.windows) + margin_y // 2
        return top - self.bottom, right - self.left

    def drop_blurs(self) -> None:
        """Delete the blurs of past depths if they are many."""
        if len(self.blurs) > _MOST_BLURS:
            self.blurs.clear()

    def light(self, renderer: Renderer, progress: Progress) -> FloatArray:
        """Mean electrons of each pixel for a scene at rest: shape :attr:`shape`."""
        mean_e = np.zeros(self.shape)
        margin_y, margin_x = self.kernels.shape
        for polarisation, window in enumerate(self.windows):
            part = partial_progress(progress, polarisation, len(self.windows))
            light = self._image(renderer, polarisation, part)
            row, column = window.row - self.bottom - margin_y // 2, window.column - self.left - margin_x // 2
            place = mean_e[row : row + light.shape[0], column : column + light.shape[1]]
            place += light[: place.shape[0], : place.shape[1]]
        return mean_e

    def _image(self, renderer: Renderer, polarisation: int, progress: Progress) -> FloatArray:
        """Mean electrons of one image with the margin of its blur: window shape plus kernel shape."""
        scene, window = renderer.scene, self.windows[polarisation]
        (k_y, k_x), (n_y, n_x) = self.kernels.shape, window.stop.shape
        light = np.zeros((n_y + k_y, n_x + k_x))
        if scene.background > 0.0:
            # The background has no structure, so that its depth does not matter.
            inner = (slice(k_y // 2, k_y // 2 + n_y), slice(k_x // 2, k_x // 2 + n_x))
            light[inner] = scene.background * self.kernels.mean_throughput * window.gain * window.stop
        for done, (index, spec) in enumerate(renderer.farthest_first(), start=1):
            layer = self.still.get((polarisation, index))
            if layer is None:
                piece = renderer.piece(index, window.tangent_x, window.tangent_y)
                layer = Layer.empty() if piece is None else self._blurred(piece, polarisation)
                if not spec.moves:
                    self.still[polarisation, index] = layer
            part = light[layer.rows, layer.columns]
            part *= 1.0 - layer.hidden
            part += layer.light
            progress("capture", done, len(scene.objects))
        return light

    def _blurred(self, piece: Piece, polarisation: int) -> Layer:
        """The layer of a piece: the steps of its depth do not hide each other, and add up."""
        window = self.windows[polarisation]
        n_y, n_x = (n + kernel - 1 for n, kernel in zip(piece.coverage.shape[1:], self.kernels.shape, strict=True))
        light, hidden = np.zeros((2, n_y, n_x))
        for depth_m, coverage, brightness in zip(piece.depth_m, piece.coverage, piece.brightness, strict=True):
            if not coverage.any():
                continue
            rows, columns = extent(coverage.any(axis=1)), extent(coverage.any(axis=0))
            crop = (_shifted(rows, piece.rows.start), _shifted(columns, piece.columns.start))
            flux = (
                piece.share[1 - polarisation if self.crossed else polarisation]
                * window.gain[crop]
                * brightness[rows, columns]
            )
            if depth_m not in self.blurs:
                self.blurs[depth_m] = FieldBlur.at_depth(self.kernels, float(depth_m))
            blurred = self.blurs[depth_m][polarisation](
                flux * window.stop[crop],
                coverage[rows, columns] * window.stop[crop],
                window.tangent_x[crop],
                window.tangent_y[crop],
            )
            height, width = blurred[0].shape
            part = (slice(rows.start, rows.start + height), slice(columns.start, columns.start + width))
            light[part] += blurred[0]
            hidden[part] += blurred[1]
        place = (slice(0, n_y), slice(0, n_x))
        rows, columns = _shifted(place[0], piece.rows.start), _shifted(place[1], piece.columns.start)
        return Layer(rows, columns, light, np.clip(hidden, 0.0, 1.0))


def partial_progress(progress: Progress, done: int, parts: int) -> Progress:
    """Progress of one of several equal parts."""
    return lambda step, current, total: progress(step, done * total + current, parts * total)


def _shifted(part: slice, start: int) -> slice:
    return slice(start + part.start, start + part.stop)
