"""Light and shares of the layers in some tiles of a frame: one round of :mod:`metafab.decode.segmentation.frame_model`.

The unknowns are the transforms of the whitened textures, so that filtering and preconditioning are products. Where
layers hide each other, radiance does not change, as in the camera: the light that this adds is that of the layers
behind without their textures, so that a round is linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.segmentation.layer_light import LayerLight

#: Steps of conjugate gradients in a round, and for a misfit, whose differences settle more slowly.
_STEPS, _MISFIT_STEPS = 3, 6
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
        square = self.optics.pictures(white.copy()) ** 2
        energy = self.optics.pictures(self._pooling * self.optics.spectra(square)) + np.float32(_LEAST_ENERGY)
        presence = cover.extent * np.minimum(np.float32(1.0), np.float32(_OPEN) * cover.open_share)
        return ExpectedLight(white, energy, presence)

    def misfit(self, share: NDArray[np.float32]) -> NDArray[np.float32]:
        """Energy of each pixel given the shares (n_pairs, n_y, n_x): shape (n_tiles, n_y, n_x).

        Squared residuals of both images over their variance, and squares of the whitened textures over the prior's:
        their sum over the tile is minus twice the logarithm of the most probable textures' posterior.
        """
        white, residual = self._light_given(_Cover.of(self, share), None, _MISFIT_STEPS)
        textures = np.add.reduceat(self.optics.pictures(white) ** 2, self.optics.starts, axis=0)
        return np.asarray((residual**2).sum(axis=1) + textures)

    @cached_property
    def _pooling(self) -> NDArray[np.float32]:
        """Transfer function of the Gaussian over which energy is pooled."""
        ky, kx = frequencies(self.optics.size, 1)
        return np.asarray(np.exp(-2.0 * (np.pi * self.pooled) ** 2 * (ky[:, None] ** 2 + kx**2)), dtype=np.float32)

    def share(self, found: ExpectedLight, typical: NDArray[np.float32]) -> NDArray[np.float32]:
        """Shares given the light, shape (n_pairs, n_y, n_x); their sum is 1 at pixels of a segment.

        ``typical``: energy of each pair's layer where no other is near, shape (n_pairs,).
        """
        energy = found.energy / typical[:, None, None] * found.presence
        energy = np.where(self.allowed, energy + np.float32(1e-4), np.float32(0.0))
        energy /= np.maximum(np.add.reduceat(energy, self.optics.starts, axis=0), np.float32(1e-9))[self.optics.of_tile]
        return energy

    def _light_given(
        self, cover: _Cover, start: NDArray[np.complex64] | None, steps: int
    ) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
        """Whitened texture of each layer given the shares: preconditioned conjugate gradients in each tile.

        Returns the textures' transforms, (n_pairs, n_ky, n_kx), and the weighted residual of the images, their shape.
        """
        optics, of_tile = self.optics, self.optics.of_tile
        light, seen = self.light[of_tile], cover.extent * cover.open_share
        spread = np.float32(_TEXTURE) * light * np.sqrt(seen)

        def textured(white: NDArray[np.complex64]) -> NDArray[np.float32]:
            picture = optics.pictures(optics.texture * white)
            picture *= spread
            return picture

        def gradient(residual: NDArray[np.float32], white: NDArray[np.complex64]) -> NDArray[np.complex64]:
            picture = optics.adjoint(self.weight * residual)
            picture *= spread
            spectra = optics.spectra(picture)
            spectra *= optics.texture
            spectra -= white
            return spectra

        seen *= light
        if start is None:
            white = np.zeros(optics.transfer[:, 0].shape, dtype=np.complex64)
        else:
            white = start.copy()
            seen += textured(white)
        residual = self.weight * (self.images - optics.rendered(optics.spectra(seen)) - self._balance(cover))
        descent = gradient(residual, white)
        scaled = self._inverse * descent
        direction, norm = scaled, self._dot(descent, scaled)
        for step in range(steps):
            change = optics.rendered(optics.spectra(textured(direction)))
            change *= self.weight
            curvature = np.einsum("tiyx,tiyx->t", change, change) + self._dot(direction, direction)
            length = (norm / np.maximum(curvature, np.float32(1e-30))).astype(np.float32)
            white += length[of_tile, None, None] * direction
            residual -= length[:, None, None, None] * change
            if step == steps - 1:
                break
            descent = gradient(residual, white)
            scaled = self._inverse * descent
            before, norm = norm, self._dot(descent, scaled)
            ratio = (norm / np.maximum(before, np.float32(1e-30))).astype(np.float32)
            direction = scaled + ratio[of_tile, None, None] * direction
        return white, residual

    def _dot(self, one: NDArray[np.complex64], other: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Inner product of two pictures by their transforms, summed over the layers of each tile: shape (n_tiles,)."""
        product = np.einsum("pyx,pyx->px", one.view(np.float32), other.view(np.float32))
        product[:, 2:-2] *= 2.0  # the other half plane
        rows, columns = self.optics.size
        return np.asarray(np.add.reduceat(product.sum(axis=1), self.optics.starts) / np.float32(rows * columns))

    def _balance(self, cover: _Cover) -> NDArray[np.float32]:
        """Light that the images gain where layers hide each other, so that radiance stays: their shape.

        A layer behind sends it by its whole light, what others hide of it included, as in the camera
        (:mod:`metafab.camera.rendering.lens`): by the visible part alone, images of even light have seams of 8 %.
        """
        optics, gained = self.optics, np.zeros_like(self.images)
        if self.hidden.size:
            whole = optics.spectra(cover.extent[self.hidden] * self.light[optics.of_tile[self.hidden]])
            transfer, blur = optics.transfer, optics.transfer / self.gains[:, :, None, None]
            gain = cover.covered[:, None] * blur[self.hidden]
            for pair, nearer, _ in self.hiding:
                gain[np.searchsorted(self.hidden, pair)] -= cover.spectra[nearer] * blur[nearer]
            added = optics.pictures(gain)
            added *= optics.pictures(whole[:, None] * transfer[self.hidden])
            for tile, one in zip(self.optics.of_tile[self.hidden].tolist(), added, strict=True):
                gained[tile] += one
        return gained

    @cached_property
    def _inverse(self) -> NDArray[np.float32]:
        """Inverse of the curvature of each frequency of each pair, for its typical light and noise."""
        known = (self.light * self.weight.mean(axis=1))[self.optics.of_tile]
        total = np.maximum(self.allowed.sum(axis=(1, 2)), 1)
        ratio = _TEXTURE * (known * self.allowed).sum(axis=(1, 2)) / total
        power = (ratio**2)[:, None, None] * self.optics.texture**2 * self.optics.power
        return np.asarray(1.0 / (1.0 + power), dtype=np.float32)


