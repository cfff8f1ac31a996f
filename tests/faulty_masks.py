"""Faulty masks pillar by pillar, displaced and missing ones: the exact, slow reference of the scattered block sums.

A displaced pillar changes its phase by k times the change of the path over it, exact for the ray to the geometric image
point. Random draws depend on seed and tile alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.layout.pillars import Lattice
from metafab.optics.geometry.imaging import Imaging
from metafab.optics.geometry.path import Ray
from metafab.optics.sources.source import FieldTile, Source

#: (dx, dy) in um of each site of a tile, broadcasting to its shape.
Offsets = Callable[[FieldTile, tuple[int, int]], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class MovedField:
    """Source with displaced sites."""

    source: Source  #: Sites at their nominal places.
    imaging: Imaging  #: Geometry.
    offsets_um: Offsets  #: Displacement of each site.
    depth_m: float  #: Object depth of the rays along which the paths change; the change hardly depends on it.

    @property
    def lattice(self) -> Lattice:
        """The unmoved sites."""
        return self.source.lattice

    def tiles(self) -> Iterator[FieldTile]:
        """Return the tiles with the phases of the displaced pillars."""
        x_um, y_um, k = self.lattice.x_um(), self.lattice.y_um(), self.imaging.wavenumber
        rays = [Ray.towards_image(self.imaging, p, self.depth_m, (0.0, 0.0)) for p in (0, 1)]
        for tile in self.source.tiles():
            n_y, n_x = tile.amplitude(0).shape
            x, y = x_um[None, tile.column : tile.column + n_x], y_um[tile.row : tile.row + n_y, None]
            dx, dy = self.offsets_um(tile, (n_y, n_x))
            turned = [
                tile.amplitude(p) * np.exp(1j * k * (ray.path_um(x + dx, y + dy) - ray.path_um(x, y)))
                for p, ray in enumerate(rays)
            ]
            yield FieldTile(tile.row, tile.column, amplitudes=np.array(turned))


@dataclass(frozen=True)
class ThinnedField:
    """Source with missing sites."""

    source: Source  #: All sites.
    share: float  #: Probability that a site is missing, 0 to 1.
    seed: int = 0  #: Seed of the choice.

    @property
    def lattice(self) -> Lattice:
        """The source's lattice."""
        return self.source.lattice

    def tiles(self) -> Iterator[FieldTile]:
        """Return the tiles without the missing sites."""
        for tile in self.source.tiles():
            amplitudes = np.array([tile.amplitude(p) for p in (0, 1)])
            lost = _random(self.seed, tile).random(amplitudes.shape[1:]) < self.share
            yield FieldTile(tile.row, tile.column, amplitudes=np.where(lost, 0.0, amplitudes))


def misplaced(source: Source, imaging: Imaging, depth_m: float, rms_nm: float, *, seed: int = 0) -> MovedField:
    """Displace each pillar independently, normal distribution of ``rms_nm`` along x and along y."""

    def offsets(tile: FieldTile, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        dx, dy = _random(seed, tile).normal(scale=1e-3 * rms_nm, size=(2, *shape))
        return dx, dy

    return MovedField(source, imaging, offsets, depth_m)


def stitched(
    source: Source, imaging: Imaging, depth_m: float, rms_nm: float, field_sites: int, *, seed: int = 0
) -> MovedField:
    """Displace each write field of ``field_sites`` sites a side, normal distribution of ``rms_nm`` along x and y."""
    rows, columns = (-(-count // field_sites) for count in source.lattice.shape)
    moved = np.random.default_rng(seed).normal(scale=1e-3 * rms_nm, size=(2, rows, columns))

    def offsets(tile: FieldTile, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        row, column = ((at + np.arange(n)) // field_sites for at, n in zip((tile.row, tile.column), shape, strict=True))
        dx, dy = moved[:, row[:, None], column[None, :]]
        return dx, dy

    return MovedField(source, imaging, offsets, depth_m)


def _random(seed: int, tile: FieldTile) -> np.random.Generator:
    return np.random.default_rng((seed, tile.row, tile.column))
