"""Field behind pillars whose light depends on the direction from which it comes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from metafab.core.errors import InputError
from metafab.layout.pillars import Lattice, PillarMap
from metafab.library.use.oblique import ObliqueChange, powers
from metafab.optics.geometry.imaging import FieldGrid, Tangent
from metafab.optics.point_spread import NeighbourMap
from metafab.optics.sources.neighbours import NeighbourField, size_windows
from metafab.optics.sources.source import ApodisedField, FieldTile, Source, WrittenField

#: Coefficients of a polarisation, by which its amplitudes change with the direction.
COEFFICIENTS = 4
#: Cosines beyond those that were solved, as a share, that are still computed: exact PSFs of a scene reach 3 % beyond
#: its field. The error of the expansion is there still below its largest within the field.
_MARGIN = 0.04


@dataclass(frozen=True)
class ObliqueField:
    """Pillars of a mask with the amplitudes that they have under light from the direction ``tangent``.

    Its tiles hold ten amplitudes: those of x and y polarisation, and the coefficients of both by which they change from
    this direction to others (:func:`metafab.library.use.oblique.powers`).
    """

    straight: WrittenField | NeighbourField  #: Amplitudes under light along the axis.
    change: ObliqueChange  #: Coefficients of each size; 0 in row 0, no pillar.
    tangent: Tangent = (0.0, 0.0)  #: Direction (x/z, y/z) of the object.

    @property
    def lattice(self) -> Lattice:
        """Lattice of the pillars."""
        return self.straight.lattice

    @property
    def pillars(self) -> PillarMap:
        """Pillars of the mask."""
        return self.straight.pillars

    def tiles(self) -> Iterator[FieldTile]:
        """Return the tiles of the mask."""
        coefficients = self.change.coefficients
        fixed = np.einsum("k,nkp->np", powers(self.tangent), coefficients)
        further = coefficients.transpose(0, 2, 1).reshape(len(coefficients), -1)
        if isinstance(self.straight, WrittenField):
            table = np.concatenate([self.straight.table + fixed, further], axis=1)
            for tile in self.straight.tiles():
                yield replace(tile, table=table)
            return
        of_size = np.concatenate([fixed, further], axis=1)
        for tile, (_, _, size_index) in zip(self.straight.tiles(), size_windows(self.pillars, 0), strict=True):
            amplitudes = np.ascontiguousarray(np.moveaxis(of_size[size_index], -1, 0))
            amplitudes[:2] += tile.amplitude(0), tile.amplitude(1)
            yield FieldTile(tile.row, tile.column, amplitudes=amplitudes)


def require_reach(tangents: Iterable[Tangent], reach: float) -> None:
    """Refuse directions with cosines beyond ``reach``, those solved: InputError."""
    cosine = max((float(np.sqrt(powers(tangent)[::2].max())) for tangent in tangents), default=0.0)
    if cosine > (1.0 + _MARGIN) * reach:
        expected = f"directions with cosines up to {reach:.3g}, the corner of the scene's field"
        remedy = "choose an object nearer to the axis, or a larger field of the scene"
        raise InputError.single("optics", "oblique", expected, f"{cosine:.3g}", remedy)


def oblique_of(source: Source) -> ObliqueField | None:
    """Return the source itself, or the one behind an apodisation, if its light depends on the direction."""
    if isinstance(source, ApodisedField):
        return oblique_of(source.source)
    return source if isinstance(source, ObliqueField) else None


def neighbour_map_of(source: Source) -> NeighbourMap | None:
    """Return what neighbours change in the light of a source, without stop and apodisation, once all tiles were read.

    None for a source without a model of neighbours.
    """
    if isinstance(source, ApodisedField):
        return neighbour_map_of(source.source)
    pillars = source.straight if isinstance(source, ObliqueField) else source
    return pillars.change if isinstance(pillars, NeighbourField) else None


def from_direction(source: Source, tangent: Tangent, grid: FieldGrid | None) -> Source:
    """Return the source under light from ``tangent``; InputError if it, or the grid, is beyond the angles solved."""
    if isinstance(source, ApodisedField):
        return replace(source, source=from_direction(source.source, tangent, grid))
    if not isinstance(source, ObliqueField):
        return source
    over_field = [] if grid is None else [(float(t_x), float(t_y)) for t_x in grid[0] for t_y in grid[1]]
    require_reach([tangent, *over_field], source.change.reach)
    return replace(source, tangent=tangent)
