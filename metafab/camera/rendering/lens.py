"""Both images of a scene at rest: the light of its objects that the aperture sees, blurred and added."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from metafab.camera.kernels import PairKernels
from metafab.camera.rendering.blurs import Blurs
from metafab.camera.rendering.occlusion import Occluder, hidden_region, padded, visible_piece, visible_share
from metafab.camera.rendering.picture import DepthPicture, surfaces
from metafab.camera.rendering.picture_image import picture_image
from metafab.camera.rendering.render import Piece, Renderer, extent, shifted
from metafab.camera.rendering.windows import Window, shifts_px_m
from metafab.core.conventions import FloatArray
from metafab.core.parallel.executor import kept_threads
from metafab.core.parallel.progress import Progress

#: Key in place of an object's number for a whole image: of a picture, or of a scene in which nothing moves.
_WHOLE = -1


@dataclass(frozen=True)
class Layer:
    """The light of one object in an image."""

    rows: slice  #: Rows of the image, margin included.
    columns: slice  #: Columns of the image.
    light: FloatArray  #: Shape (n_rows, n_columns), electrons.
    mask: Occluder | None  #: Region that the object hides; None for one out of sight.
    flux: FloatArray  #: Shape of the mask, electrons that it would send if nothing stood before it.
    piece: Piece | None = None  #: The object before any blur, kept in the x image for flat objects at rest.

    @classmethod
    def empty(cls) -> Layer:
        """The layer of an object out of sight."""
        return cls(slice(0, 0), slice(0, 0), np.zeros((0, 0)), None, np.zeros((0, 0)))


@dataclass(frozen=True)
class Lens:
    """A lens that blurs scenes, and the blurred layers that later frames of a film share."""

    blurs: Blurs  #: Blurs of the PSF pair.
    windows: tuple[Window, Window]  #: Of the x and the y image.
    #: Layers of the objects that do not move, by (polarisation, number): each is blurred once in a film,
    #: less the light that other objects at rest hide. Where nothing moves, the image as a whole.
    still: dict[tuple[int, int], Layer] = field(default_factory=dict)
    #: Picture with its depth that is photographed in place of objects; it does not move.
    picture: DepthPicture | None = None
    #: Whether the kernels are those of ghosts: in each image, light of the other polarisation (birefringent substrate).
    crossed: bool = False

    @property
    def kernels(self) -> PairKernels:
        """The PSF pair."""
        return self.blurs.kernels

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

    def forget_textures(self) -> None:
        """Delete the blurred objects, whose textures another draw changes; a picture stays."""
        if self.picture is None:
            self.still.clear()

    def pieces(self, renderer: Renderer) -> Iterator[Piece]:
        """Yield the objects in sight of the x image, farthest first; those that :meth:`light` kept are not redrawn."""
        window = self.windows[0]
        for index, _ in renderer.farthest_first():
            layer = self.still.get((0, index), Layer.empty())
            piece = layer.piece or renderer.piece(index, window.tangent_x, window.tangent_y)
            if piece is not None:
                yield piece

    @kept_threads()
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
        if (kept := self.still.get((polarisation, _WHOLE))) is not None:
            return kept.light
        if self.picture is not None:
            self._add_picture(light, self.picture, polarisation)
            return self._kept(light, polarisation)
        nearer: list[Occluder] = []
        veil = np.zeros_like(light)
        for done, (index, spec) in enumerate(reversed(renderer.farthest_first()), start=1):
            layer = self.still.get((polarisation, index))
            at_rest = [mask for mask in nearer if not mask.moves]
            if layer is None:
                piece = renderer.piece(index, window.tangent_x, window.tangent_y)
                layer = self._layer(piece, polarisation, nearer if spec.moves else at_rest, moves=spec.moves)
                if not spec.moves:
                    is_kept = polarisation == 0 and piece is not None and piece.depth_m.size == 1
                    self.still[polarisation, index] = replace(layer, piece=piece) if is_kept else layer
            light[layer.rows, layer.columns] += layer.light
            if layer.mask is not None:
                if not spec.moves and len(at_rest) < len(nearer):
                    self._darken(light, renderer, index, polarisation, layer.mask, nearer)
                self._balance(light, veil, layer.mask, layer.flux, polarisation, nearer)
                nearer.append(layer.mask)
            progress("capture", done, len(scene.objects))
        if scene.background > 0.0:
            # The background has no structure: it is not blurred. It is hidden like a surface at the farthest
            # calibrated depth.
            sky = Occluder.everywhere((n_y, n_x), float(self.kernels.psf.depth_m.max()))
            share = visible_share(sky, nearer, self._shifts(window))
            inner = (slice(k_y // 2, k_y // 2 + n_y), slice(k_x // 2, k_x // 2 + n_x))
            light[inner] += scene.background * self.kernels.mean_throughput * window.gain * window.stop * share
        return light if any(spec.moves for spec in scene.objects) else self._kept(light, polarisation)

    def _kept(self, light: FloatArray, polarisation: int) -> FloatArray:
        whole = (slice(0, light.shape[0]), slice(0, light.shape[1]))
        self.still[polarisation, _WHOLE] = Layer(*whole, light, None, np.zeros((0, 0)))
        return light

    def _add_picture(self, light: FloatArray, picture: DepthPicture, polarisation: int) -> None:
        """Add the blurred surfaces of a picture to an image."""
        window = self.windows[polarisation]
        directions = (window.tangent_x, window.tangent_y)
        channel = self._channel(polarisation)
        found = surfaces(picture, *directions, self.kernels.psf.depth_m, self._shifts(window), channel)
        if found:
            image = picture_image(found, self.blurs.over_depths(polarisation), window)
            light[: image.shape[0], : image.shape[1]] += image

    def _shifts(self, window: Window) -> FloatArray:
        pair = self.kernels.relative_to or self.kernels.psf
        return shifts_px_m(pair.aperture_um, window.tangent_x, window.tangent_y)

    def _channel(self, polarisation: int) -> int:
        """Polarisation of the light that forms an image."""
        return 1 - polarisation if self.crossed else polarisation

    def _share(self, piece: Piece, polarisation: int) -> float:
        return piece.share[self._channel(polarisation)]

    def _layer(self, piece: Piece | None, polarisation: int, nearer: Sequence[Occluder], *, moves: bool) -> Layer:
        """The layer of a piece behind others."""
        if piece is None:
            return Layer.empty()
        visible = visible_piece(piece, nearer, self._shifts(self.windows[polarisation]))
        crop = (piece.rows, piece.columns)
        window = self.windows[polarisation]
        flux = self._share(piece, polarisation) * window.gain[crop] * window.stop[crop] * piece.brightness.sum(axis=0)
        return Layer(*self._blurred(visible, polarisation), Occluder.of(piece, moves=moves), flux)

    def _balance(
        self,
        light: FloatArray,
        veil: FloatArray,
        mask: Occluder,
        flux: FloatArray,
        polarisation: int,
        nearer: Sequence[Occluder],
    ) -> None:
        """Correct the light of a surface at the outlines of nearer ones.

        Radiance does not change along a ray, so a pixel whose view nearer surfaces cover by the share a sees 1 - a of
        the surface behind. The sum of its blurred visible points has another share, because each depth has its own
        blur. The difference, times the surface's mean light, is added. ``veil`` is a; the surface adds its own part to
        it.
        """
        window, shape = self.windows[polarisation], self.kernels.shape
        margin = (shape[0] // 2, shape[1] // 2)
        own = padded(mask, margin)
        share = visible_share(replace(own, coverage=np.ones_like(own.coverage)), nearer, self._shifts(window))
        depth_m = float(1.0 / np.average(mask.vergence_per_m, weights=mask.coverage + 1e-12))
        blur = self.blurs.at_depth(depth_m, polarisation)
        parts = (own.rows, own.columns)
        inside = np.ix_(
            *(np.clip(np.arange(p.start, p.stop), 0, n - 1) for p, n in zip(parts, window.stop.shape, strict=True))
        )
        directions = (window.tangent_x[inside], window.tangent_y[inside])
        whole = [slice(p.start, p.stop + k - 1) for p, k in zip(parts, shape, strict=True)]
        place = tuple(slice(max(0, at.start), min(n, at.stop)) for at, n in zip(whole, light.shape, strict=True))
        cut = tuple(shifted(at, -full.start) for at, full in zip(place, whole, strict=True))
        seen_flux = np.pad(flux, [(wide, wide) for wide in margin])
        covered = np.minimum(own.coverage, share)
        if share.min() < 1.0 and share[own.coverage > 0.0].any():
            mean_light, hidden, covered = blur.veil([seen_flux], [1.0 - share, covered], *directions)
            light[place] += mean_light[cut] * (hidden[cut] - veil[place])
        else:
            (covered,) = blur.veil([], [covered], *directions)
        veil[place] += covered[cut]

    def _darken(
        self,
        light: FloatArray,
        renderer: Renderer,
        index: int,
        polarisation: int,
        mask: Occluder,
        nearer: Sequence[Occluder],
    ) -> None:
        """Subtract the light of a resting object that moving ones hide; only the region that they may hide is drawn."""
        window = self.windows[polarisation]
        shifts = self._shifts(window)
        crop = hidden_region(mask, [other for other in nearer if other.moves], shifts, window.stop.shape)
        piece = None if crop is None else renderer.piece(index, window.tangent_x[crop], window.tangent_y[crop])
        if crop is None or piece is None:
            return
        rows, columns = shifted(piece.rows, crop[0].start), shifted(piece.columns, crop[1].start)
        piece = replace(piece, rows=rows, columns=columns)
        before = visible_piece(piece, [other for other in nearer if not other.moves], shifts)
        lost = before.brightness - visible_piece(piece, nearer, shifts).brightness
        place_y, place_x, dark = self._blurred(replace(piece, brightness=lost), polarisation)
        light[place_y, place_x] -= dark

    def _blurred(self, piece: Piece, polarisation: int) -> tuple[slice, slice, FloatArray]:
        """Rows, columns and electrons of the image of a piece: the steps of its depth add up."""
        window = self.windows[polarisation]
        n_y, n_x = (n + kernel - 1 for n, kernel in zip(piece.coverage.shape[1:], self.kernels.shape, strict=True))
        light = np.zeros((n_y, n_x))
        for depth_m, brightness in zip(piece.depth_m, piece.brightness, strict=True):
            lit = brightness != 0.0
            if not lit.any():
                continue
            rows, columns = extent(lit.any(axis=1)), extent(lit.any(axis=0))
            crop = (shifted(rows, piece.rows.start), shifted(columns, piece.columns.start))
            flux = self._share(piece, polarisation) * window.gain[crop] * brightness[rows, columns]
            blur = self.blurs.at_depth(float(depth_m), polarisation)
            blurred = blur(flux * window.stop[crop], window.tangent_x[crop], window.tangent_y[crop])
            height, width = blurred.shape
            light[rows.start : rows.start + height, columns.start : columns.start + width] += blurred
        return shifted(slice(0, n_y), piece.rows.start), shifted(slice(0, n_x), piece.columns.start), light


def partial_progress(progress: Progress, done: int, parts: int) -> Progress:
    """Progress of one of several equal parts."""
    return lambda step, current, total: progress(step, done * total + current, parts * total)
