"""Position, height and orientation of the main lobe of a PSF, to a small fraction of a pixel."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import RectBivariateSpline

from metafab.core.conventions import FloatArray

_REACH_PX = 6
_NEWTON_STEPS = 12


def main_lobe_px(psf: FloatArray) -> tuple[float, float, float]:
    """Return the position and height of the highest maximum, by a quintic spline through the pixels around it.

    Args:
        psf: shape (n_y, n_x), irradiance sampled at or above its Nyquist rate.

    Returns:
        (x, y) in pixels from the centre pixel ``[n_y // 2, n_x // 2]``, and the irradiance there.
    """
    n_y, n_x = psf.shape
    row, column = divmod(int(np.argmax(psf)), n_x)
    rows = np.arange(max(0, row - _REACH_PX), min(n_y, row + _REACH_PX + 1))
    columns = np.arange(max(0, column - _REACH_PX), min(n_x, column + _REACH_PX + 1))
    degree = min(5, rows.size - 1, columns.size - 1)
    if degree < 3:
        return float(column - n_x // 2), float(row - n_y // 2), float(psf[row, column])
    spline = RectBivariateSpline(rows, columns, psf[np.ix_(rows, columns)], kx=degree, ky=degree)

    def value(y: float, x: float, dy: int = 0, dx: int = 0) -> float:
        return float(spline([y], [x], dx=dy, dy=dx, grid=False)[0])

    y, x = float(row), float(column)
    for _ in range(_NEWTON_STEPS):
        slope = np.array([value(y, x, 1, 0), value(y, x, 0, 1)])
        mixed = value(y, x, 1, 1)
        hessian = np.array([[value(y, x, 2, 0), mixed], [mixed, value(y, x, 0, 2)]])
        if np.linalg.det(hessian) <= 0.0 or hessian[0, 0] >= 0.0:
            break
        step = np.clip(np.linalg.solve(hessian, slope), -0.5, 0.5)
        y = min(max(y - step[0], row - 1.0, rows[0]), row + 1.0, rows[-1])
        x = min(max(x - step[1], column - 1.0, columns[0]), column + 1.0, columns[-1])
        if np.abs(step).max() < 1e-9:
            break
    return x - n_x // 2, y - n_y // 2, value(y, x)


def orientation_deg(psf: FloatArray) -> FloatArray:
    """Return ``phi_deg`` of each image: the angle of the main lobe about the centre pixel, counter-clockwise from +x.

    The angle is meaningless for a lobe at the centre, as of an ordinary lens.

    Args:
        psf: shape (n, n_y, n_x).

    Returns:
        Shape (n,), in (-180, 180]; NaN for a dark image.
    """
    places = [main_lobe_px(image) if image.any() else (math.nan, math.nan, 0.0) for image in psf]
    return np.array([math.degrees(math.atan2(y, x)) for x, y, _ in places])