@dataclass(frozen=True)
class _Cover:
    """What the shares of layers cover. A layer continues behind nearer ones."""

    spectra: NDArray[np.complex64]  # (n_pairs, n_ky, n_kx), transforms of the shares
    covered: NDArray[np.complex64]  # (n_hidden, n_ky, n_kx), transforms of the covered share of the aperture
    extent: NDArray[np.float32]  # (n_pairs, n_y, n_x), share of each pixel that a layer fills, seen or hidden
    open_share: NDArray[np.float32]  # (n_pairs, n_y, n_x), share of the aperture that sees it there

    @classmethod
    def of(cls, tiles: TileLayers, share: NDArray[np.float32]) -> _Cover:
        """The cover by shares of shape (n_pairs, n_y, n_x)."""
        optics, hidden = tiles.optics, tiles.hidden
        open_share, extent, spectra = np.ones_like(share), share.copy(), optics.spectra(share)
        covered = np.zeros((hidden.size, *spectra.shape[1:]), dtype=np.complex64)
        nearer = np.zeros((hidden.size, *share.shape[1:]), dtype=np.float32)
        for pair, one, aperture in tiles.hiding:
            index = np.searchsorted(hidden, pair)
            covered[index] += spectra[one] * aperture
            nearer[index] += share[one]
        if hidden.size:
            open_share[hidden] = np.clip(np.float32(1.0) - optics.pictures(covered.copy()), 0.0, 1.0)
            extent[hidden] = np.minimum(extent[hidden] + nearer * tiles.behind[hidden], np.float32(1.0))
        return cls(spectra, covered, extent, open_share)
