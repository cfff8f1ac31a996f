"""What fabrication does to a mask's PSFs, without rebuilding the mask: moved, missing and mis-sized pillars.

A pillar that stands aside by d sends the light of its site from there: its phase changes by k times the change of the
path over it, which is followed exactly for the ray to the geometric image point. Sizes, height, walls and index act
through the library at that corner (:func:`library_corners`). Random draws depend on seed and tile alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from metafab.core.conventions import FloatArray
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library.axes import CornerBox
from metafab.library.library import Library
from metafab.optics.image import relative_l2
from metafab.optics.imaging import Imaging
from metafab.optics.metrics import peak_irradiance
from metafab.optics.path import Ray
from metafab.optics.point_spread import Psf
from metafab.optics.source import FieldTile, Source, WrittenField, written_field
from metafab.optics.stack import psf

_FABRICATION = {"cd_bias_nm", "height_nm", "sidewall_angle_deg", "pillar_n_shift"}

#: (dx, dy) in um of each site of a tile, broadcasting to its shape.
Offsets = Callable[[FieldTile, tuple[int, int]], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class ToleranceRow:
    """One corner beside the nominal mask; the worst of both polarisations and all depths.

    Attributes:
        corner: its name.
        change: relative L2 change of the irradiance.
        peak_ratio: smallest peak over the nominal one.
        efficiency: smallest share of the power in the window.
        efficiency_change: largest change of that share, with its sign.
        turn_deg: largest turn of the main lobe of PSF_x, with its sign.
        depth_error_m: what a decoder that knows the nominal pair makes of the turn, with its sign; NaN for one depth.
    """

    corner: str
    change: float
    peak_ratio: float
    efficiency: float
    efficiency_change: float
    turn_deg: float
    depth_error_m: float


@dataclass(frozen=True)
class MovedField:
    """A source whose sites stand aside.

    Attributes:
        source: the sites at their places.
        imaging: geometry.
        offsets_um: how far each is moved.
        depth_m: object depth of the rays along which the paths change (they hardly depend on it).
    """

    source: Source
    imaging: Imaging
    offsets_um: Offsets
    depth_m: float

    @property
    def lattice(self) -> Lattice:
        """The unmoved sites."""
        return self.source.lattice

    def tiles(self) -> Iterator[FieldTile]:
        """The source's tiles with the moved pillars' phases."""
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
    """A source some of whose sites are dark.

    Attributes:
        source: all sites.
        share: of the sites that are lost, 0 to 1.
        seed: of the choice.
    """

    source: Source
    share: float
    seed: int = 0

    @property
    def lattice(self) -> Lattice:
        """The source's lattice."""
        return self.source.lattice

    def tiles(self) -> Iterator[FieldTile]:
        """The source's tiles without the lost sites."""
        for tile in self.source.tiles():
            amplitudes = np.array([tile.amplitude(p) for p in (0, 1)])
            lost = _random(self.seed, tile).random(amplitudes.shape[1:]) < self.share
            yield FieldTile(tile.row, tile.column, amplitudes=np.where(lost, 0.0, amplitudes))


def misplaced(source: Source, imaging: Imaging, depth_m: float, rms_nm: float, *, seed: int = 0) -> MovedField:
    """Every pillar on its own aside, Gaussian, ``rms_nm`` along x and along y."""

    def offsets(tile: FieldTile, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        dx, dy = _random(seed, tile).normal(scale=1e-3 * rms_nm, size=(2, *shape))
        return dx, dy

    return MovedField(source, imaging, offsets, depth_m)


def stitched(
    source: Source, imaging: Imaging, depth_m: float, rms_nm: float, field_sites: int, *, seed: int = 0
) -> MovedField:
    """Every write field of ``field_sites`` sites a side as a whole aside, Gaussian, ``rms_nm`` along x and y."""
    rows, columns = (-(-count // field_sites) for count in source.lattice.shape)
    moved = np.random.default_rng(seed).normal(scale=1e-3 * rms_nm, size=(2, rows, columns))

    def offsets(tile: FieldTile, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        row, column = ((at + np.arange(n)) // field_sites for at, n in zip((tile.row, tile.column), shape, strict=True))
        dx, dy = moved[:, row[:, None], column[None, :]]
        return dx, dy

    return MovedField(source, imaging, offsets, depth_m)


def library_corners(pillars: PillarMap, library: Library) -> dict[str, WrittenField]:
    """The mask's pillars at both ends of each axis that the library was built over (``sweep.axes``), one at a time.

    Angles of incidence and wavelengths are no faults of fabrication and left out. A library of sizes alone has no
    corners.
    """
    box = CornerBox.of(library.unit_cell)
    named = {} if box is None else {n: s for n, s in box.spans.items() if n in _FABRICATION}
    return {
        f"{name} {end:g}": written_field(pillars, library.at(**{name: end}))
        for name, span in named.items()
        for end in span
    }


def tolerance(
    nominal: Source,
    corners: Mapping[str, Source],
    imaging: Imaging,
    depths_m: Sequence[float],
    *,
    window_px: int = 64,
    target_error: float = 1e-3,
) -> list[ToleranceRow]:
    """PSFs of each corner against those of the nominal mask on the axis.

    Args:
        nominal: the mask as it should be.
        corners: name -> the mask as it may become.
        imaging: geometry.
        depths_m: ascending, near enough to each other that the pair turns by less than half a turn between them.
        window_px: points a side of each window.
        target_error: of every PSF; smaller changes mean nothing.
    """
    before = psf(nominal, imaging, depths_m, window_px=window_px, target_error=target_error)
    return [
        tolerance_row(name, before, psf(source, imaging, depths_m, window_px=window_px, target_error=target_error))
        for name, source in corners.items()
    ]


def tolerance_row(name: str, before: Psf, after: Psf) -> ToleranceRow:
    """What a corner changes, from the nominal stack and its own."""
    turn = (after.phi_deg - before.phi_deg + 180.0) % 360.0 - 180.0
    depth_error = np.full(turn.size, np.nan)
    if turn.size > 1:
        depth_error = turn / np.gradient(np.unwrap(before.phi_deg, period=360.0), before.depth_m)
    changes = [relative_l2(after.psf[p, d], before.psf[p, d]) for p in (0, 1) for d in range(before.depth_m.size)]
    return ToleranceRow(
        corner=name,
        change=max(changes),
        peak_ratio=float((peak_irradiance(after) / peak_irradiance(before)).min()),
        efficiency=float(after.efficiency.min()),
        efficiency_change=_largest(after.efficiency - before.efficiency),
        turn_deg=_largest(turn),
        depth_error_m=_largest(depth_error),
    )


def _largest(values: FloatArray) -> float:
    """The value of the largest modulus, with its sign."""
    return float(values.flat[int(np.argmax(np.abs(values)))])


def _random(seed: int, tile: FieldTile) -> np.random.Generator:
    return np.random.default_rng((seed, tile.row, tile.column))
