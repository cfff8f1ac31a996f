"""Stretched axes with every wall on a plane of grid nodes, at every resolution.

Meep's pixels are cubes, and the walls of a pillar generally lie between the nodes. The error of a pixel that a wall
crosses changes irregularly with resolution, and resonant pillars amplify it. So each axis is stretched by one constant
inside and another outside the pillar, such that both regions hold whole numbers of pixels. Maxwell's
equations keep their form in such coordinates if the materials become

    eps~_xx = eps_xx s_y s_z / s_x,    mu~_xx = s_y s_z / s_x,    and cyclically, with s = dx/du

and the fields E~_x = s_x E_x (Ward and Pendry, J. Mod. Opt. 43, 773, 1996). With the walls on nodes only tangential E
and normal H are sampled there, so that arithmetic means of eps~ and harmonic means of mu~ are accurate to second order,
also at corners and edges. The error then varies smoothly with resolution, and results can be extrapolated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from metafab.cell.meep.protocol import Block
from metafab.core.conventions import FloatArray

#: Half the thickness, in pixels, of the slab around a wall that holds its nodes and no others.
_WALL_PX = 0.25


@dataclass(frozen=True)
class Segment:
    """Part of an axis with one stretch, or a wall between two."""

    low: float  #: Lower end in pixels.
    high: float  #: Upper end in pixels.
    stretch: tuple[float, ...]  #: dx/du: one value, or two for the sides of a wall.
    region: tuple[int, ...]  #: Index of the physical region of each value.


@dataclass(frozen=True)
class Axis:
    """An axis as its regions, from low to high."""

    edges: tuple[float, ...]  #: n_regions + 1 whole numbers of pixels; the outermost are the ends of the cell.
    stretch: tuple[float, ...]  #: n_regions values of dx/du, the physical length of a pixel over the grid spacing.
    region: tuple[int, ...]  #: n_regions indices of the physical region; parts of equal index have equal permittivity.

    def segments(self) -> list[Segment]:
        """Regions and the walls between them; the outermost reach beyond the cell."""
        segments = []
        last = len(self.stretch) - 1
        for i, (low, high) in enumerate(zip(self.edges, self.edges[1:], strict=False)):
            start = low - 1.0 if i == 0 else low + _WALL_PX
            stop = high + 1.0 if i == last else high - _WALL_PX
            segments.append(Segment(start, stop, (self.stretch[i],), (self.region[i],)))
            if i < last:
                sides = slice(i, i + 2)
                segments.append(Segment(high - _WALL_PX, high + _WALL_PX, self.stretch[sides], self.region[sides]))
        return segments

    def node_stretch(self) -> FloatArray:
        """Stretch at the nodes of one period from its lower end, the mean of the pixels around each; shape (n,)."""
        first, count = self.edges[0], round(self.edges[-1] - self.edges[0])
        pixels = np.empty(count)
        for low, high, value in zip(self.edges, self.edges[1:], self.stretch, strict=False):
            pixels[round(low - first) : round(high - first)] = value
        return np.asarray((pixels + np.roll(pixels, 1)) / 2.0, dtype=np.float64)


def lateral_axis(pixels: int, inside: int, size: float, period: float, pixel: float) -> Axis:
    """An axis across the pillar, symmetric about 0; sizes in the unit of ``pixel``, the grid spacing.

    ``pixels`` of the period and ``inside`` the pillar are even numbers; 0 inside for no pillar, ``pixels`` for a film.
    """
    half = pixels / 2.0
    if inside in {0, pixels}:
        return Axis((-half, half), (period / (pixels * pixel),), (1 if inside else 0,))
    outer = (period - size) / ((pixels - inside) * pixel)
    inner = size / (inside * pixel)
    wall = inside / 2.0
    return Axis((-half, -wall, wall, half), (outer, inner, outer), (0, 1, 0))


def stretched_blocks(
    axes: tuple[Axis, Axis, Axis],
    epsilon: Mapping[tuple[int, int, int], tuple[complex, ...]],
    pixel_um: float,
    middle_z: float = 0.0,
) -> tuple[Block, ...]:
    """The structure as disjoint boxes with the materials eps~ and mu~ of the stretched grid of axes x, y, z.

    ``epsilon`` maps (x, y, z) regions to physical (eps_x, eps_y, eps_z); ``middle_z`` is the cell's middle, in pixels.
    """
    blocks = []
    middle = (0.0, 0.0, middle_z)
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
        low_x, low_y, low_z = ((part.low - at) * pixel_um for part, at in zip(segments, middle, strict=True))
        high_x, high_y, high_z = ((part.high - at) * pixel_um for part, at in zip(segments, middle, strict=True))
        eps_x, eps_y, eps_z = map(complex, eps)
        mu_x, mu_y, mu_z = map(float, 1 / inverse_mu)
        corners = (low_x, low_y, low_z), (high_x, high_y, high_z)
        blocks.append(Block(*corners, (eps_x, eps_y, eps_z), (mu_x, mu_y, mu_z)))
    return tuple(blocks)
