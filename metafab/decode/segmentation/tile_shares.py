"""Light and shares of the layers in some tiles of a frame: one round of :mod:`metafab.decode.segmentation.shares`.

The unknowns are the transforms of the whitened textures, so that filtering and preconditioning are products. Where
layers hide each other, radiance does not change, as in the camera: the light that this adds is computed once a round,
from the textures of the last one, so that a round is linear and takes fewer transforms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from metafab.decode.matching.filter_basis import frequencies
from metafab.decode.segmentation.layer_light import LayerLight

#: Steps of conjugate gradients in a round.
_STEPS = 3
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
        white = self._light_given(cover, start)
        square = self.optics.pictures(white.copy()) ** 2
        energy = self.optics.pictures(self._pooling * self.optics.spectra(square)) + np.float32(_LEAST_ENERGY)
        presence = cover.extent * np.minimum(np.float32(1.0), np.float32(_OPEN) * cover.open_share)
        return ExpectedLight(white, energy, presence)

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

    def _light_given(self, cover: _Cover, start: NDArray[np.complex64] | None) -> NDArray[np.complex64]:
        """Whitened texture of each layer given the shares: preconditioned conjugate gradients in each tile."""
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
        spectra = optics.spectra(seen)
        residual = self.weight * (self.images - optics.rendered(spectra) - self._balance(cover, spectra))
        descent = gradient(residual, white)
        scaled = self._inverse * descent
        direction, norm = scaled, self._dot(descent, scaled)
        for step in range(_STEPS):
            change = optics.rendered(optics.spectra(textured(direction)))
            change *= self.weight
            curvature = np.einsum("tiyx,tiyx->t", change, change) + self._dot(direction, direction)
            length = (norm / np.maximum(curvature, np.float32(1e-30))).astype(np.float32)
            white += length[of_tile, None, None] * direction
            if step == _STEPS - 1:
                break
            residual -= length[:, None, None, None] * change
            descent = gradient(residual, white)
            scaled = self._inverse * descent
            before, norm = norm, self._dot(descent, scaled)
            ratio = (norm / np.maximum(before, np.float32(1e-30))).astype(np.float32)
            direction = scaled + ratio[of_tile, None, None] * direction
        return white

    def _dot(self, one: NDArray[np.complex64], other: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Inner product of two pictures by their transforms, summed over the layers of each tile: shape (n_tiles,)."""
        product = np.einsum("pyx,pyx->px", one.view(np.float32), other.view(np.float32))
        product[:, 2:-2] *= 2.0  # the other half plane
        rows, columns = self.optics.size
        return np.asarray(np.add.reduceat(product.sum(axis=1), self.optics.starts) / np.float32(rows * columns))

    def _balance(self, cover: _Cover, light: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Light added to the images where layers hide each other, so that radiance is kept: shape of the images.

        ``light``: transforms of the layers' light, shape (n_pairs, n_ky, n_kx).
        """
        optics, gained = self.optics, np.zeros_like(self.images)
        if self.hidden.size:
            transfer, blur = optics.transfer, optics.transfer / self.gains[:, :, None, None]
            gain = cover.covered[:, None] * blur[self.hidden]
            for pair, nearer, _ in self.hiding:
                gain[np.searchsorted(self.hidden, pair)] -= cover.spectra[nearer] * blur[nearer]
            added = optics.pictures(gain)
            added *= optics.pictures(light[self.hidden, None] * transfer[self.hidden])
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
