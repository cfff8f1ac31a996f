"""From block sums to the field on one window of the sensor: a few matrix Fourier transforms.

The kernel h(R) exp(ikR) from a lens point r to a window point u is, exactly,

    exp(ik[R(r, 0) + R(0, u) - R(0, 0)]) x exp(ik l(r, u)) x (smooth rest),

l bilinear and separable in x and y. The first factor's r part belongs to the pupil's path, the second is a matrix
Fourier transform, and the rest (curvature, skew, obliquity, fall-off with distance) has low rank: it is sampled
on Chebyshev points and split by a singular value decomposition, sum over m of A_m(u) B_m(r).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metafab.core.conventions import ComplexArray, FloatArray
from metafab.core.numerics import HAS_NUMBA, compiled
from metafab.optics.path import Ray, incident_amplitude, path_um
from metafab.optics.pupil import Pupil

#: Block phases are reduced in double precision; what is left fits single precision: 1e-6 of the field at most.
SingleComplexArray = NDArray[np.complex64]

_EXTRA_NODES = 8


@dataclass(frozen=True)
class SmoothKernel:
    """The smooth rest of the kernel for one window, as a sum of products on Chebyshev points.

    Attributes:
        target_um: (x, y, z) of the window's centre point.
        offsets_um: shape (n,), window points along x and y from the centre.
        lens_um: ((lowest, highest) x, (lowest, highest) y) of block centres that it is good for.
        over_window: shape (rank, n, n), A_m on the window.
        on_lens: shape (rank, count, count), B_m on Chebyshev points of ``lens_um``.
    """

    target_um: tuple[float, float, float]
    offsets_um: FloatArray
    lens_um: tuple[tuple[float, float], tuple[float, float]]
    over_window: ComplexArray
    on_lens: ComplexArray

    @classmethod
    def build(
        cls,
        wavenumber: float,
        target_um: tuple[float, float, float],
        lens_um: tuple[tuple[float, float], tuple[float, float]],
        window_px: int,
        pixel_um: float,
        tolerance: float,
    ) -> SmoothKernel:
        """Sample and split the kernel to a relative error of ``tolerance``."""
        k, offsets = wavenumber, _offsets(window_px, pixel_um)
        spans = [*lens_um, *2 * [(float(offsets[0]), float(offsets[-1]))]]
        corners = np.array(np.meshgrid(*spans, indexing="ij")).reshape(4, -1)
        largest_rad = float(np.abs(k * _rest_um(target_um, *corners)).max())
        count = math.ceil(largest_rad + 0.5 * math.log10(1.0 / tolerance)) + _EXTRA_NODES
        nodes = [_chebyshev(*span, count) for span in spans]
        x, y = (axis.reshape(-1, 1) for axis in np.meshgrid(nodes[0], nodes[1]))
        u, v = (axis.reshape(1, -1) for axis in np.meshgrid(nodes[2], nodes[3]))
        distance = np.sqrt((target_um[0] + u - x) ** 2 + (target_um[1] + v - y) ** 2 + target_um[2] ** 2)
        kernel = target_um[2] / (2.0 * np.pi * distance**2) * (1.0 / distance - 1j * k)
        kernel = kernel * np.exp(1j * k * _rest_um(target_um, x, y, u, v))
        left, weight, right = np.linalg.svd(kernel, full_matrices=False)
        rank = max(1, int(np.count_nonzero(weight > tolerance * weight[0])))
        to_window = _interpolation(spans[2], count, offsets)
        sampled = (weight[:rank, None] * right[:rank]).reshape(rank, count, count)
        return cls(target_um, offsets, lens_um, to_window @ sampled @ to_window.T, left.T[:rank].reshape(sampled.shape))

    def over_pupil(self, pupil: Pupil) -> ComplexArray:
        """B_m at the block centres, shape (rank, n_y, n_x)."""
        count = self.on_lens.shape[1]
        to_x = _interpolation(self.lens_um[0], count, pupil.x_um)
        to_y = _interpolation(self.lens_um[1], count, pupil.y_um)
        return np.asarray(to_y @ self.on_lens @ to_x.T)


@dataclass(frozen=True)
class WindowTransform:
    """The linear map from block sums (path of ``target_um`` removed) to the window around it.

    Attributes:
        left: shape (n, n_y), transform along y.
        right: shape (n_x, n), transform along x.
        over_window: shape (rank, n, n), A_m with the block's own diffraction divided out.
        over_pupil: shape (rank, n_y, n_x), B_m.
    """

    left: SingleComplexArray
    right: SingleComplexArray
    over_window: ComplexArray
    over_pupil: SingleComplexArray

    @classmethod
    def build(cls, pupil: Pupil, kernel: SmoothKernel) -> WindowTransform:
        """The transform from the blocks of ``pupil`` to the window of ``kernel``."""
        k, offsets = pupil.wavenumber, kernel.offsets_um
        slope_x, slope_y = _slopes(kernel.target_um)
        left = np.exp(-1j * k * slope_y * np.outer(offsets, pupil.y_um))
        right = np.exp(-1j * k * slope_x * np.outer(pupil.x_um, offsets))
        block = pupil.carrier.block_sites
        diffraction_x = _dirichlet(k * slope_x * pupil.pitch_um[0] * offsets, block)
        diffraction_y = _dirichlet(k * slope_y * pupil.pitch_um[1] * offsets, block)
        return cls(
            left.astype(np.complex64),
            right.astype(np.complex64),
            kernel.over_window / np.outer(diffraction_y, diffraction_x),
            kernel.over_pupil(pupil).astype(np.complex64),
        )

    @property
    def rank(self) -> int:
        """Terms of the low-rank part."""
        return int(self.over_window.shape[0])

    @property
    def nbytes(self) -> int:
        """Memory held."""
        return sum(a.nbytes for a in (self.left, self.right, self.over_window, self.over_pupil))

    def field(self, blocks: SingleComplexArray) -> ComplexArray:
        """Field on the window, shape (n, n), of block sums of shape (n_y, n_x)."""
        total = np.zeros(self.over_window.shape[1:], dtype=np.complex128)
        for window, pupil in zip(self.over_window, self.over_pupil, strict=True):
            total += window * ((self.left @ (pupil * blocks)) @ self.right)
        return total

    def adjoint(self, field: ComplexArray) -> ComplexArray:
        """Block sums, shape (n_y, n_x), of a window field: the conjugate transpose of :meth:`field`."""
        total = np.zeros(self.over_pupil.shape[1:], dtype=np.complex128)
        for window, pupil in zip(self.over_window, self.over_pupil, strict=True):
            total += pupil.conj() * (self.left.conj().T @ (window.conj() * field) @ self.right.conj().T)
        return total


def refocus(pupil: Pupil, ray: Ray) -> SingleComplexArray:
    """Block sums behind another ray than the carrier: its path instead, and its incident amplitude.

    The change of path is evaluated at block centres; halving the blocks shows what that costs.
    """
    kernel = _refocus_compiled if HAS_NUMBA else _refocus_plain
    old, blocks = pupil.carrier.ray, np.empty(pupil.sums.shape, dtype=np.complex64)
    kernel(
        blocks, pupil.sums, pupil.x_um, pupil.y_um, pupil.wavenumber,
        ray.vergence_per_um, *ray.tangent, *ray.target_um, old.vergence_per_um, *old.tangent, *old.target_um,
    )  # fmt: skip
    return blocks


def _refocus_plain(
    blocks: Any, sums: Any, x: Any, y: Any, k: float,
    w: float, t_x: float, t_y: float, c_x: float, c_y: float, c_z: float,
    old_w: float, old_t_x: float, old_t_y: float, old_x: float, old_y: float, old_z: float,
) -> None:  # fmt: skip
    path = path_um(x[None, :], y[:, None], w, t_x, t_y, c_x, c_y, c_z)
    path -= path_um(x[None, :], y[:, None], old_w, old_t_x, old_t_y, old_x, old_y, old_z)
    blocks[...] = sums * np.exp(1j * k * path) * incident_amplitude(x[None, :], y[:, None], w, t_x, t_y)


@compiled
def _refocus_compiled(
    blocks: Any, sums: Any, x: Any, y: Any, k: float,
    w: float, t_x: float, t_y: float, c_x: float, c_y: float, c_z: float,
    old_w: float, old_t_x: float, old_t_y: float, old_x: float, old_y: float, old_z: float,
) -> None:  # fmt: skip
    for i in range(y.size):
        for j in range(x.size):
            if sums[i, j] == 0.0:
                blocks[i, j] = 0.0
                continue
            path = path_um(x[j], y[i], w, t_x, t_y, c_x, c_y, c_z)
            path -= path_um(x[j], y[i], old_w, old_t_x, old_t_y, old_x, old_y, old_z)
            phase = k * path
            amplitude = incident_amplitude(x[j], y[i], w, t_x, t_y)
            blocks[i, j] = sums[i, j] * (amplitude * math.cos(phase) + 1j * (amplitude * math.sin(phase)))


def _offsets(window_px: int, pixel_um: float) -> FloatArray:
    return np.multiply(np.arange(window_px) - window_px // 2, pixel_um, dtype=np.float64)


def _dirichlet(phase_per_site: FloatArray, sites: int) -> FloatArray:
    """Mean of exp(i phase n) over a centred run of ``sites``: the diffraction of a block, 1 for one site."""
    half = 0.5 * phase_per_site
    steep = np.abs(np.sin(half)) > 1e-9
    safe = np.where(steep, half, 1.0)
    return np.where(steep, np.sin(sites * safe) / (sites * np.sin(safe)), 1.0)


def _slopes(target_um: tuple[float, float, float]) -> tuple[float, float]:
    """-d^2 R / dx du and -d^2 R / dy dv at the centres: (1 - s^2) / R with the direction cosines s."""
    distance = math.dist(target_um, (0.0, 0.0, 0.0))
    s_x, s_y = target_um[0] / distance, target_um[1] / distance
    return (1.0 - s_x * s_x) / distance, (1.0 - s_y * s_y) / distance


def _rest_um(target_um: tuple[float, float, float], x: Any, y: Any, u: Any, v: Any) -> FloatArray:
    """R(r, u) - R(r, 0) - R(0, u) + R(0, 0) - l(r, u)."""
    c_x, c_y, c_z = target_um
    slope_x, slope_y = _slopes(target_um)
    mixed = (
        np.sqrt((c_x + u - x) ** 2 + (c_y + v - y) ** 2 + c_z**2)
        - np.sqrt((c_x - x) ** 2 + (c_y - y) ** 2 + c_z**2)
        - np.sqrt((c_x + u) ** 2 + (c_y + v) ** 2 + c_z**2)
        + math.dist(target_um, (0.0, 0.0, 0.0))
    )
    return np.asarray(mixed + slope_x * u * x + slope_y * v * y)


def _chebyshev(low: float, high: float, count: int) -> FloatArray:
    angle = np.pi * (np.arange(count) + 0.5) / count
    return 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)


def _interpolation(span: tuple[float, float], count: int, points: FloatArray) -> FloatArray:
    """Matrix (n_points, count) of polynomial interpolation between Chebyshev points of the first kind."""
    low, high = span
    if high == low:
        return np.full((points.size, count), 1.0 / count)
    angles = np.arccos(np.clip((low + high - 2.0 * points) / (high - low), -1.0, 1.0))
    order = np.arange(count)
    cosines = np.cos(np.outer(angles, order)) * np.where(order == 0, 1.0, 2.0) / count
    return np.asarray(cosines @ np.cos(np.outer(order, np.pi * (order + 0.5) / count)))
