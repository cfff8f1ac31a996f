"""Light and shares of the layers in some tiles of a frame: one round of the model of the frame.

The unknowns are the transforms of the whitened textures, so that filtering and preconditioning are products. Where
layers hide each other, radiance does not change, as in the camera: the light that this adds is that of the layers
behind without their textures, so that a round is linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from metafab.core.numeric.conjugate_gradients import advance, inner_products, parts, precondition, turn, twice
from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.segmentation.layered.layer_light import LayerLight, add_blurred

#: Steps of conjugate gradients in a round, and for a misfit, whose differences settle more slowly.
_STEPS, _MISFIT_STEPS = 3, 6
#: Steps for the outlines as they are, and for each displacement from there: three scenes are 0.36, 1.02 and 1.07 %
#: off, with 40 and 20 steps 0.36, 1.02 and 1.03 % (outlines between unlike contrasts, displaced by 2 px).
_FIRST_STEPS, _DISPLACED_STEPS = 4, 1
#: Rms contrast of the texture.
_TEXTURE = 0.3
#: Factor on the open share of the aperture, up to 1, for the expected presence of a farther layer: at a straight
#: outline that share is 1/2, a little more after pooling over both sides.
_OPEN = 1.7
#: Energy of whitened light that counts as none, over that of the prior.
_LEAST_ENERGY = 0.05


@dataclass(frozen=True)
class ExpectedLight:
    """Light of the layers given their shares."""

    white: NDArray[np.complex64]  #: Shape (n_pairs, n_ky, n_kx), transforms of the whitened textures.
    energy: NDArray[np.float32]  #: Shape (n_pairs, n_y, n_x), their pooled squares.
    presence: NDArray[np.float32]  #: Shape (n_pairs, n_y, n_x), expected share of a layer in a pixel's light.


@dataclass(frozen=True)
class TileLayers:
    """Pairs of a tile and a layer in it, of some tiles, sorted by tile."""

    optics: LayerLight  #: Blur of the layers.
    gains: NDArray[np.float32]  #: Shape (n_pairs, 2), factors on both images, which ``optics`` already contains.
    #: A hidden pair, a nearer pair of its tile, and the transfer function of the share of the aperture that it covers.
    hiding: list[tuple[int, int, NDArray[np.complex64]]]
    images: NDArray[np.float32]  #: Shape (n_tiles, 2, n_y, n_x), electrons.
    weight: NDArray[np.float32]  #: Shape (n_tiles, 2, n_y, n_x), inverse standard deviation of a pixel.
    light: NDArray[np.float32]  #: Shape (n_tiles, n_y, n_x), mean light, electrons.
    allowed: NDArray[np.bool_]  #: Shape (n_pairs, n_y, n_x), pixels that may belong to the layer.
    behind: NDArray[np.bool_]  #: Shape (n_pairs, n_y, n_x), pixels where it continues behind nearer ones.
    pooled: float  #: Standard deviation of the Gaussian over which energy is pooled, pixels.

    @cached_property
    def hidden(self) -> NDArray[np.intp]:
        """Pairs with nearer ones in their tile, shape (n_hidden,), ascending."""
        return np.array(sorted({pair for pair, _, _ in self.hiding}), dtype=np.intp)

    def expected(self, share: NDArray[np.float32], start: NDArray[np.complex64] | None) -> ExpectedLight:
        """The light given the shares (n_pairs, n_y, n_x), from the whitened textures of the last round."""
        cover = _Cover.of(self, share)
        white, _ = self._light_given(cover, start, _STEPS)
        spectra = self.optics.spectra(self.optics.pictures(white.copy()) ** 2)
        parts(spectra)[...] *= self._pooling
        energy = self.optics.pictures(spectra) + np.float32(_LEAST_ENERGY)
        presence = cover.extent * np.minimum(np.float32(1.0), np.float32(_OPEN) * cover.open_share)
        return ExpectedLight(white, energy, presence)

    def misfit(self, share: NDArray[np.float32]) -> NDArray[np.float32]:
        """Energy of each pixel given the shares (n_pairs, n_y, n_x): shape (n_tiles, n_y, n_x).

        Squared residuals of both images over their variance, and squares of the whitened textures over the prior's:
        their sum over the tile is minus twice the logarithm of the most probable textures' posterior.
        """
        return self._energy(*self._light_given(_Cover.of(self, share), None, _MISFIT_STEPS))

    def misfits(self, shares: Sequence[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
        """Energy of each pixel, shape (n_tiles, n_y, n_x), given each of some shares (n_pairs, n_y, n_x) much alike.

        All start at the textures found for the shares in the middle of the list: solved one by one, they would differ
        by what is left to their solution. Textures are in proportion to the share, as is the light.
        """
        middle = _Cover.of(self, shares[len(shares) // 2])
        white, _ = self._light_given(middle, None, _FIRST_STEPS, linear=True)
        covers = (_Cover.of(self, share) for share in shares)
        return [self._energy(*self._light_given(cover, white, _DISPLACED_STEPS, linear=True)) for cover in covers]

    def _energy(self, white: NDArray[np.complex64], residual: NDArray[np.float32]) -> NDArray[np.float32]:
        """Squares of whitened textures, given by their transforms, and of weighted residuals: (n_tiles, n_y, n_x)."""
        textures = np.add.reduceat(self.optics.pictures(white.copy()) ** 2, self.optics.starts, axis=0)
        return np.asarray((residual**2).sum(axis=1) + textures)

    @cached_property
    def _pooling(self) -> NDArray[np.float32]:
        """Transfer function of the Gaussian over which energy is pooled, each value twice: shape (n_ky, 2 n_kx)."""
        ky, kx = frequencies(self.optics.size, 1)
        gaussian = np.exp(-2.0 * (np.pi * self.pooled) ** 2 * (ky[:, None] ** 2 + kx**2))
        return twice(gaussian.astype(np.float32))

    def share(self, found: ExpectedLight, typical: NDArray[np.float32]) -> NDArray[np.float32]:
        """Shares given the light, shape (n_pairs, n_y, n_x); their sum is 1 at pixels of a segment.

        ``typical``: energy of each pair's layer where no other is near, shape (n_pairs,).
        """
        energy = found.energy / typical[:, None, None] * found.presence
        energy = np.where(self.allowed, energy + np.float32(1e-4), np.float32(0.0))
        energy /= np.maximum(np.add.reduceat(energy, self.optics.starts, axis=0), np.float32(1e-9))[self.optics.of_tile]
        return energy

    def _light_given(
        self, cover: _Cover, start: NDArray[np.complex64] | None, steps: int, *, linear: bool = False
    ) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
        """Whitened texture of each layer given the shares: preconditioned conjugate gradients in each tile.

        The texture's deviation is in proportion to the visible share if ``linear``, else to its root. Returns the
        textures' transforms, (n_pairs, n_ky, n_kx), and the weighted residual of the images, their shape.
        """
        optics, of_tile = self.optics, self.optics.of_tile
        light, seen = self.light[of_tile], cover.extent * cover.open_share
        spread = np.float32(_TEXTURE) * light * (seen if linear else np.sqrt(seen))
        white = np.zeros(optics.transfer[:, 0].shape, dtype=np.complex64) if start is None else start.copy()
        direction, textured = np.zeros_like(white), np.empty_like(white)
        sums = np.empty((of_tile.size, 2 * white.shape[2]), dtype=np.float32)
        joined = len(self.images), -1, self.images.shape[-1]  # both images of a tile as one

        def blurred(texture: NDArray[np.complex64]) -> NDArray[np.float32]:
            """Weighted images of the textures."""
            picture = optics.pictures(texture)
            picture *= spread
            images = optics.rendered(optics.spectra(picture))
            images *= self.weight
            return images

        def descent(residual: NDArray[np.float32]) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
            """Preconditioned descent, and its squared length in each tile."""
            picture = optics.adjoint(self.weight * residual)
            picture *= spread
            spectra = optics.spectra(picture)
            precondition(parts(spectra), self._texture, parts(white), self._inverse, sums)
            return spectra, self._length(sums)

        seen *= light
        residual = self.images - optics.rendered(optics.spectra(seen))
        residual -= self._balance(cover)
        residual *= self.weight
        if start is not None:
            np.multiply(parts(start), self._texture, out=parts(textured))
            residual -= blurred(textured)
        scaled, norm = descent(residual)
        ratio = np.zeros_like(norm)
        for step in range(steps):
            turn(parts(scaled), ratio[of_tile], parts(direction), self._texture, parts(textured), sums)
            change = blurred(textured)
            curvature = np.einsum("tiyx,tiyx->t", change, change) + self._length(sums)
            length = norm / np.maximum(curvature, np.float32(1e-30))
            advance(parts(white), length[of_tile], parts(direction))
            advance(residual.reshape(joined), -length, change.reshape(joined))
            if step == steps - 1:
                break
            before = norm
            scaled, norm = descent(residual)
            np.divide(norm, np.maximum(before, np.float32(1e-30)), out=ratio)
        return white, residual

    def _length(self, sums: NDArray[np.float32]) -> NDArray[np.float32]:
        """Squared length in each tile, shape (n_tiles,), of sums over ky, shape (n_pairs, 2 n_kx)."""
        rows, columns = self.optics.size
        return inner_products(sums, self.optics.starts, rows * columns)

    def _balance(self, cover: _Cover) -> NDArray[np.float32]:
        """Light that the images gain where layers hide each other, so that radiance stays: their shape.

        A layer behind sends it by its whole light, what others hide of it included, as in the camera
        (:mod:`metafab.camera.rendering.lens`): by the visible part alone, images of even light have seams of 8 %.
        """
        optics, hidden, gained = self.optics, self.hidden, np.zeros_like(self.images)
        if hidden.size:
            transfer = optics.transfer[hidden]
            gain = np.zeros_like(transfer)
            add_blurred(
                cover.spectra, self._balancing, np.searchsorted(hidden, [pair for pair, _, _ in self.hiding]), gain
            )
            transfer *= optics.spectra(cover.extent[hidden] * self.light[optics.of_tile[hidden]])[:, None]
            added = optics.pictures(gain)
            added *= optics.pictures(transfer)
            for tile, one in zip(optics.of_tile[hidden].tolist(), added, strict=True):
                gained[tile] += one
        return gained

    @cached_property
    def _balancing(self) -> NDArray[np.complex64]:
        """What a share of a nearer pair adds to the factor on a hidden one's light, as :attr:`hiding` lists them.

        Shape (n_hiding, 2, n_ky, n_kx): the blur of the hidden pair where the nearer one covers its aperture, without
        that of the nearer one.
        """
        blur = (parts(self.optics.transfer) / self.gains[:, :, None, None]).view(np.complex64)
        return np.stack([aperture * blur[pair] - blur[nearer] for pair, nearer, aperture in self.hiding])

    @cached_property
    def _inverse(self) -> NDArray[np.float32]:
        """Inverse of the curvature of each frequency, for typical light and noise, twice: (n_pairs, n_ky, 2 n_kx)."""
        known = (self.light * self.weight.mean(axis=1))[self.optics.of_tile]
        total = np.maximum(self.allowed.sum(axis=(1, 2)), 1)
        ratio = _TEXTURE * (known * self.allowed).sum(axis=(1, 2)) / total
        power = (ratio**2)[:, None, None] * self.optics.texture**2 * self.optics.power
        return twice(np.asarray(1.0 / (1.0 + power), dtype=np.float32))

    @cached_property
    def _texture(self) -> NDArray[np.float32]:
        """Amplitude of textures, each value twice: shape (n_ky, 2 n_kx)."""
        return twice(self.optics.texture)


@dataclass(frozen=True)
class _Cover:
    """What the shares of layers cover. A layer continues behind nearer ones."""

    spectra: NDArray[np.complex64]  # (n_hiding, n_ky, n_kx), transforms of the nearer pairs' shares
    extent: NDArray[np.float32]  # (n_pairs, n_y, n_x), share of each pixel that a layer fills, seen or hidden
    open_share: NDArray[np.float32]  # (n_pairs, n_y, n_x), share of the aperture that sees it there

    @classmethod
    def of(cls, tiles: TileLayers, share: NDArray[np.float32]) -> _Cover:
        """The cover by shares of shape (n_pairs, n_y, n_x)."""
        optics, hidden = tiles.optics, tiles.hidden
        nearer, index = np.unique([one for _, one, _ in tiles.hiding], return_inverse=True)
        open_share, extent = np.ones_like(share), share.copy()
        spectra = optics.spectra(share[nearer.astype(np.intp)])[index]
        if hidden.size:
            covered = np.zeros((hidden.size, *spectra.shape[1:]), dtype=np.complex64)
            before = np.zeros((hidden.size, *share.shape[1:]), dtype=np.float32)
            for (pair, one, aperture), spectrum in zip(tiles.hiding, spectra, strict=True):
                at = np.searchsorted(hidden, pair)
                covered[at] += spectrum * aperture
                before[at] += share[one]
            open_share[hidden] = np.clip(np.float32(1.0) - optics.pictures(covered), 0.0, 1.0)
            extent[hidden] = np.minimum(extent[hidden] + before * tiles.behind[hidden], np.float32(1.0))
        return cls(spectra, extent, open_share)
