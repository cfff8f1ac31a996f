"""Directions in the scene to places on the sensor and back, for both polarisations.

A direction is the pair of tangents (x/z, y/z) of an object point. The images are inverted: an object at +x appears at
-x of the geometric image point of the axis. The two images of the split lens have opposite distortion, some 15 pixels
over the field of Shen 2023. The place of a pixel's twin is therefore computed from the maps of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyder, polyvander
from numpy.typing import NDArray

from metafab.core.conventions import FloatArray
from metafab.core.numeric.compiled import compiled
from metafab.optics.point_spread import Psf

#: Newton's steps to a direction. Over the field of the small lens the image is then 1e-13 um off, after three steps
#: 1e-8 um.
_NEWTON_STEPS = 4
#: Share of the calibrated field by which directions may lie outside of it on either side.
_BEYOND = 0.05
#: Places that are evaluated together: a row of them stays in the cache.
_PLACES = 1024


@dataclass(frozen=True)
class ImageMap:
    """The geometric images of both polarisations as polynomials through the calibrated field points."""

    scale: float  #: Largest tangent of the field points; the argument of the polynomials is tangent / scale.
    #: Shape (2, 2, n_y, n_x), over polarisation, (x, y) on the sensor, powers of y and of x.
    coefficients_um: FloatArray
    #: Lowest and highest calibrated tangent along x and along y; infinite for a pair without a field.
    field: tuple[tuple[float, float], tuple[float, float]] = ((-np.inf, np.inf), (-np.inf, np.inf))

    @classmethod
    def from_psf(cls, psf: Psf) -> ImageMap:
        """The map at the middle depth of ``psf``; without field points, the image of an inverting pinhole."""
        middle = psf.depth_m.size // 2
        if psf.field is None:
            coefficients = np.zeros((2, 2, 2, 2))
            coefficients[:, :, 0, 0] = psf.centre_um[:, middle]
            coefficients[:, 0, 0, 1] = coefficients[:, 1, 1, 0] = -psf.sensor_distance_um
            return cls(1.0, coefficients)
        tangent_x, tangent_y = psf.field.tangent_x, psf.field.tangent_y
        scale = float(max(np.abs(tangent_x).max(), np.abs(tangent_y).max())) or 1.0
        inverse_x = _fit(tangent_x / scale)
        inverse_y = _fit(tangent_y / scale)
        centre = psf.field.centre_um[:, middle]
        coefficients = np.einsum("ij,pjkc,lk->pcil", inverse_y, centre, inverse_x)
        # A single field point along an axis still needs a slope: the pinhole's.
        if tangent_x.size == 1:
            coefficients = np.concatenate([coefficients, np.zeros_like(coefficients)], axis=3)
            coefficients[:, 0, 0, 1] = -psf.sensor_distance_um * scale
        if tangent_y.size == 1:
            coefficients = np.concatenate([coefficients, np.zeros_like(coefficients)], axis=2)
            coefficients[:, 1, 1, 0] = -psf.sensor_distance_um * scale
        return cls(scale, coefficients, (_span(tangent_x), _span(tangent_y)))

    def covers(self, tangent_x: FloatArray, tangent_y: FloatArray) -> NDArray[np.bool_]:
        """Whether directions of any shape lie in the calibrated field, or hardly beyond; of that shape."""
        (left, right), (low, high) = self.field
        return np.asarray((tangent_x >= left) & (tangent_x <= right) & (tangent_y >= low) & (tangent_y <= high))

    def to_sensor_um(
        self, polarisation: int, tangent_x: FloatArray, tangent_y: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Geometric image (x, y) on the sensor, um, of directions x/z and y/z of any shape, each of that shape.

        Polarisation 0 is x, 1 is y.
        """
        x, y = self._polynomials(self.coefficients_um[polarisation], tangent_x, tangent_y)
        return x, y

    def jacobian_um(self, polarisation: int, tangent_x: FloatArray, tangent_y: FloatArray) -> FloatArray:
        """d(x, y) / d(tangent_x, tangent_y) at directions of any shape (...): shape (..., 2, 2), um."""
        by_x, by_y = (polyder(self.coefficients_um[polarisation], axis=axis) / self.scale for axis in (2, 1))
        by_tangent = [self._polynomials(slopes, tangent_x, tangent_y) for slopes in (by_x, by_y)]
        return np.moveaxis(np.stack(by_tangent, axis=1), (0, 1), (-2, -1))

    def _polynomials(self, coefficients: FloatArray, tangent_x: FloatArray, tangent_y: FloatArray) -> FloatArray:
        """Polynomials, coefficients of shape (2, n_y, n_x), at directions of any shape (...): shape (2, ...)."""
        x, y = np.broadcast_arrays(tangent_x, tangent_y)
        out = np.empty((2, x.size))
        _evaluate(np.ascontiguousarray(coefficients), np.ravel(x / self.scale), np.ravel(y / self.scale), out)
        return out.reshape(2, *x.shape)

    def to_tangent(self, polarisation: int, x_um: FloatArray, y_um: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The direction (x/z, y/z) whose geometric image is at (x, y) on the sensor, by Newton's method from the axis.

        Places have any shape, which directions share; polarisation 0 is x, 1 is y. Far outside the calibrated field the
        map may not be invertible; see :meth:`covers`.
        """
        tangent_x, tangent_y = np.zeros(()), np.zeros(())  # The first step is linear: one expansion for all places.
        limit = 2.0 * self.scale if self.scale < 1.0 else 1.0
        for _ in range(_NEWTON_STEPS):
            x, y = self.to_sensor_um(polarisation, tangent_x, tangent_y)
            jacobian = self.jacobian_um(polarisation, tangent_x, tangent_y)
            determinant = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
            dx, dy = x_um - x, y_um - y
            step_x = (jacobian[..., 1, 1] * dx - jacobian[..., 0, 1] * dy) / determinant
            step_y = (jacobian[..., 0, 0] * dy - jacobian[..., 1, 0] * dx) / determinant
            tangent_x = np.clip(tangent_x + step_x, -limit, limit)
            tangent_y = np.clip(tangent_y + step_y, -limit, limit)
        return tangent_x, tangent_y

    def area_um2(self, polarisation: int, tangent_x: FloatArray, tangent_y: FloatArray) -> FloatArray:
        """Sensor area per unit area of tangents, um^2, at directions of any shape: the same shape."""
        return np.asarray(np.abs(np.linalg.det(self.jacobian_um(polarisation, tangent_x, tangent_y))))


@compiled
def _evaluate(coefficients: FloatArray, u: FloatArray, v: FloatArray, out: FloatArray) -> None:
    """Two polynomials by Horner's rule, shape (2, n), from powers of v and of u: coefficients (2, n_v, n_u).

    The loops over places are innermost, for vector instructions, and short, for the cache.
    """
    row = np.empty(_PLACES)
    for start in range(0, u.size, _PLACES):
        along, across = u[start : start + _PLACES], v[start : start + _PLACES]
        for k in range(len(out)):
            value, c = out[k, start : start + _PLACES], coefficients[k]
            value[:] = 0.0
            for i in range(c.shape[0] - 1, -1, -1):
                row[:] = 0.0
                for j in range(c.shape[1] - 1, -1, -1):
                    for place in range(value.size):
                        row[place] = row[place] * along[place] + c[i, j]
                for place in range(value.size):
                    value[place] = value[place] * across[place] + row[place]


def _span(tangents: FloatArray) -> tuple[float, float]:
    """Range of usable directions along one axis; unlimited for a single field point."""
    if tangents.size == 1:
        return -np.inf, np.inf
    low, high = float(tangents.min()), float(tangents.max())
    return low - _BEYOND * (high - low), high + _BEYOND * (high - low)


def _fit(nodes: FloatArray) -> FloatArray:
    """Matrix from values at the nodes to power coefficients of the polynomial through them (degree 5 at most)."""
    return np.asarray(np.linalg.pinv(polyvander(nodes, min(nodes.size - 1, 5))))
