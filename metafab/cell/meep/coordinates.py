"""Coordinates in which every wall lies on a plane of grid nodes, at every resolution.

Meep's pixels are cubes, and a pillar of any width has its walls anywhere between the nodes; how much a pixel that
a wall crosses errs changes from one resolution to the next, and resonant pillars do not forgive it. So each axis
is stretched piecewise: inside and outside the pillar by a constant each, such that both hold whole numbers of
pixels. Maxwell's equations keep their form in such coordinates if the materials become

    eps~_xx = eps_xx s_y s_z / s_x,    mu~_xx = s_y s_z / s_x,    and so on in turn, with s = dx/du

and the fields E~_x = s_x E_x (Ward and Pendry, J. Mod. Opt. 43, 773, 1996). With the walls on nodes only
tangential E and normal H are sampled there, so that arithmetic means of eps~ and harmonic means of mu~ are second
order, without corners or edges to guess at. The errors of successive resolutions then have the same cause and the
same shape, and extrapolate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from metafab.core.conventions import FloatArray

#: Half the thickness, in pixels, of the slab around a wall that catches its nodes and nothing else.
_WALL_PX = 0.25


@dataclass(frozen=True)
class Segment:
    """A part of an axis in which the grid sees one stretch.

    Attributes:
        low: lower end in pixels; likewise ``high``.
        stretch: dx/du, one value, or the two sides' of a wall.
        region: index of the physical region behind each of them.
    """

    low: float
    high: float
    stretch: tuple[float, ...]
    region: tuple[int, ...]


@dataclass(frozen=True)
class Axis:
    """An axis as its regions, from low to high.

    Attributes:
        edges: shape (n_regions + 1,), whole pixels; the outermost are the ends of the cell.
        stretch: shape (n_regions,), physical length of a pixel over ``pixel_um``.
        region: shape (n_regions,), what is there (regions of the same number are the same).
    """

    edges: tuple[float, ...]
    stretch: tuple[float, ...]
    region: tuple[int, ...]

    def segments(self) -> list[Segment]:
        """Regions and the walls between them; the outermost reach beyond the cell."""
        found = []
        last = len(self.stretch) - 1
        for i, (low, high) in enumerate(zip(self.edges, self.edges[1:], strict=False)):
            start = low - 1.0 if i == 0 else low + _WALL_PX
            stop = high + 1.0 if i == last else high - _WALL_PX
            found.append(Segment(start, stop, (self.stretch[i],), (self.region[i],)))
            if i < last:
                found.append(Segment(high - _WALL_PX, high + _WALL_PX, self.stretch[i : i + 2], self.region[i : i + 2]))
        return found

    def node_stretch(self) -> FloatArray:
        """Stretch at the nodes of one period, beginning at the lower end: the mean of the pixel around each."""
        first, count = self.edges[0], round(self.edges[-1] - self.edges[0])
        pixels = np.empty(count)
        for low, high, value in zip(self.edges, self.edges[1:], self.stretch, strict=False):
            pixels[round(low - first) : round(high - first)] = value
        return np.asarray((pixels + np.roll(pixels, 1)) / 2.0, dtype=np.float64)


def lateral_axis(pixels: int, inside: int, size: float, period: float, pixel: float) -> Axis:
    """An axis across the pillar, symmetric about 0.

    Args:
        pixels: a period's; even.
        inside: those of the pillar; even, 0 for none, ``pixels`` for a film.
        size: the pillar's size, in the unit of ``pixel``.
        period: in the same unit.
        pixel: grid spacing.
    """
    half = pixels / 2.0
    if inside in {0, pixels}:
        return Axis((-half, half), (period / (pixels * pixel),), (1 if inside else 0,))
    outer = (period - size) / ((pixels - inside) * pixel)
    inner = size / (inside * pixel)
    wall = inside / 2.0
    return Axis((-half, -wall, wall, half), (outer, inner, outer), (0, 1, 0))


@dataclass(frozen=True)
class Cuboid:
    """A box of the stretched grid with its materials, as the grid's points see them.

    Attributes:
        low: (x, y, z) in pixels; likewise ``high``.
        epsilon: diagonal of eps~.
        mu: diagonal of mu~.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    epsilon: tuple[complex, complex, complex]
    mu: tuple[float, float, float]


def cuboids(axes: tuple[Axis, Axis, Axis], epsilon: Mapping[tuple[int, int, int], tuple[complex, ...]]) -> list[Cuboid]:
    """The structure as disjoint boxes.

    Args:
        axes: x, y, z.
        epsilon: physical (eps_x, eps_y, eps_z) of each triple of regions.
    """
    found = []
    for segments in product(*(axis.segments() for axis in axes)):
        sides = list(product(*(range(len(segment.stretch)) for segment in segments)))
        eps = np.zeros(3, dtype=np.complex128)
        inverse_mu = np.zeros(3)
        for side in sides:
            s = np.array([segment.stretch[i] for segment, i in zip(segments, side, strict=True)])
            x, y, z = (segment.region[i] for segment, i in zip(segments, side, strict=True))
            factor = np.prod(s) / s**2
            eps += np.array(epsilon[x, y, z]) * factor / len(sides)
            inverse_mu += 1.0 / factor / len(sides)
        found.append(
            Cuboid(
                (segments[0].low, segments[1].low, segments[2].low),
                (segments[0].high, segments[1].high, segments[2].high),
                (complex(eps[0]), complex(eps[1]), complex(eps[2])),
                (float(1 / inverse_mu[0]), float(1 / inverse_mu[1]), float(1 / inverse_mu[2])),
            )
        )
    return found
