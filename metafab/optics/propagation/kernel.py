"""Propagation kernel from the lens to one window of the sensor: a separable part times a low-rank rest.

The kernel h(R) exp(ikR) from a lens point (x, y) to a window point (u, v) is, up to a phase on the window alone,

    exp(ik R(x, y; 0, 0)) x exp(ik X(x, u)) x exp(ik Y(y, v)) x rest(x, y, u, v).

The first factor belongs to the path over the pupil. X and Y are the exact changes of distance along the axes. Each
depends on one lens and one window coordinate, so that they are the two matrices of a separable transform. The rest
(curvature and skew off the axes, obliquity, decay with distance) is smooth and has low rank: it is sampled on Chebyshev
points and split by a singular value decomposition, sum over m of A_m(u, v) B_m(x, y).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numeric import chebyshev
from metafab.core.numeric.chebyshev import Span

#: Block phases are reduced in double precision. The rest fits single precision, with errors of at most 1e-6 of the
#: field.
SingleComplexArray = NDArray[np.complex64]

#: Size of the kernel cache (least recently used out first), and the largest window that is cached: up to 2 MB each.
_KERNELS_KEPT, _LARGEST_KEPT_PX = 16, 128

#: Vectors of the first random sketch of a kernel, and surplus vectors among them, which make the others exact.
_SKETCH, _SPARE = 40, 8


@dataclass(frozen=True)
class KernelSpec:
    """Lens, window and accuracy of a kernel."""

    wavenumber: float  #: k, rad/um, of the blocks or of another wavelength.
    #: (x, y, z) of the window's centre, point ``window_px // 2`` along either side.
    target_um: tuple[float, float, float]
    lens_um: tuple[Span, Span]  #: ((lowest, highest) x, (lowest, highest) y) of the block centres.
    window_px: int  #: Points along a side.
    pixel_um: float  #: Distance of points.
    tolerance: float  #: Relative error of the low-rank rest, 1e-7 or more.

    @property
    def offsets_um(self) -> FloatArray:
        """Window points along x and y from the centre, shape (window_px,)."""
        return np.multiply(np.arange(self.window_px) - self.window_px // 2, self.pixel_um, dtype=np.float64)


@dataclass(frozen=True)
class WindowKernel:
    """Propagation from Chebyshev points of the lens to one window, for blocks of any size."""

    spec: KernelSpec  #: Lens, window and accuracy.
    left: SingleComplexArray  #: Shape (n, q_y), exp(ik Y).
    right: SingleComplexArray  #: Shape (q_x, n), exp(ik X).
    over_window: SingleComplexArray  #: Shape (rank, n, n), A_m.
    over_lens: SingleComplexArray  #: Shape (rank, q_y, q_x), B_m.

    @classmethod
    def build(cls, spec: KernelSpec) -> WindowKernel:
        """Sample and split the kernel; kernels of up to 128 points a side are cached for other depths and masks."""
        return _build(spec) if spec.window_px <= _LARGEST_KEPT_PX else _build.__wrapped__(spec)

    @staticmethod
    def clear_cache() -> None:
        """Drop all cached kernels."""
        _build.cache_clear()

    @property
    def rank(self) -> int:
        """Number of low-rank terms."""
        return int(self.over_window.shape[0])


def largest_changes_rad(
    wavenumber: float, target_um: tuple[float, float, float], lens_um: tuple[Span, Span], window_um: Span
) -> tuple[float, float, float]:
    """Return the largest phases kX, kY and of the rest, rad, at the corners of the lens and of the window.

    The window spans ``window_um`` along either axis.
    """
    corners = np.array(np.meshgrid(*lens_um, window_um, window_um, indexing="ij")).reshape(4, -1)
    x, y, rest = (wavenumber * float(np.abs(change).max()) for change in _changes_um(target_um, *corners))
    return x, y, rest


@lru_cache(maxsize=_KERNELS_KEPT)
def _build(spec: KernelSpec) -> WindowKernel:
    k, target_um, lens_um, offsets = spec.wavenumber, spec.target_um, spec.lens_um, spec.offsets_um
    span = (float(offsets[0]), float(offsets[-1]))
    x_rad, y_rad, rest_rad = largest_changes_rad(k, target_um, lens_um, span)
    x = chebyshev.points(lens_um[0], chebyshev.points_needed(x_rad, spec.tolerance))
    y = chebyshev.points(lens_um[1], chebyshev.points_needed(y_rad, spec.tolerance))
    over_window, over_lens = _split_rest(spec, span, rest_rad)
    to_window = chebyshev.interpolation(span, over_window.shape[1], offsets)
    to_x = chebyshev.interpolation(lens_um[0], over_lens.shape[1], x)
    to_y = chebyshev.interpolation(lens_um[1], over_lens.shape[1], y)
    along_x, _, _ = _changes_um(target_um, x[:, None], 0.0, offsets[None, :], 0.0)
    _, along_y, _ = _changes_um(target_um, 0.0, y[None, :], 0.0, offsets[:, None])
    return WindowKernel(
        spec,
        np.exp(1j * k * along_y).astype(np.complex64),
        np.exp(1j * k * along_x).astype(np.complex64),
        (to_window @ over_window @ to_window.T).astype(np.complex64),
        (to_y @ over_lens @ to_x.T).astype(np.complex64),
    )


def _split_rest(spec: KernelSpec, window_um: Span, rest_rad: float) -> tuple[ComplexArray, ComplexArray]:
    """A_m and B_m, each of shape (rank, count, count), on Chebyshev points of the window and of the lens."""
    count = chebyshev.points_needed(rest_rad, spec.tolerance)
    x, y = np.meshgrid(*(chebyshev.points(span, count) for span in spec.lens_um))
    u, v = np.meshgrid(*(chebyshev.points(span, count) for span in (window_um, window_um)))
    x, y, u, v = x.reshape(-1, 1), y.reshape(-1, 1), u.reshape(1, -1), v.reshape(1, -1)
    _, _, rest = _changes_um(spec.target_um, x, y, u, v)
    c_x, c_y, c_z = spec.target_um
    distance = np.sqrt((c_x + u - x) ** 2 + (c_y + v - y) ** 2 + c_z**2)
    spreading = c_z / (2.0 * np.pi * distance**2) * (1.0 / distance - 1j * spec.wavenumber)
    kernel = spreading * np.exp(1j * spec.wavenumber * rest)
    kept = _leading_vectors(kernel, spec.tolerance)
    shape = (-1, count, count)
    return kept.reshape(shape), (kernel @ kept.conj().T).T.reshape(shape)


def _leading_vectors(matrix: ComplexArray, tolerance: float) -> ComplexArray:
    """Fewest right singular vectors, rows of (rank, n), that hold a square matrix to ``tolerance``, weakest first.

    The range is found by a random sketch (Halko, Martinsson and Tropp, SIAM Review 53, 217, 2011), widened until the
    vectors miss a small enough part of the squared Frobenius norm, which is known to 1e-15.
    """
    whole, n = float(np.vdot(matrix, matrix).real), len(matrix)
    for width in (_SKETCH, 3 * _SKETCH, n):
        part = matrix
        if width < n:
            sketch = np.random.default_rng(0).standard_normal((n, width))
            part = np.linalg.qr(matrix @ sketch)[0].conj().T @ matrix
        _, values, vectors = np.linalg.svd(part, full_matrices=False)
        lost = whole - np.cumsum(values**2)
        small = np.flatnonzero(lost <= tolerance**2 * whole)
        if small.size and small[0] < width - _SPARE:
            break
    rank = int(small[0]) + 1 if small.size else n
    return np.asarray(vectors[:rank][::-1])


def _changes_um(
    target_um: tuple[float, float, float], x: Any, y: Any, u: Any, v: Any
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """X(x, u), Y(y, v) and the rest of R(x, y; u, v) - R(x, y; 0, 0) - R(0, 0; u, v) + R(0, 0; 0, 0)."""
    c_x, c_y, c_z = target_um

    def change(x: Any, y: Any, u: Any, v: Any) -> FloatArray:
        return np.asarray(
            np.sqrt((c_x + u - x) ** 2 + (c_y + v - y) ** 2 + c_z**2)
            - np.sqrt((c_x - x) ** 2 + (c_y - y) ** 2 + c_z**2)
            - np.sqrt((c_x + u) ** 2 + (c_y + v) ** 2 + c_z**2)
            + math.hypot(c_x, c_y, c_z)
        )

    along_x, along_y = change(x, 0.0, u, 0.0), change(0.0, y, 0.0, v)
    return along_x, along_y, change(x, y, u, v) - along_x - along_y
