"""A plane, or a curved surface, over a picture.

The vergence 1/z of a plane is linear over its picture: Z = Z_0 + a X + b Y with X = t_x Z and Y = t_y Z gives
1/Z = (1 - a t_x - b t_y) / Z_0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from metafab.core.conventions import FloatArray


@dataclass(frozen=True)
class Plane:
    """Vergence that is linear over the picture, or quadratic on a curved surface."""

    vergence_per_m: float  #: 1/depth at ``centre``.
    #: Its change per downsampled pixel along (y, x); (0, 0) for one depth.
    slope_per_m: tuple[float, float] = (0.0, 0.0)
    centre: tuple[float, float] = (0.0, 0.0)  #: (row, column), downsampled pixels.
    #: Factors of y^2, y x and x^2 from the centre, per squared downsampled pixel; (0, 0, 0) for a plane.
    curvature_per_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def tilted(self) -> bool:
        """Whether the surface has more than one depth."""
        return self.slope_per_m != (0.0, 0.0) or self.curved

    @property
    def curved(self) -> bool:
        """Whether the surface is no plane."""
        return self.curvature_per_m != (0.0, 0.0, 0.0)

    def at(self, row: FloatArray, column: FloatArray) -> FloatArray:
        """1/depth (1/m) at places in downsampled pixels, scalars or arrays that broadcast.

        It is at least a hundredth of that at the centre.
        """
        y, x = row - self.centre[0], column - self.centre[1]
        rise = self.slope_per_m[0] * y + self.slope_per_m[1] * x
        if self.curved:
            yy, yx, xx = self.curvature_per_m
            rise = rise + yy * y**2 + yx * y * x + xx * x**2
        return np.maximum(self.vergence_per_m + rise, 0.01 * self.vergence_per_m)

    def moved(self, rows: int, columns: int) -> Plane:
        """The plane in a picture whose contents are moved by some rows and columns."""
        return replace(self, centre=(self.centre[0] + rows, self.centre[1] + columns)) if self.tilted else self

    def over(self, shape: tuple[int, ...]) -> FloatArray:
        """1/depth at each pixel of a picture: shape ``shape``."""
        if not self.tilted:
            return np.broadcast_to(self.at(np.zeros(()), np.zeros(())), shape)
        row, column = np.ogrid[: shape[0], : shape[1]]
        return np.broadcast_to(self.at(row.astype(np.float64), column.astype(np.float64)), shape)
